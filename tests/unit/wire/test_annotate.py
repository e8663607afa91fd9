"""What `pubsub decode` shows: every byte of a message once, with the values that the decoder gives."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import Any

import pytest

from tests.unit.wire.corpus import KEYS, chunked_messages, mutate, secured_messages, valid_messages
from tests.unit.wire.test_bad_messages import TABLE
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, DataValue, Matrix, Variant
from ua_fleet.wire import Codec
from ua_fleet.wire.annotate import annotate
from ua_fleet.wire.chunks import read_chunk
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, Probe
from ua_fleet.wire.security import SIGNATURE_BYTES, MessageKey, SecuredDatagram, SecurityMode, read_security
from ua_fleet.wire.spans import Span, printable, type_name

Named = tuple[str, Any]
NO_VALUES = ("NotRead", "RawData", "Padding", "Body")
SELF_EXPLAINING = ("Flags", "EncodingMask", "Length", "Count", "Sizes", "Size", "SecurityTokenId", "ArrayDimensions")
"""Names of what says how to read on: the decoder does not give it."""


def shown(spans: tuple[Span, ...]) -> list[Named]:
    """The values of a message, without what only says how to read on."""
    return [
        (span.name, span.value)
        for span in spans
        if span.name not in NO_VALUES
        and span.section != "SecurityHeader"
        and not any(word in span.name.rpartition(".")[2] for word in SELF_EXPLAINING)
    ]


def covers(spans: tuple[Span, ...], datagram: bytes) -> bool:
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
        ("PublisherId", message.publisher_id),
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
    yield "PublisherId", probe.publisher_id
    yield "ProbeType", 1
    yield "InformationType", probe.kind
    for index, writer_id in enumerate(probe.data_set_writer_ids):
        yield f"DataSetWriterIds[{index}]", writer_id


def told(decoded: object) -> list[Named] | None:
    """What the annotation has to show of a decoded message."""
    if isinstance(decoded, NetworkMessage):
        return list(of_message(decoded))
    return list(of_probe(decoded)) if isinstance(decoded, Probe) else None


def refused(datagram: bytes) -> RemoteWireError | None:
    try:
        Codec().decode(datagram)
    except RemoteWireError as error:
        return error
    return None


@pytest.mark.parametrize("datagram", [pytest.param(data, id=str(at)) for at, data in enumerate(valid_messages())])
def test_every_byte_once_and_the_values_of_the_decoder(datagram: bytes) -> None:
    error = refused(datagram)
    spans = annotate(datagram, error=None if error and error.cause == "secured" else error)
    assert covers(spans, datagram)
    if error is None:
        expected = told(Codec().decode(datagram))
        assert expected is None or shown(spans) == expected


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
    chance, corpus = Random(3), valid_messages()
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
    assert printable("é\x1b[2J\x9b\n") == "é\\x1b[2J\\x9b\\n"
    text = "\x1b[31m"
    datagram = bytes.fromhex("f101ba08016400014df4 01 0100 0c 05000000") + text.encode()
    assert all(span.meaning.isprintable() for span in annotate(datagram))


def test_nested_values_do_not_exhaust_the_stack() -> None:
    datagram = bytes.fromhex("f101ba08016400014df4 01 0100") + b"\x18" * 50_000
    assert covers(annotate(datagram, error=refused(datagram)), datagram)
    assert covers(annotate(datagram), datagram)
