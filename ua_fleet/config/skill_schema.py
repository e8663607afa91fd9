"""Skills in `fleet.yaml`: what a robot does when it is asked, with typed arguments and limits."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from ua_fleet.config.base import RANGED, DataSetId, Model, Name, ScalarType
from ua_fleet.config.shapes import all_of, given, implies, limited_to
from ua_fleet.fleet.skills import ArgumentModel, SkillLimits, argument_problem

__all__ = ["ArgumentConfig", "SkillConfig", "SkillLimitsConfig"]

ArgumentName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")]


class ArgumentConfig(
    Model,
    frozen=True,
    json_schema_extra=all_of(
        {"not": limited_to("type", ScalarType.DATETIME, ScalarType.BYTE_STRING)},
        implies(given("range"), limited_to("type", *RANGED)),
    ),
):
    """One argument or result of a skill."""

    type: ScalarType
    """Built-in type; DateTime and ByteString are not for arguments."""
    unit: str | None = None
    """Engineering unit, e.g. `deg`; scenarios may give a value in another unit of the same kind."""
    range: tuple[float, float] | None = None
    """Least and greatest legal value; anything else is refused before the robot hears of it."""
    default: bool | int | float | str | None = None
    """Value where none is given; without it the argument has to be given."""
    description: str = ""
    """Text for people."""

    @model_validator(mode="after")
    def _check(self) -> ArgumentConfig:
        if self.type in (ScalarType.DATETIME, ScalarType.BYTE_STRING):
            raise ValueError(f"type: an argument is no {self.type.value}; write it as a String or a number")
        if self.range is not None:
            if self.range[0] >= self.range[1]:
                raise ValueError("range: the first value must be less than the second")
            if self.type in (ScalarType.BOOLEAN, ScalarType.STRING):
                raise ValueError(f"range: {self.type.value} has no range")
        if self.default is not None and (problem := argument_problem(self.model("default"), self.default)):
            raise ValueError(problem)
        return self

    def model(self, name: str) -> ArgumentModel:
        """The argument as the fleet knows it."""
        return ArgumentModel(name, int(self.type.builtin), self.unit, self.range, self.default, self.description)


class SkillLimitsConfig(Model, frozen=True):
    """What a skill takes at most; requests beyond are refused."""

    least_interval_s: float = Field(default=0.0, ge=0)
    """Least time between two requests."""
    largest_message_bytes: int = Field(default=65_507, ge=64)
    """Largest request."""
    requests_at_once: int = Field(default=1, ge=1)
    """Executions that may be under way."""
    most_requestors: int = Field(default=16, ge=1)
    """Different requestors at a time; one is forgotten a minute after its last request."""
    visible_to: tuple[Annotated[int, Field(ge=0, le=65535)], ...] | None = None
    """Spaces that see the skill and may request it; left out: all that may command the robot."""

    def model(self) -> SkillLimits:
        """The limits as the fleet knows them."""
        return SkillLimits(
            self.least_interval_s,
            self.largest_message_bytes,
            self.requests_at_once,
            self.most_requestors,
            self.visible_to,
        )


class SkillConfig(Model, frozen=True):
    """One skill of one robot."""

    id: DataSetId | None = None
    """Needed in the end: numeric id in the fleet's namespace, DataSetWriterId of its Action. `ua-fleet config
    assign-ids` fills it in."""
    description: str = ""
    """Text for people, the description of the node."""
    needs: tuple[Name, ...] = ()
    """Capacities that a robot needs for it; whoever has them and the skill may take over."""
    arguments: dict[ArgumentName, ArgumentConfig] = {}
    """Arguments by name, in their order."""
    results: dict[ArgumentName, ArgumentConfig] = {}
    """Results by name, in their order."""
    timeout_s: float = Field(default=60.0, gt=0)
    """An execution that takes longer is given up."""
    immediate: bool = False
    """Whether it is over at once, so that the answer to the request brings the results."""
    limits: SkillLimitsConfig = SkillLimitsConfig()
    """What it takes at most."""
    via: dict[str, Any] = {}
    """How the bridge has the robot do it, by the bridge's kind. Left out: the robot's program offers it by itself."""
