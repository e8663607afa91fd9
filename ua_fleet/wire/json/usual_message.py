"""The message that publishers send most, read in one go: all headers, one key frame, everything in its usual form.

Whatever is not exactly as expected makes it give up (None), and the general way decides: it reads nothing that the
general way reads otherwise. Only values that are objects are looked at for their depth; headers have no member
that is not read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple, cast

from orjson import loads

from ua_fleet.wire.json.causes import Leniency
from ua_fleet.wire.json.data_messages import FieldsOf, JsonData, Source
from ua_fleet.wire.json.data_sets import DataSetFields
from ua_fleet.wire.json.dates import usual_date
from ua_fleet.wire.json.parsing import DEFAULT_LIMITS, Limits, is_deeper
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, FrameKind, NetworkMessage, PublisherIdType

__all__ = ["KeyFrame", "data_of_key_frame", "decode_usual_message", "usual_key_frame"]

_UINT32: Final = 0xFFFF_FFFF
_KEY: Final = FrameKind.KEY.value
_VARIANT: Final = FieldEncoding.VARIANT
_AROUND_PAYLOAD: Final = 3
"""Objects and arrays of a message around its payload."""
_STRING: Final = PublisherIdType.STRING.value
_NOTHING: Final[Mapping[Leniency, int]] = MappingProxyType({})

_new = cast("Callable[[Any, tuple[Any, ...]], Any]", tuple.__new__)  # pyright: ignore[reportUnknownMemberType]
"""Makes a NamedTuple of all of its parts, without the time that its own class takes."""


class KeyFrame(NamedTuple):
    """What stands around and in a payload."""

    message_id: str
    source: Source
    sequence_number: int | None
    timestamp: int | None
    status: int | None
    major_version: int | None
    minor_version: int | None
    payload: dict[str, Any]


def decode_usual_message(
    tree: dict[str, Any], fields_of: FieldsOf, source: Source, limits: Limits = DEFAULT_LIMITS
) -> JsonData | None:
    """A NetworkMessage of data; None for one that is not as usual, or has no metadata of its version."""
    key_frame = usual_key_frame(tree, source)
    return None if key_frame is None else data_of_key_frame(*key_frame, fields_of, limits)


def usual_key_frame(tree: dict[str, Any], source: Source) -> KeyFrame | None:
    """The one DataSetMessage of a NetworkMessage; None where it is not as usual."""
    message_id: Any = tree.get("MessageId")
    publisher_id: Any = tree.get("PublisherId")
    group: Any = tree.get("WriterGroupName")
    if (
        message_id.__class__ is not str
        or not message_id
        or publisher_id.__class__ is not str
        or publisher_id[:1] == "0"
        or len(tree) != (4 if group is None else 5)
    ):
        return None
    if group is None:
        group = source.writer_group_name
    elif group.__class__ is not str:
        return None
    ticks: int | None
    major: int | None
    minor: int | None
    try:
        (item,) = tree["Messages"]
        writer_id, payload, size = item["DataSetWriterId"], item["Payload"], len(item)
        if (
            writer_id.__class__ is not int
            or not 0 <= writer_id <= 0xFFFF
            or payload.__class__ is not dict
            or item["MessageType"] != "ua-keyframe"
        ):
            return None
        # What may be there is taken off the number of members, so that nothing else is overlooked: a PublisherId, or a
        # MinorVersion.
        number = item.get("SequenceNumber")
        if number is not None:
            size -= 1
            number = _usual_number(number)
        time = item.get("Timestamp")
        if time is None:
            ticks = None
        else:
            size -= 1
            ticks = usual_date(time)
        status = item.get("Status")
        if status is not None:
            size -= 1
            status = _usual_status(status) if status else _GOOD[status.__class__]
        version = item.get("MetaDataVersion")
        if version is None:
            major = minor = None
        else:
            size -= len(version) == 2  # nobody has looked how deep other members nest
            major, minor = _usual_number(version["MajorVersion"]), _usual_number(version["MinorVersion"])
        name = item.get("DataSetWriterName")
        if name is not None:
            size -= 1
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        return None
    if size != 3 or (name is not None and name.__class__ is not str):
        return None
    source = _new(Source, (publisher_id, group, writer_id, name))
    return KeyFrame(message_id, source, number, ticks, status, major, minor, payload)


def data_of_key_frame(
    message_id: str,
    source: Source,
    sequence_number: int | None,
    timestamp: int | None,
    status: int | None,
    major_version: int | None,
    minor_version: int | None,
    payload: Any,
    fields_of: FieldsOf,
    limits: Limits,
) -> JsonData | None:
    """The NetworkMessage of one key frame; None without metadata of its version, or where its payload is not usual.

    The arguments are the parts of a KeyFrame, which the fastest way does not put together, and what a message may have.
    The payload is an object, or the bytes of a text, which may be no JSON.
    """
    fields = fields_of(source)
    if fields is None or not (major_version is None or major_version == fields.major_version):
        return None
    values = fields.decode_text(payload) if payload.__class__ is bytes else None
    if values is None:
        values = _values_of(fields, payload, limits)
        if values is None:
            return None
    publisher_id, group, writer_id = source[0], source[1], source[2]  # faster than to take a NamedTuple apart
    types = fields.planned_types
    # All parts of a DataSetMessage and of a NetworkMessage, in their order.
    message = _new(DataSetMessage, (
        writer_id, _KEY, types, values, sequence_number, timestamp, None, status, major_version, minor_version,
        _VARIANT, None, None, None, None, None, None, None, True,
    ))  # fmt: skip
    network_message = _new(
        NetworkMessage,
        (publisher_id, _STRING, None, None, None, None, None, None, None, None, None, True, (message,)),
    )
    result: JsonData = _new(JsonData, (network_message, (source,), message_id, group, _NOTHING))
    return result


def _values_of(fields: DataSetFields, payload: Any, limits: Limits) -> tuple[Any, ...] | None:
    """The values of a payload by a plan for objects."""
    if payload.__class__ is bytes:
        try:
            payload = loads(payload)
        except (ValueError, RecursionError):  # orjson.JSONDecodeError is a ValueError
            return None
        if payload.__class__ is not dict:
            return None
    if fields.may_nest:
        if is_deeper(payload, limits.depth - _AROUND_PAYLOAD):
            return None
        fields.reading.packed = 0
    values = fields.decode_usual(fields.reading, payload)
    return fields.planned(payload) if values is None else values


_GOOD: Final = {dict: 0}
"""`{}` is Good, and nothing else that is empty."""


def _usual_status(status: Any) -> int:
    """The Code of a Status that has no more than that and a Symbol; raises ValueError, TypeError or KeyError."""
    if len(status) > 1 and (len(status) > 2 or status["Symbol"].__class__ is not str):
        raise ValueError(status)
    return _usual_number(status["Code"])


def _usual_number(value: Any) -> int:
    """A UInt32; raises ValueError for anything else."""
    if value.__class__ is int and 0 <= value <= _UINT32:
        number: int = value
        return number
    raise ValueError(value)
