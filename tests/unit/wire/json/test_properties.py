"""Any value, in any form: what is written is read as it was."""

from __future__ import annotations

from typing import Any

import orjson
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.wire.json.samples import SOURCE, VERSION, data
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import (
    ARRAY,
    DIMENSIONS,
    BuiltinType,
    DataValue,
    DiagnosticInfo,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    Variant,
)
from ua_fleet.wire.json import DataSetFields, Form, JsonData, JsonWriterPlan, Source, decode_json, encode_data
from ua_fleet.wire.json.dates import LATEST
from ua_fleet.wire.json.parsing import Reading
from ua_fleet.wire.json.scalars import RANGES
from ua_fleet.wire.json.variants import Writing, decode_variant, encode_variant
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FieldMetaData

B = BuiltinType
NAMESPACES = ("urn:fleet", "urn:a;b%c")

TEXTS = st.text(st.characters(codec="utf-8"), max_size=12)
GUIDS = st.uuids()
INDICES = st.integers(0, 0xFFFF)
NODE_IDS = st.builds(NodeId, INDICES, st.one_of(st.integers(0, 0xFFFF_FFFF), TEXTS, GUIDS, st.binary(max_size=9)))
STATUSES = st.integers(0, 0xFFFF_FFFF)
DATES = st.integers(0, 2_650_467_743_989_999_999) | st.just(LATEST)
MAYBE = st.none() | TEXTS
INT32S = st.none() | st.integers(-0x8000_0000, 0x7FFF_FFFF)
FLOATS = st.floats(width=32, allow_nan=False)
TEXT_OR_NONE = MAYBE.map(lambda text: text or None)
"""JSON leaves out an empty part of a LocalizedText, as it does one that is null."""

SCALARS: dict[int, st.SearchStrategy[Any]] = {
    B.BOOLEAN: st.booleans(),
    **{kind: st.integers(*bounds) for kind, bounds in RANGES.items()},
    B.FLOAT: FLOATS,
    B.DOUBLE: st.floats(allow_nan=False),
    B.STRING: MAYBE,
    B.DATETIME: DATES,
    B.GUID: GUIDS,
    B.BYTE_STRING: st.none() | st.binary(max_size=20),
    B.XML_ELEMENT: MAYBE,
    B.NODE_ID: NODE_IDS,
    B.EXPANDED_NODE_ID: st.builds(ExpandedNodeId, NODE_IDS, st.none(), st.integers(0, 0xFFFF_FFFF)),
    B.STATUS_CODE: STATUSES,
    B.QUALIFIED_NAME: st.builds(QualifiedName, INDICES, TEXTS),
    B.LOCALIZED_TEXT: st.builds(LocalizedText, TEXT_OR_NONE, TEXT_OR_NONE),
    B.EXTENSION_OBJECT: st.builds(ExtensionObject, NODE_IDS, st.binary(max_size=20)),
    B.DIAGNOSTIC_INFO: st.builds(DiagnosticInfo, *[INT32S] * 4, MAYBE, st.none() | STATUSES.filter(bool), st.none()),
}


def values_of(kind: int) -> st.SearchStrategy[Variant]:
    scalars = SCALARS[kind]

    def matrix(rows: list[list[Any]]) -> Variant:
        flat = tuple([value for row in rows for value in row])
        return Variant(kind | ARRAY | DIMENSIONS, Matrix(flat, (len(rows), 2)))

    return st.one_of(
        scalars.map(lambda value: Variant(kind, value)),
        st.lists(scalars, max_size=4).map(lambda values: Variant(kind | ARRAY, tuple(values))),
        st.lists(st.lists(scalars, min_size=2, max_size=2), min_size=1, max_size=3).map(matrix),
    )


PLAIN = st.sampled_from([int(kind) for kind in SCALARS]).flatmap(values_of)
TIMES = st.none() | DATES.filter(bool)
PICOSECONDS = st.none() | st.integers(1, 9999)
DATA_VALUES = st.builds(DataValue, st.none() | PLAIN, STATUSES, TIMES, TIMES, PICOSECONDS, PICOSECONDS)
VARIANTS = st.one_of(
    PLAIN,
    st.just(Variant(0, None)),
    DATA_VALUES.map(lambda value: Variant(B.DATA_VALUE.value, value)),
    st.lists(PLAIN, max_size=3).map(lambda values: Variant(B.VARIANT | ARRAY, tuple(values))),
)


@given(variant=VARIANTS, is_verbose=st.booleans())
@settings(max_examples=400, deadline=None)
def test_any_variant_comes_back(variant: Variant, is_verbose: bool) -> None:
    written = orjson.dumps(encode_variant(Writing(NAMESPACES, is_verbose), variant))
    reading = Reading(NAMESPACES)
    assert decode_variant(reading, orjson.loads(written)) == variant
    assert not reading.leniencies


@given(variants=st.lists(PLAIN, min_size=1, max_size=12), form=st.sampled_from(list(Form)))
@settings(max_examples=200, deadline=None)
def test_any_message_comes_back_and_a_plan_writes_the_same(variants: list[Variant], form: Form) -> None:
    fields = tuple(
        [
            FieldMetaData(f"f{index}", code & 0x3F, value_rank=2 if code & DIMENSIONS else 1 if code & ARRAY else -1)
            for index, (code, _) in enumerate(variants)
        ]
    )
    data_set = DataSetFields(DataSetMetaData("any", fields, VERSION, namespaces=NAMESPACES))
    types, values = zip(*variants, strict=True)
    message = DataSetMessage(1001, types=types, values=values, sequence_number=1, timestamp=2, status=0)
    message = message._replace(major_version=VERSION.major, minor_version=VERSION.minor)

    def fields_of(_source: Source) -> DataSetFields:
        return data_set

    text = encode_data(data(message), [data_set], form)
    assert JsonWriterPlan(data_set, form, source=SOURCE).encode("m-1", 1, 2, 0, values) == text
    back = decode_json(text, fields_of)
    assert isinstance(back, JsonData)
    assert back.message.messages == (message,)
    assert not back.leniencies


FLOAT_FIELD = DataSetFields(DataSetMetaData("float", (FieldMetaData("f", B.FLOAT),), VERSION))
LEAST, MOST = 2.0**-126, (2.0 - 2.0**-23) * 2.0**127
"""The smallest and the largest normal Float."""
EDGES = [
    *(0.0, -0.0, 2.0**-149, 2.0**-150, LEAST - 2.0**-149, LEAST, LEAST + 2.0**-149, MOST, MOST + 2.0**103, 2.0**128),
    *(1.0 + 2.0**-23, 1.0 + 2.0**-24, 1.0 + 2.0**-25, 1.0 + 3 * 2.0**-24, 5e-324, 1e300, 1.7976931348623157e308),
]


@given(
    value=st.sampled_from([sign * edge for edge in EDGES for sign in (1, -1)])
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.floats(width=32, allow_nan=False, allow_infinity=False)
)
@settings(max_examples=400, deadline=None)
def test_a_plan_rounds_a_float_as_it_is_rounded_alone(value: float) -> None:
    payload = {"f": value}
    planned = FLOAT_FIELD.planned(payload)
    try:
        (expected,) = FLOAT_FIELD.decode_by_names(Reading(), DataSetMessage(1), payload).values
    except RemoteWireError:
        assert planned is None
    else:
        assert planned is not None
        assert repr(planned[0]) == repr(expected)
