"""DateTimes as text: every way of writing and reading one gives the same."""

from __future__ import annotations

from typing import Any

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType as B
from ua_fleet.wire.json import DataSetFields, Form, JsonWriterPlan
from ua_fleet.wire.json.data_messages import MINIMAL, NETWORK_MESSAGE
from ua_fleet.wire.json.dates import LATEST, decode_date, encode_date
from ua_fleet.wire.json.parsing import Reading
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData

NOON = 133_500_000_000_000_000
BEYOND = 2_650_467_743_990_000_000
FIELDS = DataSetFields(DataSetMetaData("d", (FieldMetaData("time", B.DATETIME),), ConfigurationVersion(1, 1)))
PLAN = JsonWriterPlan(FIELDS, Form.VERBOSE)
TICKS = st.one_of(
    st.integers(-LATEST - 1, LATEST),
    st.integers(NOON - 3, NOON + 20_000_000),
    st.sampled_from([0, 1, 9_999_999, 10_000_000, 10_000_001, BEYOND - 1, BEYOND, BEYOND + 1, LATEST, -1]),
)


@given(st.lists(TICKS, min_size=1, max_size=6))
def test_a_plan_writes_times_as_they_are_written_one_by_one(times: list[int]) -> None:
    for ticks in times:
        tree = orjson.loads(PLAN.encode("m", 1, ticks, 0, (ticks,)))
        (message,) = tree["Messages"]
        assert message["Timestamp"] == message["Payload"]["time"] == encode_date(ticks)


@given(TICKS)
def test_a_plan_reads_times_as_they_are_read_one_by_one(ticks: int) -> None:
    text = encode_date(ticks)
    reading = Reading()
    expected = decode_date(reading, text)
    assert expected == (0 if ticks < 0 else LATEST if ticks >= BEYOND else ticks)
    for _ in range(2):  # the second time its second is known
        assert FIELDS.planned({"time": text}) == (expected,)
    assert not reading.leniencies


@pytest.mark.parametrize("value", [True, 1.5, "133500000000000001", None, LATEST + 1, -LATEST - 2, 10**400])
@pytest.mark.parametrize("layout", [NETWORK_MESSAGE, MINIMAL])
def test_what_is_no_time_is_refused(value: Any, layout: Any) -> None:
    plan = JsonWriterPlan(FIELDS, Form.VERBOSE, layout)
    plan.encode("m", 1, NOON + 1, 0, (NOON + 1,))
    with pytest.raises(LocalWireError):
        plan.encode("m", 1, NOON + 1, 0, (value,))
    if layout.data_set_header and value is not None:  # without a Timestamp the header has none
        with pytest.raises(LocalWireError):
            plan.encode("m", 1, value, 0, (NOON + 1,))
    assert orjson.loads(plan.encode("m", 1, NOON + 1, 0, (NOON + 1,)))


@pytest.mark.parametrize(
    "text",
    [
        "2024-W03-3T21:20:00Z",
        "2024-01-17T212000.5Z",
        "2024-01-17T21:20+01Z",
        "2024-01-17 T1:20:00Z",
        "20240117T21:20:00.0Z",
    ],
)
def test_what_is_another_form_of_iso_8601_is_refused(text: str) -> None:
    with pytest.raises(RemoteWireError):
        decode_date(Reading(), text)
    assert FIELDS.planned({"time": text}) is None


@pytest.mark.parametrize(
    "end",
    [
        ".123456Z",
        ".12345678Z",
        ".1234567",
        ".1234567z",
        ".1234e10Z",
        ".12345.7Z",
        ".-123456Z",
        ".+123456Z",
        ".123_567Z",
        ".Z",
        "Z",
        "1234567Z",
        ",1234567Z",
        ".[12345]Z",
        ".123456\u0667Z",
        ".12345 7Z",
        ".123456 Z",
        ". 123456Z",
        ".1234567\x00",
    ],
)
def test_a_plan_that_knows_the_second_reads_no_other_fraction(end: str) -> None:
    text = "2024-01-17T21:20:00"
    for known in (".0000001Z", ".9999999Z"):
        assert FIELDS.planned({"time": text + known}) is not None
        reading = Reading()
        try:
            expected = decode_date(reading, text + end)
        except RemoteWireError:
            expected = None
        planned = FIELDS.planned({"time": text + end})
        assert planned is None or (planned == (expected,) and not reading.leniencies)
