"""How many messages TalkRoBots exchanges: Eq. 1 to 12 of its paper, section 5.1, as they are printed.

Ayaida et al., "TalkRoBots: A Middleware for Robotic Systems in Industry 4.0", Future Internet 2022.

The tasks of a scenario stand in blocks: tasks that one actor performs one after the other. A task that stands alone may
be counted as a block of one or as none; Eq. 8 gives the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from ua_fleet.errors import ScenarioError
from ua_fleet.traffic import MessageKind

__all__ = [
    "EQUATION_12_KINDS",
    "Situation",
    "blocks_of",
    "boot",
    "cyclic",
    "devices",
    "equation_12_sum",
    "fail",
    "forward",
    "identification",
    "scenario",
    "sensor",
    "start",
    "task",
    "tasks",
    "total",
]

EQUATION_12_KINDS: Final = (
    MessageKind.REGISTRATION,
    MessageKind.REQUEST,
    MessageKind.RESPONSE,
    MessageKind.STATUS,
    MessageKind.TOKEN,
    MessageKind.FAULT,
)
"""The kinds of messages that Eq. 12 counts, besides the updates of sensors."""


def equation_12_sum(by_kind: Mapping[MessageKind, int]) -> int:
    """The sum over the kinds that Eq. 12 counts, of messages or of bytes."""
    return sum(by_kind.get(kind, 0) for kind in EQUATION_12_KINDS)


@dataclass(frozen=True, slots=True)
class Situation:
    """What the equations know of an experiment; the symbols are those of table 2."""

    robots: int
    """n."""
    direct_tasks: int = 0
    """N_d: tasks in direct or ROS mode."""
    interpreted_tasks: int = 0
    """N_i: tasks in interpreted mode, sent as five fields."""
    blocks: tuple[int, ...] = ()
    """m_1 to m_k: how many tasks each block has."""
    sensor_rates: tuple[float, ...] = ()
    """x_1 to x_s: messages of each device in a second."""
    elapsed_s: float = 0.0
    """Delta_t."""
    local_requests: int = 0
    """R_l: requests to a sensor at the same robot."""
    remote_requests: int = 0
    """R_e: requests to a sensor at another robot."""
    faulty_robots: int = 0
    """N_f, at most n - 1."""

    def __post_init__(self) -> None:
        counts = (
            self.direct_tasks,
            self.interpreted_tasks,
            self.local_requests,
            self.remote_requests,
            self.faulty_robots,
        )
        if self.robots < 1 or min(counts) < 0:
            raise ScenarioError("the equations need one robot at least, and no count below 0")
        if self.faulty_robots >= self.robots:
            raise ScenarioError(f"of {self.robots} robots at most {self.robots - 1} may be faulty (Eq. 11)")
        if any(size < 1 for size in self.blocks) or sum(self.blocks) > tasks(self):
            raise ScenarioError("a block has one task at least, and all blocks no more than the scenario")


def boot(robots: int) -> int:
    """Eq. 1, d_boot: start, started and waiting of each robot's middleware, and the scenario to the first actor."""
    return 3 * robots + 1


def identification(robots: int) -> int:
    """Eq. 2, d_identification: each robot that joins tells all, and all that are there answer."""
    return robots * (robots + 1) // 2


def devices(rates: Sequence[float], elapsed_s: float) -> float:
    """Eq. 3, d_devices: two messages for each device that is plugged in, and its updates."""
    return 2 * len(rates) + elapsed_s * sum(rates)


def start(situation: Situation) -> float:
    """Eq. 4, d_start: all that comes before the first task, and the sensors' updates."""
    return (
        boot(situation.robots) + identification(situation.robots) + devices(situation.sensor_rates, situation.elapsed_s)
    )


def tasks(situation: Situation) -> int:
    """Eq. 5, N_task."""
    return situation.direct_tasks + situation.interpreted_tasks


def scenario(situation: Situation) -> int:
    """Eq. 6 and 9, d_scenario: tasks and hand-overs."""
    return task(situation) + forward(situation)


def task(situation: Situation) -> int:
    """Eq. 7, d_task: ready, task, done, and done to the operator; an interpreted task is sent as five messages."""
    return 4 * situation.direct_tasks + 8 * situation.interpreted_tasks


def forward(situation: Situation) -> int:
    """Eq. 8, d_forward: one message wherever the next task is another actor's. Without tasks there is none."""
    if not tasks(situation):
        return 0
    return tasks(situation) - sum(situation.blocks) + len(situation.blocks) - 1


def sensor(local_requests: int, remote_requests: int) -> int:
    """Eq. 10, d_sensor: request and response, both forwarded where the sensor is at another robot."""
    return 2 * local_requests + 4 * remote_requests


def fail(faulty_robots: int) -> int:
    """Eq. 11, d_fail: the robot tells the Cloud, which sends the mended scenario back."""
    return 2 * faulty_robots


def total(situation: Situation) -> float:
    """Eq. 12, d."""
    return (
        start(situation)
        + scenario(situation)
        + sensor(situation.local_requests, situation.remote_requests)
        + fail(situation.faulty_robots)
    )


def blocks_of(actors: Sequence[str]) -> tuple[int, ...]:
    """The blocks of a scenario whose tasks are these actors', in order."""
    return tuple([len(list(block)) for _, block in groupby(actors)])


def cyclic(robots: int, direct_tasks: int, faulty_robots: int = 0) -> Situation:
    """Section 5.2.1: tasks go round the robots, in direct or ROS mode, and no sensor is asked."""
    actors = [str(index % max(robots, 1)) for index in range(direct_tasks)]
    return Situation(robots, direct_tasks, blocks=blocks_of(actors), faulty_robots=faulty_robots)
