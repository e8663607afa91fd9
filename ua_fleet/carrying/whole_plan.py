"""A plan made again of all its parts, as they were written down when the run began: see `part`. Pure.

So it does not depend on what fleet.yaml says now: a bridge may have left it, with its robots.
"""

from __future__ import annotations

from collections.abc import Mapping

from ua_fleet.carrying.part import Part, PartInvalid, PartSegment, Road
from ua_fleet.carrying.plan import Edge, Plan, Segment

__all__ = ["plan_of"]


def plan_of(parts: Mapping[int, Part]) -> Plan:
    """The plan of which these are all parts, by their spaces; raises PartInvalid where they are not all of one."""
    there = {number: (space, one) for space, part in parts.items() for number, one in part.segments.items()}
    last = [number for number, (_, one) in there.items() if one.fails is None and not one.tells]
    if there.keys() != set(range(len(there))) or len(last) != 1:
        raise PartInvalid("these are not all parts of one plan")
    segments = [_segment_in(*there[number]) for number in range(len(there))]
    return Plan(tuple(segments), last[0], next(iter(parts.values())).lease_s)


def _segment_in(space: int, one: PartSegment) -> Segment:
    return Segment(
        space,
        one.slots,
        list(one.body.steps),
        [_edge(road) for road in one.then],
        [_edge(road) for road in one.otherwise],
        None if one.fails is None else _edge(one.fails),
        [_edge(road) for road in one.lost],
        list(one.needs),
        one.loops,
        list(one.hears),
        one.tells,
    )


def _edge(road: Road) -> Edge:
    return Edge(road.segment, road.slot, road.is_next)
