"""The message that publishers send most, read in one go: all headers, one key frame, everything in its usual form.

Whatever is not exactly as expected makes it give up (None), and the general way decides: it reads nothing that the
general way reads otherwise. It never recurses, so it needs no look at the depth of the message.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, cast

from ua_fleet.wire.json.causes import Leniency
from ua_fleet.wire.json.data_messages import FieldsOf, JsonData, Source
from ua_fleet.wire.json.dates import usual_date
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, PublisherIdType

__all__ = ["decode_usual_message"]

_UINT32: Final = 0xFFFF_FFFF
_KEY: Final = FrameKind.KEY.value
_STRING: Final = PublisherIdType.STRING.value
_NO_GROUP: Final = NetworkMessage()[2:12]
"""What stands between the PublisherId and the messages of a NetworkMessage."""
_NOTHING: Final[Mapping[Leniency, int]] = MappingProxyType({})
_REST: Final = DataSetMessage(0)[10:]
"""What stands behind the versions of a DataSetMessage."""
_GOOD: Final = {dict: 0}
"""`{}` is Good, and nothing else that is empty."""

_new = cast("Callable[[Any, tuple[Any, ...]], Any]", tuple.__new__)  # pyright: ignore[reportUnknownMemberType]
"""Makes a NamedTuple of all of its parts, without the time that its own class takes."""


def decode_usual_message(tree: dict[str, Any], fields_of: FieldsOf, source: Source) -> JsonData | None:
    """A NetworkMessage of data; None for one that is not as usual, or has no metadata of its version."""
    items: Any = tree.get("Messages")
    message_id: Any = tree.get("MessageId")
    publisher_id: Any = tree.get("PublisherId")
    group: Any = tree.get("WriterGroupName")
    if (
        items.__class__ is not list
        or len(items) != 1
        or len(tree) != (4 if group is None else 5)
        or message_id.__class__ is not str
        or not message_id
        or publisher_id.__class__ is not str
        or publisher_id[:1] == "0"
    ):
        return None
    if group is None:
        group = source.writer_group_name
    elif group.__class__ is not str:
        return None
    item: Any = items[0]
    head = _usual_head(item) if item.__class__ is dict else None
    if head is None:
        return None
    writer_id, payload = item["DataSetWriterId"], item["Payload"]
    source = _new(Source, (publisher_id, group, writer_id, item.get("DataSetWriterName")))
    fields = fields_of(source)
    if fields is None or not (head[4] is None or head[4] == fields.metadata.configuration_version.major):
        return None
    planned = fields.planned(payload)
    if planned is None:
        return None
    message = _new(DataSetMessage, (writer_id, _KEY, *planned, *head, *_REST))
    network_message = _new(NetworkMessage, (publisher_id, _STRING, *_NO_GROUP, (message,)))
    result: JsonData = _new(JsonData, (network_message, (source,), message_id, group, _NOTHING))
    return result


def _usual_head(item: dict[str, Any]) -> tuple[int | None, ...] | None:
    """Sequence number, time, picoseconds, status and versions of a key frame, whose other parts are as usual too."""
    writer_id: Any = item.get("DataSetWriterId")
    name, version = item.get("DataSetWriterName"), item.get("MetaDataVersion")
    number, time, status = item.get("SequenceNumber"), item.get("Timestamp"), item.get("Status")
    # Nothing stands there but what is looked at here, so a PublisherId or a MinorVersion in it is not overlooked.
    if (
        len(item) != 8 - (name, version, number, time, status).count(None)
        or item.get("MessageType") != "ua-keyframe"
        or item.get("Payload").__class__ is not dict
        or writer_id.__class__ is not int
        or not 0 <= writer_id <= 0xFFFF
        or (name is not None and name.__class__ is not str)
        or (number is not None and (number.__class__ is not int or not 0 <= number <= _UINT32))
    ):
        return None
    try:
        if status is not None:
            status = _usual_number(status["Code"]) if status else _GOOD[status.__class__]
        if time is not None:
            time = usual_date(time)
        if version is None:
            return number, time, None, status, None, None
        major, minor = version["MajorVersion"], version["MinorVersion"]
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        return None
    if (
        major.__class__ is not int
        or not 0 <= major <= _UINT32
        or minor.__class__ is not int
        or not 0 <= minor <= _UINT32
    ):
        return None
    return number, time, None, status, major, minor


def _usual_number(value: Any) -> int:
    """A UInt32; raises ValueError for anything else."""
    if value.__class__ is int and 0 <= value <= _UINT32:
        number: int = value
        return number
    raise ValueError(value)
