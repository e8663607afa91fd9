"""Events for the history: their fields as bytes when they happen, and as fields again when clients ask for them."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import hashlib
from typing import Any, Final, Protocol

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import variant_from_binary

from ua_fleet.endpoint.answers import Misfit
from ua_fleet.endpoint.binary.builtin import encode_content, encode_variant
from ua_fleet.endpoint.convert import ticks_of
from ua_fleet.endpoint.stack import DECODE_ERRORS, ObjectIds, ns0
from ua_fleet.history.events import BrokenEvent, KeptEvent, encode_event
from ua_fleet.history.rows import Row
from ua_fleet.values import datetime_from_ticks

__all__ = ["MOST_FIELD_BYTES", "MOST_STRANGER_BYTES", "EventKeeper", "PastEvent", "past_event"]

MOST_FIELD_BYTES: Final = 16_384
"""Of a field; a larger one is not kept."""
MOST_STRANGER_BYTES: Final = 512
"""Likewise of an event that somebody without a user has caused: the thumbprint of a certificate, and not all of it."""
_SERVER: Final = ns0(ObjectIds.Server)
_LOST: Final = ns0(ObjectIds.EventQueueOverflowEventType)
_LOST_TEXT: Final = "events are missing from here on: the server did not run, or could not store them"
_LOST_SEVERITY: Final = 500
_NO_FIELD: Final = ua.Variant()


class Record(Protocol):
    """Takes the bytes of an event."""

    def __call__(self, time: int, data: bytes, *, is_audit: bool) -> None:
        """Keep an event of such a Time."""
        ...


class EventKeeper:
    """Keeps the events of a server."""

    def __init__(self, record: Record, misfit: Misfit, *, audit: bool) -> None:
        """Keep events.

        Args:
            record: takes each.
            misfit: told of one that cannot be encoded.
            audit: whether AuditEvents are kept.
        """
        self._record, self._misfit, self.audit = record, misfit, audit
        self.left_out = 0
        """AuditEvents of changes that were not kept since their maker had too many; the audit log sums them up."""

    def keep(self, event: Any, *, is_audit: bool = False, most_bytes: int = MOST_FIELD_BYTES) -> None:
        """Keep an event, with its fields of at most so many bytes; clients are told of it in any case."""
        try:
            fields: dict[str, bytes] = {}
            for name, kind in event.data_types.items():
                value = getattr(event, name)
                if value is not None and len(data := encode_content(value, kind)) <= most_bytes:
                    fields[name] = data
            time = ticks_of(event.Time)
            self._record(time, encode_event(time, fields), is_audit=is_audit)
        except Exception as error:  # noqa: BLE001 - a mistake of ours, which costs the history this event
            self._misfit(f"an event of type {getattr(event, 'EventType', None)}, for the history", error)


class PastEvent:
    """An event of the history, as filters look at it."""

    def __init__(self, kept: KeptEvent) -> None:
        self._kept = kept
        self._decoded: dict[str, ua.Variant] = {}

    def encoded(self, name: str) -> bytes | None:
        """A field as an encoded Variant; None for none."""
        return self._kept.field(name)

    def variant(self, name: str) -> ua.Variant:
        """A field; null for none. Raises BrokenEvent, which no filter takes for an event that does not pass."""
        found = self._decoded.get(name)
        if found is None:
            data = self._kept.field(name)
            try:
                found = self._decoded[name] = _NO_FIELD if data is None else variant_from_binary(Buffer(data))
            except DECODE_ERRORS as error:
                raise BrokenEvent(f"{name}: {error!s:.100}") from error
        return found

    def __getattr__(self, name: str) -> Any:
        """The value of a field, as an event that happens now has it; raises AttributeError."""
        if self._kept.field(name) is None:
            raise AttributeError(name)
        return self.variant(name).Value


def past_event(row: Row) -> PastEvent:
    """The event of a row; the mark of a gap is an event, too. Raises ValueError or struct.error for what is broken."""
    return PastEvent(KeptEvent(_lost(row.time) if row.value is None else row.value))


def _lost(time: int) -> bytes:
    """An EventQueueOverflowEvent (OPC 10000-4 7.22.3): the same one whenever it is read."""
    moment = datetime_from_ticks(time)
    fields = {
        "EventId": ua.Variant(hashlib.sha256(b"gap %d" % time).digest()[:16], ua.VariantType.ByteString),
        "EventType": ua.Variant(_LOST, ua.VariantType.NodeId),
        "SourceNode": ua.Variant(_SERVER, ua.VariantType.NodeId),
        "SourceName": ua.Variant("Server", ua.VariantType.String),
        "Time": ua.Variant(moment, ua.VariantType.DateTime),
        "ReceiveTime": ua.Variant(moment, ua.VariantType.DateTime),
        "Message": ua.Variant(ua.LocalizedText(_LOST_TEXT), ua.VariantType.LocalizedText),
        "Severity": ua.Variant(_LOST_SEVERITY, ua.VariantType.UInt16),
    }
    return encode_event(time, {name: encode_variant(field) for name, field in fields.items()})
