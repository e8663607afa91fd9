"""Which robots could take a task over, and what is known of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from ua_fleet.fleet.skills import ArgumentModel
from ua_fleet.resilience import (
    Candidate,
    Criterion,
    DecisionMode,
    Excluded,
    Judgements,
    OnLimit,
    Ranking,
    Synthesis,
    Weights,
    availability,
    rank,
    weigh,
)
from ua_fleet.scenario import FleetView, Lookup, RobotView, Value, ValueUnknown
from ua_fleet.scenario.model import Task
from ua_fleet.scenario.parameters import argument_problems

__all__ = ["CriterionSource", "DistanceFrom", "ResilienceSettings", "TaskToDo", "TasksAhead", "ValueOf", "rank_robots"]


MOST_DECLARATIONS: Final = 8
"""Declarations of one skill that are told apart: each robot is compared with all of them."""


@dataclass(frozen=True, slots=True)
class ValueOf:
    """A robot's own value: `battery` is `<robot>.battery`."""

    name: str


@dataclass(frozen=True, slots=True)
class TasksAhead:
    """Availability: 100, and less with each task that the robot has ahead in all runs."""


@dataclass(frozen=True, slots=True)
class DistanceFrom:
    """To where the task is: to a place that an argument names, else to the robot that failed."""

    x: str
    y: str
    """Names of a robot's values, e.g. `pose.x`."""
    argument: str | None = None
    places: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])


CriterionSource = ValueOf | TasksAhead | DistanceFrom


@dataclass(frozen=True, slots=True)
class ResilienceSettings:
    """How a replacement is chosen. Changing it is an operator's matter."""

    criteria: tuple[tuple[Criterion, CriterionSource], ...]
    judgements: Judgements
    synthesis: Synthesis = Synthesis.DISTRIBUTIVE
    mode: DecisionMode = DecisionMode.OPERATOR
    limit_s: float = 60.0
    """How long an operator may think."""
    on_limit: OnLimit = OnLimit.BEST_IF_KNOWN
    silence_s: float = 30.0
    """How long a silent robot is waited for."""
    return_s: float = 300.0
    """How long a silent robot is waited for that may be at a task with `on_unknown: retry`."""
    weights: Weights = field(init=False, repr=False, compare=False)
    """Of all criteria."""

    def __post_init__(self) -> None:
        weights = weigh([criterion.name for criterion, _ in self.criteria], self.judgements)  # or refuses them
        object.__setattr__(self, "weights", weights)


@dataclass(frozen=True, slots=True)
class TaskToDo:
    """What has to be taken over."""

    task: Task
    capacities: Sequence[str]
    """Those that it names, and those that the skill needs on the robot that failed."""
    arguments: Mapping[str, Value]
    """As they are written, as far as they are known."""
    failed: str
    """The robot that cannot do it; empty where there was none."""
    excluded: Mapping[str, str] = field(default_factory=dict[str, str])
    """Robots that are not asked for it again, with the reason."""
    is_repaired: bool = False
    """Whether the robot that could not do it works again, and may have it back."""

    def problems(self, robot: RobotView) -> list[str]:
        """Why a robot that has the skill cannot be asked with these arguments."""
        return argument_problems(robot.skills[self.task.skill], self.arguments, self.task)


def rank_robots(
    task: TaskToDo,
    fleet: FleetView,
    settings: ResilienceSettings,
    *,
    unfit: Callable[[str, Collection[str]], str | None],
    tasks_ahead: Callable[[str], int],
    lookup: Lookup,
) -> Ranking:
    """Rank the robots that could do a task. A criterion counts where it is about such a task, and a distance only where
    it is known to where.

    A robot needs the capacities that the task needs, and those that the skill needs on this robot.

    Args:
        task: what has to be done.
        fleet: all robots.
        settings: the criteria and their judgements.
        unfit: why a robot cannot do now what needs some capacities; None where it can.
        tasks_ahead: how many tasks a robot has ahead.
        lookup: values of robots.
    """
    skill = task.task.skill
    own = {robot.name: fleet.needs(robot.name, skill) for robot in fleet.robots.values()}
    needed = {*task.capacities, *(capacity for needs in own.values() for capacity in needs)}
    criteria = [
        (criterion, source)
        for criterion, source in settings.criteria
        if criterion.is_about(skill, needed) and _applies(source, task, lookup)
    ]
    candidates: list[Candidate] = []
    excluded: list[Excluded] = []
    problems_of = _Problems(task)
    for robot in fleet.robots.values():
        needs = dict.fromkeys((*task.capacities, *own[robot.name]))
        missing = [capacity for capacity in needs if capacity not in robot.capacities]
        reason = unfit(robot.name, needs)
        if missing:
            why = "; ".join([f" now: {robot.lacks[name]}" for name in missing if name in robot.lacks][:1])
            excluded.append(Excluded(robot.name, f"lacks the capacity {', '.join(missing)}{why}"))
        elif skill not in robot.skills:
            excluded.append(Excluded(robot.name, f"has no skill {skill}"))
        elif reason is not None:
            excluded.append(Excluded(robot.name, reason))
        elif robot.name in task.excluded:
            excluded.append(Excluded(robot.name, task.excluded[robot.name]))
        elif robot.name == task.failed and not task.is_repaired:
            excluded.append(Excluded(robot.name, "is to be replaced"))
        elif problems := problems_of(robot):
            excluded.append(Excluded(robot.name, f"cannot be asked: {'; '.join(problems)}"))
        else:
            values: dict[str, float] = {}
            unknown: dict[str, str] = {}
            for criterion, source in criteria:
                try:
                    values[criterion.name] = _raw_value(source, robot.name, task, tasks_ahead, lookup)
                except ValueUnknown as error:
                    unknown[criterion.name] = str(error)
            candidates.append(Candidate(robot.name, values, unknown, tasks_ahead(robot.name)))
    return rank(
        [criterion for criterion, _ in criteria],
        settings.weights.among([criterion.name for criterion, _ in criteria]),
        candidates,
        excluded=excluded,
        synthesis=settings.synthesis,
    )


class _Problems:
    """Why robots cannot be asked: found once for all that declare the same arguments."""

    def __init__(self, task: TaskToDo) -> None:
        self._task = task
        self._known: list[tuple[tuple[ArgumentModel, ...], list[str]]] = []

    def __call__(self, robot: RobotView) -> list[str]:
        arguments = robot.skills[self._task.task.skill].arguments
        for known, problems in self._known:
            if known == arguments:
                return problems
        problems = self._task.problems(robot)
        if len(self._known) < MOST_DECLARATIONS:
            self._known.append((arguments, problems))
        return problems


def _applies(source: CriterionSource, task: TaskToDo, lookup: Lookup) -> bool:
    if isinstance(source, DistanceFrom):
        try:
            _place(source, task, lookup)
        except ValueUnknown:
            return False  # the failed robot may be silent, and nobody is nearer to nowhere
    return True


def _raw_value(
    source: CriterionSource, robot: str, task: TaskToDo, tasks_ahead: Callable[[str], int], lookup: Lookup
) -> float:
    match source:
        case TasksAhead():
            return availability(tasks_ahead(robot))
        case ValueOf(name=name):
            return _number(lookup, f"{robot}.{name}")
        case DistanceFrom():
            x, y = _place(source, task, lookup)
            return math.hypot(_number(lookup, f"{robot}.{source.x}") - x, _number(lookup, f"{robot}.{source.y}") - y)


def _place(source: DistanceFrom, task: TaskToDo, lookup: Lookup) -> tuple[float, float]:
    place = _named_place(source, task)
    if place is not None:
        return place
    if not task.failed:
        raise ValueUnknown("it is not known where the task is")
    return _number(lookup, f"{task.failed}.{source.x}"), _number(lookup, f"{task.failed}.{source.y}")


def _named_place(source: DistanceFrom, task: TaskToDo) -> tuple[float, float] | None:
    name = task.arguments.get(source.argument or "")
    return source.places.get(name) if isinstance(name, str) else None


def _number(lookup: Lookup, name: str) -> float:
    value = lookup(name)
    if isinstance(value, str):
        raise ValueUnknown(f"{name} is {value!r}, no number")
    return float(value)
