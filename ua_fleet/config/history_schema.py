"""`history` in `fleet.yaml`: what is kept of values, and for how long."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from ua_fleet.config.base import Model

__all__ = ["HistoryConfig", "ValueHistoryConfig"]

Seconds = Annotated[float, Field(ge=0, le=1e7, allow_inf_nan=False)]
Deadband = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Days = Annotated[float, Field(gt=0, le=36_500, allow_inf_nan=False)]
MEGABYTE: Final = 1_000_000


class ValueHistoryConfig(Model, frozen=True):
    """What is kept of the values of a robot or of one data source, where that differs from what is said above it."""

    deadband: Deadband | None = None
    """A number is kept when it differs from the one kept last by more than this; in the unit of the value. It is for
    numbers alone."""
    at_most_each_s: Seconds | None = None
    """Seconds from one kept value to the next at least. The last value always arrives, and changes of quality do not
    wait."""
    at_least_each_s: Seconds | None = None
    """A value that arrives so long after the kept one is kept even though it is the same; 0: never."""
    days: Days | None = None
    """For how long values are kept."""


class HistoryConfig(Model, frozen=True):
    """The history of values, which the server keeps in `history.db` in its `state_dir`; see docs/history.md."""

    record: bool = True
    """Keep the values of all robots. `false`: of those robots and data sources alone that have a `history` of their
    own."""
    megabytes: float = Field(default=1000, ge=10, le=1e7, allow_inf_nan=False)
    """What the file takes at most; the oldest values give way."""
    days: Days = 30
    """For how long values are kept."""
    deadband: Deadband = 0
    """As of a robot; 0: each change is kept."""
    at_most_each_s: Seconds = 0
    """As of a robot; 0: no limit."""
    at_least_each_s: Seconds = 60
    """As of a robot."""
