"""The fleet that is simulated, as `fleet.yaml` and a scenario's file would say it: section 5.2.1 of the paper.

Each robot has a bridge and a space of its own. The tasks go round the robots, one after the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ua_fleet.config.resilience_schema import ModeName, ResilienceConfig
from ua_fleet.config.schema import BridgeConfig, FleetConfig, PubSubConfig, PubSubSecurity, RobotConfig, ScalarType
from ua_fleet.config.skill_schema import ArgumentConfig, SkillConfig
from ua_fleet.errors import ScenarioError, ScenarioInvalid
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.scenario import FleetView, Scenario, read_scenario, validate
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.values import StatusCode

__all__ = ["MOST_ROBOTS", "MOST_TASKS", "TASK_S", "Settings", "SettingsInvalid", "fleet_of", "scenario_of"]

MOST_ROBOTS: Final = 10_000
MOST_TASKS: Final = 10_000
TASK_S: Final = 3.0
"""How long a robot is at a task (5.2.1)."""
USUAL_ROBOTS: Final = 100
"""Up to so many robots send their keep-alives with the usual period; more of them send as many altogether."""
SKILL: Final = "work"
_FIRST_SPACE: Final = 256
_FIRST_ID: Final = 1
_IDS: Final = 3
"""Of a robot: its bridge's status, its SkillStatus, its skill."""


class SettingsInvalid(ScenarioError):
    """A simulation that cannot be: says which number, and what it may be."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT


@dataclass(frozen=True, slots=True)
class Settings:
    """What is simulated."""

    robots: int
    tasks: int
    faults: int = 0
    """Robots that fail during their first task."""
    seed: int = 0
    keep_alive_s: float | None = None
    """Period of keep-alives. Whatever else is sent with a period becomes slower with it. None: 1 s up to 100 robots,
    and more with more of them."""
    all_hear_all: bool = False
    """Deliver every datagram to every process. The messages are the same; it takes the square of the time."""
    carried: bool = False
    """The bridges carry the run; else the server asks each robot."""

    def __post_init__(self) -> None:
        for name, value, most in (("robots", self.robots, MOST_ROBOTS), ("tasks", self.tasks, MOST_TASKS)):
            if not 1 <= value <= most:
                raise SettingsInvalid(f"{value:,} {name}: give 1 to {most:,}")
        most = min(self.robots - 1, self.tasks)
        if not 0 <= self.faults <= most:
            raise SettingsInvalid(
                f"{self.faults:,} faults: with {self.robots:,} robots and {self.tasks:,} tasks give 0 to {most:,}; only"
                " a robot with a task can fail, and one has to be left"
            )
        if self.keep_alive_s is not None and not 0.1 <= self.keep_alive_s <= 3600:
            raise SettingsInvalid(f"a keep-alive period of {self.keep_alive_s:g} s: give 0.1 to 3600")

    @property
    def timing(self) -> PubSubTiming:
        """The periods of PubSub: the usual ones, all slowed down by the same factor."""
        usual = PubSubTiming()
        keep_alive_s = self.keep_alive_s
        if keep_alive_s is None:
            keep_alive_s = usual.keep_alive_s * max(1.0, self.robots / USUAL_ROBOTS)
        slower = keep_alive_s / usual.keep_alive_s
        return PubSubTiming(
            keep_alive_s,
            usual.receive_timeout_s * slower,
            usual.repeat_interval_s * slower,
            usual.announce_interval_s * slower,
            usual.status_interval_s * slower,
        )


def requestors_of(settings: Settings) -> list[tuple[int, ...]]:
    """The spaces that may command each bridge, in the order of the robots.

    In a carried run these are the bridge that hands it tokens and the one that ends the run, which hears of every
    failure itself. Where robots fail, each may be asked in place of any other one.
    """
    with_tasks = min(settings.robots, settings.tasks)
    spaces = [_FIRST_SPACE + number for number in range(settings.robots)]
    if not settings.carried:
        return [(SERVER_SPACE,)] * settings.robots
    if settings.faults:
        return [(SERVER_SPACE, *spaces)] * settings.robots
    last = (settings.tasks - 1) % settings.robots
    return [
        (SERVER_SPACE, *spaces[:with_tasks])
        if number == last
        else (SERVER_SPACE, *sorted({spaces[(number - 1) % with_tasks], spaces[last]}))
        for number in range(settings.robots)
    ]


def fleet_of(settings: Settings) -> FleetConfig:
    """The fleet as its `fleet.yaml` would say it."""
    timing = settings.timing
    bridges: dict[str, BridgeConfig] = {}
    robots: dict[str, RobotConfig] = {}
    argument = ArgumentConfig(type=ScalarType.DOUBLE, unit="m", range=(0, 100))
    for number, requestors in enumerate(requestors_of(settings)):
        name, first_id = robot_name(number), _FIRST_ID + number * _IDS
        bridges[name] = BridgeConfig(
            kind="virtual", space=_FIRST_SPACE + number, status_id=first_id, requestors=requestors
        )
        robots[name] = RobotConfig(
            bridge=name,
            capacities=("mobile",),
            skill_status_id=first_id + 1,
            skills={SKILL: SkillConfig(id=first_id + 2, needs=("mobile",), arguments={"distance": argument})},
        )
    return FleetConfig(
        version=1,
        pubsub=PubSubConfig(
            security=PubSubSecurity.SIGN_AND_ENCRYPT,
            keep_alive_s=timing.keep_alive_s,
            receive_timeout_s=timing.receive_timeout_s,
            repeat_interval_s=timing.repeat_interval_s,
        ),
        bridges=bridges,
        robots=robots,
        resilience=ResilienceConfig(mode=ModeName.AUTOMATIC),
    )


def scenario_of(settings: Settings, fleet: FleetView) -> Scenario:
    """The tasks, read and checked as a scenario's file is."""
    lines = ["version: 1", "name: cycle", "steps:"]
    for number in range(settings.tasks):
        robot = robot_name(number % settings.robots)
        lines.append(f"  - {{task: t{number + 1}, skill: {SKILL}, robot: {robot}, arguments: {{distance: 1.5}}}}")
    reading = read_scenario("\n".join(lines).encode(), "cycle.yaml")
    validation = validate(reading.scenario, fleet, "cycle.yaml")
    problems = [*reading.problems, *validation.problems]
    if problems:
        raise ScenarioInvalid([str(problem) for problem in problems])
    return validation.scenario


def robot_name(number: int) -> str:
    """The name of a robot, and of its bridge."""
    return f"robot{number + 1}"
