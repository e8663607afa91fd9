"""A skill that a robot's own program offers: what it is told of a halt."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

from ua_bridges.ros.ports.port import LoadedType
from ua_bridges.ros.ports.program import ProgramPort
from ua_bridges.ros.topic_mapping import QosConfig

from tests.unit.bridges.ros.skill_fakes import SCHEMA, spec_of
from ua_fleet.bridge.driver import DriverEvent, Execution, ExecutionEnded
from ua_fleet.bridge.executing import Executing

ID = bytes(range(16))
ABSENT = "/ua_2_2_5 has no subscriber; start the robot's node"


class Program:
    """See Spoken and SkillGraph: a program that keeps what it is asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.absent = ""

    def load(self, ros_type: str) -> LoadedType:
        return LoadedType(cast("type[Any]", SimpleNamespace), SCHEMA)

    def speak(self, name: str, ros_type: str, qos: QosConfig) -> Program:
        return self

    def look(self, now: float) -> str:
        return self.absent

    def publish(self, message: Any) -> None:
        self.asked.append(json.loads(message.data)["request"])


class Bench:
    def __init__(self) -> None:
        spec = spec_of(timeout_s=60.0)
        self.told: list[DriverEvent] = []
        self.program, self.executing = Program(), Executing(self.told.append)
        self.port = ProgramPort(spec, self.executing, self.told.append)
        self.port.opened(self.program)
        (listened,) = self.port.listened()
        self.source = listened.source
        self.source("")
        execution = Execution(ID, spec.topic, 1, (), 60.0)
        self.port.begin(execution, self.port.prepare(execution), 0.0)
        self.heard = listened.heard
        self.says("running")

    def says(self, state: str) -> None:
        self.heard(SimpleNamespace(data=json.dumps({"execution_id": ID.hex(), "state": state})))

    @property
    def cancels(self) -> int:
        return self.program.asked.count("cancel")

    def ends(self) -> list[str]:
        return [event.message for event in self.told if isinstance(event, ExecutionEnded)]


def test_program_is_told_to_stop_when_it_is_there_and_until_it_has() -> None:
    bench = Bench()
    bench.program.absent = ABSENT
    bench.port.cancel(ID, 1.0)
    bench.port.turn(2.0)
    assert bench.cancels == 0
    bench.program.absent = ""
    for now in (3.0, 3.2, 3.9, 4.1, 4.2):
        bench.port.turn(now)
    bench.port.cancel(ID, 4.5)
    assert bench.cancels == 2, "once a second"
    bench.says("halted")
    bench.port.turn(9.0)
    assert bench.cancels == 2
    assert bench.ends() == ["it was halted"]


def test_program_whose_status_is_not_heard_is_told_all_the_same() -> None:
    bench = Bench()
    bench.source("it has no publisher")
    bench.port.cancel(ID, 1.0)
    assert bench.cancels == 1


def test_what_is_overdue_says_whether_its_robot_was_told() -> None:
    for absent, said in (
        ("", "it was told to stop"),
        (ABSENT, f"it could not be told to stop: {ABSENT}; see what the robot does"),
    ):
        bench = Bench()
        bench.program.absent = absent
        (opened,) = bench.executing.overdue(60.0)
        bench.port.overdue(opened, 60.0)
        assert bench.ends() == [f"it took longer than 60 s; {said}"]
