from __future__ import annotations

import pytest

from ua_fleet.pubsub import PropertyValue, field_property, first_property, make_field, type_code, type_codes
from ua_fleet.pubsub.frames import types_fit
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, QualifiedName
from ua_fleet.wire import Codec, encode_metadata_announcement
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMetaData,
    FieldMetaData,
    MetaDataAnnouncement,
    PublisherIdType,
)

MATRIX = ARRAY | DIMENSIONS


def test_a_field_s_properties_travel_in_its_metadata() -> None:
    properties: dict[str, PropertyValue] = {
        "RosType": "std_msgs/Float64",
        "NodeOnly": True,
        "Range": (0.0, 1.5),
        "Size": 3,
        "Step": 0.5,
    }
    fields = (make_field("a", BuiltinType.DOUBLE, properties=properties), make_field("b", BuiltinType.BYTE, array=True))
    metadata = DataSetMetaData("m", fields, ConfigurationVersion(1, 1))
    announcement = MetaDataAnnouncement(1, PublisherIdType.UINT16, 0, 7, metadata)
    decoded = Codec().decode(encode_metadata_announcement(announcement))
    assert isinstance(decoded, MetaDataAnnouncement)
    assert {name: field_property(decoded.metadata.fields[0], name) for name in properties} == properties
    assert field_property(decoded.metadata.fields[0], "Other") is None
    assert decoded.metadata.fields[1].array_dimensions == (0,)


def test_the_same_name_has_the_same_id_and_another_name_another() -> None:
    one, same, other = make_field("a", 1), make_field("a", 1), make_field("b", 1)
    assert one == same
    assert one.data_set_field_id != other.data_set_field_id


def test_a_property_is_found_in_the_first_field_that_has_it() -> None:
    fields = (make_field("a", 1), make_field("b", 1, properties={"RosType": "x/Y"}))
    metadata = DataSetMetaData("m", fields, ConfigurationVersion(1, 1))
    assert first_property(metadata, "RosType") == "x/Y"
    assert first_property(metadata, "Other") is None
    assert fields[1].properties[0][0] == QualifiedName(0, "RosType")


@pytest.mark.parametrize(("rank", "code"), [(-1, 11), (1, 11 | ARRAY), (2, 11 | MATRIX), (5, 11 | MATRIX), (-2, 11)])
def test_type_codes(rank: int, code: int) -> None:
    field = FieldMetaData("f", 11, value_rank=rank)
    assert type_code(field) == code
    assert type_codes((field, field)) == (code, code)


@pytest.mark.parametrize(
    ("rank", "fitting"),
    [
        (-1, {11}),
        (1, {11 | ARRAY}),
        (2, {11 | MATRIX}),
        (0, {11 | ARRAY, 11 | MATRIX}),
        (-2, {11, 11 | ARRAY, 11 | MATRIX}),
        (-3, {11, 11 | ARRAY}),
    ],
)
def test_a_rank_lets_in_what_it_says(rank: int, fitting: set[int]) -> None:
    field = FieldMetaData("f", 11, value_rank=rank)
    codes = {11, 11 | ARRAY, 11 | MATRIX}
    assert {code for code in codes if types_fit((code,), (field,))} == fitting
    assert not types_fit((10,), (field,))
    assert types_fit((BuiltinType.STATUS_CODE,), (field,))
