"""Chunks of messages under the keys of one token (OPC 10000-6 6.7.2), sealed and opened without an object for a header.

Only what is sent and received all the time: single chunks of MSG messages and their keys. What is not opened here is
looked at by asyncua's code, which knows the keys before these, all other kinds of chunks, and what is wrong with one.
"""

from __future__ import annotations

import hmac
import struct
from collections.abc import Callable
from typing import Any, Final

from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.modes import CBC
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.hmac import HMAC

__all__ = [
    "HEAD",
    "LAST",
    "MORE",
    "NO_KEYS",
    "SEQUENCE",
    "ChunkKeys",
    "most_body",
    "open_chunk",
    "opening_keys",
    "seal_chunk",
    "sealing_keys",
]

HEAD: Final = struct.Struct("<4sIII")
"""Message type and kind of chunk, size, SecureChannelId, TokenId."""
SEQUENCE: Final = struct.Struct("<II")
"""SequenceNumber and RequestId."""
LAST: Final = b"MSGF"
MORE: Final = b"MSGC"
_SIGNATURE: Final = 32
_BLOCK: Final = 16
"""Of AES, whatever its key."""
_PADDINGS: Final = tuple(bytes([size]) * (size + 1) for size in range(_BLOCK))
"""PaddingSize and so many bytes, each of this value."""


class _Cipher:
    """AES in CBC mode by which each chunk begins with the same vector, in one direction.

    One context of OpenSSL goes on from chunk to chunk. It takes the last encrypted block of the one before for the
    vector, which the first block of each makes up for: a context for each would take as long as encrypting does.
    """

    __slots__ = ("_before", "_update", "_vector")

    def __init__(self, update: Callable[[bytes], bytes], vector: bytes) -> None:
        self._update = update
        self._before = self._vector = int.from_bytes(vector)

    def encrypted(self, plain: bytes) -> bytes:
        """The whole blocks of a chunk, at least one, encrypted."""
        made = self._update(self._from_vector(plain[:_BLOCK]) + plain[_BLOCK:])
        self._before = int.from_bytes(made[-_BLOCK:])
        return made

    def decrypted(self, made: bytes) -> bytes:
        """The whole blocks of a chunk, at least one, decrypted."""
        plain = self._update(made)
        plain = self._from_vector(plain[:_BLOCK]) + plain[_BLOCK:]
        self._before = int.from_bytes(made[-_BLOCK:])
        return plain

    def _from_vector(self, first: bytes) -> bytes:
        return (int.from_bytes(first) ^ self._before ^ self._vector).to_bytes(_BLOCK)


class ChunkKeys:
    """What the chunks of one direction are signed and encrypted by; without a cipher they are signed alone."""

    __slots__ = ("cipher", "signer")

    def __init__(self, signing_key: bytes | None, cipher: _Cipher | None) -> None:
        self.signer = None if signing_key is None else HMAC(signing_key, SHA256())
        self.cipher = cipher


NO_KEYS: Final = ChunkKeys(None, None)
"""Of a channel without security."""


def sealing_keys(key: bytes, cipher: Cipher[Any] | None) -> ChunkKeys:
    """What chunks are made by: HMAC-SHA256 and AES in CBC mode, as all policies of this server have them.

    Args:
        key: signs.
        cipher: encrypts; None where chunks are signed alone.
    """
    return ChunkKeys(key, None if cipher is None else _Cipher(cipher.encryptor().update, _vector_of(cipher)))


def opening_keys(key: bytes, cipher: Cipher[Any] | None) -> ChunkKeys:
    """What chunks are opened by; as `sealing_keys`."""
    return ChunkKeys(key, None if cipher is None else _Cipher(cipher.decryptor().update, _vector_of(cipher)))


def _vector_of(cipher: Cipher[Any]) -> bytes:
    mode: Any = cipher.mode
    assert isinstance(mode, CBC)
    return bytes(mode.initialization_vector)


def most_body(keys: ChunkKeys, chunk_bytes: int) -> int:
    """Bytes of a message that fit into one chunk."""
    room = chunk_bytes - HEAD.size
    if keys.signer is None:
        return room - SEQUENCE.size
    if keys.cipher is None:
        return room - SEQUENCE.size - _SIGNATURE
    return room // _BLOCK * _BLOCK - SEQUENCE.size - _SIGNATURE - 1


def open_chunk(frame: bytes, keys: ChunkKeys) -> bytes | None:
    """SequenceHeader and body of a chunk; None where these keys do not open it, for whatever reason."""
    signer = keys.signer
    if signer is None:
        return frame[HEAD.size :]
    plain = frame[HEAD.size :]
    if keys.cipher is not None:
        if len(plain) % _BLOCK or not plain:
            return None
        plain = keys.cipher.decrypted(plain)
    end = len(plain) - _SIGNATURE
    if end < SEQUENCE.size:
        return None
    check = signer.copy()
    check.update(frame[: HEAD.size] + plain[:end])
    if not hmac.compare_digest(check.finalize(), plain[end:]):
        return None
    if keys.cipher is None:
        return plain[:end]
    size = end - 1 - plain[end - 1]
    return plain[:size] if size >= SEQUENCE.size else None


def seal_chunk(kind: bytes, channel_id: int, token_id: int, sequence: bytes, body: bytes, keys: ChunkKeys) -> bytes:
    """A chunk.

    Args:
        kind: LAST or MORE.
        channel_id: of the channel.
        token_id: whose keys these are.
        sequence: its SequenceHeader.
        body: its part of the message, of at most `most_body`.
        keys: of the server's direction.
    """
    plain = sequence + body
    signer = keys.signer
    if signer is None:
        return HEAD.pack(kind, HEAD.size + len(plain), channel_id, token_id) + plain
    if keys.cipher is not None:
        plain += _PADDINGS[-(len(plain) + 1 + _SIGNATURE) % _BLOCK]
    head = HEAD.pack(kind, HEAD.size + len(plain) + _SIGNATURE, channel_id, token_id)
    made = signer.copy()
    made.update(head + plain)
    plain += made.finalize()
    return head + (plain if keys.cipher is None else keys.cipher.encrypted(plain))
