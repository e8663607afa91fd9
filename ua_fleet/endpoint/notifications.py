"""Notifications as bytes (OPC 10000-4 7.25): encoded one by one, so that none can cost a client the others.

A message of them is encoded once: what is kept until it is acknowledged are the bytes that were sent.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Sequence
from datetime import datetime
from typing import Final

from asyncua import ua

from ua_fleet.endpoint.answers import EncodedResponse, Misfit, encode_value
from ua_fleet.endpoint.binary.builtin import encode_time, encode_variant
from ua_fleet.endpoint.binary.data_values import kept_bytes, with_times
from ua_fleet.endpoint.binary.encoders import encode_extension_object
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.stack import DECODE_ERRORS, ObjectIds, StatusCodes, status

__all__ = [
    "change_bytes",
    "changes_of",
    "encode_codes",
    "encode_message",
    "event_bytes",
    "events_of",
    "kept_change_bytes",
    "publish_response",
    "status_change",
]

_CHANGES: Final = int(ObjectIds.DataChangeNotification_Encoding_DefaultBinary)
_EVENTS: Final = int(ObjectIds.EventNotificationList_Encoding_DefaultBinary)
_OBJECT_HEAD: Final = struct.Struct("<BBHBi")
"""NodeId of a structure's encoding in four bytes, that there is a body, and its length."""
_COUNT: Final = struct.Struct("<i")
_NUMBER: Final = struct.Struct("<I")
_NO_DIAGNOSTICS: Final = bytes(4)


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


def changes_of(parts: Sequence[bytes]) -> bytes:
    """A DataChangeNotification of encoded notifications, as an ExtensionObject."""
    return _object(_CHANGES, b"".join((_COUNT.pack(len(parts)), *parts, bytes(4))))


def events_of(parts: Sequence[bytes]) -> bytes:
    """An EventNotificationList of encoded notifications, as an ExtensionObject."""
    return _object(_EVENTS, b"".join((_COUNT.pack(len(parts)), *parts)))


def _object(type_id: int, body: bytes) -> bytes:
    return _OBJECT_HEAD.pack(1, 0, type_id, 1, len(body)) + body


def status_change(code: int) -> bytes:
    """A StatusChangeNotification, as an ExtensionObject."""
    return encode_extension_object(ua.StatusChangeNotification(Status=status(code)))


def encode_message(sequence: int, told_at: datetime, notifications: Sequence[bytes]) -> bytes:
    """A NotificationMessage (OPC 10000-4 7.26).

    Args:
        sequence: its SequenceNumber.
        told_at: its PublishTime.
        notifications: encoded ExtensionObjects.
    """
    return b"".join((_NUMBER.pack(sequence), encode_time(told_at), _COUNT.pack(len(notifications)), *notifications))


def encode_codes(codes: Sequence[int]) -> bytes:
    """An array of StatusCodes."""
    return struct.pack(f"<i{len(codes)}I", len(codes), *codes)


def publish_response(
    subscription_id: int, message: bytes, results: bytes, kept: Collection[int] = (), *, more: bool = False
) -> EncodedResponse:
    """A PublishResponse (OPC 10000-4 5.14.5).

    Args:
        subscription_id: whose message it is.
        message: the encoded NotificationMessage.
        results: of the acknowledgements of the request, encoded.
        kept: AvailableSequenceNumbers.
        more: whether more waits to be told.
    """
    count = len(kept)
    head = struct.pack(f"<Ii{count}I?", subscription_id, count, *kept, more)
    return EncodedResponse(ua.PublishResponse, b"".join((head, message, results, _NO_DIAGNOSTICS)))
