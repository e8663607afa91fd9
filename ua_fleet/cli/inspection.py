"""Looks into single messages for `pubsub decode`: what they are, whether they verify, what each byte says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ua_fleet.counters import Counters
from ua_fleet.dissect.annotate import annotate
from ua_fleet.dissect.spans import ByteSpan
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.security.reassembly import Reassembly
from ua_fleet.wire import Codec
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.chunks import Chunk, read_chunk
from ua_fleet.wire.generic import Decoded
from ua_fleet.wire.security import (
    SIGNATURE_BYTES,
    MessageKey,
    SecuredDatagram,
    SecurityMode,
    read_security,
    without_security,
)

__all__ = ["Inspected", "Inspector"]

MOST_MESSAGE_BYTES: Final = 64 * 1024 * 1024
"""A chunked message that announces more is refused."""
_NO_KEY: Final = "it is encrypted; give the key data of its SecurityGroup with --key"


@dataclass(frozen=True, slots=True)
class Inspected:
    """What is known about one message."""

    datagram: bytes
    spans: tuple[ByteSpan, ...]
    """Each of its bytes; where it could be decrypted, in plain."""
    security: SecuredDatagram | None = None
    """None where not even its header can be read."""
    verified: bool | None = None
    """None where there is nothing to verify, or no key."""
    decoded: Decoded | None = None
    chunk: Chunk | None = None
    whole: Inspected | None = None
    """What this chunk completes."""
    error: RemoteWireError | None = None
    """Why it is not decoded."""

    @property
    def is_unverified(self) -> bool:
        """Whether it is signed, and shown without its signature being checked."""
        heard = self.security
        return heard is not None and heard.mode is SecurityMode.SIGN and self.verified is None


class Inspector:
    """Inspects one message after the other; chunks are kept until the others are seen."""

    def __init__(self, key: MessageKey | None = None) -> None:
        self._key = key
        self._codec = Codec()
        self._reassembly = Reassembly(Counters(), MOST_MESSAGE_BYTES)
        self._is_whole: dict[tuple[object, ...], bool] = {}
        """The chunked messages that were seen."""

    @property
    def incomplete(self) -> int:
        """How many messages there are of which not all chunks were seen."""
        return list(self._is_whole.values()).count(False)

    def inspect(self, datagram: bytes) -> Inspected:
        """Look into one message; never raises on what it holds."""
        try:
            heard = read_security(datagram)
        except RemoteWireError as error:
            return Inspected(datagram, annotate(datagram, error=error), error=error)
        try:
            plain, verified = self._open(heard)
        except RemoteWireError as error:
            return Inspected(datagram, annotate(datagram, closed=True), heard, False, error=error)
        if plain is None:
            return Inspected(datagram, annotate(datagram), heard, error=RemoteWireError(Cause.SECURED, _NO_KEY))
        return self._inspect_plain(heard, plain, verified)

    def _open(self, heard: SecuredDatagram) -> tuple[bytes | None, bool | None]:
        """The plain form of a message, and whether it verified."""
        if heard.mode is SecurityMode.NONE:
            return heard.datagram, None
        if self._key is not None:
            return self._key.unprotect(heard), True
        return (None if heard.mode is SecurityMode.SIGN_AND_ENCRYPT else without_security(heard)), None

    def _inspect_plain(self, heard: SecuredDatagram, plain: bytes, verified: bool | None) -> Inspected:
        datagram = heard.datagram
        end = len(datagram)
        if heard.mode is not SecurityMode.NONE:
            end -= SIGNATURE_BYTES + heard.footer_size
        payload_size = end - heard.payload_offset
        payload = plain[len(plain) - payload_size :]
        try:
            chunk = read_chunk(plain)
            decoded = self._codec.decode(plain) if chunk is None else None
        except RemoteWireError as error:
            moved = _moved(error, heard.payload_offset - (len(plain) - payload_size), len(plain) - payload_size)
            return Inspected(datagram, annotate(datagram, payload=payload, error=moved), heard, verified, error=moved)
        spans = annotate(datagram, payload=payload)
        try:
            whole = None if chunk is None else self._join(chunk)
        except RemoteWireError as error:
            return Inspected(datagram, spans, heard, verified, chunk=chunk, error=error)
        refused = None if whole is None else whole.error
        return Inspected(datagram, spans, heard, verified, decoded, chunk, whole, refused)

    def _join(self, chunk: Chunk) -> Inspected | None:
        """The message that a chunk completes; RemoteWireError where it contradicts the others."""
        message = (*chunk[:6], chunk.message_sequence_number)
        self._is_whole.setdefault(message, False)
        joined = self._reassembly.add(chunk, now=0.0)
        if joined is None:
            return None
        self._is_whole[message] = True
        try:
            return Inspected(joined, annotate(joined), read_security(joined), None, self._codec.decode(joined))
        except RemoteWireError as error:
            return Inspected(joined, annotate(joined, error=error), error=error)


def _moved(error: RemoteWireError, by: int, payload_offset: int) -> RemoteWireError:
    """An error in the plain form of a message, with its offset in the datagram."""
    if not by or error.offset < payload_offset:
        return error
    return RemoteWireError(error.cause, error.detail, error.offset + by)
