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
RUNNING = {"running": "text == 'moving'"}
HALTED = {"halted": "text == 'stopped'"}


class Published:
    """See Spoken: what is published is kept."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def look(self, now: float) -> str:
        return ""

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


def test_a_status_of_the_time_before_is_no_word_of_the_halt() -> None:
    bench = Bench(**RUNNING)
    bench.halt()
    bench.says(state(text="standing"))
    assert bench.ends() == []
