"""Faults of robots, as alarms have them: active while the cause is there, acknowledged when an operator has seen it.

    normal --raised--> active, not acknowledged --acknowledged--> active, acknowledged
    active --cleared--> inactive; forgotten once it is acknowledged too
    inactive, not acknowledged --raised--> active, not acknowledged

A robot may have several at once, one for each source (what found it). Each takes away the capacities that it names, or
all: a task can be done when no active fault takes one that it needs. Silence takes none (`scenario.consequences`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Final

from ua_fleet.errors import ScenarioError
from ua_fleet.printing import utc_text
from ua_fleet.scenario.consequences import ANNOUNCED, NOT_HALTED, RAISED, SKILL, meaning_of

__all__ = ["BY_PERSON", "Fault", "FaultChange", "Faults"]


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of one robot."""

    id: str
    robot: str
    source: str
    """What found it: `announced`, `robot`, `silent`, `skill`, or the name of a condition."""
    reason: str
    active: bool
    acknowledged: bool
    since: float
    acknowledged_by: str = ""
    capacities: tuple[str, ...] = ()
    """Those that it takes away; empty: all."""

    def takes(self, needs: Collection[str]) -> bool:
        """Whether it keeps its robot from what needs these capacities."""
        if not self.active or not meaning_of(self.source).keeps_from_work:
            return False
        return not self.capacities or any(capacity in needs for capacity in self.capacities)

    @property
    def cure(self) -> str:
        """What ends it, for people: the command, where it takes a person."""
        if self.source == ANNOUNCED:
            return f"it ends when {self.robot} says that it is repaired"
        if self.source in BY_PERSON:
            return f"{BY_PERSON[self.source]}, run: ua-fleet fault clear {self.id}"
        return "it ends by itself, with what was found"

    @property
    def told(self) -> str:
        """Who has it since when, what it is, and what ends it, in one line for people."""
        what = f"lacks {', '.join(self.capacities)}" if self.capacities else "has a fault"
        return f"{self.robot} {what}: {self.reason} ({self.id}, since {utc_text(self.since)}); {self.cure}"


BY_PERSON: Final = {
    NOT_HALTED: "when it was seen to stand",
    RAISED: "when it can work again",
    SKILL: "when it can work again",
}
"""Sources of faults that a person ends, and when."""
_ADDING: Final = (RAISED, SKILL)
"""Sources of which each word is about something more; the others tell all that is wrong each time."""
_MOST_REASON: Final = 200


class FaultChange(Enum):
    """What happened to a fault."""

    RAISED = auto()
    REASON_CHANGED = auto()
    CLEARED = auto()
    ACKNOWLEDGED = auto()


class Faults:
    """The faults of a fleet."""

    def __init__(self) -> None:
        self._faults: dict[str, Fault] = {}
        self._of_robot: dict[str, dict[str, Fault]] = {}
        """The same by robot: a thousand robots may have one each."""

    def __iter__(self) -> Iterator[Fault]:
        return iter(self._faults.values())

    def get(self, fault_id: str) -> Fault:
        """A fault by its id; raises ScenarioError where there is none."""
        fault = self._faults.get(fault_id)
        if fault is None:
            raise ScenarioError(f"there is no fault {fault_id!r}")
        return fault

    def active(self, robot: str) -> list[Fault]:
        """What is wrong with a robot, the first first."""
        return [fault for fault in self._of(robot) if fault.active]

    def keeping(self, robot: str, needs: Collection[str]) -> list[Fault]:
        """Those that keep a robot from what needs these capacities."""
        return [fault for fault in self._of(robot) if fault.takes(needs)]

    def unfit(self, robot: str, needs: Collection[str]) -> str | None:
        """Why a robot cannot do now what needs these capacities; None where it can."""
        faults = self.keeping(robot, needs)
        if not faults:
            return None
        worst = next((fault for fault in faults if not fault.capacities), faults[0])
        if not worst.capacities:
            return f"has a fault: {worst.reason}"
        lacks = [capacity for capacity in worst.capacities if capacity in needs]
        return f"lacks {', '.join(lacks)}: {worst.reason}"

    def raise_fault(
        self, robot: str, source: str, reason: str, now: float, capacities: tuple[str, ...] = ()
    ) -> tuple[Fault, FaultChange] | None:
        """A fault was found that takes capacities away, or all; None where it is known already."""
        fault_id = f"{robot}.{source}"
        before = self._faults.get(fault_id)
        if before is not None and before.active:
            if source in _ADDING and before.capacities != capacities:
                reason = before.reason if reason in before.reason else f"{before.reason}; {reason}"[:_MOST_REASON]
                both = before.capacities and capacities
                capacities = tuple(dict.fromkeys((*before.capacities, *capacities))) if both else ()
            if (before.reason, before.capacities) == (reason, capacities):
                return None
            fault = replace(before, reason=reason, capacities=capacities)
            self._keep(fault)
            return fault, FaultChange.REASON_CHANGED
        fault = Fault(fault_id, robot, source, reason, True, False, now, capacities=capacities)
        self._keep(fault)
        return fault, FaultChange.RAISED

    def clear(self, robot: str, source: str) -> tuple[Fault, FaultChange] | None:
        """Its cause is gone; None where there was none."""
        fault_id = f"{robot}.{source}"
        before = self._faults.get(fault_id)
        if before is None or not before.active:
            return None
        fault = replace(before, active=False)
        self._keep(fault)
        return fault, FaultChange.CLEARED

    def acknowledge(self, fault_id: str, by: str) -> tuple[Fault, FaultChange]:
        """An operator has seen it.

        Raises:
            ScenarioError: there is no such fault, or it was acknowledged before, with by whom.
        """
        before = self.get(fault_id)
        if before.acknowledged:
            raise ScenarioError(f"{fault_id} was acknowledged by {before.acknowledged_by} before")
        fault = replace(before, acknowledged=True, acknowledged_by=by)
        self._keep(fault)
        return fault, FaultChange.ACKNOWLEDGED

    def _of(self, robot: str) -> Iterable[Fault]:
        return self._of_robot.get(robot, {}).values()

    def _keep(self, fault: Fault) -> None:
        of_robot = self._of_robot.setdefault(fault.robot, {})
        if fault.active or not fault.acknowledged:
            self._faults[fault.id] = of_robot[fault.id] = fault
            return
        del self._faults[fault.id], of_robot[fault.id]
        if not of_robot:
            del self._of_robot[fault.robot]
