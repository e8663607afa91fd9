"""An OpenSecureChannel message as bytes (OPC 10000-6 6.7.2): its header in the clear, and what is encrypted behind it.

The keys are those of asyncua's policies, and so is what is done with them. The first message of a channel is opened
here; those of renewals go through asyncua's code, which knows what may come between two tokens.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import functools
import hashlib
import struct
from typing import Any, Final, NamedTuple

from asyncua import ua
from asyncua.crypto.security_policies import SecurityPolicyNone

from ua_fleet.endpoint.binary.builtin import encode_string
from ua_fleet.endpoint.chunks import SEQUENCE
from ua_fleet.endpoint.connection import FrameError
from ua_fleet.endpoint.stack import Refusal, StatusCodes
from ua_fleet.wire.builtin import decode_byte_string, decode_string
from ua_fleet.wire.cursor import Cursor

__all__ = [
    "NONE_URI",
    "OPENING",
    "Message",
    "OpenHeader",
    "Opening",
    "check_open_header",
    "open_opening",
    "seal_opening",
]

NONE_URI: Final = SecurityPolicyNone.URI
OPENING: Final = b"OPNF"
_HEAD: Final = struct.Struct("<4sII")
"""Message type and kind of chunk, size, SecureChannelId."""
_MOST_URI: Final = 255
"""Longest SecurityPolicyUri (OPC 10000-6 6.7.2.3)."""
_MOST_THUMBPRINT: Final = 20
_MOST_ENCRYPTED: Final = 4_096
"""Encrypted bytes of an OpenSecureChannel. Each 256 or 512 of them are one use of the server's private key; a client
with the longest keys needs some 1,500."""


class Message(NamedTuple):
    """A whole message of a client."""

    request_id: int
    body: bytes


class OpenHeader(NamedTuple):
    """What an OpenSecureChannel message says in the clear."""

    policy_uri: str
    certificate: bytes | None
    """SenderCertificate, with what was sent of its issuers."""
    thumbprint: bytes | None
    """ReceiverCertificateThumbprint: the SHA-1 of the certificate whose key it is encrypted for."""
    start: int
    """Where its encrypted part begins."""


class Opening(NamedTuple):
    """An OpenSecureChannel message, opened."""

    policy_uri: str
    certificate: bytes
    """SenderCertificate, with what was sent of its issuers."""
    message: Message


def check_open_header(frame: bytes) -> OpenHeader:
    """What a message says in the clear.

    Raises:
        RemoteWireError, Refusal: it has no such header.
        FrameError: more is encrypted than any client needs.
    """
    cursor = Cursor(frame, _HEAD.size)
    uri = decode_string(cursor) or ""
    certificate = decode_byte_string(cursor)
    thumbprint = decode_byte_string(cursor)
    if len(uri) > _MOST_URI or len(thumbprint or b"") > _MOST_THUMBPRINT:
        raise Refusal(StatusCodes.BadDecodingError, "a security header that is too long")
    rest = len(frame) - cursor.position
    if uri != NONE_URI and rest > _MOST_ENCRYPTED:
        raise FrameError(StatusCodes.BadTcpMessageTooLarge, f"{rest} encrypted bytes to open a channel")
    return OpenHeader(uri, certificate, thumbprint, cursor.position)


def open_opening(frame: bytes, start: int, policy: Any) -> tuple[int, Message]:
    """Sequence number and message of what is encrypted from `start` on, under our key and the client's signature.

    Raises:
        InvalidSignature: it is not signed by the client's certificate.
        ValueError, struct.error: it was not encrypted for us, or is no message.
    """
    crypto = policy.asymmetric_cryptography
    crypto.use_prev_key = False
    plain = crypto.decrypt(frame[start:])
    size = crypto.vsignature_size()
    if size:
        plain, signature = plain[:-size], plain[-size:]
        crypto.verify(frame[:start] + plain, signature)
    plain = crypto.remove_padding(plain)
    sequence, request_id = SEQUENCE.unpack_from(plain)
    return sequence, Message(request_id, plain[SEQUENCE.size :])


@functools.lru_cache(256)
def _security_header(uri: str, own: tuple[bytes, ...], peer: bytes | None) -> bytes:
    """The AsymmetricAlgorithmSecurityHeader of our messages to a client with this certificate."""
    thumbprint = hashlib.sha1(peer, usedforsecurity=False).digest() if peer else None
    return encode_string(uri) + encode_string(b"".join(own) or None) + encode_string(thumbprint)


def seal_opening(data: bytes, channel_id: int, sequence: bytes, policy: Any) -> bytes:
    """The message of an encoded response.

    Args:
        data: the response.
        channel_id: of the channel.
        sequence: its SequenceHeader.
        policy: asyncua's, of the channel.
    """
    crypto = policy.asymmetric_cryptography
    own: tuple[bytes, ...] = ()
    if policy.host_certificate and policy.Mode != ua.MessageSecurityMode.None_:
        own = policy.host_certificate, *policy.host_certificate_chain
    security = _security_header(policy.URI, own, policy.peer_certificate)
    plain = sequence + data
    plain += crypto.padding(len(plain))
    blocks = (len(plain) + crypto.signature_size()) // crypto.plain_block_size()
    size = _HEAD.size + len(security) + blocks * crypto.encrypted_block_size()
    head = _HEAD.pack(OPENING, size, channel_id) + security
    return head + bytes(crypto.encrypt(plain + crypto.signature(head + plain)))
