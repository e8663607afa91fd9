"""The service with robots that are asked by nobody, a clock that stands still, and a journal that may fail."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import structlog

from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import SkillRejected, StorageUnavailable
from ua_fleet.fleet.capacities import Capacities
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import RobotState
from ua_fleet.monitoring import Mistakes
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.operation.runs.task_calls import Recorded, Requests
from ua_fleet.orchestrator import FaultChanged, Output, RunChanged
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.scenario.facts import RunEnded
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.skill.status import SKILL_STATUS_FIELDS, ExecutionStatus, SkillStatus
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, NodeId
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

SKILL = {
    "arguments": {"angle": {"type": "Double", "default": 0, "range": [-90, 90]}},
    "results": {"weight": {"type": "Double"}},
    "timeout_s": 5,
}
CONFIG = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"cell": {"kind": "virtual", "space": 2, "status_id": 900}},
        "robots": {
            robot: {
                "bridge": "cell",
                "skill_status_id": 1200 + number,
                "fault_id": 1300 + number,
                "skills": {"grab": {"id": 1100 + number, **SKILL}},
                "data": {
                    "battery": {"id": 1000 + number, "type": "Double"},
                    "fault": {"id": 1010 + number, "type": "Boolean"},
                },
            }
            for number, robot in enumerate(("left", "right"))
        },
        "resilience": {
            "mode": "automatic",
            "faults": {"battery_low": {"robots": ["left", "right"], "when": "battery < 20"}},
        },
    }
)
STATUS = {"left": Topic(2, 2, 1200), "right": Topic(2, 2, 1201)}
"""The SkillStatus of each robot."""
ONE = "version: 1\nname: one\nsteps:\n  - {task: a, skill: grab, robot: left, arguments: {angle: 5}}\n"
ACCEPTED = RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.RUNNING))
IMMEDIATE = RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.DONE))


class Robots:
    """What asks robots."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, tuple[Any, ...], bytes]] = []
        self.halted: list[str] = []
        self.inquired: list[bytes] = []
        self.known: dict[bytes, RequestOutcome | None] = {}
        self.refusal: Exception | None = None

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        if self.refusal is not None:
            raise self.refusal
        assert topic.space == 2
        assert timeout_s == 5
        self.asked.append((robot, tuple(arguments.values()), execution_id))
        self.known[execution_id] = None

    def prepare(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> Recorded | None:
        return None

    def recorded(self, records: Iterable[Recorded], left_out: Iterable[bytes]) -> None:
        assert not [*records, *left_out]

    def leave(self, execution_id: bytes) -> None: ...

    @property
    def left(self) -> tuple[bytes, ...]:
        return ()

    def halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        self.halted.append(robot)
        raise SkillRejected("it cannot stop")

    def inquire(self, execution_id: bytes) -> None:
        self.inquired.append(execution_id)

    def known_outcome(self, execution_id: bytes) -> RequestOutcome | None:
        return self.known[execution_id]


class FailingJournal(RunJournal):
    fails = False
    writes = 0
    """Transactions."""

    def write(self, *args: Any, **kwargs: Any) -> None:
        if self.fails:
            raise StorageUnavailable("the disk is full")
        self.writes += 1
        super().write(*args, **kwargs)


class World:
    def __init__(
        self,
        folder: Path,
        robots: Robots | None = None,
        *,
        heard: Sequence[str] = ("left", "right"),
        config: FleetConfig = CONFIG,
        requests: Requests | None = None,
        journal: FailingJournal | None = None,
        began: float = 100.0,
    ) -> None:
        self.robots = robots or Robots()
        self.journal = FailingJournal(folder / "runs.db") if journal is None else journal
        self.said: list[Output] = []
        self.now: float = began
        self.mistakes = Mistakes()
        self.faulted: dict[str, bool] = {}
        """Whether the faults of robots take away all that they can do, as it was told last."""
        model = fleet_model(config)
        self.capacities = Capacities(model.robots)
        self.service = ScenarioService(
            config,
            model,
            self.journal,
            requests or self.robots,
            folder=folder,
            show=self.show,
            forgotten=lambda run_id: None,
            requested=lambda key, execution_id: None,
            sooner=lambda: None,
            clock=lambda: self.now,
            wall_s=lambda: self.now,
            capacities=self.capacities,
            mistakes=self.mistakes,
            log=structlog.get_logger(),
            faulted=self.faulted.__setitem__,
        )
        self.records = self.service.restore()
        self.go_on()
        for robot in heard:
            self.state(robot, RobotState.IDLE)

    def show(self, output: Output) -> None:
        self.said.append(output)

    def go_on(self) -> None:
        """As the server does after a start."""
        self.service.go_on()

    def state(self, robot: str, state: RobotState) -> None:
        self.value(f"Robots.{robot}.State", int(state), BuiltinType.INT32)

    def silence(self, robot: str) -> None:
        """Nothing of a robot is heard any more, neither its values nor its SkillStatus."""
        self.state(robot, RobotState.OFFLINE)
        self.service.source_lost(STATUS[robot])
        self.service.take_news()

    def value(self, key: int | str, value: object, kind: BuiltinType = BuiltinType.DOUBLE, status: int = 0) -> None:
        self.service.value_changed(ValueChanged(NodeId(2, key), int(kind), value, status, 1, False))
        if isinstance(key, str) or key >= 1300:
            self.service.take_news()

    def hear(self, status_id: int, *executions: ExecutionStatus, status: int = 0) -> None:
        """A robot's SkillStatus."""
        shown = SkillStatus()
        for execution in executions:
            shown.show(execution)
        types, values = shown.fields()
        message = DataSetMessage(status_id, types=types, values=values, status=status)
        metadata = DataSetMetaData("skill status", SKILL_STATUS_FIELDS, ConfigurationVersion(1, 1))
        self.service.heard(DataReceived(Topic(2, 2, status_id), message, metadata))
        self.service.take_news()

    def start(self, text: str = ONE, names: Sequence[str] = (), values: Sequence[str] = ()) -> str:
        return self.service.runs.start(self.service.runs.valid(text), names, values, "anna")

    def pass_time(self, seconds: float) -> None:
        end = self.now + seconds
        while (due := self.service.next_deadline()) is not None and due <= end:
            self.now = max(self.now, due)
            self.service.poll()
        self.now = end

    def faults(self) -> list[str]:
        return [f"{output.fault.id} {output.change.name}" for output in self.said if isinstance(output, FaultChanged)]

    def ended(self) -> list[str]:
        return [
            f"{output.fact.outcome.value} {output.fact.reason}".strip()
            for output in self.said
            if isinstance(output, RunChanged) and isinstance(output.fact, RunEnded)
        ]
