"""The message that publishers send most, read in one go: all headers, one key frame, everything in its usual form.

Whatever is not exactly as expected makes it give up (None) before anything is counted or asked, and the general way
decides: it reads nothing that the general way reads otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, cast

from ua_fleet.wire.json.data_messages import FieldsOf, JsonData, Source
from ua_fleet.wire.json.data_sets import keep_payload
from ua_fleet.wire.json.dates import usual_date
from ua_fleet.wire.json.parsing import Reading
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, PublisherIdType

__all__ = ["decode_usual_message"]

_UINT32: Final = 0xFFFF_FFFF
_KEY: Final = FrameKind.KEY.value
_STRING: Final = PublisherIdType.STRING.value
_NETWORK_HEADERS: Final = frozenset({"MessageId", "MessageType", "PublisherId", "WriterGroupName", "Messages"})
_REST: Final = DataSetMessage(0)[10:]
"""What stands behind the versions of a DataSetMessage."""
_GOOD: Final = {dict: 0}
"""`{}` is Good, and nothing else that is empty."""

_new = cast("Callable[[Any, tuple[Any, ...]], Any]", tuple.__new__)  # pyright: ignore[reportUnknownMemberType]
"""Makes a NamedTuple of all of its parts, without the time that its own class takes."""


def decode_usual_message(
    reading: Reading, tree: dict[str, Any], fields_of: FieldsOf, source: Source
) -> JsonData | None:
    """A NetworkMessage of data; None for one that is not as usual. Raises RemoteWireError for its payload."""
    items: Any = tree.get("Messages")
    message_id: Any = tree.get("MessageId")
    publisher_id: Any = tree.get("PublisherId")
    group: Any = tree.get("WriterGroupName")
    if (
        items.__class__ is not list
        or len(items) != 1
        or not tree.keys() <= _NETWORK_HEADERS
        or message_id.__class__ is not str
        or not message_id
        or publisher_id.__class__ is not str
        or publisher_id[:1] == "0"
        or (group is not None and group.__class__ is not str)
    ):
        return None
    if group is None:
        group = source.writer_group_name
    item: Any = items[0]
    head = _usual_head(item) if item.__class__ is dict else None
    if head is None:
        return None
    writer_id, payload = item["DataSetWriterId"], item["Payload"]
    source = _new(Source, (publisher_id, group, writer_id, item.get("DataSetWriterName")))
    fields = fields_of(source)
    message: DataSetMessage
    if fields is None or not (head[4] is None or head[4] == fields.metadata.configuration_version.major):
        message = keep_payload(_new(DataSetMessage, (writer_id, _KEY, (), (), *head, *_REST)), payload)
    else:
        planned = fields.planned(reading, payload)
        if planned is None:
            message = _new(DataSetMessage, (writer_id, _KEY, (), (), *head, *_REST))
            message = fields.decode_by_names(reading, message, payload)
        else:
            message = _new(DataSetMessage, (writer_id, _KEY, *planned, *head, *_REST))
    network_message = NetworkMessage(publisher_id, _STRING, messages=(message,))
    result: JsonData = _new(JsonData, (network_message, (source,), message_id, group, reading.leniencies))
    return result


def _usual_head(item: dict[str, Any]) -> tuple[int | None, ...] | None:
    """Sequence number, time, picoseconds, status and versions of a key frame, whose other parts are as usual too."""
    writer_id: Any = item.get("DataSetWriterId")
    name, version = item.get("DataSetWriterName"), item.get("MetaDataVersion")
    number, time, status = item.get("SequenceNumber"), item.get("Timestamp"), item.get("Status")
    # Nothing stands there but what is looked at here, so a PublisherId or a MinorVersion in it is not overlooked.
    present = 8 - (name, version, number, time, status).count(None)
    if (
        len(item) != present
        or item.get("MessageType") != "ua-keyframe"
        or item.get("Payload").__class__ is not dict
        or writer_id.__class__ is not int
        or not 0 <= writer_id <= 0xFFFF
        or (name is not None and name.__class__ is not str)
    ):
        return None
    try:
        if number is not None:
            number = _usual_number(number)
        if status is not None:
            status = _usual_number(status["Code"]) if status else _GOOD[status.__class__]
        if time is not None:
            time = usual_date(time)
        if version is None:
            return number, time, None, status, None, None
        major, minor = _usual_number(version["MajorVersion"]), _usual_number(version["MinorVersion"])
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    return number, time, None, status, major, minor


def _usual_number(value: Any) -> int:
    """A UInt32; raises ValueError for anything else."""
    if value.__class__ is int and 0 <= value <= _UINT32:
        number: int = value
        return number
    raise ValueError(value)
