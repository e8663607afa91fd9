"""Texts that are known but for four places are read as the parser reads them, or not from what is known."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.wire.json.test_fuzz import outcome
from ua_fleet.values import BuiltinType as B
from ua_fleet.wire.json import DataSetFields, Form, JsonCause, JsonWriterPlan, Source, decode_json
from ua_fleet.wire.json import known_text as known
from ua_fleet.wire.json.data_messages import decode_data
from ua_fleet.wire.json.known_text import decode_known_text
from ua_fleet.wire.json.parsing import Reading, parse
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData

NOON = 133_500_000_000_000_000
SOURCE = Source("2", "fleet", 1001, "speed")
VERSION = ConfigurationVersion(7, 8)
FIELDS = DataSetFields(DataSetMetaData("d", (FieldMetaData("a", B.DOUBLE), FieldMetaData("b", B.STRING)), VERSION))
PLAN = JsonWriterPlan(FIELDS, Form.VERBOSE, source=SOURCE)
USUAL = PLAN.encode("m-1", 70_000, NOON + 1_234_567, 0, (1.5, "x"))


def fields_of(_source: Source) -> DataSetFields:
    return FIELDS


def general(text: bytes, source: Source) -> Any:
    reading = Reading()
    return decode_data(reading, parse(text, reading), fields_of, source)


@pytest.fixture(autouse=True)
def only_the_usual_text_is_known() -> None:
    known._outlines.clear()  # pyright: ignore[reportPrivateUsage]
    decode_json(USUAL, fields_of)


def check(text: bytes, source: Source = Source()) -> bool:  # noqa: B008 - immutable
    """Whether a text was read from what is known of it; it is read as in the general way at any rate."""
    from_known = decode_known_text(text, fields_of, source)
    expected = outcome(lambda: general(text, source))
    if from_known is not None:
        assert outcome(lambda: from_known) == expected
    assert outcome(lambda: decode_json(text, fields_of, source=source)) == expected
    return from_known is not None


@pytest.mark.parametrize(
    "message",
    [
        ("m-1", 70_000, NOON + 1_234_567, 0, (1.5, "x")),
        ("é ☃", 0, NOON + 1, 0, (-2.5, '"}]}')),
        ("m", 1, NOON, 0, (1.5, "x")),
        ("m", 0xFFFF_FFFF, NOON + 9_999_999, 0, (0.0, '","Payload":{"a":1}}]}')),
    ],
)
def test_a_text_of_a_known_outline_is_read(message: tuple[str, int, int, int, tuple[Any, ...]]) -> None:
    assert check(PLAN.encode(*message))


def test_a_time_of_another_second_is_read_from_what_is_known() -> None:
    second = 10_000_000
    for ticks in (NOON + second, NOON + second + 5, NOON + 5, NOON, NOON + 5, NOON + second, NOON + 60 * second + 9):
        check(PLAN.encode("m", 1, ticks, 0, (1.5, "x")))  # a second that was never seen is parsed
        assert check(PLAN.encode("m", 2, ticks, 0, (1.5, "x")))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"m-1"', b'""'),
        (b'"m-1"', rb'"m\"1"'),
        (b'"m-1"', b'"m\n1"'),
        (b'"m-1"', b'"m\xff1"'),
        (b'"m-1"', b'"m-1","MessageId":"m-2"'),
        (b":70000", b":070000"),
        (b":70000", b":-1"),
        (b":70000", b":4294967296"),
        (b":70000", b":70000.0"),
        (b":70000", b':"70000"'),
        (b":70000", b":" + b"9" * 5_000),
        (b":70000", b":70000,"),
        (b".1234567Z", b".Z"),
        (b".1234567Z", b"z"),
        (b".1234567Z", b".123_567Z"),
        (b".1234567Z", b".+123456Z"),
        (b".1234567Z", b".12345678Z"),
        (b".1234567Z", b".1234567z"),
        (b"2024-01", b"2024-13"),
        (b'"x"}', b'"x"},"Payload":{"a":2.5,"b":"y"}'),
        (b'"x"}', b'"x"},"Status":{"Code":5}'),
        (b'"x"}', b'"x"},{"DataSetWriterId":5,"Payload":{}'),
        (b'"x"}', b'"x"'),
        (b'{"a"', b'[{"a"'),
        (b'{"a":1.5,"b":"x"}', b"[]"),
        (b'{"a":1.5,"b":"x"}', b"null"),
        (b'{"a":1.5,"b":"x"}', b'{"a":1.5}'),
        (b'{"a":1.5,"b":"x"}', b'{"a":"NaN","b":"x"}'),
        (b"}]}", b"}]} "),
        (b"}]}", b"}],}"),
        (b"}]}", b'}],"PublisherId":"3"}'),
        (b'{"MessageId"', b' {"MessageId"'),
        (b'{"MessageId"', b'\xef\xbb\xbf{"MessageId"'),
        (b'{"MessageId"', b'{"Messageid"'),
        (b'"MajorVersion":7', b'"MajorVersion":6'),
        (b'"MajorVersion":7', b'"MajorVersion":7.0'),
        (b'"Status":{}', b'"Status":{"Code":2147483648}'),
        (b'"Status":{}', b'"Status":{},"SequenceNumber":5'),
        (b'"DataSetWriterName"', b'"SequenceNumber":5,"DataSetWriterName"'),
        (b'"speed"', rb'"\"SequenceNumber":5'),
        (b'"ua-keyframe"', b'"ua-deltaframe"'),
        (b'"PublisherId":"2"', b'"PublisherId":"02"'),
        (b'"PublisherId":"2"', b'"PublisherId":"2","PublisherId":"3"'),
    ],
)
def test_a_text_that_differs_elsewhere_is_read_as_it_stands(old: bytes, new: bytes) -> None:
    assert old in USUAL
    text = USUAL.replace(old, new, 1)
    assert not check(text)
    check(text)  # now with what was learned from it, if anything was
    check(USUAL)
    assert check(USUAL)


def test_what_the_topic_tells_of_the_group_counts_where_the_text_says_nothing() -> None:
    text = JsonWriterPlan(FIELDS, source=SOURCE._replace(writer_group_name=None)).encode(*_MESSAGE)
    decode_json(text, fields_of)
    for group in ("one", "two", None):
        assert check(text, Source(writer_group_name=group))


def test_no_more_outlines_are_kept_than_a_thousand() -> None:
    for writer_id in range(1, 3_000):
        text = USUAL.replace(b":1001", b":%d" % writer_id)
        decode_json(text, fields_of)
        assert check(text)
    assert 0 < len(known._outlines) <= 1_024  # pyright: ignore[reportPrivateUsage]


_MESSAGE = ("m-1", 1, NOON + 1_234_567, 0, (1.5, "x"))


NESTED = {
    "DiagnosticInfo": (B.DIAGNOSTIC_INFO, '{"InnerDiagnosticInfo":', '{"SymbolicId":1}', "}"),
    "DataValue": (B.DATA_VALUE, '{"Value":{"UaType":23,"Value":', '{"Value":{"UaType":6,"Value":1}}', "}}"),
    "Variants": (B.DATA_VALUE, '{"UaType":24,"Value":[', '{"UaType":6,"Value":1}', "]}"),
}


@pytest.mark.parametrize("name", NESTED)
def test_values_in_values_are_followed_as_far_on_every_way(name: str) -> None:
    kind, begin, inner, end = NESTED[name]
    fields = DataSetFields(FIELDS.metadata._replace(fields=(FieldMetaData("a", kind),)))
    causes = set[str]()
    for levels in (1, 2, 10, 13, 14, 15, 20, 27, 28, 29, 30, 100, 250, 1_500):
        text = USUAL.replace(b'{"a":1.5,"b":"x"}', f'{{"a":{begin * levels}{inner}{end * levels}}}'.encode())

        def one(text: bytes = text) -> Any:
            return decode_json(text, lambda _source: fields)

        def other(text: bytes = text) -> Any:
            reading = Reading()
            return decode_data(reading, parse(text, reading), lambda _source: fields, Source())

        assert outcome(one) == outcome(other)
        causes.add(outcome(one)[:10])
    assert JsonCause.DEPTH in causes
    assert len(causes) >= 2
