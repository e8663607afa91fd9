"""What `pubsub decode` shows: every byte of a message once, with the values that the decoder gives."""

from __future__ import annotations

import re
from collections.abc import Iterator
from random import Random
from typing import Any

import pytest

from tests.unit.wire.corpus import mutate
from tests.unit.wire.discovery_samples import ANNOUNCEMENTS
from tests.unit.wire.everything import ACTIONS, KEYS, PROBES, chunked_messages, plain_messages, secured_messages
from tests.unit.wire.test_bad_messages import TABLE
from ua_fleet.dissect.annotate import annotate
from ua_fleet.dissect.spans import ByteSpan, type_name
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import (
    ARRAY,
    DIMENSIONS,
    BuiltinType,
    DataValue,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    Variant,
)
from ua_fleet.wire import Codec, encode_probe
from ua_fleet.wire.actions import ActionMessage, encode_action
from ua_fleet.wire.announcements import encode_announcement
from ua_fleet.wire.chunks import read_chunk
from ua_fleet.wire.messages import (
    Announcement,
    DataSetMessage,
    DataSetMetaData,
    FieldMetaData,
    FrameKind,
    NetworkMessage,
    Probe,
    ProbeKind,
)
from ua_fleet.wire.security import SIGNATURE_BYTES, MessageKey, SecuredDatagram, SecurityMode, read_security

Named = tuple[str, Any]
NO_VALUES = ("NotRead", "RawData", "Padding", "Body")
HOW_TO_READ_ON = re.compile(
    r"(^|\.)(\w+Flags[12]?|EncodingMask|(Array)?Length|(Field)?Count|Sizes?(\[\d+\])?)$(?<!\.FieldFlags)"
)
"""What says how to read on: the decoder does not give it."""
DIMENSIONS_OF_AN_ARRAY = re.compile(r"ArrayDimensions\[\d+\]$")


def shown(spans: tuple[ByteSpan, ...]) -> list[Named]:
    """The values of a message, without what only says how to read on."""
    return [
        (span.name, span.value)
        for span in spans
        if span.name not in NO_VALUES
        and not (span.name.endswith("].Status") and span.value == 0)  # of a DataValue: as good as none
        and not (span.name == "PublisherId" and span.value is None)
        and span.section != "SecurityHeader"
        and not HOW_TO_READ_ON.search(span.name)
        and (span.section == "Discovery announcement" or not DIMENSIONS_OF_AN_ARRAY.search(span.name))
    ]


def covers(spans: tuple[ByteSpan, ...], datagram: bytes) -> bool:
    position = 0
    for span in spans:
        if span.offset != position or not span.data:
            return False
        position += len(span.data)
    return b"".join(span.data for span in spans) == datagram


def of_value(name: str, code: int, value: Any) -> Iterator[Named]:
    kind = code & 0x3F
    if code & DIMENSIONS and isinstance(value, Matrix):
        yield from of_value(name, code & ~DIMENSIONS, value.values)
    elif code & ARRAY:
        if kind <= BuiltinType.DOUBLE or kind in (BuiltinType.DATETIME, BuiltinType.STATUS_CODE):
            yield from [(name, value)] if value else []
        else:
            for index, element in enumerate(value or ()):
                yield from of_value(f"{name}[{index}]", kind, element)
    elif isinstance(value, Variant):
        yield from of_value(name, value.type, value.value)
    elif isinstance(value, DataValue):
        yield from of_data_value(name, value)
    elif kind and value not in ("", b""):
        yield name, value


def of_data_value(name: str, value: DataValue) -> Iterator[Named]:
    if value.variant is not None:
        yield from of_value(f"{name}.Value", *value.variant)
    if value.status:
        yield f"{name}.Status", value.status
    for part, number in (
        ("SourceTimestamp", value.source_timestamp),
        ("SourcePicoSeconds", value.source_picoseconds),
        ("ServerTimestamp", value.server_timestamp),
        ("ServerPicoSeconds", value.server_picoseconds),
    ):
        if number is not None:
            yield f"{name}.{part}", number


def present(*named: Named) -> list[Named]:
    return [(name, value) for name, value in named if value is not None]


def of_part(part: DataSetMessage) -> Iterator[Named]:
    yield from present(
        ("DataSetMessageSequenceNumber", part.sequence_number),
        ("Timestamp", part.timestamp),
        ("PicoSeconds", part.picoseconds),
        ("Status", part.status),
        ("ConfigurationVersionMajorVersion", part.major_version),
        ("ConfigurationVersionMinorVersion", part.minor_version),
    )
    for index, (code, value) in enumerate(zip(part.types, part.values, strict=True)):
        name = f"DataSetFields[{index}]"
        if part.kind == FrameKind.DELTA and part.indices is not None:
            yield f"DeltaFrameFields[{index}].FieldIndex", part.indices[index]
            name = f"DeltaFrameFields[{index}].FieldValue"
        if part.field_status is None:
            yield from of_value(name, code, value)
        else:
            columns = (
                part.field_source_timestamps,
                part.field_server_timestamps,
                part.field_source_picoseconds,
                part.field_server_picoseconds,
            )
            times = [None if column is None else column[index] for column in columns]
            variant = Variant(code, value) if code else None
            yield from of_data_value(name, DataValue(variant, part.field_status[index], *times))


def of_message(message: NetworkMessage) -> Iterator[Named]:
    yield from present(
        ("PublisherId", None if message.publisher_id == "" else message.publisher_id),
        ("DataSetClassId", message.data_set_class_id),
        ("WriterGroupId", message.writer_group_id),
        ("GroupVersion", message.group_version),
        ("NetworkMessageNumber", message.network_message_number),
        ("SequenceNumber", message.sequence_number),
    )
    if message.payload_header:
        for index, part in enumerate(message.messages):
            yield f"DataSetWriterIds[{index}]", part.data_set_writer_id
    yield from present(("Timestamp", message.timestamp), ("PicoSeconds", message.picoseconds))
    for index, (code, value) in enumerate(
        zip(message.promoted_types or (), message.promoted_values or (), strict=True)
    ):
        yield from of_value(f"Fields[{index}]", code, value)
    for part in message.messages:
        yield from of_part(part)


def of_probe(probe: Probe) -> Iterator[Named]:
    if probe.kind == ProbeKind.FIND_APPLICATIONS:
        yield "ProbeType", 2
        return
    yield "ProbeType", 1
    yield "InformationType", probe.kind
    if probe.kind in (ProbeKind.DATA_SET_META_DATA, ProbeKind.DATA_SET_WRITER_CONFIGURATION):
        for index, writer_id in enumerate(probe.data_set_writer_ids):
            yield f"DataSetWriterIds[{index}]", writer_id
    if probe.kind == ProbeKind.WRITER_GROUP_CONFIGURATION:
        yield "WriterGroupId", probe.writer_group_id
    if probe.kind == ProbeKind.PUBSUB_CONNECTIONS:
        for index, uri in enumerate(probe.transport_profile_uris):
            yield f"TransportProfileUris[{index}]", uri
        yield "IncludeWriterGroups", probe.include_writer_groups
    if probe.kind in (ProbeKind.PUBSUB_CONNECTIONS, ProbeKind.WRITER_GROUP_CONFIGURATION):
        yield "IncludeDataSetWriters", probe.include_data_set_writers


def in_wire_order(value: Any) -> tuple[Any, ...]:
    """The parts of a structure as they stand in the bytes."""
    if isinstance(value, DataSetMetaData):
        version = value.configuration_version
        return value.namespaces, value.name, value.description, value.fields, value.data_set_class_id, version
    if isinstance(value, FieldMetaData):
        data_type = NodeId(0, value.builtin_type) if value.data_type is None else value.data_type
        return (
            *(value.name, value.description, value.field_flags, value.builtin_type, data_type, value.value_rank),
            *(value.array_dimensions, value.max_string_length, value.data_set_field_id),
            tuple((key, Variant(code, part)) for key, code, part in value.properties),
        )
    return tuple(value)


def values_of(value: Any) -> Iterator[Any]:
    """The single values of an announcement; empty Strings, null and counts are not told apart here."""
    if isinstance(value, Variant):
        yield from [part for _, part in of_value("", *value)]
    elif isinstance(value, ExtensionObject):
        yield from values_of(value.body)
    elif isinstance(value, tuple) and not isinstance(value, NodeId | QualifiedName | LocalizedText):
        for part in in_wire_order(value):
            yield from values_of(part)
    elif value not in (None, "", b""):
        yield value


def of_action(message: ActionMessage) -> Iterator[Named]:
    parts = (message, *message.others)
    yield from present(("PublisherId", message.publisher_id), ("WriterGroupId", message.writer_group_id))
    for index, part in enumerate(parts):
        yield f"DataSetWriterIds[{index}]", part.data_set_writer_id
    for name, value in (
        ("ResponseAddress", message.response_address),
        ("CorrelationData", message.correlation_data),
        ("RequestorId", message.requestor_id),
        ("TimeoutHint", message.timeout_hint_ms),
    ):
        yield from present((name, value or None))
    for part in parts:
        yield from present(("Timestamp", part.timestamp), ("Status", part.status))
        yield "ActionTargetId", part.action_target_id
        yield "RequestId", part.request_id
        yield "ActionState", part.action_state
        for index, (code, value) in enumerate(zip(part.types, part.values, strict=True)):
            yield from of_value(f"DataSetFields[{index}]", code, value)


@pytest.mark.parametrize("action", ACTIONS)
def test_actions(action: ActionMessage) -> None:
    datagram = encode_action(action)
    spans = annotate(datagram)
    assert covers(spans, datagram)
    assert shown(spans) == list(of_action(action))
    assert not any(span.name == "NotRead" for span in spans)


def told(decoded: object) -> list[Named] | None:
    """What the annotation has to show of a decoded message."""
    if isinstance(decoded, NetworkMessage):
        return list(of_message(decoded))
    return None


def refused(datagram: bytes) -> RemoteWireError | None:
    try:
        Codec().decode(datagram)
    except RemoteWireError as error:
        return error
    return None


@pytest.mark.parametrize("datagram", [pytest.param(data, id=str(at)) for at, data in enumerate(plain_messages())])
def test_every_byte_once_and_the_values_of_the_decoder(datagram: bytes) -> None:
    error = refused(datagram)
    spans = annotate(datagram, error=None if error and error.cause == "secured" else error)
    assert covers(spans, datagram)
    if error is None:
        expected = told(Codec().decode(datagram))
        assert expected is None or shown(spans) == expected


def shown_behind(spans: tuple[ByteSpan, ...], section: str) -> list[Named]:
    return [(name, value) for name, value in shown(tuple(span for span in spans if span.section == section))]


@pytest.mark.parametrize("probe", PROBES, ids=lambda probe: ProbeKind(probe.kind).name)
def test_probes(probe: Probe) -> None:
    datagram = encode_probe(probe)
    spans = annotate(datagram)
    assert covers(spans, datagram)
    assert shown_behind(spans, "Discovery probe") == list(of_probe(probe))
    assert not any(span.name == "NotRead" for span in spans)


@pytest.mark.parametrize("name", ANNOUNCEMENTS)
def test_announcements(name: str) -> None:
    announcement = ANNOUNCEMENTS[name]
    datagram = encode_announcement(announcement)
    spans = annotate(datagram)
    assert covers(spans, datagram)
    assert not any(span.name == "NotRead" for span in spans)
    if isinstance(announcement, Announcement):
        return
    _, *rest = [
        value
        for name, value in shown_behind(spans, "Discovery announcement")
        if not name.endswith((".TypeId", ".Encoding", "ApplicationInformationType")) and value not in (None, "", b"")
    ]
    assert rest == list(values_of(announcement[2:]))


def test_secured_messages_show_what_was_encrypted() -> None:
    for datagram in secured_messages():
        heard = read_security(datagram)
        key = next(key for key in KEYS if signed_by(key, heard))
        plain = key.unprotect(heard)
        end = len(datagram) - SIGNATURE_BYTES
        payload = plain[len(plain) - (end - heard.payload_offset) :]
        spans = annotate(datagram, payload=payload)
        assert covers(spans, datagram[: heard.payload_offset] + payload + datagram[end:])
        assert shown(spans) == [*shown(annotate(plain)), ("Signature", None)]
        closed = annotate(datagram)
        assert covers(closed, datagram)
        assert any(span.name == "EncryptedData" for span in closed) == (heard.mode is SecurityMode.SIGN_AND_ENCRYPT)
        assert covers(annotate(datagram, closed=True), datagram)
        assert [span for span in annotate(datagram, closed=True) if span.offset < heard.payload_offset] == [
            span for span in spans if span.offset < heard.payload_offset
        ]


def signed_by(key: MessageKey, heard: SecuredDatagram) -> bool:
    try:
        key.unprotect(heard)
    except RemoteWireError:
        return False
    return True


def test_chunks() -> None:
    for datagram in chunked_messages():
        chunk = read_chunk(datagram)
        assert chunk is not None
        spans = annotate(datagram)
        assert covers(spans, datagram)
        values = {span.name: span.value for span in spans}
        assert (values["MessageSequenceNumber"], values["ChunkOffset"], values["TotalSize"]) == (
            chunk.message_sequence_number,
            chunk.offset,
            chunk.total_size,
        )
        assert spans[-1].data == chunk.data
        assert values.get("DataSetWriterId") == chunk.data_set_writer_id


@pytest.mark.parametrize("encoded", [pytest.param(row[2], id=row[0]) for row in TABLE])
def test_malformed_messages_are_named_up_to_the_mistake(encoded: str) -> None:
    datagram = bytes.fromhex(encoded)
    error = refused(datagram)
    assert error is not None
    spans = annotate(datagram, error=error)
    assert covers(spans, datagram)
    assert [span.offset for span in spans[:-1]] == [span.offset for span in spans if span.offset < error.offset][
        : len(spans) - 1
    ]


def test_mutated_messages() -> None:
    chance, corpus = Random(3), plain_messages()
    codec = Codec()
    for _ in range(5_000):
        datagram = mutate(chance, corpus)
        error = decoded = None
        try:
            decoded = codec.decode(datagram)
        except RemoteWireError as caught:
            error = caught
        spans = annotate(datagram, error=error)
        assert covers(spans, datagram)
        expected = told(decoded)
        if expected is not None:
            assert repr(shown(spans)) == repr(expected)  # NaN is not equal to itself
        if isinstance(decoded, NetworkMessage) and all(part.valid for part in decoded.messages):
            assert not any(span.name == "NotRead" for span in spans)


def test_flags_are_spelled_out() -> None:
    spans = annotate(bytes.fromhex("f101ba08016400014df4 09 0100 0300"))
    assert [(span.offset, span.name, span.meaning) for span in spans[:6]] == [
        (0, "UADPFlags", "version 1; PublisherId, GroupHeader, PayloadHeader, ExtendedFlags1"),
        (1, "ExtendedFlags1", "PublisherId is a UInt16"),
        (2, "PublisherId", "2234"),
        (4, "GroupFlags", "WriterGroupId"),
        (5, "WriterGroupId", "100"),
        (7, "Count", "1 DataSetMessage"),
    ]
    assert spans[7][3:] == ("DataSetFlags1", 9, "valid, fields are Variant; DataSetMessageSequenceNumber")


@pytest.mark.parametrize(
    ("code", "name"),
    [(0, "Null"), (1, "Boolean"), (11, "Double"), (0x8D, "DateTime[]"), (0xC6, "Int32[][]"), (26, "type 26")],
)
def test_names_of_types(code: int, name: str) -> None:
    assert type_name(code) == name


def test_nothing_that_a_terminal_obeys_is_shown() -> None:
    text = "\x1b[31m"
    datagram = bytes.fromhex("f101ba08016400014df4 01 0100 0c 05000000") + text.encode()
    assert all(span.meaning.isprintable() for span in annotate(datagram))


def test_nested_values_do_not_exhaust_the_stack() -> None:
    datagram = bytes.fromhex("f101ba08016400014df4 01 0100") + b"\x18" * 50_000
    assert covers(annotate(datagram, error=refused(datagram)), datagram)
    assert covers(annotate(datagram), datagram)
