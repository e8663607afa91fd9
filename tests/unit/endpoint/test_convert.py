"""Values between our form and asyncua's."""

from __future__ import annotations

import dataclasses
import importlib
import uuid
from datetime import UTC, datetime
from typing import Any

import pytest
from asyncua import ua as typed_ua
from asyncua.common.utils import Buffer

from ua_fleet.endpoint.convert import data_value, fleet_variant, to_status, to_variant
from ua_fleet.nodes.units import unit_code, unit_id
from ua_fleet.values import (
    ARRAY,
    DIMENSIONS,
    UNIX_EPOCH_TICKS,
    BuiltinType,
    DataValue,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    StatusCode,
    Variant,
)

ua: Any = typed_ua
binary: Any = importlib.import_module("asyncua.ua.ua_binary")
NOW = datetime(2026, 1, 2, tzinfo=UTC)

SCALARS: dict[BuiltinType, Any] = {
    BuiltinType.BOOLEAN: True,
    BuiltinType.SBYTE: -1,
    BuiltinType.BYTE: 200,
    BuiltinType.INT16: -300,
    BuiltinType.UINT16: 300,
    BuiltinType.INT32: -70_000,
    BuiltinType.UINT32: 70_000,
    BuiltinType.INT64: -(1 << 40),
    BuiltinType.UINT64: 1 << 63,
    BuiltinType.FLOAT: 0.5,
    BuiltinType.DOUBLE: 0.1,
    BuiltinType.STRING: "é",
    BuiltinType.DATETIME: UNIX_EPOCH_TICKS + 15_000_000_000_000_000,
    BuiltinType.GUID: uuid.UUID(int=7),
    BuiltinType.BYTE_STRING: b"\x00\xff",
    BuiltinType.XML_ELEMENT: "<a/>",
    BuiltinType.NODE_ID: NodeId(2, "1.x"),
    BuiltinType.EXPANDED_NODE_ID: ExpandedNodeId(NodeId(2, 5), "urn:x", 1),
    BuiltinType.STATUS_CODE: int(StatusCode.BAD_TIMEOUT),
    BuiltinType.QUALIFIED_NAME: QualifiedName(1, "q"),
    BuiltinType.LOCALIZED_TEXT: LocalizedText("t", "en"),
    BuiltinType.EXTENSION_OBJECT: ExtensionObject(NodeId(0, 886), bytes(16)),
}
BACK = [kind for kind in SCALARS if kind <= BuiltinType.BYTE_STRING]


@pytest.mark.parametrize("kind", SCALARS)
@pytest.mark.parametrize("shape", ["scalar", "array", "empty", "null", "matrix"])
def test_every_type_can_be_carried_to_clients(kind: BuiltinType, shape: str) -> None:
    value = SCALARS[kind]
    code, content = {
        "scalar": (kind, value),
        "array": (kind | ARRAY, (value, value)),
        "empty": (kind | ARRAY, ()),
        "null": (kind | ARRAY, None),
        "matrix": (kind | ARRAY | DIMENSIONS, Matrix((value,) * 4, (2, 2))),
    }[shape]
    packed = binary.variant_to_binary(to_variant(int(code), content))
    assert packed[0] == int(code)
    assert binary.variant_from_binary(Buffer(packed)).VariantType.value == kind


@pytest.mark.parametrize("kind", [BuiltinType.STRING, BuiltinType.BYTE_STRING, BuiltinType.XML_ELEMENT])
def test_null_texts_can_be_carried(kind: BuiltinType) -> None:
    binary.variant_to_binary(to_variant(int(kind), None))
    binary.variant_to_binary(to_variant(int(kind) | ARRAY, (None, SCALARS[kind])))


@pytest.mark.parametrize("kind", BACK)
def test_what_clients_send_comes_back_as_it_was(kind: BuiltinType) -> None:
    value = SCALARS[kind]
    for code, content in ((int(kind), value), (int(kind) | ARRAY, (value, value)), (int(kind) | ARRAY, ())):
        packed = binary.variant_to_binary(to_variant(code, content))
        assert fleet_variant(binary.variant_from_binary(Buffer(packed))) == (code, content)


def test_no_value_has_the_type_code_0() -> None:
    assert fleet_variant(None) == (0, None)


def test_nested_values_are_carried() -> None:
    inner = DataValue(Variant(BuiltinType.DOUBLE, 1.0), StatusCode.GOOD, UNIX_EPOCH_TICKS)
    binary.variant_to_binary(to_variant(int(BuiltinType.VARIANT) | ARRAY, (Variant(int(BuiltinType.DOUBLE), 1.0),)))
    assert to_variant(int(BuiltinType.DATA_VALUE), inner).Value.SourceTimestamp == datetime(1970, 1, 1, tzinfo=UTC)


def test_a_structure_in_xml_is_bad_and_harms_nothing() -> None:
    value = data_value(int(BuiltinType.EXTENSION_OBJECT), ExtensionObject(NodeId(2, 1), "<a/>"), 0, NOW, NOW)
    assert value.StatusCode == to_status(StatusCode.BAD_DATA_ENCODING_INVALID)
    assert value.Value is not None
    assert value.Value.Value is None


@pytest.mark.parametrize("status", [StatusCode.GOOD, StatusCode.BAD_NO_COMMUNICATION])
@pytest.mark.parametrize("source_time", [NOW, None])
def test_a_data_value_is_what_asyncua_would_make_of_its_parts(status: StatusCode, source_time: datetime | None) -> None:
    value = data_value(int(BuiltinType.DOUBLE), 1.5, int(status), source_time, NOW)
    made = ua.DataValue(ua.Variant(1.5, ua.VariantType.Double), ua.StatusCode(ua.UInt32(status)), source_time, NOW)
    parts = [each.name for each in dataclasses.fields(ua.DataValue)]
    assert [getattr(value, part) for part in parts] == [getattr(made, part) for part in parts]
    assert binary.struct_to_binary(value) == binary.struct_to_binary(made)


def test_a_bad_status_may_stand_beside_the_last_value() -> None:
    value = data_value(int(BuiltinType.DOUBLE), 1.5, int(StatusCode.BAD_NO_COMMUNICATION), NOW, NOW)
    read = binary.struct_from_binary(type(value), Buffer(binary.struct_to_binary(value)))
    assert read.Value.Value == 1.5
    assert read.StatusCode.name == "BadNoCommunication"
    assert read.SourceTimestamp == NOW


def test_units_have_their_unece_code() -> None:
    assert unit_code("m/s") == "MTS"
    assert unit_id("m/s") == 5067859
    assert unit_id("%") == 20529
    assert unit_id("furlong") == -1
