"""Faults that nobody has to tell the server of: a robot is silent, announces its own fault, or a condition holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import FleetModel, RobotModel, RobotState
from ua_fleet.orchestrator import Fault, FaultConditions, FaultFound, FaultRule
from ua_fleet.scenario import Lookup
from ua_fleet.scenario.consequences import ALARM, ANNOUNCED, BRIDGE_OFF, NOT_HALTED, RAISED, SILENT, SKILL
from ua_fleet.values import NodeId, Quality, quality_of

__all__ = ["ANNOUNCED", "SILENT", "FaultFinder"]

MOST_CHARACTERS: Final = 200
"""Of what a robot says of its fault."""
_OF_NO_CONDITION: Final = frozenset({ANNOUNCED, BRIDGE_OFF, NOT_HALTED, RAISED, SILENT, SKILL})
"""Sources of faults that have no condition in `fleet.yaml`; beside them those of alarms."""


class FaultFinder:
    """Each method returns what is new since the one before."""

    def __init__(
        self,
        model: FleetModel,
        rules: Iterable[FaultRule],
        named_first: Callable[[str, str], tuple[tuple[str, ...], str]],
    ) -> None:
        """Look after the robots of a model; none has been heard yet.

        Args:
            model: of the fleet.
            rules: conditions that are faults.
            named_first: the capacities that a robot's word of a fault begins with, and the rest of it.
        """
        self._named_first = named_first
        self._states: dict[NodeId, str] = {}
        self._fault_keys: dict[NodeId, str] = {}
        self._names: set[str] = set()
        self._heard: set[str] = set()
        self._fallen_silent: set[str] = set()
        self._announced: dict[str, str] = {}
        """What robots say now; not of those whose program is silent."""
        self._conditions = FaultConditions(tuple(rules))
        self._alarms: set[str] = set()
        """Faults that are active alarms, by their ids."""
        for robot in model.robots:
            self.add(robot)

    def add(self, robot: RobotModel) -> None:
        """Look after a robot too."""
        self._names.add(robot.name)
        self._states[robot.part("State")] = robot.name
        if robot.fault is not None:
            self._fault_keys[robot.fault.key] = robot.name

    def remove(self, robot: RobotModel) -> None:
        """Look after a robot no more."""
        self._names.discard(robot.name)
        self._heard.discard(robot.name)
        self._fallen_silent.discard(robot.name)
        self._announced.pop(robot.name, None)
        self._states.pop(robot.part("State"), None)
        if robot.fault is not None:
            self._fault_keys.pop(robot.fault.key, None)

    def forget(self, robot: str) -> None:
        """What conditions find of a robot that is gone is found anew when it comes again."""
        self._conditions.forget(robot)

    def heard(self, robot: str) -> None:
        """A robot was heard before it was looked after."""
        self._heard.add(robot)

    @property
    def has_conditions(self) -> bool:
        """Whether values of robots may be faults."""
        return bool(self._conditions.names)

    def restored(self, fault: Fault) -> None:
        """A fault of a run before the restart."""
        self._conditions.restored(fault.robot, fault.source)

    def has_lost_condition(self, fault: Fault) -> bool:
        """Whether a condition found a fault that is in `fleet.yaml` no more, or not for this robot: nothing would end
        the fault.
        """
        is_of_condition = fault.source not in _OF_NO_CONDITION and not fault.source.startswith(ALARM)
        return is_of_condition and not self._conditions.is_about(fault.robot, fault.source)

    def knows(self, change: ValueChanged) -> bool:
        """Whether a node is about faults alone, and no condition can be about it."""
        return change.key in self._states or change.key in self._fault_keys

    def changed(self, change: ValueChanged) -> list[FaultFound]:
        """A node that `knows` names has another value."""
        robot = self._states.get(change.key)
        if robot is not None:
            return self._state_changed(robot, change.value)
        return self._said(self._fault_keys[change.key], change)

    def _state_changed(self, robot: str, state: object) -> list[FaultFound]:
        was_heard = robot in self._heard
        if state != RobotState.OFFLINE:
            self._heard.add(robot)
            self._fallen_silent.discard(robot)
            return [FaultFound(robot, SILENT, False, "")]
        if not was_heard:
            return []
        self._heard.discard(robot)
        self._fallen_silent.add(robot)
        return [FaultFound(robot, SILENT, True, "it is silent")]

    def _said(self, robot: str, change: ValueChanged) -> list[FaultFound]:
        """What a robot has announced lasts until it says something else, also while it is silent."""
        if quality_of(change.status) is Quality.BAD or not isinstance(change.value, str):
            self._announced.pop(robot, None)
            return []
        reason = " ".join(change.value.split())[:MOST_CHARACTERS]
        self._announced[robot] = reason
        capacities, rest = self._named_first(robot, reason)
        return [FaultFound(robot, ANNOUNCED, bool(reason), rest or reason, capacities)]

    def not_heard(self) -> list[FaultFound]:
        """Robots that had time enough since the start."""
        never = sorted(self._names - self._heard - self._fallen_silent)
        return [FaultFound(robot, SILENT, True, "it is not heard") for robot in never]

    def check(self, lookup: Lookup) -> list[FaultFound]:
        """Values of robots have changed."""
        return self._conditions.check(lookup)

    def alarms_found(self, found: Iterable[FaultFound]) -> None:
        """Alarms of values that are faults have become active or inactive."""
        for one in found:
            (self._alarms.add if one.active else self._alarms.discard)(f"{one.robot}.{one.source}")

    def is_there(self, fault: Fault) -> bool:
        """Whether the cause of a fault is there as far as can be seen, so that nobody can say that it is over."""
        if fault.source == SILENT:
            return fault.robot not in self._heard
        if fault.source == ANNOUNCED:
            return bool(self._announced.get(fault.robot))
        return fault.id in self._alarms or self._conditions.is_active(fault.robot, fault.source)
