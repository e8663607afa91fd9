"""Who stands in for robots that have failed, as facts say it. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from ua_fleet.scenario.facts import Fact, Replaced, RobotReturned, StandInTold

__all__ = ["StandIns", "take_stand_in", "told_stand_ins"]

StandIns = dict[str, dict[str, str]]
"""Who does what a robot is to do, by the capacity that a task needs; for the empty one, all of its tasks."""


def take_stand_in(known: StandIns, fact: Fact) -> bool:
    """Take in a fact; whether it is about that."""
    match fact:
        case Replaced():
            capacities = tuple(fact.capacities) or ("",)
            if fact.failed == fact.robot:  # it was repaired before anybody had taken over
                _let_back(known, fact.failed, ("", *capacities))
            elif fact.lasting and fact.failed:
                known.setdefault(fact.failed, {}).update(dict.fromkeys(capacities, fact.robot))
        case RobotReturned():
            _let_back(known, fact.robot, (fact.capacity,))
        case StandInTold():
            known.setdefault(fact.failed, {})[fact.capacity] = fact.robot
        case _:
            return False
    return True


def told_stand_ins(known: Mapping[str, Mapping[str, str]], at: float) -> Iterator[StandInTold]:
    """What another part of the run is told of it."""
    for failed, by_capacity in known.items():
        for capacity, robot in by_capacity.items():
            yield StandInTold(at, failed, robot, capacity)


def _let_back(known: StandIns, robot: str, capacities: Iterable[str]) -> None:
    """Nobody stands in for a robot any more where these are needed."""
    by_capacity = known.get(robot, {})
    for capacity in capacities:
        by_capacity.pop(capacity, None)
    if not by_capacity:
        known.pop(robot, None)
