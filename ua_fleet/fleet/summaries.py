"""How robots stand in short, a hundred together, for lists of all of them: what has changed, and when it is due. Pure.

    put, remove -> the group of the robot has changed -> take_due, once its period is over -> one Variable is written

The first change of a group is due at once, the next ones together when the period since then is over, so that no change
is lost at the end. Robots keep the order in which they came, and one that comes later gets a place that is free. The
last group is empty: who watches all groups sees in it that there will be another one.
"""

from __future__ import annotations

from math import inf
from typing import Final, NamedTuple

from ua_fleet.fleet.model import GROUP_SIZE

__all__ = ["PERIOD_S", "Summaries", "SummaryRecord"]

PERIOD_S: Final = 1.0
"""Each group is written so often at most."""


class SummaryRecord(NamedTuple):
    """RobotSummaryDataType of the UaFleet nodeset, its fields in their order. Times are ticks of the wall clock."""

    name: str
    state: int
    """RobotStateEnumeration."""
    state_since: int
    """0: nobody has said so yet."""
    quality: int
    """StatusCode: the worst of the robot's values."""
    last_update: int
    """When data of the robot last reached the server; 0 before."""
    task: str
    """What it is at, for people; empty: nothing."""
    run_id: str
    """The run that has given it the task; empty: none."""
    held: bool
    held_by: str
    held_since: int
    """0: it is not held."""
    held_reason: str
    faults: int
    """How many are active."""
    fault: str
    """The most telling of them, for people."""
    bridge: str
    capacities: tuple[str, ...]


class Summaries:
    """The groups of one fleet. `now` is float seconds of any monotonic clock."""

    def __init__(self, period_s: float = PERIOD_S, group_size: int = GROUP_SIZE) -> None:
        self._period_s, self._group_size = period_s, group_size
        self._groups: list[dict[str, SummaryRecord]] = [{}]
        self._free_at: list[float] = [-inf]
        self._group_of: dict[str, int] = {}
        self._changed: dict[int, None] = {}
        self._next: float | None = None

    def __len__(self) -> int:
        """How many groups there are, the empty one at the end with them."""
        return len(self._groups)

    def put(self, summary: SummaryRecord) -> None:
        """A robot is there, and stands so."""
        number = self._group_of.get(summary.name)
        if number is None:
            number = next(one for one, group in enumerate(self._groups) if len(group) < self._group_size)
            self._group_of[summary.name] = number
            if number == len(self._groups) - 1:
                self._groups.append({})
                self._free_at.append(-inf)
        group = self._groups[number]
        if group.get(summary.name) != summary:
            group[summary.name] = summary
            self._mark(number)

    def remove(self, name: str) -> None:
        """A robot is gone, if it was there."""
        number = self._group_of.pop(name, None)
        if number is not None:
            del self._groups[number][name]
            self._mark(number)

    def group(self, number: int) -> tuple[SummaryRecord, ...]:
        """The robots of a group."""
        return tuple(self._groups[number].values())

    def take_due(self, now: float, most: int) -> list[int]:
        """Groups that have changed and may be written now, those that have waited longest first."""
        free_at = self._free_at
        due = sorted([number for number in self._changed if free_at[number] <= now], key=free_at.__getitem__)[:most]
        for number in due:
            del self._changed[number]
            free_at[number] = now + self._period_s
        self._next = min([free_at[number] for number in self._changed], default=None)
        return due

    def next_deadline(self) -> float | None:
        """When `take_due` is to be called next, or None."""
        return self._next

    def _mark(self, number: int) -> None:
        if number not in self._changed:
            self._changed[number] = None
            free_at = self._free_at[number]
            self._next = free_at if self._next is None else min(self._next, free_at)
