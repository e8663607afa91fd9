"""NetworkMessages of data as JSON (OPC 10000-14 7.2.5.3, 7.2.5.4, annex A.3).

What a JSON message has and UADP has not stands beside the messages, in `JsonData`: the classes of the messages
themselves are those of UADP, so that one encoding can be made of the other. UADP's NetworkMessageNumber, GroupVersion,
sequence number and times of the NetworkMessage have no place in JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import orjson

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire.builtin import MISFITS
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.data_sets import JSON_PAYLOAD, DataSetFields, keep_payload
from ua_fleet.wire.json.dates import decode_date, encode_date
from ua_fleet.wire.json.fields import Form
from ua_fleet.wire.json.headers import (
    decode_class_id,
    decode_message_id,
    decode_publisher_id,
    decode_text,
    decode_version,
    decode_writer_id,
    encode_publisher_id,
    encode_version,
)
from ua_fleet.wire.json.parsing import Reading, dump, shown
from ua_fleet.wire.json.scalars import SCALAR_ENCODERS, decode_integer, decode_status, encode_status
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, PublisherIdType

__all__ = [
    "DATA",
    "DATA_SET_MESSAGE",
    "MINIMAL",
    "NETWORK_MESSAGE",
    "FieldsOf",
    "JsonData",
    "Layout",
    "Source",
    "decode_data",
    "encode_data",
]

DATA: Final = "ua-data"

KINDS: Final[dict[str, int]] = {
    "ua-keyframe": FrameKind.KEY.value,
    "ua-deltaframe": FrameKind.DELTA.value,
    "ua-event": FrameKind.EVENT.value,
    "ua-keepalive": FrameKind.KEEP_ALIVE.value,
}
KIND_NAMES: Final = {kind: name for name, kind in KINDS.items()}

MEMBERS: Final = frozenset(
    {
        "DataSetWriterId",
        "DataSetWriterName",
        "PublisherId",
        "WriterGroupName",
        "SequenceNumber",
        "MetaDataVersion",
        "MinorVersion",
        "Timestamp",
        "Status",
        "MessageType",
        "Payload",
    }
)
"""What a DataSetMessage may have (table 185)."""


class Layout(NamedTuple):
    """Which headers messages have: bits of the JsonNetworkMessageContentMask (OPC 10000-14 6.3.2.1.1)."""

    network_header: bool = True
    data_set_header: bool = True
    single: bool = False
    """One DataSetMessage, as an object and not in an array."""
    message_type: bool = True
    """Each DataSetMessage says what it is; without it delta frames and events cannot be told from key frames."""


NETWORK_MESSAGE: Final = Layout()
DATA_SET_MESSAGE: Final = Layout(network_header=False, single=True)
MINIMAL: Final = Layout(network_header=False, data_set_header=False, single=True)
"""The three layouts of annex A.3."""


class Source(NamedTuple):
    """Which DataSetWriter a message is of, as far as its headers, or the topic that it came on, tell."""

    publisher_id: str | None = None
    writer_group_name: str | None = None
    data_set_writer_id: int | None = None
    data_set_writer_name: str | None = None


UNKNOWN_SOURCE: Final = Source()

FieldsOf = Callable[[Source], DataSetFields | None]
"""The fields of a DataSetWriter, or None where there is no metadata of it yet."""


class JsonData(NamedTuple):
    """One NetworkMessage of data, with what only JSON has."""

    message: NetworkMessage
    sources: tuple[Source, ...] = ()
    """One for each of its DataSetMessages."""
    message_id: str | None = None
    writer_group_name: str | None = None
    leniencies: Mapping[Leniency, int] = MappingProxyType({})
    """How often what was forgiven."""


def decode_data(
    reading: Reading, tree: Any, fields_of: FieldsOf, source: Source = UNKNOWN_SOURCE, layout: Layout | None = None
) -> JsonData:
    """A NetworkMessage of data from its parsed text; raises RemoteWireError.

    Args:
        reading: what the message's values refer to, and where leniencies are counted.
        tree: what `parse` made of the text.
        fields_of: tells the fields of a DataSetWriter. A payload for which it returns None, or fields of another
            version, stays `raw` in its message.
        source: what is known of the sender without the headers.
        layout: which headers there are; without it they are told by what stands there.
    """
    message_id: str | None = None
    class_id = None
    has_header = layout.network_header if layout is not None else tree.__class__ is dict and _has_network_header(tree)
    items: Any = tree
    if has_header:
        if tree.__class__ is not dict:
            raise RemoteWireError(JsonCause.SHAPE, f"a NetworkMessage that is no object: {shown(tree)}")
        message_id = decode_message_id(reading, tree.get("MessageId"))
        if tree.get("MessageType") != DATA:
            if tree.get("MessageType") is not None:
                raise RemoteWireError(JsonCause.MESSAGE_TYPE, f"{shown(tree['MessageType'])} is not {DATA}")
            reading.note(Leniency.MESSAGE_TYPE_MISSING)
        source = _outer_source(reading, tree, source)
        if "DataSetClassId" in tree:
            class_id = decode_class_id(reading, tree["DataSetClassId"])
        items = _messages_of(reading, tree)
    parts: list[Any] = items if items.__class__ is list else [items]
    if items.__class__ is not list and items.__class__ is not dict:
        raise RemoteWireError(JsonCause.SHAPE, f"DataSetMessages that are no array: {shown(items)}")
    messages: list[DataSetMessage] = []
    sources: list[Source] = []
    for item in parts:
        if item.__class__ is not dict:
            raise RemoteWireError(JsonCause.SHAPE, f"a DataSetMessage that is no object: {shown(item)}")
        has_header = layout.data_set_header if layout is not None else _has_data_set_header(item)
        message, its_source = _decode_message(reading, item, source, fields_of, has_header=has_header)
        messages.append(message)
        sources.append(its_source)
    publisher_id = source.publisher_id
    if publisher_id is None and sources:
        publisher_id = sources[0].publisher_id
    return JsonData(
        NetworkMessage(publisher_id, PublisherIdType.STRING.value, class_id, messages=tuple(messages)),
        tuple(sources),
        message_id,
        source.writer_group_name,
        reading.leniencies,
    )


def _messages_of(reading: Reading, tree: dict[str, Any]) -> Any:
    items = tree.get("Messages")
    if items is None:
        reading.note(Leniency.MESSAGES_MISSING)
        return []
    return items


def _has_network_header(tree: dict[str, Any]) -> bool:
    return tree.get("MessageType") == DATA or "Messages" in tree or ("MessageId" in tree and "Payload" not in tree)


def _has_data_set_header(item: dict[str, Any]) -> bool:
    """Whether it is a DataSetMessage and not its payload alone: all of its members are those of one."""
    if "Payload" in item:
        return item.keys() <= MEMBERS or "DataSetWriterId" in item or "MessageType" in item
    return bool(item) and item.keys() <= MEMBERS


def _outer_source(reading: Reading, tree: dict[str, Any], source: Source) -> Source:
    publisher_id, group = tree.get("PublisherId"), tree.get("WriterGroupName")
    if publisher_id is not None:
        source = source._replace(publisher_id=decode_publisher_id(reading, publisher_id))
    if group is not None:
        source = source._replace(writer_group_name=decode_text(group, "WriterGroupName"))
    return source


def _decode_message(
    reading: Reading, item: dict[str, Any], source: Source, fields_of: FieldsOf, *, has_header: bool
) -> tuple[DataSetMessage, Source]:
    if not has_header:
        message = DataSetMessage(source.data_set_writer_id or 0)
        return _with_payload(reading, message, item, fields_of(source)), source
    if "PublisherId" in item or "WriterGroupName" in item:
        source = _outer_source(reading, item, source)
    writer_id, name = item.get("DataSetWriterId"), item.get("DataSetWriterName")
    if name is not None:
        name = decode_text(name, "DataSetWriterName")
    elif writer_id is None:
        name = source.data_set_writer_name
    if writer_id is None:
        writer_id = source.data_set_writer_id
    elif writer_id.__class__ is not int or not 0 <= writer_id <= 0xFFFF:
        writer_id, name = decode_writer_id(reading, writer_id, name)
    source = Source(source.publisher_id, source.writer_group_name, writer_id, name)
    kind, payload = _decode_kind(item)
    major, minor = decode_version(reading, item)
    number, time, status = item.get("SequenceNumber"), item.get("Timestamp"), item.get("Status")
    message = DataSetMessage(
        writer_id or 0,
        kind,
        (),
        (),
        None if number is None else decode_integer(reading, BuiltinType.UINT32, number),
        None if time is None else decode_date(reading, time),
        None,
        None if status is None else decode_status(reading, status),
        major,
        minor,
    )
    if kind == FrameKind.KEEP_ALIVE:
        return message, source
    return _with_payload(reading, message, payload, fields_of(source)), source


def _decode_kind(item: dict[str, Any]) -> tuple[int, Any]:
    name, payload = item.get("MessageType"), item.get("Payload")
    if name is None:  # what has no payload is a keep-alive
        return (FrameKind.KEY if payload is not None else FrameKind.KEEP_ALIVE).value, payload
    kind = KINDS.get(name) if name.__class__ is str else None
    if kind is None:
        raise RemoteWireError(JsonCause.MESSAGE_TYPE, f"a DataSetMessage of type {shown(name)}")
    if payload is None and kind != FrameKind.KEEP_ALIVE:
        raise RemoteWireError(JsonCause.MISSING, f"a {name} without its Payload")
    return kind, payload


def _with_payload(
    reading: Reading, message: DataSetMessage, payload: Any, fields: DataSetFields | None
) -> DataSetMessage:
    if fields is None or not fields.fits(message):
        return keep_payload(message, payload)
    return fields.decode(reading, message, payload)


def encode_data(
    data: JsonData,
    fields: Sequence[DataSetFields | None],
    form: Form = Form.VERBOSE,
    layout: Layout = NETWORK_MESSAGE,
) -> bytes:
    """The text of a NetworkMessage of data; raises LocalWireError.

    Args:
        data: the message. Its PublisherId may be a number; that of a source takes part only without a network header.
        fields: those of each DataSetMessage, None for a keep-alive or a payload that is kept as text.
        form: how fields are written.
        layout: which headers there are. What is None in a message is not written.
    """
    try:
        return _encode_data(data, fields, form, layout)
    except MISFITS as error:
        raise LocalWireError(f"a NetworkMessage that is not put together right: {error}") from error


def _encode_data(data: JsonData, fields: Sequence[DataSetFields | None], form: Form, layout: Layout) -> bytes:
    messages = data.message.messages
    if len(fields) != len(messages):
        raise LocalWireError(f"fields of {len(fields)} for {len(messages)} DataSetMessages")
    if layout.single and len(messages) != 1:
        raise LocalWireError(f"{len(messages)} DataSetMessages for a layout with a single one")
    sources = data.sources or (UNKNOWN_SOURCE,) * len(messages)
    items = [
        _encode_message(data, message, source, its_fields, form, layout)
        for message, source, its_fields in zip(messages, sources, fields, strict=True)
    ]
    content: Any = items[0] if layout.single else items
    if not layout.network_header:
        return dump(content)
    if data.message_id is None:
        raise LocalWireError("a NetworkMessage without its MessageId")
    head: dict[str, Any] = {"MessageId": data.message_id, "MessageType": DATA}
    if data.message.publisher_id is not None:
        head["PublisherId"] = encode_publisher_id(data.message.publisher_id)
    if data.writer_group_name is not None:
        head["WriterGroupName"] = data.writer_group_name
    if data.message.data_set_class_id is not None:
        head["DataSetClassId"] = str(data.message.data_set_class_id)
    head["Messages"] = content
    return dump(head)


def _encode_message(
    data: JsonData, message: DataSetMessage, source: Source, fields: DataSetFields | None, form: Form, layout: Layout
) -> Any:
    payload = _encode_payload(message, fields, form)
    if not layout.data_set_header:
        if message.kind == FrameKind.KEEP_ALIVE:
            raise LocalWireError("a keep-alive without a header has no content")
        return payload
    out: dict[str, Any] = {}
    if message.data_set_writer_id:
        out["DataSetWriterId"] = SCALAR_ENCODERS[BuiltinType.UINT16]((), False, message.data_set_writer_id)
    if source.data_set_writer_name is not None:
        out["DataSetWriterName"] = source.data_set_writer_name
    if not layout.network_header:
        publisher_id = data.message.publisher_id if source.publisher_id is None else source.publisher_id
        if publisher_id is not None:
            out["PublisherId"] = encode_publisher_id(publisher_id)
        group = data.writer_group_name if source.writer_group_name is None else source.writer_group_name
        if group is not None:
            out["WriterGroupName"] = group
    if message.sequence_number is not None:
        out["SequenceNumber"] = SCALAR_ENCODERS[BuiltinType.UINT32]((), False, message.sequence_number)
    out |= encode_version(message)
    if message.timestamp is not None:
        out["Timestamp"] = encode_date(message.timestamp)
    if message.status is not None:
        out["Status"] = encode_status((), form is not Form.COMPACT, message.status)
    if layout.message_type:
        out["MessageType"] = KIND_NAMES[message.kind]
    if message.kind != FrameKind.KEEP_ALIVE:
        out["Payload"] = payload
    return out


def _encode_payload(message: DataSetMessage, fields: DataSetFields | None, form: Form) -> Any:
    if message.kind not in KIND_NAMES:
        raise LocalWireError(f"no such kind of DataSetMessage: {message.kind!r:.80}")
    if message.kind == FrameKind.KEEP_ALIVE:
        if message.types or message.values:
            raise LocalWireError("a keep-alive has no fields")
        return None
    if message.encoding == JSON_PAYLOAD and message.raw is not None:
        return orjson.Fragment(message.raw)
    if message.raw is not None:
        raise LocalWireError("RawData of UADP, which has to be decoded by its metadata first")
    if fields is None:
        raise LocalWireError("fields without their metadata: JSON needs their names")
    return fields.encode(fields.writing(form), message)
