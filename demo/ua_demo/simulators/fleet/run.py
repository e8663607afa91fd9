"""One simulation, from its settings to its result. The same settings give the same result, but for the wall time."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from random import Random
from typing import Final

from ua_demo.simulators.fleet.fleet import TASK_S, Settings, fleet_of, robot_name, scenario_of
from ua_demo.simulators.fleet.processes import Place, VirtualBridge, VirtualServer
from ua_demo.simulators.fleet.robot import VirtualRobot
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
from ua_fleet.scenario.facts import RunEnded, TaskAssigned, TaskOutcome, TaskOver
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

    @property
    def is_right(self) -> bool:
        """Whether the run is done, with each of its tasks once."""
        done = self.tasks_done
        return self.outcome == "done" and len(done) == self.settings.tasks == done.total()

    def take(self, output: Output) -> None:
        """Take what the orchestrator tells."""
        if isinstance(output, FaultChanged) and output.change is FaultChange.RAISED:
            self.failures.append(Failure(output.fault.robot, "", output.fault.since))
        elif isinstance(output, DecisionChanged):
            failure = next((one for one in reversed(self.failures) if one.robot == output.failed), None)
            if failure is not None and not failure.replacement:
                failure.task = output.task
                if isinstance(output.event, ReplacementChosen):
                    failure.replacement = output.event.robot
        elif isinstance(output, RunChanged):
            if isinstance(output.fact, RunEnded):
                self.outcome, self.reason = output.fact.outcome.value, output.fact.reason
                self.ended_s = output.fact.at
            elif isinstance(output.fact, TaskAssigned) and not self.began_s:
                self.began_s = output.fact.at
            elif isinstance(output.fact, TaskOver) and output.fact.outcome is TaskOutcome.DONE:
                self.tasks_done[output.fact.step] += 1


def simulate(settings: Settings) -> Result:
    """Have a virtual fleet do its tasks.

    Raises:
        ScenarioError: the run did not come to an end, which is a mistake of the program.
    """
    began = time.perf_counter()
    result = Result(settings)
    fleet = _Fleet(settings, result)
    limit_s = (settings.tasks + settings.faults + 1) * 2 * TASK_S + _SPARE_S
    if not fleet.world.run(lambda: bool(result.outcome), limit_s):
        raise ScenarioError(f"the simulated run did not end within {limit_s:g} s of its own clock")
    for counters in fleet.counters:
        result.drops.update(counters.drops)
    result.wall_s = time.perf_counter() - began
    return result


class _Fleet:
    """A world with a server and all bridges in it."""

    def __init__(self, settings: Settings, result: Result) -> None:
        self._timing, self._traffic = settings.timing, result.traffic
        self._random = Random(settings.seed)  # noqa: S311 - the same luck for the same seed; its keys protect nothing
        self._route = None if settings.all_hear_all else Route()
        self.world = World(settings.seed, self._route)
        self.counters: list[Counters] = []
        config = fleet_of(settings)
        self._keys = {group_id: self._random.randbytes(POLICY.key_data_bytes) for group_id in all_groups(config)}
        model = fleet_model(config)
        view = fleet_view(model.robots, {})
        endpoint = self.world.endpoint()
        place = self._place(SERVER_SPACE, all_groups(config), endpoint)
        self.world.add(VirtualServer(config, model, view, scenario_of(settings, view), place, result.take), endpoint)
        if self._route is not None:
            self._route.server = endpoint.address
        with_tasks = range(min(settings.robots, settings.tasks))
        failing = {robot_name(number) for number in self._random.sample(with_tasks, settings.faults)}
        for robot in model.robots:
            self._add_bridge(config, robot, fails=robot.name in failing)

    def _add_bridge(self, config: FleetConfig, robot: RobotModel, *, fails: bool) -> None:
        space, endpoint = config.space_of(robot.name), self.world.endpoint()
        if self._route is None:
            groups = groups_of(config, space)
        else:  # it hears the server alone
            groups = telemetry_group(space), command_group(space), telemetry_group(SERVER_SPACE)
            self._route.bridges[space] = endpoint.address
        place = self._place(space, groups, endpoint)
        driver = VirtualRobot(_skill_of(robot), self.world.clock, fails=fails)
        self.world.add(VirtualBridge(config, robot.bridge, driver, place), endpoint)

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
