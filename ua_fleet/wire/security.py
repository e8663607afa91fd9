"""UADP message security: a plain datagram made a secured one, and back (OPC 10000-14 7.2.4.4.2, 7.2.4.4.3).

    secured = key.protect(plain, payload_offset(plain), token_id, nonce, SecurityMode.SIGN_AND_ENCRYPT)
    heard = read_security(datagram)      # who claims to have sent it, and which key it needs; nothing of it is verified
    plain = key.unprotect(heard)         # or RemoteWireError(Cause.SIGNATURE)

The codec never sees a secured message: what `unprotect` returns is a message as `Codec.decode` takes it. Which key,
which nonce, which mode suffices and what was replayed is for `ua_fleet.pubsub.security`. This is the only module of the
protocol that uses `cryptography`.

Layout of the key data (table 155): SigningKey 32, EncryptingKey 16 or 32, KeyNonce 4. Counter block of AES-CTR (table
157): KeyNonce 4, MessageNonce 8, then the number of the block from 1, big endian. What follows the SecurityHeader is
encrypted, then everything is signed with HMAC-SHA256.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import IntEnum, StrEnum
from struct import Struct
from typing import Final, NamedTuple

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.ciphers.modes import CTR
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.hmac import HMAC

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.header import HAS_SECURITY_HEADER, NO_SECURITY, decode_flags
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.outline import encode_flags, read_outline

__all__ = [
    "MOST_ADDED_BYTES",
    "NONCE_BYTES",
    "SIGNATURE_BYTES",
    "MessageKey",
    "SecuredDatagram",
    "SecurityMode",
    "SecurityPolicy",
    "opened_form",
    "payload_offset",
    "read_security",
]

SIGNING_KEY_BYTES: Final = 32
KEY_NONCE_BYTES: Final = 4
NONCE_BYTES: Final = 8
"""Length of a MessageNonce (table 156)."""
SIGNATURE_BYTES: Final = 32
MOST_ADDED_BYTES: Final = 1 + len(NO_SECURITY) + NONCE_BYTES + SIGNATURE_BYTES
"""By so many bytes at most is a message longer when it is secured: ExtendedFlags1, SecurityHeader, signature."""
FIRST_BLOCK: Final = b"\0\0\0\1"

# SecurityFlags
IS_SIGNED: Final = 0x01
IS_ENCRYPTED: Final = 0x02
HAS_SECURITY_FOOTER: Final = 0x04
FORCE_KEY_RESET: Final = 0x08
RESERVED_SECURITY_FLAGS: Final = 0xF0

_SIGNED: Final = slice(-SIGNATURE_BYTES)
_SIGNATURE: Final = slice(-SIGNATURE_BYTES, None)
_FLAGS_TOKEN_NONCE_LENGTH = Struct("<BIB")

MOST_HEADS: Final = 1024
LONGEST_HEAD: Final = 64
"""A key remembers how so many heads of messages, none longer than this, are written in the other form."""


class SecurityPolicy(StrEnum):
    """The policies of UADP message security, by their URI (OPC 10000-7)."""

    AES128_CTR = "http://opcfoundation.org/UA/SecurityPolicy#PubSub-Aes128-CTR"
    AES256_CTR = "http://opcfoundation.org/UA/SecurityPolicy#PubSub-Aes256-CTR"

    @classmethod
    def named(cls, name: str) -> SecurityPolicy:
        """The policy of a name as `PubSub-Aes256-CTR`; KeyError for any other."""
        return _POLICIES_BY_NAME[name]

    @property
    def short_name(self) -> str:
        """What follows the # of the URI."""
        return self.value.rpartition("#")[2]

    @property
    def key_data_bytes(self) -> int:
        """Length of the key data of one token."""
        return SIGNING_KEY_BYTES + _ENCRYPTING_KEY_BYTES[self] + KEY_NONCE_BYTES


_ENCRYPTING_KEY_BYTES: Final = {SecurityPolicy.AES128_CTR: 16, SecurityPolicy.AES256_CTR: 32}
_POLICIES_BY_NAME: Final = {policy.short_name: policy for policy in SecurityPolicy}


class SecurityMode(IntEnum):
    """MessageSecurityMode (OPC 10000-4 7.20)."""

    NONE = 1
    SIGN = 2
    SIGN_AND_ENCRYPT = 3


_NONE: Final = SecurityMode.NONE
_SIGN: Final = SecurityMode.SIGN
_ENCRYPTED: Final = SecurityMode.SIGN_AND_ENCRYPT
_MODES: Final = {
    0: SecurityMode.NONE,
    IS_SIGNED: SecurityMode.SIGN,
    IS_SIGNED | IS_ENCRYPTED: SecurityMode.SIGN_AND_ENCRYPT,
}
_USUAL_MODES: Final = {flags: mode for flags, mode in _MODES.items() if mode is not _NONE}
_FLAGS: Final = {mode: flags for flags, mode in _MODES.items()}


class SecuredDatagram(NamedTuple):
    """What a datagram says about its sender and its security. Before `unprotect` all of it is a claim.

    Bytes up to `header_offset` precede the SecurityHeader, those from `payload_offset` on follow it.
    """

    datagram: bytes
    publisher_id: int | str | None
    publisher_id_type: int
    writer_group_id: int | None
    writer_ids: tuple[int, ...]
    """Of the payload header; empty without one."""
    is_action: bool
    is_discovery: bool
    mode: SecurityMode
    token_id: int
    nonce: bytes
    """8 bytes, or none in a message that is only signed (the form of table 154, its token id is 0)."""
    force_key_reset: bool
    header_offset: int
    payload_offset: int
    footer_size: int


# What our own publishers send: UADPFlags and ExtendedFlags1, PublisherId, GroupFlags, WriterGroupId, Count and
# DataSetWriterId, and then, in a secured message, SecurityFlags, SecurityTokenId, NonceLength and MessageNonce.
_USUAL_PLAIN: Final = Struct("<H2xB2xB2x")
_USUAL_SECURED: Final = Struct("<HHBHBHBIB8s")
_USUAL_HEAD_BYTES: Final = _USUAL_PLAIN.size
_USUAL_SECURED_HEAD_BYTES: Final = _USUAL_SECURED.size
_FEWEST_SECURED_BYTES: Final = _USUAL_SECURED.size + SIGNATURE_BYTES
_PLAIN_FLAGS: Final = 0x01F1
_SECURED_FLAGS: Final = 0x11F1
_UINT16: Final = PublisherIdType.UINT16.value
_flags_of_usual = _USUAL_PLAIN.unpack_from
_read_usual = _USUAL_SECURED.unpack_from
_new: Callable[[type[SecuredDatagram], tuple[object, ...]], SecuredDatagram]
_new = tuple.__new__  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]


def read_security(datagram: bytes) -> SecuredDatagram:
    """Read the outline and the SecurityHeader of any message, plain ones too (mode NONE); raises RemoteWireError."""
    try:
        values = _read_usual(datagram)
    except struct.error:
        return _read_any(datagram)
    start, publisher_id, group, writer_group_id, count, writer_id, flags, token_id, length, nonce = values
    if group != 1 or count != 1:
        return _read_any(datagram)
    if start == _PLAIN_FLAGS:
        mode, token_id, nonce, end = _NONE, 0, b"", _USUAL_HEAD_BYTES
    elif start != _SECURED_FLAGS or length != NONCE_BYTES or len(datagram) < _FEWEST_SECURED_BYTES:
        return _read_any(datagram)
    else:
        usual = _USUAL_MODES.get(flags)
        if usual is None:
            return _read_any(datagram)
        mode, end = usual, _USUAL_SECURED_HEAD_BYTES
    read = (
        datagram, publisher_id, _UINT16, writer_group_id, (writer_id,), False, False,
        mode, token_id, nonce, False, _USUAL_HEAD_BYTES, end, 0,
    )  # fmt: skip
    return _new(SecuredDatagram, read)


def _read_any(datagram: bytes) -> SecuredDatagram:
    cursor = Cursor(datagram)
    outline = read_outline(cursor)
    header_offset = cursor.position
    mode, token_id, nonce, force_key_reset, footer_size = _NONE, 0, b"", False, 0
    if outline.extended1 & HAS_SECURITY_HEADER:
        flags = cursor.byte()
        mode = _mode(flags, header_offset)
        token_id = cursor.uint32()
        nonce = cursor.take(cursor.byte())
        force_key_reset = bool(flags & FORCE_KEY_RESET)
        footer_size = cursor.uint16() if flags & HAS_SECURITY_FOOTER else 0
        if mode is not _NONE:
            _check_lengths(mode, len(nonce), footer_size, cursor)
    return SecuredDatagram(
        datagram,
        outline.publisher_id,
        outline.publisher_id_type,
        outline.writer_group_id,
        outline.writer_ids,
        outline.is_action,
        outline.is_discovery,
        mode,
        token_id,
        nonce,
        force_key_reset,
        header_offset,
        cursor.position,
        footer_size,
    )


def _mode(flags: int, offset: int) -> SecurityMode:
    mode = _MODES.get(flags & (IS_SIGNED | IS_ENCRYPTED))
    if mode is None or flags & RESERVED_SECURITY_FLAGS or (mode is _NONE and flags):
        raise RemoteWireError(Cause.SECURITY_FLAGS, f"SecurityFlags 0x{flags:02x}", offset)
    return mode


def _check_lengths(mode: SecurityMode, nonce_length: int, footer_size: int, cursor: Cursor) -> None:
    if nonce_length != NONCE_BYTES and (nonce_length or mode is _ENCRYPTED):
        raise RemoteWireError(Cause.NONCE_LENGTH, f"a nonce of {nonce_length} bytes", cursor.position)
    if cursor.remaining < SIGNATURE_BYTES:
        detail = f"{cursor.remaining} bytes left for a signature of {SIGNATURE_BYTES}"
        raise RemoteWireError(Cause.TRUNCATED, detail, cursor.position)
    if cursor.remaining < SIGNATURE_BYTES + footer_size:
        raise RemoteWireError(Cause.SECURITY_FOOTER, f"a footer of {footer_size} bytes", cursor.position)


def payload_offset(datagram: bytes) -> int:
    """Where the SecurityHeader of a plain message would stand; behind the empty one that discovery messages have.

    The ActionHeader follows it. Raises LocalWireError for a message that is secured already.
    """
    try:
        flags, group, count = _flags_of_usual(datagram)
    except struct.error:
        pass  # too short to be one of ours
    else:
        if flags == _PLAIN_FLAGS and group == 1 and count == 1:
            return _USUAL_HEAD_BYTES
    read = _read_any(datagram)
    if read.mode is not _NONE:
        raise LocalWireError("a message that is secured already")
    return read.payload_offset


class MessageKey:
    """The key of one security token. It is never shown, and not for use in several threads at once."""

    __slots__ = (
        "_key_nonce",
        "_mac",
        "_mode",
        "_plain_heads",
        "_reset_nonce",
        "_secured_heads",
        "_token_id",
        "_update",
        "policy",
    )

    def __init__(self, policy: SecurityPolicy, key_data: bytes) -> None:
        """Raises LocalWireError for key data of another length than the policy's."""
        if len(key_data) != policy.key_data_bytes:
            length = f"{policy.key_data_bytes} bytes, not {len(key_data)}"
            raise LocalWireError(f"the key data of {policy.short_name} has {length}")
        self.policy = policy
        self._key_nonce = key_data[-KEY_NONCE_BYTES:]
        self._mac = HMAC(key_data[:SIGNING_KEY_BYTES], SHA256()).copy
        # One context serves both directions: AES-CTR decrypts by encrypting again.
        context = Cipher(AES(key_data[SIGNING_KEY_BYTES:-KEY_NONCE_BYTES]), CTR(bytes(16))).encryptor()
        self._reset_nonce = context.reset_nonce
        self._update = context.update
        self._plain_heads: dict[bytes, bytes] = {}
        """From heads of verified messages to those of the plain ones."""
        self._secured_heads: dict[bytes, bytes] = {}
        """The way back, for the token id and the mode of the last message that was protected."""
        self._token_id: int = 0
        self._mode: SecurityMode = _NONE

    def __repr__(self) -> str:
        return f"MessageKey({self.policy.short_name})"

    def protect(
        self,
        datagram: bytes,
        payload_offset: int,
        token_id: int,
        nonce: bytes,
        mode: SecurityMode,
        *,
        force_key_reset: bool = False,
    ) -> bytes:
        """The secured form of a plain message whose payload begins at `payload_offset`.

        The nonce must never have been used with this key. Raises LocalWireError for what cannot be secured so.
        """
        if len(nonce) != NONCE_BYTES:
            raise LocalWireError(f"a MessageNonce has {NONCE_BYTES} bytes, not {len(nonce)}")
        if mode is not self._mode or token_id != self._token_id:
            self._secured_heads.clear()
            self._mode, self._token_id = mode, token_id
        if force_key_reset:
            head = _secured_head(datagram[:payload_offset], token_id, mode, FORCE_KEY_RESET)
        else:
            try:
                head = self._secured_heads[datagram[:payload_offset]]
            except KeyError:
                plain = datagram[:payload_offset]
                head = _secured_head(plain, token_id, mode)
                _remember(self._secured_heads, plain, head)
        if mode is _ENCRYPTED:
            self._reset_nonce(self._key_nonce + nonce + FIRST_BLOCK)
            signed = head + nonce + self._update(datagram[payload_offset:])
        else:
            signed = head + nonce + datagram[payload_offset:]
        mac = self._mac()
        mac.update(signed)
        return signed + mac.finalize()

    def unprotect(self, secured: SecuredDatagram) -> bytes:
        """The plain form of a secured message; RemoteWireError(Cause.SIGNATURE) unless this key signed it.

        It is verified before anything is decrypted. The SecurityHeader is gone, or empty in a discovery message.
        """
        datagram, mode = secured.datagram, secured.mode
        signed = datagram[_SIGNED]
        mac = self._mac()
        mac.update(signed)
        try:
            mac.verify(datagram[_SIGNATURE])  # in constant time
        except InvalidSignature:
            raise RemoteWireError(Cause.SIGNATURE, "not the signature of this key and message") from None
        if mode is _ENCRYPTED:
            self._reset_nonce(self._key_nonce + secured.nonce + FIRST_BLOCK)
            payload = self._update(signed[secured.payload_offset :])
        elif mode is _SIGN:
            payload = signed[secured.payload_offset :]
        else:
            raise RemoteWireError(Cause.SIGNATURE, "no SecurityHeader that says so", secured.header_offset)
        if secured.footer_size:
            payload = payload[: -secured.footer_size]
        try:
            return self._plain_heads[datagram[: secured.header_offset]] + payload
        except KeyError:
            head = _plain_head(secured)
            _remember(self._plain_heads, datagram[: secured.header_offset], head)
            return head + payload


def without_security(secured: SecuredDatagram) -> bytes:
    """The plain form of a message that is signed only, not verified: for people to look at, not to be taken as data."""
    datagram = secured.datagram
    return _plain_head(secured) + datagram[secured.payload_offset : -SIGNATURE_BYTES - secured.footer_size]


def opened_form(secured: SecuredDatagram, plain: bytes) -> bytes:
    """A secured message as it was sent, but for what was encrypted, which stands in plain: for people to look at.

    Args:
        secured: which has been verified.
        plain: what `unprotect` has made of it.
    """
    datagram, start = secured.datagram, secured.payload_offset
    if secured.mode is not _ENCRYPTED:
        return datagram
    end = len(datagram) - SIGNATURE_BYTES - secured.footer_size
    return datagram[:start] + plain[len(plain) - (end - start) :] + datagram[end:]


def _secured_head(plain_head: bytes, token_id: int, mode: SecurityMode, more_flags: int = 0) -> bytes:
    """The head of a secured message up to its nonce, from the head of the plain one."""
    if mode is _NONE:
        raise LocalWireError("a message is not protected with the mode None")
    if not 0 <= token_id <= 0xFFFF_FFFF:
        raise LocalWireError(f"a SecurityTokenId is a UInt32: {token_id}")
    cursor = Cursor(plain_head)
    try:
        outline = read_outline(cursor)
    except RemoteWireError as error:
        raise LocalWireError(f"the head of a message that cannot be secured: {error}") from error
    empty = NO_SECURITY if outline.extended1 & HAS_SECURITY_HEADER else b""
    if plain_head[cursor.position :] != empty:
        raise LocalWireError("a message that is secured already, or whose payload begins elsewhere")
    flags = encode_flags(outline.flags, outline.extended1 | HAS_SECURITY_HEADER, outline.extended2)
    security_header = _FLAGS_TOKEN_NONCE_LENGTH.pack(_FLAGS[mode] | more_flags, token_id, NONCE_BYTES)
    return flags + plain_head[outline.flags_size : cursor.position] + security_header


def _plain_head(secured: SecuredDatagram) -> bytes:
    """The head of a plain message, from that of the secured one; a discovery message keeps an empty SecurityHeader."""
    cursor = Cursor(secured.datagram, 0, secured.header_offset)
    flags, extended1, extended2 = decode_flags(cursor)
    names = cursor.take(cursor.remaining)
    if secured.is_discovery:
        return encode_flags(flags, extended1, extended2) + names + NO_SECURITY
    return encode_flags(flags, extended1 & ~HAS_SECURITY_HEADER, extended2) + names


def _remember(heads: dict[bytes, bytes], head: bytes, other_form: bytes) -> None:
    if len(head) <= LONGEST_HEAD:
        if len(heads) >= MOST_HEADS:
            del heads[next(iter(heads))]
        heads[head] = other_form
