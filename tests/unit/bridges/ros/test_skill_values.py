"""Arguments into messages; conditions and results out of them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.skill_values import Condition, Outcome, RequestFiller, ResponseReader, StatusReader, fill_constants
from ua_bridges.ros.skills import ServiceSkill, StatusTopic

from tests.unit.bridges.ros.skill_fakes import SCHEMA, spec_of, state
from ua_fleet.bridge.executing import Ended, ended_text
from ua_fleet.errors import SkillRejected
from ua_fleet.scenario.expression import ValueUnknown
from ua_fleet.values import StatusCode

SPEC = spec_of(
    arguments={"speed": {"type": "Double"}, "place": {"type": "String"}},
    results={"reached": {"type": "Double"}, "count": {"type": "UInt32"}},
)
SERVICE = {"name": "/go", "type": "robot_msgs/Go"}


def service(**more: Any) -> ServiceSkill:
    return ServiceSkill.model_validate({**SERVICE, **more})


def test_arguments_and_constants_fill_a_message() -> None:
    way = service(fields={"place": "text"}, constants={"count": 3, "pose.x": 1.5, "values": [1, 2.5]})
    filler = RequestFiller(SPEC, way, SCHEMA)
    filler.check(state())
    message = filler.fill(state(), (0.5, "dock"))
    assert (message.speed, message.text, message.count, message.pose.x) == (0.5, "dock", 3, 1.5)
    assert list(message.values) == [1.0, 2.5]


@pytest.mark.parametrize(
    ("way", "said"),
    [
        (service(), "place"),
        (service(fields={"place": "nowhere"}), "robot_msgs/State has no field 'nowhere'"),
        (service(fields={"place": "text"}, constants={"pose.y": 1}), "robot_msgs/Pose has no field 'y'"),
    ],
)
def test_places_that_a_message_does_not_have(way: ServiceSkill, said: str) -> None:
    with pytest.raises(ConversionError, match=said):
        RequestFiller(SPEC, way, SCHEMA)


def test_constant_that_does_not_fit_is_found_at_the_start() -> None:
    filler = RequestFiller(SPEC, service(fields={"place": "text"}, constants={"count": "many"}), SCHEMA)
    with pytest.raises(ConversionError, match="count"):
        filler.check(state())


def test_argument_that_does_not_fit_is_refused() -> None:
    filler = RequestFiller(SPEC, service(fields={"speed": "count", "place": "text"}), SCHEMA)
    with pytest.raises(SkillRejected, match=r"field speed: 0\.5 is not an integer"):
        filler.fill(state(), (0.5, "dock"))


def test_message_of_constants_alone() -> None:
    assert fill_constants(SCHEMA, {"pose.x": 2}, state()).pose.x == 2.0


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("count == 3", True),
        ("text == 'moving' and pose.x > 1", True),
        ("pose.x >= arguments.speed", True),
        ("arguments.place == text", False),
        ("not (speed > 1 or count < 3)", True),
    ],
)
def test_conditions(text: str, holds: bool) -> None:
    condition = Condition(text, SPEC.arguments, state())
    message, arguments = state(count=3, text="moving", x=2.0, speed=0.5), {"speed": 2.0, "place": "dock"}
    assert condition.holds(message, arguments) is holds


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("coutn == 3", "the message has no field 'coutn'"),
        ("pose == 3", "pose is a SimpleNamespace, neither a number nor a text"),
        ("arguments.velocity > 3", "the skill has no such argument"),
    ],
)
def test_conditions_over_what_is_not_there(text: str, said: str) -> None:
    with pytest.raises(ConversionError, match=said):
        Condition(text, SPEC.arguments, state())


def test_condition_that_cannot_be_decided() -> None:
    with pytest.raises(ValueUnknown):
        Condition("text > 3", SPEC.arguments, state()).holds(state(), {})


@pytest.mark.parametrize(("count", "fraction"), [(50, 0.5), (-3, 0.0), (300, 1.0)])
def test_progress_is_a_fraction(count: int, fraction: float) -> None:
    assert Condition("count / 100", (), state()).fraction(state(count=count), {}) == fraction


def test_progress_that_is_none() -> None:
    assert Condition("text", (), state()).fraction(state(text="half"), {}) is None
    assert Condition("1 / count", (), state()).fraction(state(count=0), {}) is None


def reader(**more: Any) -> ResponseReader:
    way = service(results={"reached": "pose.x"}, message="text", **more)
    return ResponseReader(SPEC, way, way.success, state())


@pytest.mark.parametrize(
    ("message", "ended"),
    [
        (state(x=2.0, count=7), Ended(0, (2.0, 7))),
        (state(x=2.0, count=7, text="well\ndone"), Ended(0, (2.0, 7), "well done")),
        (state(speed=1.0, text="stuck"), Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), "stuck")),
        (state(speed=1.0), Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), "the robot says that it failed")),
        (
            state(count=-1),
            Ended(StatusCode.UNCERTAIN, (), "it is done; its result count is not known: -1 does not fit into UInt32"),
        ),
    ],
)
def test_response_tells_the_end(message: Any, ended: Ended) -> None:
    assert reader(success="speed == 0").read(message, {}) == ended


def test_success_that_cannot_be_said_is_no_success() -> None:
    ended = reader(success="text > 1").read(state(), {})
    assert ended.status == StatusCode.BAD_TYPE_MISMATCH


def test_result_that_a_message_does_not_have() -> None:
    with pytest.raises(ConversionError, match="the message has no field 'reached'"):
        ResponseReader(SPEC, service(), None, state())


def test_result_in_an_array_that_is_empty_now() -> None:
    found = ResponseReader(SPEC, service(results={"reached": "values[1]"}), None, state())
    assert found.read(state(values=[1.0, 2.0]), {}) == Ended(0, (2.0, 0))
    assert found.read(state(), {}).status == StatusCode.UNCERTAIN


def status(**more: Any) -> StatusReader:
    raw = {"topic": "/s", "type": "robot_msgs/State", "done": "count == 2", "failed": "count == 3", **more}
    return StatusReader(SPEC, StatusTopic.model_validate({"results": {"reached": "pose.x"}, **raw}), state())


@pytest.mark.parametrize(
    ("message", "outcome"),
    [
        (state(count=1, speed=0.25), Outcome(None, 0.25)),
        (state(count=2, x=4.0), Outcome(Ended(0, (4.0, 2)))),
        (state(count=3), Outcome(Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), "the robot says that it failed"))),
        (state(count=1, speed=math.nan), Outcome(None, None)),
    ],
)
def test_status_topic_is_judged(message: Any, outcome: Outcome) -> None:
    assert status(progress="speed").judge(message, {}) == outcome


def test_status_counts_from_when_the_robot_runs() -> None:
    assert status().runs(state(), {})
    running = status(running="text == 'moving'")
    assert [running.runs(state(text=text), {}) for text in ("idle", "moving")] == [False, True]


def test_a_robots_text_is_one_line_of_bounded_length() -> None:
    assert ended_text("a\nb\t c ") == "a b c"
    assert len(ended_text("x" * 1000)) == 200
