"""One field of a data source in `fleet.yaml`."""

from __future__ import annotations

from typing import Final

from pydantic import model_validator

from ua_fleet.config.alarm_schema import LimitsConfig, NormalConfig, limits_problem
from ua_fleet.config.base import RANGED, FieldPath, Model, ScalarType
from ua_fleet.config.shapes import given, implies, limited_to

__all__ = ["OF_FIELDS", "FieldConfig"]

OF_FIELDS: Final = ("array", "unit", "range", "path", "initial", "limits", "normal")
"""What a data source of a single field has itself."""


class FieldConfig(Model, frozen=True, json_schema_extra=implies(given("range"), limited_to("type", *RANGED))):
    """One field of a DataSet."""

    type: ScalarType
    """Built-in type of the field, or of its elements."""
    array: bool = False
    """Whether the field is an array of `type`."""
    unit: str | None = None
    """Engineering unit as shown to users, e.g. `m/s` or `%`."""
    range: tuple[float, float] | None = None
    """Least and greatest legal value; a value outside is refused (client) or shown as Uncertain (robot)."""
    path: FieldPath | None = None
    """Where the field stands in the robot's own message, e.g. `twist.linear.x`; the field's name if left out."""
    initial: bool | int | float | str | None = None
    """First value of a node that clients write. Without it the node waits for its first value."""
    limits: LimitsConfig | None = None
    """Limits of a number beyond which it is an alarm."""
    normal: bool | NormalConfig | None = None
    """The normal value of a Boolean: the other one is an alarm."""

    @model_validator(mode="after")
    def _check(self) -> FieldConfig:
        if self.range is not None:
            if self.range[0] >= self.range[1]:
                raise ValueError("range: the first value must be less than the second")
            if self.type not in RANGED:
                raise ValueError(f"range: {self.type.value} has no range")
        if self.limits is not None:
            if self.type not in RANGED or self.array:
                raise ValueError(f"limits: {'an array' if self.array else self.type.value} has no limits")
            if problem := limits_problem(self.limits, self.range):
                raise ValueError(f"limits: {problem}")
        if self.normal is not None and (self.type is not ScalarType.BOOLEAN or self.array):
            raise ValueError("normal: it is for a single Boolean; numbers have `limits`")
        return self

    @property
    def has_alarm(self) -> bool:
        """Whether some of its values are an alarm."""
        return self.limits is not None or self.normal is not None
