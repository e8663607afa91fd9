"""Structures, structures with optional fields and unions: JSON beside bytes, by their descriptions (5.4.6 to 5.4.8)."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from tests.unit.wire.json.samples import METADATA, OPTIONAL, PATH, POINT, UNION
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ExtensionObject, NodeId
from ua_fleet.wire.builtin import encode_extension_object as encode_binary
from ua_fleet.wire.descriptions import StructureDescription, StructureField, StructureType
from ua_fleet.wire.json import DataSetFields, JsonBody, JsonCause, Leniency, Reading
from ua_fleet.wire.json.data_types import DataTypes
from ua_fleet.wire.json.fields import decode_field, encode_field, planned_fields
from ua_fleet.wire.json.structures import decode_extension_object, encode_extension_object
from ua_fleet.wire.json.variants import Writing
from ua_fleet.wire.messages import DataSetMessage, FieldMetaData

TYPES = DataTypes(METADATA)
VERBOSE = Writing(METADATA.namespaces, verbose=True, types=TYPES)
COMPACT = VERBOSE._replace(verbose=False)
RAW = VERBOSE._replace(raw=True)


def reading() -> Reading:
    return Reading(METADATA.namespaces, TYPES)


def body(layout: str, *values: Any) -> bytes:
    return struct.pack("<" + layout, *values)


PAST = body("dqi1s", 1.5, -3, 1, b"a") + body("dqi", 0.0, 0, -1)

CASES: list[tuple[StructureDescription, bytes, Any, Any]] = [
    (POINT, body("dqi1s", 1.5, -3, 1, b"a"), {"X": 1.5, "Y": "-3", "Name": "a"}, {"X": 1.5, "Y": "-3", "Name": "a"}),
    (POINT, body("dqi", 0.0, 0, -1), {}, {"X": 0.0, "Y": "0", "Name": None}),
    (
        PATH,
        body("i", 2) + PAST + body("i", 1) + body("iii", 2, 1, 2) + body("ii", 5, 6) + bytes((6,)) + body("i", 9),
        {
            "Points": [{"X": 1.5, "Y": "-3", "Name": "a"}, {}],
            "Colour": 1,
            "Grid": {"Array": [5, 6], "Dimensions": [1, 2]},
            "Any": {"UaType": 6, "Value": 9},
        },
        {
            "Points": [{"X": 1.5, "Y": "-3", "Name": "a"}, {"X": 0.0, "Y": "0", "Name": None}],
            "Colour": "Deep_Green_1",
            "Grid": {"Array": [5, 6], "Dimensions": [1, 2]},
            "Any": {"UaType": 6, "Value": 9},
        },
    ),
    # The example of OPC 10000-6 5.4.7: O1 is absent, O2 is there and 0.
    (OPTIONAL, body("Iibi", 2, 1, 2, 0), {"EncodingMask": 2, "X": 1, "Y": 2}, {"X": 1, "Y": 2, "O2": 0}),
    # The example of OPC 10000-6 5.4.8.
    (UNION, body("Id", 2, 3.1415), {"SwitchField": 2, "B": 3.1415}, {"B": 3.1415}),
    (UNION, body("I", 0), {}, {}),
    (UNION, body("Ii", 1, 0), {"SwitchField": 1, "A": 0}, {"A": 0}),
]


@pytest.mark.parametrize(("description", "data", "compact", "verbose"), CASES)
def test_both_ways(description: StructureDescription, data: bytes, compact: Any, verbose: Any) -> None:
    value = ExtensionObject(description.default_encoding, data)
    type_id = {"UaTypeId": f"nsu=urn:fleet;i={description.data_type.identifier!s}"}
    assert encode_extension_object(COMPACT, value) == type_id | compact
    assert encode_extension_object(VERBOSE, value) == type_id | verbose
    for text in (type_id | compact, type_id | verbose):
        noted = reading()
        assert decode_extension_object(noted, text) == value
        assert not noted.leniencies


def field_of(description: StructureDescription, rank: int = -1) -> Any:
    field = FieldMetaData("f", 22, data_type=description.data_type, value_rank=rank)
    return planned_fields(METADATA._replace(fields=(field,)), TYPES)[0]


@pytest.mark.parametrize(("description", "data", "compact", "verbose"), CASES)
def test_as_a_field_of_their_own_type(
    description: StructureDescription, data: bytes, compact: Any, verbose: Any
) -> None:
    value = ExtensionObject(description.default_encoding, data)
    field = field_of(description)
    assert encode_field(VERBOSE, field, 22, value) == verbose
    if description is not PATH:
        assert encode_field(RAW, field, 22, value) == verbose
    else:
        assert encode_field(RAW, field, 22, value) == verbose | {"Any": {"Value": 9}}
    text = encode_field(COMPACT, field, 22, value)
    assert text == {
        "UaType": 22,
        "Value": {"UaTypeId": f"nsu=urn:fleet;i={description.data_type.identifier!s}"} | compact,
    }
    for item in (verbose, text):
        assert decode_field(reading(), field, item)[:2] == (22, value)


def test_a_subtype_says_its_type() -> None:
    value = ExtensionObject(POINT.default_encoding, body("dqi", 0.0, 1, -1))
    text = encode_field(VERBOSE, field_of(UNION), 22, value)
    assert text == {"UaTypeId": "nsu=urn:fleet;i=3003", "X": 0.0, "Y": "1", "Name": None}
    assert decode_field(reading(), field_of(UNION), text)[:2] == (22, value)


def test_an_array_of_structures() -> None:
    values = (ExtensionObject(UNION.default_encoding, body("Ii", 1, 7)), ExtensionObject(NodeId(0, 0), None))
    text = encode_field(VERBOSE, field_of(UNION, 1), 22 | 0x80, values)
    assert text == [{"A": 7}, {}]
    assert decode_field(reading(), field_of(UNION, 1), text).value[0] == values[0]


def test_the_older_forms_of_unions_and_structures() -> None:
    noted = reading()
    old = {"TypeId": {"Id": 3006, "Namespace": 1}, "Body": {"SwitchField": 2, "Value": 3.1415}}
    assert decode_extension_object(noted, old) == ExtensionObject(UNION.default_encoding, body("Id", 2, 3.1415))
    assert Leniency.OLD_UNION in noted.leniencies
    noted = reading()
    assert decode_field(noted, field_of(UNION), "text").value == ExtensionObject(
        UNION.default_encoding, body("Ii4s", 3, 4, b"text")
    )
    assert noted.leniencies == {Leniency.OLD_UNION: 1}


def test_one_without_a_description_stays_json() -> None:
    noted = reading()
    text = {"UaTypeId": "nsu=urn:fleet;i=9999", "A": [1, {"B": 2}]}
    value = decode_extension_object(noted, text)
    assert isinstance(value.body, JsonBody)
    assert noted.leniencies == {Leniency.STRUCTURE_UNDESCRIBED: 1}
    assert encode_extension_object(VERBOSE, value) == text
    with pytest.raises(LocalWireError, match="no description tells"):
        encode_binary(bytearray(), value)


def test_bytes_that_are_not_as_described_stay_bytes() -> None:
    for data in (b"short", body("dqi", 0.0, 0, -1) + b"more", body("I", 9)):
        value = ExtensionObject(UNION.default_encoding if len(data) == 4 else POINT.default_encoding, data)
        text = encode_extension_object(VERBOSE, value)
        assert text is not None
        assert text["UaEncoding"] == 1
        assert decode_extension_object(reading(), text).body == data


def test_structures_of_the_specification_need_no_description() -> None:
    value = ExtensionObject(NodeId(0, 886), body("dd", -1.0, 1.0))
    assert encode_extension_object(VERBOSE, value) == {"UaTypeId": "i=884", "Low": -1.0, "High": 1.0}
    bits = ExtensionObject(NodeId(0, 12765), body("i1si1s", 1, b"\5", 1, b"\7"))
    text = encode_extension_object(COMPACT, bits)
    assert text == {"UaTypeId": "i=12755", "Value": "BQ==", "ValidBits": "Bw=="}
    assert decode_extension_object(reading(), text) == bits


def test_subtyped_values_are_extension_objects_and_variants() -> None:
    description = StructureDescription(
        NodeId(1, 1),
        METADATA.structures[0].name,
        (
            StructureField("S", POINT.data_type, is_optional=True),
            StructureField("N", NodeId(0, 26), is_optional=True),
            StructureField("P", POINT.data_type),
        ),
        StructureType.WITH_SUBTYPED_VALUES,
        NodeId(1, 2),
    )
    types = DataTypes(METADATA._replace(structures=(POINT, description)))
    text = {
        "UaTypeId": "nsu=urn:fleet;i=1",
        "S": {"UaTypeId": "nsu=urn:fleet;i=3003", "X": 1.5, "Y": "2", "Name": None},
        "N": {"UaType": 3, "Value": 7},
        "P": {"X": 0.0, "Y": "0", "Name": None},
    }
    value = decode_extension_object(Reading(METADATA.namespaces, types), text)
    assert isinstance(value.body, bytes)
    assert not isinstance(value.body, JsonBody)
    assert encode_extension_object(VERBOSE._replace(types=types), value) == text


@pytest.mark.parametrize(
    ("number", "members", "cause"),
    [
        (3003, [1], JsonCause.VALUE_TYPE),
        (3003, {"X": "fast"}, JsonCause.VALUE_TEXT),
        (3004, {"Points": {}}, JsonCause.VALUE_TYPE),
        (3004, {"Grid": [1]}, JsonCause.DIMENSIONS),
        (3004, {"Colour": "Red_--1"}, JsonCause.VALUE_TEXT),
        (3005, {"EncodingMask": 4}, JsonCause.STRUCTURE),
        (3006, {"SwitchField": 4}, JsonCause.STRUCTURE),
        (3006, {"A": 1, "B": 2.0}, JsonCause.STRUCTURE),
        (3006, {"D": 1}, JsonCause.STRUCTURE),
        (3006, True, JsonCause.STRUCTURE),
    ],
)
def test_what_contradicts_its_description(number: int, members: Any, cause: JsonCause) -> None:
    old = {"TypeId": {"Id": number, "Namespace": 1}, "Body": members}
    with pytest.raises(RemoteWireError) as caught:
        decode_extension_object(reading(), old)
    assert caught.value.cause == cause


def test_a_structure_that_contains_itself_ends() -> None:
    itself = POINT._replace(data_type=NodeId(1, 1), fields=(StructureField("Self", NodeId(1, 1)),))
    types = DataTypes(METADATA._replace(structures=(itself,)))
    with pytest.raises(RemoteWireError) as caught:
        decode_extension_object(Reading(METADATA.namespaces, types), {"UaTypeId": "nsu=urn:fleet;i=1"})
    assert caught.value.cause == JsonCause.DEPTH
    value = ExtensionObject(itself.default_encoding, b"")
    text = encode_extension_object(VERBOSE._replace(types=types), value)
    assert text == {"UaTypeId": "nsu=urn:fleet;i=5003", "UaEncoding": 1, "UaBody": ""}


def described(*structures: StructureDescription) -> DataSetFields:
    field = FieldMetaData("f", 22, data_type=structures[0].data_type)
    return DataSetFields(METADATA._replace(fields=(field,), structures=structures))


def level_of(number: int) -> StructureDescription:
    """A structure of ten of the next level."""
    members = tuple([StructureField(f"m{index}", NodeId(1, number + 1)) for index in range(10)])
    return POINT._replace(data_type=NodeId(1, number), fields=members, default_encoding=NodeId(1, 6000 + number))


ITSELF = UNION._replace(
    data_type=NodeId(1, 1), fields=tuple([StructureField(f"m{index}", NodeId(1, 1)) for index in range(8)])
)
TEXTS = UNION._replace(
    data_type=NodeId(1, 1), fields=tuple([StructureField(f"m{index}", NodeId(0, 15)) for index in range(1_000)])
)


@pytest.mark.parametrize(
    ("structures", "item"),
    [
        ((ITSELF,), True),  # 8 ** 17 ways
        ((*map(level_of, range(1, 11)), POINT._replace(data_type=NodeId(1, 11))), {}),  # 10 ** 10 members
        ((TEXTS,), "A" * 100_001),  # each member reads it all, and finds at its end that it is none
    ],
)
def test_what_descriptions_make_of_a_short_value_is_bounded(
    structures: tuple[StructureDescription, ...], item: Any
) -> None:
    fields = described(*structures)
    payload = {"f": item}
    for read in (fields.decode, fields.decode_by_names):
        with pytest.raises(RemoteWireError) as caught:
            read(Reading(), DataSetMessage(1), payload)
        assert caught.value.cause == JsonCause.ELEMENTS
    # What one message has spent is not missing in the next one.
    assert fields.planned(payload) is None
    assert fields.decode(Reading(), DataSetMessage(1), {"f": None}).types == (22,)


def test_the_messages_of_one_text_have_one_budget() -> None:
    fields = described(*map(level_of, range(1, 4)), POINT._replace(data_type=NodeId(1, 4)))
    noted = Reading()
    for _ in range(20):
        fields.decode(noted, DataSetMessage(1), {"f": {}})
    noted.packed *= 10
    with pytest.raises(RemoteWireError) as caught:
        fields.decode(noted, DataSetMessage(1), {"f": {}})
    assert caught.value.cause == JsonCause.ELEMENTS


def test_what_fields_of_one_type_know_of_it_is_made_once() -> None:
    kinds = ((6, NodeId(1, 3001)), (22, POINT.data_type))
    fields = [FieldMetaData(f"f{kind}{index}", kind, data_type=of) for kind, of in kinds for index in range(2)]
    first, second, third, fourth = DataSetFields(METADATA._replace(fields=tuple(fields))).fields
    assert first.names == {0: "Red", 1: "Deep_Green"}
    assert first.names is second.names
    assert third.members == {"EncodingMask", "SwitchField", "UaTypeId", "X", "Y", "Name"}
    assert third.members is fourth.members
