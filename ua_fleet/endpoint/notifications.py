"""Notifications as bytes (OPC 10000-4 7.25): encoded one by one, so that none can cost a client the others."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from asyncua import ua

from ua_fleet.endpoint.answers import Misfit, encode_value
from ua_fleet.endpoint.binary.builtin import encode_variant
from ua_fleet.endpoint.binary.data_values import kept_bytes, with_times
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.stack import DECODE_ERRORS, ObjectIds, StatusCodes, ns0, status

__all__ = ["change_bytes", "changes_of", "event_bytes", "events_of", "kept_change_bytes"]

_CHANGES: Final = ns0(ObjectIds.DataChangeNotification_Encoding_DefaultBinary)
_EVENTS: Final = ns0(ObjectIds.EventNotificationList_Encoding_DefaultBinary)


def change_bytes(client_handle: int, value: ua.DataValue, room: int, misfit: Misfit, what: Callable[[], str]) -> bytes:
    """A MonitoredItemNotification; a value that cannot be encoded, or is longer than `room`, as its StatusCode."""
    return int(client_handle).to_bytes(4, "little") + encode_value(value, room, misfit, what)


def kept_change_bytes(
    client_handle: int, held: HeldValue, value: ua.DataValue, room: int, wanted: ua.TimestampsToReturn
) -> bytes | None:
    """As `change_bytes`, of a value that `held` holds or held: for another item or a Read it may be encoded already.

    None where it is not to be had so: it is large, or cannot be encoded, or nobody else is told of it, so that its
    bytes would be kept for nothing.
    """
    kept = held.encoded
    if (kept is None or kept[0] is not value) and not held.is_watched_by_several:
        return None
    try:
        data = kept_bytes(held, value)
    except DECODE_ERRORS:
        return None
    if data is None or len(data) > room:
        return None
    return int(client_handle).to_bytes(4, "little") + with_times(data, wanted)


def event_bytes(notification: ua.EventFieldList, misfit: Misfit, what: str) -> bytes:
    """An EventFieldList; a field that cannot be encoded is Bad_EncodingError."""
    fields = notification.EventFields
    parts = [int(notification.ClientHandle).to_bytes(4, "little"), len(fields).to_bytes(4, "little")]
    for number, field in enumerate(fields):
        try:
            parts.append(encode_variant(field))
        except DECODE_ERRORS as error:
            misfit(f"{what}, field {number} of an event", error)
            parts.append(encode_variant(ua.Variant(status(StatusCodes.BadEncodingError), ua.VariantType.StatusCode)))
    return b"".join(parts)


def changes_of(parts: Sequence[bytes]) -> ua.ExtensionObject:
    """A DataChangeNotification of encoded notifications."""
    return _body(_CHANGES, b"".join((len(parts).to_bytes(4, "little"), *parts, bytes(4))))


def events_of(parts: Sequence[bytes]) -> ua.ExtensionObject:
    """An EventNotificationList of encoded notifications."""
    return _body(_EVENTS, b"".join((len(parts).to_bytes(4, "little"), *parts)))


def _body(type_id: ua.NodeId, data: bytes) -> ua.ExtensionObject:
    return ua.ExtensionObject(type_id, ua.ByteString(data))
