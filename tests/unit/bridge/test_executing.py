"""Each execution ends once."""

from __future__ import annotations

from ua_fleet.bridge.configured import ConfiguredSkill
from ua_fleet.bridge.driver import (
    DriverEvent,
    Dropped,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
)
from ua_fleet.bridge.executing import Ended, Executing
from ua_fleet.config.base import Model
from ua_fleet.config.schema import SkillConfig
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

ID, OTHER = bytes(16), bytes([1]) * 16
SPEC = ConfiguredSkill[Model](
    "carrier",
    "dock",
    Topic(2, 2, 1010),
    Topic(2, 2, 1011),
    SkillConfig.model_validate({"arguments": {"to": {"type": "String"}}, "timeout_s": 5}),
    None,
)
EXECUTION = Execution(ID, SPEC.topic, 1, ("dock",))


def executing() -> tuple[Executing, list[DriverEvent]]:
    told: list[DriverEvent] = []
    return Executing(told.append), told


def drops(told: list[DriverEvent]) -> list[str]:
    return [event.detail for event in told if isinstance(event, Dropped) and event.cause is Drop.UNASKED]


def test_it_ends_once_and_what_comes_later_is_counted() -> None:
    one, told = executing()
    opened = one.begin(SPEC, EXECUTION, 10.0)
    assert (opened.arguments, opened.deadline, opened.skill) == ({"to": "dock"}, 15.0, "carrier.dock")
    one.progress(ID, 0.0)
    assert one.end(ID, Ended(0, (1,), "there"))
    assert not one.end(ID, Ended(0, (2,)))
    one.forget(ID, "late")
    one.progress(ID, 0.5)
    assert told[:2] == [ExecutionProgressed(ID, 0.0), ExecutionEnded(ID, 0, (1,), "there")]
    assert drops(told) == ["a robot answered again, or after its time was over"] * 3
    assert len(told) == 5


def test_an_answer_for_another_execution_is_counted() -> None:
    one, told = executing()
    one.begin(SPEC, EXECUTION, 0.0)
    one.end(OTHER, Ended(0))
    assert drops(told) == ["a robot answered for an execution that is not open"]
    assert one.get(ID) is not None


def test_progress_is_told_where_it_is_new() -> None:
    one, told = executing()
    one.begin(SPEC, EXECUTION, 0.0)
    for fraction, said in ((0.0, ""), (0.0, ""), (0.005, ""), (0.02, ""), (0.02, "half way")):
        one.progress(ID, fraction, said)
    assert told == [ExecutionProgressed(ID, *rest) for rest in ((0.0, ""), (0.02, ""), (0.02, "half way"))]


def test_what_nobody_can_tell_is_forgotten() -> None:
    one, told = executing()
    one.begin(SPEC, EXECUTION, 0.0)
    one.forget(ID, "power was off")
    assert told == [ExecutionForgotten(ID, "power was off")]


def test_what_takes_too_long_is_overdue() -> None:
    one, _ = executing()
    opened = one.begin(SPEC, EXECUTION, 10.0)
    assert one.overdue(14.9) == []
    assert one.overdue(15.0) == [opened]


def test_an_execution_that_is_asked_about_again_is_open_again() -> None:
    one, told = executing()
    for _ in range(2):
        one.begin(SPEC, EXECUTION, 0.0)
        assert one.end(ID, Ended(0))
    assert drops(told) == []


def test_ends_that_are_remembered_are_bounded() -> None:
    one, told = executing()
    for number in range(1001):
        each = EXECUTION._replace(execution_id=number.to_bytes(16, "big"))
        one.begin(SPEC, each, 0.0)
        one.end(each.execution_id, Ended(0))
    one.end(bytes(16), Ended(0))
    assert drops(told) == ["a robot answered for an execution that is not open"]


def test_what_the_robot_never_heard_of_may_be_begun_again() -> None:
    one, told = executing()
    one.begin(SPEC, EXECUTION, 10.0)
    assert one.due() == 15.0
    one.never(ID)
    assert told == [ExecutionNotBegun(ID)]
    assert one.due() is None
    one.never(ID)
    assert len(drops(told)) == 1
    one.begin(SPEC, EXECUTION, 20.0)
    assert one.end(ID, Ended(0))


def test_a_robot_that_stands_is_told_once_and_again_when_it_goes_on() -> None:
    one, told = executing()
    one.begin(SPEC, EXECUTION, 10.0)
    for _ in range(2):
        one.suspended(ID, 0.5, "it stands")
    one.progress(ID, 0.5, "it stands")
    assert told == [
        ExecutionSuspended(ID, "it stands"),
        ExecutionProgressed(ID, 0.5, "it stands"),
        ExecutionResumed(ID),
        ExecutionProgressed(ID, 0.5, "it stands"),
    ]
    one.suspended(OTHER, 0.5)
    assert drops(told) == ["a robot answered for an execution that is not open"]
    assert [opened.execution_id for opened in one.overdue(15.0)] == [ID], "its time goes on"
