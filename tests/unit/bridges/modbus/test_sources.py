"""Readings of registers as samples, and messages as writes."""

from __future__ import annotations

import math
from typing import Any

import pytest
from ua_bridges.modbus.sinks import BitWrite, Writing, writes_of
from ua_bridges.modbus.sources import Answer, Failed, PolledSource, ReadField, ReadPlan, SourceSpec, differs

from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead, SourceFound, SourceLost, SourceRead
from ua_fleet.counters import Drop
from ua_fleet.registers import AddressSpan, DeviceLimits, Register, RegisterType, RegisterUnfit, Table
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, Variant

HOLDING, COIL = Table.HOLDING, Table.COIL
TOPIC = Topic(300, 2, 10)


def word(address: int, kind: RegisterType = RegisterType.UINT16, **more: Any) -> Register:
    return Register(HOLDING, address, kind, **more)


class Scene:
    def __init__(self, *fields: ReadField, limits: DeviceLimits | None = None, is_aging: bool = False) -> None:
        spec = SourceSpec(TOPIC, "press.x", "plc", 1.0, fields, is_aging)
        self.source = PolledSource(spec)
        self.plan = ReadPlan([field.register.span for field in fields], limits or DeviceLimits())
        self.source.place(self.plan)
        self.time_ns = 0

    def read(self, *answers: Answer) -> list[DriverEvent]:
        self.time_ns += 1
        return self.source.take(dict(zip(self.plan.requests, answers, strict=True)), self.time_ns)


def test_first_reading_finds_the_source_and_tells_its_values() -> None:
    scene = Scene(
        ReadField("a", BuiltinType.UINT16, word(0)),
        ReadField("b", BuiltinType.DOUBLE, word(1, RegisterType.INT32, scale=0.1)),
        ReadField("c", BuiltinType.BOOLEAN, Register(COIL, 5, RegisterType.BOOL)),
    )
    found, sample = scene.read([True], [7, 0, 15])
    assert isinstance(found, SourceFound)
    assert [(field.name, field.builtin_type) for field in found.fields] == [
        ("a", BuiltinType.UINT16),
        ("b", BuiltinType.DOUBLE),
        ("c", BuiltinType.BOOLEAN),
    ]
    assert sample == SampleRead(TOPIC, (7, 1.5, True), 1)


def test_each_reading_of_a_source_with_a_maximum_age_counts() -> None:
    fields = [ReadField(name, BuiltinType.UINT16, word(at)) for name, at in (("a", 0), ("b", 900))]
    scene = Scene(*fields, is_aging=True)
    scene.read([1], [1])
    assert scene.read([1], [1]) == [SourceRead(TOPIC, 2)]
    failed = Failed(int(StatusCode.BAD_TIMEOUT), Drop.NO_ANSWER, "no answer")
    assert isinstance(scene.read([1], failed)[0], SampleRead)
    assert scene.read([1], failed) == [SourceRead(TOPIC, 4)], "a is read, and b is Bad for itself"
    assert isinstance(scene.read(failed, failed)[0], SampleRead)
    assert scene.read(failed, failed) == []


def test_what_did_not_change_is_not_told_again() -> None:
    scene = Scene(ReadField("a", BuiltinType.UINT16, word(0)))
    scene.read([1])
    assert scene.read([1]) == []
    assert scene.read([2]) == [SampleRead(TOPIC, (2,), 3)]


def test_deadband_is_about_what_was_told_last() -> None:
    scene = Scene(ReadField("a", BuiltinType.UINT16, word(0), deadband=2.0))
    scene.read([10])
    assert scene.read([12]) == []
    assert scene.read([8]) == []
    assert scene.read([13]) == [SampleRead(TOPIC, (13,), 4)]
    assert scene.read([11]) == []


def test_request_that_fails_makes_its_own_values_bad() -> None:
    scene = Scene(
        ReadField("a", BuiltinType.UINT16, word(0)),
        ReadField("b", BuiltinType.UINT16, word(50)),
    )
    scene.read([1], [2])
    bad = Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_TIMEOUT)
    silent = Failed(StatusCode.BAD_TIMEOUT, Drop.NO_ANSWER, "no answer")
    assert scene.read([1], silent) == [SampleRead(TOPIC, (1, bad), 2)]
    assert scene.read([1], silent) == []
    assert scene.read([1], [2]) == [SampleRead(TOPIC, (1, 2), 4)]


def test_value_that_does_not_fit_is_bad_and_counted_each_time() -> None:
    scene = Scene(
        ReadField("a", BuiltinType.STRING, word(0, RegisterType.STRING, length=1)),
        ReadField("b", BuiltinType.UINT16, word(1)),
    )
    events = scene.read([0xFFFF, 3])
    assert [event.cause for event in events if isinstance(event, Dropped)] == [Drop.CONVERSION]
    (sample,) = [event for event in events if isinstance(event, SampleRead)]
    assert sample.values == (Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_DECODING_ERROR), 3)
    assert [type(event) for event in scene.read([0xFFFF, 3])] == [Dropped]


def test_lost_source_is_found_again_with_its_values() -> None:
    scene = Scene(ReadField("a", BuiltinType.UINT16, word(0)))
    assert scene.source.lose() == []
    scene.read([1])
    assert scene.source.lose() == [SourceLost(TOPIC)]
    assert scene.source.lose() == []
    assert [type(event) for event in scene.read([1])] == [SourceFound, SampleRead]


def test_refused_request_is_taken_apart_so_that_one_address_spoils_no_other() -> None:
    scene = Scene(
        ReadField("a", BuiltinType.UINT16, word(0)),
        ReadField("b", BuiltinType.INT32, word(1, RegisterType.INT32)),
        ReadField("c", BuiltinType.BOOLEAN, word(1, RegisterType.BOOL, bit=0)),
    )
    (request,) = scene.plan.requests
    assert scene.plan.split(request) == [AddressSpan(HOLDING, 0, 1), AddressSpan(HOLDING, 1, 2)]
    scene.source.place(scene.plan)
    refused = Failed(StatusCode.BAD_CONFIGURATION_ERROR, Drop.REJECTED, "no such address")
    _, sample = scene.read([7], refused)
    assert isinstance(sample, SampleRead)
    assert sample.values[0] == 7
    assert sample.values[1] == Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_CONFIGURATION_ERROR)
    assert scene.plan.split(AddressSpan(HOLDING, 0, 1)) == []


def test_plan_says_what_it_saves() -> None:
    assert ReadPlan([AddressSpan(HOLDING, address, 1) for address in range(10)], DeviceLimits()).saved == 9


@pytest.mark.parametrize(
    ("value", "before", "deadband", "is_other"),
    [
        (1.0, 1.0, 0.0, False),
        (1.0, 1.1, 0.0, True),
        (1.0, 1.1, 0.2, False),
        (math.nan, math.nan, 0.0, False),
        (math.nan, 1.0, 5.0, True),
        (math.inf, math.inf, 1.0, False),
        (1.0, Variant(BuiltinType.STATUS_CODE, 1), 5.0, True),
        ("a", "b", 0.0, True),
    ],
)
def test_what_counts_as_another_value(value: Any, before: Any, deadband: float, is_other: bool) -> None:
    assert differs(value, before, deadband) is is_other


def test_neighbours_are_written_together_and_bits_alone() -> None:
    values = [
        (word(2), 5),
        (word(0, RegisterType.UINT32), 0x00010002),
        (word(9), 6),
        (word(20, RegisterType.BOOL, bit=0), True),
        (word(20, RegisterType.BOOL, bit=3), False),
        (Register(COIL, 1, RegisterType.BOOL), True),
        (Register(COIL, 2, RegisterType.BOOL), False),
    ]
    assert writes_of(values, 123, 1968) == [
        Writing(AddressSpan(COIL, 1, 2), (True, False)),
        Writing(AddressSpan(HOLDING, 0, 3), (1, 2, 5)),
        Writing(AddressSpan(HOLDING, 9, 1), (6,)),
        BitWrite(20, 0b1001, 0b0001),
    ]
    assert [write.span.count for write in writes_of(values[:2], 2, 8) if isinstance(write, Writing)] == [2, 1]


def test_nothing_is_written_when_one_value_does_not_fit() -> None:
    with pytest.raises(RegisterUnfit):
        writes_of([(word(0), 5), (word(1), 70_000)], 123, 1968)
