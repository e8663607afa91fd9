"""Resilience in `fleet.yaml`: who takes over when a robot fails."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from ua_fleet.config.base import FieldPath, Model, Name
from ua_fleet.config.shapes import exactly_one
from ua_fleet.orchestrator import CriterionSource, DistanceFrom, FaultRule, ResilienceSettings, TasksAhead, ValueOf
from ua_fleet.resilience import Criterion, CriterionKind, DecisionMode, Missing, OnLimit, Synthesis
from ua_fleet.scenario import parse_expression
from ua_fleet.scenario.expression import ExpressionInvalid

__all__ = ["RESERVED_SOURCES", "CriterionConfig", "DistanceConfig", "FaultConditionConfig", "ResilienceConfig"]

LONGEST_LIMIT_S: Final = 2e11
"""A deadline is told to people as a time, and the last one of those is at the end of the year 9999."""
RESERVED_SOURCES: Final = frozenset({"announced", "not_halted", "robot", "silent", "skill"})
"""What else finds faults."""


class DistanceConfig(Model, frozen=True):
    """How far a robot is from where the task is."""

    x: FieldPath
    """A robot's value, e.g. `pose.x`."""
    y: FieldPath
    """Likewise."""
    argument: str | None = None
    """Argument of the task that names a place. For any other the task is where the robot failed."""
    places: dict[str, tuple[float, float]] = {}
    """Places by name."""


class CriterionConfig(
    Model, frozen=True, json_schema_extra=exactly_one("value", "distance", "tasks_ahead", empty=(False,))
):
    """One criterion. Its raw value is one of `value`, `distance` and `tasks_ahead`."""

    kind: Literal["benefit", "cost"]
    """`benefit`: more is better. `cost`: less is better."""
    range: tuple[float, float]
    """Least and greatest value to be expected; a cost below 1 % of it counts as 1 %. A value that is more than 1,000
    times as great as its greater end counts as not known."""
    unit: str = ""
    """Unit as shown to people. Left out: that of the values that it is made of, if all of them have the same."""
    value: FieldPath | None = None
    """A robot's value, e.g. `battery.percentage`."""
    distance: DistanceConfig | None = None
    """The distance between two points."""
    tasks_ahead: bool = False
    """Availability: 100, and less with each task that the robot has ahead."""
    missing: Literal["worst", "neutral", "exclude"] = "worst"
    """What it means that a robot's value is not known. `worst`: it counts as the worst end of the range. `neutral`: it
    counts neither for the robot nor against it. `exclude`: the robot gives way to those whose values are known."""
    capacities: tuple[Name, ...] = ()
    """The criterion counts for tasks that need one of these capacities. Neither this nor `skills`: for all tasks."""
    skills: tuple[Name, ...] = ()
    """It counts for tasks of these skills."""

    @model_validator(mode="after")
    def _check(self) -> CriterionConfig:
        if sum((self.value is not None, self.distance is not None, self.tasks_ahead)) != 1:
            raise ValueError("give exactly one of `value`, `distance` and `tasks_ahead: true`")
        if self.range[0] >= self.range[1]:
            raise ValueError("range: the first value must be less than the second")
        if max(map(abs, self.range)) > 1e100 or self.range[1] - self.range[0] < 1e-100:
            raise ValueError("range: from -1e100 to 1e100, and at least 1e-100 wide")
        return self

    def criterion(self, name: str) -> Criterion:
        """By what robots are compared."""
        missing = Missing(self.missing)
        kind = CriterionKind(self.kind)
        return Criterion(name, kind, self.range, self.unit, missing, self.capacities, self.skills)

    def source(self) -> CriterionSource:
        """Where the raw value comes from."""
        if self.value is not None:
            return ValueOf(self.value)
        if self.distance is not None:
            return DistanceFrom(self.distance.x, self.distance.y, self.distance.argument, self.distance.places)
        return TasksAhead()


class FaultConditionConfig(Model, frozen=True):
    """A fault that is found by a condition on values of a robot."""

    robots: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Robots that may have it."""
    when: str
    """The fault is there when this is true, e.g. `battery < 20`; names are the robot's own values, or with a
    robot's name before them that one's."""
    until: str | None = None
    """It is over when this is true; left out: when `when` is false."""
    reason: str = ""
    """What people read; the condition itself if left out."""
    capacities: tuple[Name, ...] = ()
    """What the fault takes away: tasks that need none of these go on. Left out: all."""

    @model_validator(mode="after")
    def _check(self) -> FaultConditionConfig:
        try:
            self.rule("")
        except ExpressionInvalid as error:
            raise ValueError(str(error)) from None
        return self

    def rule(self, name: str) -> FaultRule:
        """The rule that the orchestrator goes by."""
        until = None if self.until is None else parse_expression(self.until)
        return FaultRule(name, self.robots, parse_expression(self.when), until, self.reason, self.capacities)


class ModeName(StrEnum):
    """Who chooses a replacement."""

    OPERATOR = "operator"
    AUTOMATIC = "automatic"
    ABORT = "abort"


class ResilienceConfig(Model, frozen=True):
    """Who takes over when a robot fails: the Analytic Hierarchy Process over criteria of your choice."""

    mode: ModeName = ModeName.OPERATOR
    """`operator`: a person chooses. `automatic`: the best candidate. `abort`: nobody takes over."""
    limit_s: float = Field(default=60.0, gt=0, le=LONGEST_LIMIT_S, allow_inf_nan=False)
    """How long an operator may think."""
    on_limit: Literal["best_if_known", "best", "abort"] = "best_if_known"
    """What happens then. `best_if_known`: the best candidate is taken, but where nobody knows whether the first robot
    is still at it the task fails. `best`: the best candidate in any case, beside the first one if need be. `abort`: the
    task fails."""
    silence_s: float = Field(default=30.0, ge=0)
    """How long a silent robot is waited for, from the server's start at the earliest; then nobody knows what it is at,
    and another one is looked for where it had begun nothing."""
    return_s: float = Field(default=300.0, ge=0)
    """How long a silent robot is waited for that may be at a task with `on_unknown: retry`; then a decision asks."""
    synthesis: Literal["distributive", "ideal"] = "distributive"
    """`ideal`: a further candidate who is nowhere the best changes no order."""
    criteria: Annotated[dict[Name, CriterionConfig], Field(min_length=1)] = {
        "availability": CriterionConfig(kind="benefit", range=(0, 100), tasks_ahead=True)
    }
    """Criteria by name, at most 15."""
    judgements: dict[Name, dict[Name, Annotated[float, Field(gt=0)]]] = {}
    """How many times more important one criterion is than another: `{battery: {distance: 2}}`. Each pair once."""

    faults: dict[Name, FaultConditionConfig] = {}
    """Faults that are found by conditions, by name."""

    def rules(self) -> tuple[FaultRule, ...]:
        """The conditions that are faults."""
        return tuple(fault.rule(name) for name, fault in self.faults.items())

    def settings(self) -> ResilienceSettings:
        """What the orchestrator goes by; raises JudgementsInvalid, never for a file that was loaded."""
        criteria = tuple((config.criterion(name), config.source()) for name, config in self.criteria.items())
        judgements = {(one, other): value for one, row in self.judgements.items() for other, value in row.items()}
        return ResilienceSettings(
            criteria,
            judgements,
            synthesis=Synthesis(self.synthesis),
            mode=DecisionMode(self.mode.value),
            limit_s=self.limit_s,
            on_limit=OnLimit(self.on_limit),
            silence_s=self.silence_s,
            return_s=self.return_s,
        )
