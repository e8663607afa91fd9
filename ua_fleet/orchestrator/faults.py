"""Faults of robots, as alarms have them: active while the cause is there, acknowledged when an operator has seen it.

    normal --raised--> active, not acknowledged --acknowledged--> active, acknowledged
    active --cleared--> inactive; forgotten once it is acknowledged too
    inactive, not acknowledged --raised--> active, not acknowledged

A robot may have several at once, one for each source (what found it). It can work when none is active.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum, auto

from ua_fleet.errors import ScenarioError

__all__ = ["Fault", "FaultChange", "Faults"]


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

    def __iter__(self) -> Iterator[Fault]:
        return iter(self._faults.values())

    def get(self, fault_id: str) -> Fault:
        """A fault by its id; raises ScenarioError where there is none."""
        fault = self._faults.get(fault_id)
        if fault is None:
            raise ScenarioError(f"there is no fault {fault_id!r}")
        return fault

    def active(self, robot: str) -> list[Fault]:
        """What keeps a robot from working, the first first."""
        return [fault for fault in self._faults.values() if fault.robot == robot and fault.active]

    def unfit(self) -> dict[str, str]:
        """The robots that cannot work now, with the reason."""
        unfit: dict[str, str] = {}
        for fault in self._faults.values():
            if fault.active:
                unfit.setdefault(fault.robot, f"has a fault: {fault.reason}")
        return unfit

    def raise_fault(self, robot: str, source: str, reason: str, now: float) -> tuple[Fault, FaultChange] | None:
        """A fault was found; None where it is known already."""
        fault_id = f"{robot}.{source}"
        before = self._faults.get(fault_id)
        if before is not None and before.active:
            if before.reason == reason:
                return None
            fault = self._faults[fault_id] = replace(before, reason=reason)
            return fault, FaultChange.REASON_CHANGED
        fault = self._faults[fault_id] = Fault(fault_id, robot, source, reason, True, False, now)
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

    def _keep(self, fault: Fault) -> None:
        if fault.active or not fault.acknowledged:
            self._faults[fault.id] = fault
        else:
            del self._faults[fault.id]
