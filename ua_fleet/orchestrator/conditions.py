"""Faults that are found: conditions on robots' values, e.g. `battery < 20`.

A name in a condition is a value of the robot itself: `battery` is `<robot>.battery`. With a robot's name before it, it
is that robot's, e.g. of a cell with sensors. While a value is not known, nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ua_fleet.scenario import Expression, Lookup, Value, ValueUnknown

__all__ = ["FaultConditions", "FaultFound", "FaultRule"]


@dataclass(frozen=True, slots=True)
class FaultRule:
    """One condition that is a fault of a robot."""

    name: str
    robots: tuple[str, ...]
    when: Expression
    """True: the fault is there."""
    until: Expression | None = None
    """True: it is over. None: when `when` is false."""
    reason: str = ""
    capacities: tuple[str, ...] = ()
    """What it takes away; empty: all."""


@dataclass(frozen=True, slots=True)
class FaultFound:
    """A condition has come true, or is over."""

    robot: str
    source: str
    active: bool
    reason: str
    capacities: tuple[str, ...] = ()
    """What it takes away; empty: all."""


class FaultConditions:
    """Watches conditions; `check` whenever values have changed."""

    def __init__(self, rules: Sequence[FaultRule]) -> None:
        self._rules = tuple(rules)
        self.names = frozenset([rule.name for rule in self._rules])
        """The sources of all faults that conditions find."""
        self._active: set[tuple[str, str]] = set()

    def restored(self, robot: str, source: str) -> None:
        """A fault of a run before is active still, and a rule can end it."""
        if self.is_about(robot, source):
            self._active.add((robot, source))

    def forget(self, robot: str) -> None:
        """A robot is gone: what is true when it comes again is found anew."""
        self._active = {key for key in self._active if key[0] != robot}

    def is_about(self, robot: str, source: str) -> bool:
        """Whether a rule finds such a fault of a robot, and its end."""
        return any(rule.name == source and robot in rule.robots for rule in self._rules)

    def is_active(self, robot: str, source: str) -> bool:
        """Whether a condition was true when it was looked at last."""
        return (robot, source) in self._active

    def check(self, lookup: Lookup) -> list[FaultFound]:
        """What has changed."""
        found: list[FaultFound] = []
        for rule in self._rules:
            for robot in rule.robots:
                key = robot, rule.name
                is_active = key in self._active
                now_active = _holds(rule, robot, lookup, was_active=is_active)
                if now_active == is_active:
                    continue
                if now_active:
                    self._active.add(key)
                else:
                    self._active.discard(key)
                reason = rule.reason or rule.when.text
                found.append(FaultFound(robot, rule.name, now_active, reason, rule.capacities))
        return found


def _holds(rule: FaultRule, robot: str, lookup: Lookup, *, was_active: bool) -> bool:
    def of_robot(name: str) -> Value:
        try:
            return lookup(f"{robot}.{name}")
        except ValueUnknown:
            if "." in name:
                return lookup(name)
            raise

    try:
        if was_active and rule.until is not None:
            return not rule.until.holds(of_robot)
        return rule.when.holds(of_robot)
    except ValueUnknown:
        return was_active
