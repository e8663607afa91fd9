"""One simulation, from its settings to its result. The same settings give the same result, but for the wall time."""

from __future__ import annotations

import gc
import time
from collections import Counter
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass, field
from random import Random
from typing import Final

from ua_demo.simulators.fleet.carried import carried_parts, carrier_in_memory
from ua_demo.simulators.fleet.fleet import TASK_S, Settings, fleet_of, robot_name, scenario_of
from ua_demo.simulators.fleet.processes import Place, VirtualBridge
from ua_demo.simulators.fleet.robot import VirtualRobot
from ua_demo.simulators.fleet.server import VirtualRuns, VirtualServer
from ua_demo.simulators.fleet.world import Route, World
from ua_fleet.bridge.driver import Skill, SkillTarget
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups, groups_of
from ua_fleet.counters import Counters
from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.model import RobotModel
from ua_fleet.operation.runs.values import fleet_view
from ua_fleet.orchestrator import DecisionChanged, FaultChanged, Output, RunChanged
from ua_fleet.orchestrator.faults import FaultChange
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.security import Envelope
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.resilience import ReplacementChosen
from ua_fleet.scenario.facts import Fact, Replaced, RunEnded, TaskAssigned, TaskOutcome, TaskOver
from ua_fleet.server.attached import Ground, Parts
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.traffic import Traffic
from ua_fleet.transport.memory import MemoryEndpoint
from ua_fleet.transport.sealed import SealedSender
from ua_fleet.wire import SecurityMode, SecurityPolicy

__all__ = ["Failure", "Result", "simulate"]

POLICY: Final = SecurityPolicy.AES256_CTR
_LIFETIME_S: Final = 1e9
"""Keys are not changed."""
_SPARE_S: Final = 60.0
_COLLECTION: Final = (10_000, 10, 1_000)
"""Thresholds of the garbage collection: what is young is looked through as ever, and the whole fleet next to never."""


@dataclass(slots=True)
class Failure:
    """A robot that failed."""

    robot: str
    task: str
    detected_s: float
    replacement: str = ""
    """Who took the task over; empty where nobody did."""


@dataclass(slots=True)
class Result:
    """What a simulation came to. Times are seconds of its own clock, but for `wall_s`."""

    settings: Settings
    traffic: Traffic = field(default_factory=Traffic)
    outcome: str = ""
    """`done`, or how the run ended otherwise."""
    reason: str = ""
    began_s: float = 0.0
    """When the run began."""
    ended_s: float = 0.0
    tasks_done: Counter[str] = field(default_factory=Counter[str])
    """How often each task was done, by its name; once is right."""
    failures: list[Failure] = field(default_factory=list[Failure])
    drops: Counter[str] = field(default_factory=Counter[str])
    """What any process has dropped, by its cause."""
    wall_s: float = 0.0
    """How long the simulation took."""
    cpu_s: float = 0.0
    """What it took of a processor."""
    _tasks: dict[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]], repr=False)
    """The name of each task and who has it now, by its step."""

    @property
    def is_right(self) -> bool:
        """Whether the run is done, with each of its tasks once."""
        done = self.tasks_done
        return self.outcome == "done" and len(done) == self.settings.tasks == done.total()

    def take(self, output: Output) -> None:
        """Take what the orchestrator tells."""
        if isinstance(output, FaultChanged) and output.change is FaultChange.RAISED:
            self._failed(output.fault.robot, output.fault.since)
        elif isinstance(output, DecisionChanged):
            failure = next((one for one in reversed(self.failures) if one.robot == output.failed), None)
            if failure is not None and not failure.replacement:
                failure.task = output.task
                if isinstance(output.event, ReplacementChosen):
                    failure.replacement = output.event.robot
        elif isinstance(output, RunChanged):
            self._take_fact(output.fact)

    def _take_fact(self, fact: Fact) -> None:
        if isinstance(fact, RunEnded):
            self.outcome, self.reason = fact.outcome.value, fact.reason
            self.ended_s = fact.at
        elif isinstance(fact, TaskAssigned):
            self._tasks[fact.step] = fact.task, fact.robot
            self.began_s = self.began_s or fact.at
        elif isinstance(fact, TaskOver) and fact.outcome is TaskOutcome.DONE:
            self.tasks_done[fact.step] += 1
        elif isinstance(fact, TaskOver) and fact.outcome is TaskOutcome.STOPPED:
            self._failed(self._tasks[fact.step][1], fact.at)
        elif isinstance(fact, Replaced):
            for failure in self.failures:
                if failure.robot == fact.failed and not failure.replacement:
                    failure.task, failure.replacement = self._tasks[fact.step][0], fact.robot

    def _failed(self, robot: str, at: float) -> None:
        """A robot has failed, as the server has found or a bridge has told."""
        if all(failure.robot != robot for failure in self.failures):
            self.failures.append(Failure(robot, "", at))


def simulate(settings: Settings) -> Result:
    """Have a virtual fleet do its tasks.

    Raises:
        ScenarioError: the run did not come to an end, which is a mistake of the program.
    """
    began, cpu_began_s = time.perf_counter(), time.process_time()
    result = Result(settings)
    with _rare_collection():
        _run(settings, result)
    result.wall_s, result.cpu_s = time.perf_counter() - began, time.process_time() - cpu_began_s
    return result


def _run(settings: Settings, result: Result) -> None:
    """Have a fleet live until its run is over. Nothing keeps it then: it is collected, not just looked through."""
    fleet = _Fleet(settings, result)
    limit_s = (settings.tasks + settings.faults + 1) * 2 * TASK_S + _SPARE_S
    if not fleet.world.run(lambda: bool(result.outcome), limit_s):
        raise ScenarioError(f"the simulated run did not end within {limit_s:g} s of its own clock")
    for counters in fleet.counters:
        result.drops.update(counters.drops)


@contextmanager
def _rare_collection() -> Generator[None]:
    """A fleet stays as a whole until its run is over: to look through it meanwhile took a quarter of the computing."""
    before = gc.get_threshold()
    gc.set_threshold(*_COLLECTION)
    try:
        yield
    finally:
        gc.set_threshold(*before)


class _Fleet:
    """A world with a server and all bridges in it."""

    def __init__(self, settings: Settings, result: Result) -> None:
        self._timing, self._traffic = settings.timing, result.traffic
        self._random = Random(settings.seed)  # noqa: S311 - the same luck for the same seed; its keys protect nothing
        # In a carried run each bridge ranks robots of others by what it hears of them.
        to_all = settings.all_hear_all or (settings.carried and settings.faults > 0)
        self._route = None if to_all else Route()
        self.world = World(settings.seed, self._route)
        self.counters: list[Counters] = []
        config = fleet_of(settings)
        self._keys = {group_id: self._random.randbytes(POLICY.key_data_bytes) for group_id in all_groups(config)}
        model = fleet_model(config)
        view = fleet_view(model.robots, {})
        endpoint = self.world.endpoint()
        place = self._place(SERVER_SPACE, all_groups(config), endpoint)
        self._is_carried, scenario = settings.carried, scenario_of(settings, view)

        def parts(ground: Ground) -> Parts:
            if settings.carried:
                return carried_parts(config, model, scenario, place, result.take, ground)
            return Parts(runs=VirtualRuns(config, model, view, scenario, ground, place.clock, result.take))

        self.world.add(VirtualServer(config, model, place, parts), endpoint)
        self._commanded = _commanded(config)
        if self._route is not None:
            self._route.server = endpoint.address
        with_tasks = range(min(settings.robots, settings.tasks))
        failing = {robot_name(number) for number in self._random.sample(with_tasks, settings.faults)}
        for robot in model.robots:
            self._add_bridge(config, robot, fails=robot.name in failing)

    def _add_bridge(self, config: FleetConfig, robot: RobotModel, *, fails: bool) -> None:
        space, endpoint = config.space_of(robot.name), self.world.endpoint()
        groups: list[str]
        if self._route is None:
            groups = list(groups_of(config, space))
        else:  # it hears the server, and the bridges that it hands something over to
            groups = [telemetry_group(SERVER_SPACE)]
            for other in dict.fromkeys((space, *self._commanded.get(space, ()))):
                groups += [telemetry_group(other), command_group(other)]
            self._route.bridges[space] = endpoint.address
        place = self._place(space, groups, endpoint)
        driver = VirtualRobot(_skill_of(robot), self.world.clock, fails=fails)
        carry = carrier_in_memory(config, robot.bridge) if self._is_carried else None
        self.world.add(VirtualBridge(config, robot.bridge, driver, place, carry), endpoint)

    def _place(self, space: int, groups: Iterable[str], endpoint: MemoryEndpoint) -> Place:
        counters, random = Counters(), Random(self._random.random())  # noqa: S311 - see above
        self.counters.append(counters)
        envelope = Envelope(space, counters, mode=SecurityMode.SIGN_AND_ENCRYPT, nonces=MemoryNonces(), random=random)
        for group_id in groups:
            envelope.install(group_id, GroupKeys(POLICY, 1, (self._keys[group_id],), _LIFETIME_S, _LIFETIME_S), 0.0)
        sender = SealedSender(envelope, endpoint, self.world.clock, self._sent)
        return Place(self._timing, counters, envelope, sender, self.world.clock, random)

    def _sent(self, datagram: bytes, size: int) -> None:
        self._traffic.take(datagram, size, self.world.clock())


def _commanded(config: FleetConfig) -> dict[int, list[int]]:
    """The spaces that each space may command."""
    found: dict[int, list[int]] = {}
    for bridge in config.bridges.values():
        for space in bridge.requestors:
            found.setdefault(space, []).append(bridge.space)
    return found


def _skill_of(robot: RobotModel) -> Skill:
    """What the robot's bridge is told to offer."""
    (skill,) = robot.skills
    assert robot.skill_status is not None, "fleet_of gives each robot one"
    return Skill(
        Topic(robot.skill_status.space, robot.ns, skill.id),
        skill.name,
        (SkillTarget(1, robot.name, robot.skill_status),),
        request=tuple([make_field(argument.name, argument.type) for argument in skill.arguments]),
    )
