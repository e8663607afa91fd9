"""The server: the parts of the real one that send something, without event loop, disk and nodes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Final

from ua_demo.simulators.fleet.processes import Place, nothing
from ua_fleet.config.applications import server_application
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.commands import Commands
from ua_fleet.fleet.model import FleetModel
from ua_fleet.fleet.state import FleetState
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.operation.runs.requests import TaskRequests
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.operation.skills.tracker import SkillTracker
from ua_fleet.orchestrator import OperatorAsked, Orchestrator, Output, TaskCancelled, TaskFollowed, TaskStarted
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.scenario import FleetView, Scenario, Value, ValueUnknown
from ua_fleet.scenario.facts import Fact, TaskOutcome
from ua_fleet.server.attached import Ground, NoRuns, Parts
from ua_fleet.server.core import ServerCore
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.transport.base import Address

__all__ = ["CHECK_S", "OPERATOR", "RUN_ID", "Unread", "VirtualRuns", "VirtualServer"]

RUN_ID: Final = "20260101-000001-000000"
"""As long as those that a server gives."""
CHECK_S: Final = 1.0
"""How often it is looked whether all robots are there, so that the run can begin."""
OPERATOR: Final = "operator"

MakeParts = Callable[[Ground], Parts]
"""Makes what runs scenarios in a server."""


class VirtualServer:
    """The server's core with one run, and nobody who looks at nodes."""

    def __init__(self, config: FleetConfig, model: FleetModel, place: Place, make_parts: MakeParts) -> None:
        """Put a server together.

        Args:
            config: the fleet.
            model: its robots.
            place: where it lives.
            make_parts: makes what runs the scenario, which begins once all robots are known.
        """
        self.counters, self._clock, self._wall_ticks = place.counters, place.clock, place.wall_ticks
        subscriber, mistakes = place.subscriber(SERVER_SPACE), Mistakes()
        ground = Ground(
            publisher=place.publisher(SERVER_SPACE, server_application(config)),
            subscriber=subscriber,
            counters=place.counters,
            commands=Commands(model),
            state=FleetState(model, place.counters),
            skills=SkillCommands(
                MemoryJournal(),
                send=place.sender.send,
                want=subscriber.want_action,
                sooner=nothing,
                wall_ticks=place.wall_ticks,
                must_be_verified=True,
                told=self._concluded,
                clock=place.clock,
                log=Unread(),
            ),
            tracker=SkillTracker(model),
            mistakes=mistakes,
            log=Unread(),
            send=place.sender.send,
        )
        self._core = ServerCore(
            ground,
            make_parts(ground),
            analog_rate_hz=config.server.analog_rate_hz,
            tick_s=math.inf,  # what it does each second is for those who look at nodes
        )
        self._mistakes, self._has_begun = mistakes, False

    def receive(self, datagram: bytes, sender: Address) -> None:
        """Take a datagram."""
        self._core.receive(datagram, sender, now=self._clock(), wall=self._wall_ticks())
        self._check()

    def poll(self) -> None:
        """Do what is due."""
        now, wall = self._clock(), self._wall_ticks()
        if not self._has_begun:
            self._has_begun = True
            self._core.begin(now=now, wall=wall)
        self._core.poll(now=now, wall=wall)
        self._check()

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return self._core.next_deadline(self._clock()) if self._has_begun else 0.0

    def _concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self._core.concluded(execution_id, outcome, now=self._clock(), wall=self._wall_ticks())

    def _check(self) -> None:
        """What would cost a server an item must not happen here."""
        if self._mistakes.count:
            raise ScenarioError(f"the simulation is wrong: {self._mistakes.text()}")


class VirtualRuns(NoRuns):
    """One run that needs no disk, as soon as all robots can be asked."""

    def __init__(
        self,
        config: FleetConfig,
        model: FleetModel,
        view: FleetView,
        scenario: Scenario,
        ground: Ground,
        clock: Callable[[], float],
        show: Callable[[Output], None],
    ) -> None:
        """Wait for the robots of a model.

        Args:
            config: the fleet.
            model: its robots.
            view: the same, for the scenario.
            scenario: what is run.
            ground: of the server.
            clock: seconds.
            show: told of everything that happens.
        """
        skills = ground.skills
        self._show, self._scenario, self._skills, self._clock = show, scenario, skills, clock
        self._facts: list[tuple[str, Fact]] = []
        self._orchestrator = Orchestrator(
            config.resilience.settings(),
            view,
            _no_value,
            lambda run_id, fact: self._facts.append((run_id, fact)),
        )
        self._tasks = TaskRequests(
            {robot.name: robot for robot in model.robots},
            skills,
            requested=lambda _node, _execution_id: None,
            clock=clock,
            is_silent=self._orchestrator.is_silent,
            accepted=self._accepted,
            ended=self._ended,
            mistakes=ground.mistakes,
            log=Unread(),
        )
        self._missing = [
            Topic(robot.skill_status.space, robot.ns, skill.id)
            for robot in model.robots
            if robot.skill_status is not None
            for skill in robot.skills
        ]
        """Actions of which it is not known yet that they were announced."""
        self._begin_at: float | None = CHECK_S
        self._held: deque[Output] = deque()
        self._is_carrying_out = False

    def heard(self, event: DataReceived) -> None:
        """Take a robot's SkillStatus."""
        if self._tasks.robot_of(event.topic) is not None:
            self._tasks.show(event)
            self._tasks.take_shown(event.topic)

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """The outcome of a request is known."""
        self._tasks.concluded(execution_id, outcome)

    def poll(self) -> None:
        """Do what is due."""
        now = self._clock()
        self._tasks.poll()
        if self._begin_at is not None and now >= self._begin_at:
            self._begin_at = now + CHECK_S
            self._missing = [topic for topic in self._missing if self._skills.action(topic) is None]
            if not self._missing:
                self._begin_at = None
                self._do(self._orchestrator.start(RUN_ID, self._scenario, {}, by=OPERATOR, now=now))
        due = self._orchestrator.next_deadline()
        if due is not None and now >= due:
            self._do(self._orchestrator.poll(now))

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        deadlines = self._tasks.next_deadline(), self._orchestrator.next_deadline(), self._begin_at
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def _accepted(self, execution_id: str) -> None:
        self._do(self._orchestrator.accepted(execution_id, self._clock()))

    def _ended(self, execution_id: str, outcome: TaskOutcome, message: str, results: Mapping[str, Value]) -> None:
        self._do(self._orchestrator.ended(execution_id, outcome, self._clock(), message=message, results=results))

    def _do(self, outputs: Iterable[Output]) -> None:
        """Carry out what follows, and what follows from that, in order."""
        self._held.extend(outputs)
        if self._is_carrying_out:
            return  # whoever carries out takes this as well
        self._is_carrying_out = True
        try:
            while self._held:
                output = self._held.popleft()
                if isinstance(output, TaskStarted):
                    self._tasks.begin(output)
                elif isinstance(output, TaskFollowed | OperatorAsked):
                    self._tasks.follow(output)
                elif isinstance(output, TaskCancelled):
                    self._tasks.cancel(output)
                self._show(output)
        finally:
            self._is_carrying_out = False


class Unread:
    """The log of a server that nobody runs."""

    def info(self, _event: str, /, **_values: object) -> None:
        """A robot or bridge is there."""

    def warning(self, _event: str, /, **_values: object) -> None:
        """One is gone: the report of the simulation tells of it."""

    def error(self, _event: str, /, **_values: object) -> None:
        """Data of the server's own cannot be sent; it has none."""


def _no_value(name: str) -> Value:
    raise ValueUnknown(f"a virtual robot has no value {name}")
