"""A bridge and the server: the parts of the real processes, without event loop, disk and nodes.

`bridge.runner` and `server.hub` are what a machine has in their place. What is left out here sends nothing.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from random import Random
from typing import Final

import structlog

from ua_demo.simulators.fleet.robot import VirtualRobot
from ua_fleet.bridge.actions import Actions
from ua_fleet.bridge.core import BridgeCore
from ua_fleet.bridge.driver import DriverStatus, SourceFound
from ua_fleet.bridge.status import STATUS_FIELDS, STATUS_INTERVAL_S, status_topic, status_values
from ua_fleet.config.applications import bridge_application, server_application
from ua_fleet.config.registration import announced_robots
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Counters
from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.commands import Commands
from ua_fleet.fleet.model import FleetModel
from ua_fleet.fleet.state import FleetState
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.operation.runs.requests import TaskRequests
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.operation.skills.tracker import SkillTracker
from ua_fleet.orchestrator import OperatorAsked, Orchestrator, Output, TaskCancelled, TaskFollowed, TaskStarted
from ua_fleet.pubsub.application import Application
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.security import Envelope
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.scenario import FleetView, Scenario, Value, ValueUnknown
from ua_fleet.scenario.facts import Fact, TaskOutcome
from ua_fleet.server.attached import Ground, NoRuns, Parts
from ua_fleet.server.core import ServerCore
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.transport.base import Address
from ua_fleet.transport.sealed import SealedSender
from ua_fleet.values import TICKS_PER_SECOND
from ua_fleet.wire import Codec

__all__ = ["Place", "VirtualBridge", "VirtualServer"]

START_TICKS: Final = 134_116_128_000_000_000
"""The wall clock at time 0: 2026-01-01 UTC."""
RUN_ID: Final = "20260101-000001-000000"
"""As long as those that a server gives."""
CHECK_S: Final = 1.0
"""How often it is looked whether all robots are there, so that the run can begin."""
OPERATOR: Final = "operator"


_log: Final = structlog.get_logger("ua_fleet.simulator")


def wall_ticks(now: float) -> int:
    """The wall clock of all processes."""
    return START_TICKS + round(now * TICKS_PER_SECOND)


@dataclass(frozen=True, slots=True)
class Place:
    """What a process is given: its own clock, way into the network, keys and counters."""

    timing: PubSubTiming
    counters: Counters
    envelope: Envelope
    """With its keys."""
    sender: SealedSender
    clock: Callable[[], float]
    """Seconds."""
    random: Random
    """Spreads probes."""

    def publisher(self, space: int, application: Application) -> Publisher:
        """Its DataSetWriters."""
        most = self.envelope.max_plain_bytes
        return Publisher(space, self.timing, self.counters, Codec(), application, max_packed_bytes=most)

    def subscriber(self, space: int) -> Subscriber:
        """Its DataSetReaders."""
        return Subscriber(space, self.timing, self.counters, Codec(), envelope=self.envelope, random=self.random)

    def wall_ticks(self) -> int:
        """The wall clock."""
        return wall_ticks(self.clock())


class VirtualBridge:
    """One bridge with its robot."""

    def __init__(self, config: FleetConfig, name: str, robot: VirtualRobot, place: Place) -> None:
        """Put a bridge together; it begins with its first `poll`.

        Args:
            config: the fleet.
            name: of the bridge.
            robot: its driver.
            place: where it lives.
        """
        bridge = config.bridges[name]
        self.counters = place.counters
        self._name, self._kind, self._robot, self._clock = name, bridge.kind, robot, place.clock
        publisher = place.publisher(bridge.space, bridge_application(config, name))
        self._core = BridgeCore(
            bridge.space,
            publisher,
            place.subscriber(bridge.space),
            place.counters,
            send=place.sender.send,
            publish=robot.publish,
        )
        self._actions = self._core.actions = Actions(
            bridge.space,
            publisher,
            place.counters,
            driver=robot,
            journal=MemoryJournal(),
            requestors=bridge.requestors,
            must_be_verified=True,
            core=self._core,
            send=place.sender.send,
            send_to=place.sender.send,
            wall_ticks=place.wall_ticks,
            failed=_raise,
            definitions=announced_robots(config, name),
            skills_period_s=math.inf,  # a virtual robot's never change
        )
        topic = status_topic(config, bridge)
        assert topic is not None, "fleet_of gives each bridge one"
        self._status_topic = topic
        self._status_period_s = STATUS_INTERVAL_S * place.timing.keep_alive_s / PubSubTiming().keep_alive_s
        self._status_at = 0.0
        self._has_begun = False

    def receive(self, datagram: bytes, sender: Address) -> None:
        """Take a datagram."""
        self._core.from_pubsub(datagram, now=self._clock(), sender=sender)

    def poll(self) -> None:
        """Do what is due."""
        now = self._clock()
        wall = wall_ticks(now)
        if not self._has_begun:
            self._has_begun = True
            self._begin(now, wall)
        for event in self._robot.poll(now):
            self._core.from_space(event, now=now, wall_ticks=wall)
        if now >= self._status_at:
            self._status_at = now + self._status_period_s
            status = DriverStatus(connected=True, detail="a virtual robot")
            self._core.tell(
                self._status_topic, status_values(self._name, self._kind, status, self.counters), wall, now=now
            )
        self._core.poll(now, wall)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        if not self._has_begun:
            return 0.0
        deadlines = self._core.next_deadline(), self._robot.next_deadline(), self._status_at
        return min(deadline for deadline in deadlines if deadline is not None)

    def _begin(self, now: float, wall: int) -> None:
        self._core.begin(now=now, wall_ticks=wall)
        source = SourceFound(self._status_topic, f"{self._name} status", STATUS_FIELDS)
        self._core.from_space(source, now=now, wall_ticks=wall)
        self._actions.begin(now)


class VirtualServer:
    """The server's core with one run, and nobody who looks at nodes."""

    def __init__(
        self,
        config: FleetConfig,
        model: FleetModel,
        view: FleetView,
        scenario: Scenario,
        place: Place,
        show: Callable[[Output], None],
    ) -> None:
        """Put a server together; the run begins once it knows all robots.

        Args:
            config: the fleet.
            model: its robots.
            view: the same, for the scenario.
            scenario: what is run.
            place: where it lives.
            show: told of everything that happens.
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
                sooner=_nothing,
                wall_ticks=place.wall_ticks,
                must_be_verified=True,
                told=self._concluded,
                clock=place.clock,
                log=_log,
            ),
            tracker=SkillTracker(model),
            mistakes=mistakes,
            log=_Unread(),
            send=place.sender.send,
        )
        runs = VirtualRuns(config, model, view, scenario, ground.skills, mistakes, place.clock, show)
        self._core = ServerCore(
            ground,
            Parts(runs=runs),
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
        skills: SkillCommands,
        mistakes: Mistakes,
        clock: Callable[[], float],
        show: Callable[[Output], None],
    ) -> None:
        """Wait for the robots of a model; the arguments are those of VirtualServer."""
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
            mistakes=mistakes,
            log=_log,
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


class _Unread:
    """The log of a server that nobody runs."""

    def info(self, _event: str, /, **_values: object) -> None:
        """A robot or bridge is there."""

    def warning(self, _event: str, /, **_values: object) -> None:
        """One is gone: the report of the simulation tells of it."""

    def error(self, _event: str, /, **_values: object) -> None:
        """Data of the server's own cannot be sent; it has none."""


def _nothing() -> None:
    """The world asks for the next deadline after everything that it has had a process do."""


def _no_value(name: str) -> Value:
    raise ValueUnknown(f"a virtual robot has no value {name}")


def _raise(text: str, error: BaseException | None) -> None:
    """What a bridge would log for an operator must not happen here."""
    raise ScenarioError(f"the simulation is wrong: {text}") from error
