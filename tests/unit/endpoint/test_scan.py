"""The scan reads what asyncua reads, and refuses what its budget, the bytes or the specification do not allow."""

from __future__ import annotations

import importlib
import struct
import tracemalloc
from typing import Any

import pytest
from asyncua.common.utils import Buffer

from ua_fleet.endpoint.binary.encoders import encode
from ua_fleet.endpoint.data_values import in_asyncuas_order
from ua_fleet.endpoint.decoding import decode_parameters, decode_request_head
from ua_fleet.endpoint.scan import DEEPEST_NESTING, Scan, step_of
from ua_fleet.endpoint.stack import Refusal, name_of
from ua_fleet.errors import RemoteWireError

ua: Any = importlib.import_module("asyncua.ua")
binary: Any = importlib.import_module("asyncua.ua.ua_binary")

MIB = 1024 * 1024


def length(value: int) -> bytes:
    return struct.pack("<i", value)


def scanned(kind: Any, data: bytes, memory: int = 64 * MIB) -> int:
    """How far a value reaches."""
    scan = Scan(data, 0, len(data), memory)
    step_of(kind).walk(scan)
    return scan.position


def refused(kind: Any, data: bytes, memory: int = 64 * MIB) -> str:
    with pytest.raises(Refusal) as error:
        scanned(kind, data, memory)
    return name_of(error.value.ua_status)


def _variant(value: Any, kind: Any) -> Any:
    return ua.Variant(value, kind)


VALUES = [
    ua.Variant(),
    _variant([1, 2, 3], ua.VariantType.Int16),
    _variant([[1, 2], [3, 4], [5, 6]], ua.VariantType.Double),
    _variant([], ua.VariantType.String),
    _variant("\u00e4\U0001f600", ua.VariantType.String),
    _variant(None, ua.VariantType.ByteString),
    _variant([ua.Variant(1, ua.VariantType.Byte), ua.Variant(["a"], ua.VariantType.String)], ua.VariantType.Variant),
    _variant(ua.DataValue(1.5), ua.VariantType.DataValue),
    _variant([ua.DataValue("x"), ua.DataValue(None, ua.StatusCode(ua.StatusCodes.Bad))], ua.VariantType.DataValue),
    _variant(ua.LocalizedText("a", "de"), ua.VariantType.LocalizedText),
    _variant(ua.QualifiedName("a", 3), ua.VariantType.QualifiedName),
    _variant(ua.NodeId("a", 3), ua.VariantType.NodeId),
    _variant(ua.ExpandedNodeId("a", 3, None, "urn:x", 1), ua.VariantType.ExpandedNodeId),
    _variant([ua.Range(1.0, 2.0), ua.EUInformation()], ua.VariantType.ExtensionObject),
    _variant(ua.ExtensionObject(ua.NodeId(99999, 7), b"abc"), ua.VariantType.ExtensionObject),
    _variant(ua.DiagnosticInfo(), ua.VariantType.DiagnosticInfo),
]


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_a_value_is_scanned_to_its_end(value: Any) -> None:
    data = binary.variant_to_binary(value)
    assert scanned(ua.Variant, data + b"rest") == len(data)


def test_every_structure_is_scanned_as_far_as_asyncua_reads_it() -> None:
    read = 0
    for kind in set(ua.extension_objects_by_typeid.values()):
        try:
            data = binary.struct_to_binary(kind())
            rest = Buffer(data)
            binary.from_binary(kind, rest)
        except Exception:  # noqa: BLE001 - one that asyncua cannot take through itself is none to compare with
            continue
        assert scanned(kind, data) == rest.cur_pos, kind
        read += 1
    assert read > 250


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"\x80" + length(10**8), "BadDecodingError"),
        (b"\x80" + length(1), "BadDecodingError"),
        (b"\x97" + length(10**8), "BadDecodingError"),
        (b"\x86" + length(2**31 - 1), "BadDecodingError"),
        (b"\x8c" + length(-5), "BadDecodingError"),
        (b"\x0c" + length(-5) + b"abc", "BadDecodingError"),
        (b"\x0c" + length(4) + b"abc", "BadDecodingError"),
        (b"\x46\0\0\0\0" + length(1) + length(1), "BadDecodingError"),
        (b"\x18\0", "BadDecodingError"),
        (b"\x20\0", "BadDecodingError"),
        (b"\xc6" + length(1) + bytes(4) + length(2) + length(1000) * 2, "BadDecodingError"),
        (b"\xc6" + length(0) + length(2) + length(1_000_000) + length(0), "BadDecodingError"),
        (b"\xc6" + length(1) + bytes(4) + length(33) + length(1) * 33, "BadDecodingError"),
        (b"\xc6" + length(1) + bytes(4) + length(2) + length(-1) * 2, "BadDecodingError"),
        (b"\xc6" + length(4) + bytes(16) + length(1) + length(3), "BadDecodingError"),
        (b"\x11\x03\0\0" + length(-1), "BadDecodingError"),
        (b"\x11\x06\0\0", "BadDecodingError"),
        (b"\x16\x01\0\x04\x03\x01" + length(-1), "BadDecodingError"),
        (b"\x16\x01\0\x04\x03\x02" + length(0), "BadDecodingError"),
        (b"\x16\x01\0\x74\x03\x01" + length(100), "BadDecodingError"),
        (b"\x97" + length(60_000) + bytes(60_000), "BadEncodingLimitsExceeded"),
        (b"\x98" + length(60_000) + bytes(60_000), "BadEncodingLimitsExceeded"),
        (b"\x8c" + length(60_000) + length(-1) * 60_000, "BadEncodingLimitsExceeded"),
        ((b"\x98" + length(1)) * (DEEPEST_NESTING + 1) + b"\0", "BadEncodingLimitsExceeded"),
        ((b"\x97" + length(1) + b"\1") * (DEEPEST_NESTING + 1) + b"\0", "BadEncodingLimitsExceeded"),
    ],
)
def test_what_no_bytes_can_hold_is_refused_without_memory(data: bytes, code: str) -> None:
    tracemalloc.start()
    try:
        assert refused(ua.Variant, data, 4 * MIB) == code
        assert tracemalloc.get_traced_memory()[1] < 2 * MIB
    finally:
        tracemalloc.stop()


async def test_as_many_levels_as_the_specification_wants_are_decoded() -> None:
    value = (b"\x98" + length(1)) * (DEEPEST_NESTING - 1) + b"\0"
    body = length(1) + b"\0\x55" + struct.pack("<I", 13) + length(-1) + b"\1" + value
    decoded = await decode_parameters(ua.WriteParameters, Buffer(body), most_operations=1, most_memory=MIB)
    inner, levels = decoded.NodesToWrite[0].Value.Value, 0
    while inner.Value:
        inner, levels = inner.Value[0], levels + 1
    assert levels == DEEPEST_NESTING - 1


async def test_more_memory_than_the_budget_is_never_taken() -> None:
    """The estimate of the scan is above what asyncua really takes, for values small and large."""
    for value in (
        b"\x83" + length(1_000_000) + b"\x7f" * 1_000_000,
        b"\x82" + length(330_000) + b"\x80" * 330_000,
        b"\x84" + length(330_000) + b"\x80\x80" * 330_000,
        b"\x97" + length(19_000) + bytes(19_000),
        b"\x98" + length(75_000) + bytes(75_000),
        b"\x91" + length(60_000) + bytes(120_000),
        b"\xc3" + length(100_000) + bytes(100_000) + length(2) + length(100_000) + length(1),
    ):
        body = length(1) + b"\0\x55" + struct.pack("<I", 13) + length(-1) + b"\1" + value
        tracemalloc.start()
        try:
            await decode_parameters(ua.WriteParameters, Buffer(body), most_operations=1, most_memory=16 * MIB)
            assert tracemalloc.get_traced_memory()[1] < 20 * MIB
        finally:
            tracemalloc.stop()


def test_dimensions_cost_a_list_of_all_elements_each() -> None:
    """32 of them over a million bytes took 250 MB: asyncua keeps what it slices at each level."""
    count = 1_000_000
    array = bytes([0x80 | 0x40 | ua.VariantType.Byte.value]) + length(count) + bytes(count)
    many = array + length(32) + length(1) * 31 + length(count)
    assert refused(ua.Variant, many) == "BadEncodingLimitsExceeded"
    few = array + length(2) + length(1000) * 2
    assert scanned(ua.Variant, few) == len(few)


async def test_operations_are_counted_before_they_are_decoded() -> None:
    body = bytes(12) + length(3) + binary.struct_to_binary(ua.ReadValueId()) * 3
    decoded = await decode_parameters(ua.ReadParameters, Buffer(body), most_operations=3, most_memory=MIB)
    assert len(decoded.NodesToRead) == 3
    with pytest.raises(Refusal) as error:
        await decode_parameters(ua.ReadParameters, Buffer(body), most_operations=2, most_memory=MIB)
    assert name_of(error.value.ua_status) == "BadTooManyOperations"


async def test_a_null_array_of_operations_is_an_empty_one() -> None:
    decoded = await decode_parameters(
        ua.DeleteSubscriptionsParameters, Buffer(length(-1)), most_operations=1, most_memory=MIB
    )
    assert decoded.SubscriptionIds == []


def _head(additional: bytes) -> bytes:
    return (
        b"\1\0\xae\1\5\0\0"
        + length(3)
        + b"abc"
        + bytes(8)
        + struct.pack("<II", 7, 0)
        + length(-1)
        + length(5)
        + additional
    )


def test_an_additional_header_is_passed_and_not_decoded() -> None:
    bomb = b"\x80" + length(10**8)
    for additional in (b"\0\0\0", b"\1\0\x75\x03\1" + length(len(bomb)) + bomb, b"\0\0\2" + length(3) + b"<a>"):
        body = Buffer(_head(additional) + b"parameters")
        head = decode_request_head(body)
        assert (head.kind, head.token, head.handle, head.timeout_hint_ms) == (430, b"abc", 7, 5)
        assert bytes(body) == b"parameters"


@pytest.mark.parametrize("cut", range(1, len(_head(b"\0\0\1" + length(2) + b"xy"))))
def test_a_header_that_is_cut_is_refused(cut: int) -> None:
    with pytest.raises((RemoteWireError, Refusal)):
        decode_request_head(Buffer(_head(b"\0\0\1" + length(2) + b"xy")[:-cut]))


def test_where_the_times_of_a_data_value_are_in_another_order_is_found() -> None:
    """asyncua has SourcePicoSeconds behind ServerTimestamp, OPC 10000-6 5.2.2.17 before."""
    times, number = struct.pack("<qHqH", 1, 2, 3, 4), b"\x03\x07"
    given = b"\x3d" + number + times
    scan = Scan(given, 0, len(given), MIB)
    step_of(ua.DataValue).walk(scan)
    assert (scan.position, scan.misplaced) == (len(given), [11])
    read = binary.from_binary(ua.DataValue, Buffer(in_asyncuas_order(given, scan.misplaced)))
    assert (read.SourcePicoseconds, read.ServerPicoseconds) == (2, 4)
    assert [ua.datetime_to_win_epoch(time) // 10 for time in (read.SourceTimestamp, read.ServerTimestamp)] == [0, 0]
    nested = b"\x17" + given
    for data, kind in (
        (b"\x1c" + times[:-2], ua.DataValue),  # without a value: found
        (b"\x34" + times[:10] + times[-2:], ua.DataValue),  # no ServerTimestamp
        (b"\x2c" + times[:8] + times[10:], ua.DataValue),  # no SourcePicoSeconds
        (nested, ua.Variant),
    ):
        scan = Scan(data, 0, len(data), MIB)
        step_of(kind).walk(scan)
        assert (scan.position, scan.misplaced) == (len(data), [9] if data[0] == 0x1C else [])


async def test_each_operation_has_its_times_in_order() -> None:
    """Also behind one that has none, and before one."""
    plain = ua.WriteValue(ua.NodeId("a", 1), ua.AttributeIds.Value, None, ua.DataValue(1.5))
    other = b"\x00\x05\x0d\x00\x00\x00\xff\xff\xff\xff" + b"\x3d\x03\x07" + struct.pack("<qHqH", 10, 2, 30, 4)
    parts = [binary.struct_to_binary(plain), other, other, binary.struct_to_binary(plain)]
    body = Buffer(length(len(parts)) + b"".join(parts))
    decoded = await decode_parameters(ua.WriteParameters, body, most_operations=10, most_memory=MIB)
    values = [each.Value for each in decoded.NodesToWrite]
    assert [value.Value.Value for value in values] == [1.5, 7, 7, 1.5]
    assert [value.SourcePicoseconds for value in values] == [None, 2, 2, None]
    assert [value.ServerPicoseconds for value in values] == [None, 4, 4, None]
    assert [ua.datetime_to_win_epoch(value.ServerTimestamp) for value in values[1:3]] == [30, 30]
    assert b"".join(encode(value)[-20:] for value in values[1:3]) == struct.pack("<qHqH", 10, 2, 30, 4) * 2


def test_what_has_no_picoseconds_is_encoded_as_by_asyncua() -> None:
    time = ua.get_win_epoch()
    for value in (
        ua.DataValue(1.5),
        ua.DataValue(1.5, SourceTimestamp=time, ServerTimestamp=time),
        ua.DataValue(1.5, SourceTimestamp=time, SourcePicoseconds=2),
        ua.ReadValueId(),
    ):
        assert encode(value) == binary.struct_to_binary(value)


@pytest.mark.parametrize(
    "token", [b"\x00\x00", b"\x00\x07", b"\x01\x00\x00\x00", b"\x05\x00\x00" + length(32) + b"t" * 32]
)
def test_a_common_header_is_read_as_any_other(token: bytes) -> None:
    data = (
        b"\x01\x00" + struct.pack("<H", 461) + token + struct.pack("<qII", 1, 7, 3) + length(-1) + length(5) + bytes(3)
    )
    body, entry = Buffer(data + b"parameters"), Buffer(data.replace(length(-1), length(0)))
    head = decode_request_head(body)
    assert head == decode_request_head(entry)
    assert (head.kind, head.handle, head.diagnostics, head.timeout_hint_ms) == (461, 7, 3, 5)
    assert head.token == (b"t" * 32 if len(token) > 32 else None)
    assert bytes(body) == b"parameters"
