"""A skill by a topic: what its status says of a halt."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest
from ua_bridges.ros.ports.port import LoadedType
from ua_bridges.ros.ports.topic import TopicPort
from ua_bridges.ros.skills import TopicSkill
from ua_bridges.ros.topic_mapping import QosConfig

from tests.unit.bridges.ros.skill_fakes import SCHEMA, spec_of, state
from ua_fleet.bridge.driver import DriverEvent, Execution, ExecutionEnded, ExecutionForgotten
from ua_fleet.bridge.executing import HALTED_S, Executing
from ua_fleet.values import StatusCode

ID = bytes(range(16))
CANCELLED = StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT
ABSENT = "/go has no subscriber; start the robot's node"
RUNNING = {"running": "text == 'moving'"}
HALTED = {"halted": "text == 'stopped'"}


class Published:
    """See Spoken: what is published is kept."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self.absent = ""

    def look(self, now: float) -> str:
        return self.absent

    def publish(self, message: Any) -> None:
        self.messages.append(message)


class Graph:
    """See SkillGraph."""

    def __init__(self) -> None:
        self.spoken = Published()

    def load(self, ros_type: str) -> LoadedType:
        return LoadedType(cast("type[Any]", state), SCHEMA)

    def speak(self, name: str, ros_type: str, qos: QosConfig) -> Published:
        return self.spoken


class Bench:
    def __init__(self, **status: str) -> None:
        told = {"topic": "/s", "type": "robot_msgs/State", "done": "count == 1", "failed": "count == 2", **status}
        way = {
            "topic": "/go",
            "type": "robot_msgs/State",
            "halt": {"speed": 0.0},
            "status": {"message": "text", **told},
        }
        spec = spec_of({"topic": way}, timeout_s=60.0)
        self.told: list[DriverEvent] = []
        self.graph, self.executing = Graph(), Executing(self.told.append)
        assert spec.via is not None
        assert isinstance(spec.via.way, TopicSkill)
        self.port = TopicPort(spec, spec.via.way, self.executing, self.told.append)
        self.port.opened(self.graph)
        (listened,) = self.port.listened()
        listened.source("")
        self.says: Callable[[Any], None] = listened.heard
        execution = Execution(ID, spec.topic, 1, (), 60.0)
        self.port.begin(execution, self.port.prepare(execution), 0.0)
        assert len(self.graph.spoken.messages) == 1

    def halt(self) -> None:
        self.port.cancel(ID, 1.0)
        assert len(self.graph.spoken.messages) == 2

    def give_up(self, now: float) -> None:
        for opened in self.executing.overdue(now):
            self.port.overdue(opened, now)

    def ends(self) -> list[tuple[int, str]]:
        return [(event.status, event.message) for event in self.told if isinstance(event, ExecutionEnded)]

    def forgotten(self) -> list[str]:
        return [event.message for event in self.told if isinstance(event, ExecutionForgotten)]


@pytest.mark.parametrize(
    ("status", "said", "end"),
    [
        (RUNNING, {"text": "standing"}, (CANCELLED, "it was halted")),
        (HALTED, {"text": "stopped"}, (CANCELLED, "it was halted")),
        (RUNNING | HALTED, {"text": "stopped"}, (CANCELLED, "it was halted")),
        (RUNNING, {"text": "fell", "count": 2}, (CANCELLED, "fell")),
        (HALTED, {"text": "there", "count": 1}, (0, "there")),
    ],
)
def test_it_was_halted_when_its_status_says_so(
    status: dict[str, str], said: dict[str, Any], end: tuple[int, str]
) -> None:
    bench = Bench(**status)
    bench.says(state(text="moving"))
    bench.halt()
    bench.says(state(text="moving"))
    assert bench.ends() == [], "a message that was published has stopped nothing yet"
    bench.says(state(**said))
    assert bench.ends() == [end]


@pytest.mark.parametrize("status", [{}, RUNNING, HALTED])
def test_a_robot_that_ignores_its_halt_is_not_halted(status: dict[str, str]) -> None:
    bench = Bench(**status)
    bench.says(state(text="moving"))
    bench.halt()
    bench.says(state(text="moving"))
    bench.give_up(1.0 + HALTED_S - 0.1)
    assert bench.forgotten() == []
    bench.give_up(1.0 + HALTED_S)
    assert bench.ends() == []
    (said,) = bench.forgotten()
    assert "its standstill is not confirmed" in said


def test_a_halt_is_told_once_when_the_robot_is_there() -> None:
    bench = Bench(**RUNNING)
    spoken = bench.graph.spoken
    bench.says(state(text="moving"))
    spoken.absent = ABSENT
    bench.port.cancel(ID, 1.0)
    bench.port.turn(2.0)
    assert len(spoken.messages) == 1
    spoken.absent = ""
    for now in (10.0, 10.5, 11.5, 14.0):
        bench.port.turn(now)
    assert len(spoken.messages) == 2, "what it means to a robot that goes on nobody knows"
    bench.port.cancel(ID, 14.1)
    bench.port.cancel(ID, 14.2)
    assert len(spoken.messages) == 3
    for now in (14.5, 15.2, 17.0):
        bench.port.turn(now)
    assert len(spoken.messages) == 4, "another word is asked for, and comes a second after the last"
    bench.give_up(10.0 + HALTED_S)
    (said,) = bench.forgotten()
    assert "its standstill is not confirmed" in said, "its time has begun when it was told"


def test_a_halt_that_is_not_told_before_the_end_is_not_told_later() -> None:
    bench = Bench(**RUNNING)
    bench.says(state(text="moving"))
    bench.graph.spoken.absent = ABSENT
    bench.port.cancel(ID, 1.0)
    bench.says(state(text="there", count=1))
    assert bench.ends() == [(0, "there")]
    bench.graph.spoken.absent = ""
    bench.port.turn(2.0)
    assert len(bench.graph.spoken.messages) == 1


def test_what_is_overdue_says_whether_its_robot_was_told() -> None:
    bench = Bench(**RUNNING)
    bench.graph.spoken.absent = ABSENT
    bench.port.turn(59.0)
    bench.give_up(60.0)
    ((_, said),) = bench.ends()
    assert said == f"it took longer than 60 s; it could not be told to stop: {ABSENT}; see what the robot does"
    assert len(bench.graph.spoken.messages) == 1
    bench = Bench(**RUNNING)
    bench.give_up(60.0)
    ((_, said),) = bench.ends()
    assert said == "it took longer than 60 s; it was told to stop"
    assert len(bench.graph.spoken.messages) == 2


def test_a_status_of_the_time_before_is_no_word_of_the_halt() -> None:
    bench = Bench(**RUNNING)
    bench.halt()
    bench.says(state(text="standing"))
    assert bench.ends() == []
