"""How the robots stand in short, a hundred in a Variable: `Fleet/Summaries/1`, `2` and so on; see `fleet.summaries`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from ua_fleet.endpoint.convert import data_value
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.members import RobotLiveness
from ua_fleet.fleet.model import RobotState
from ua_fleet.fleet.state import FleetState
from ua_fleet.fleet.summaries import Summaries, SummaryRecord
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.nodes.scenario_nodes import ticks_of
from ua_fleet.operation.runs.activity import RobotActivities
from ua_fleet.values import ARRAY, BuiltinType, ExtensionObject, NodeId
from ua_fleet.wire.structure import BOOLEAN, ENUMERATION, STATUS_CODE, STRING, TIME, UINT32, array, structure

__all__ = ["SUMMARIES", "SUMMARY_SHAPE", "SummaryNodes"]

SUMMARIES: Final = "Fleet.Summaries"
SUMMARY_SHAPE: Final = structure(
    SummaryRecord,
    *(STRING, ENUMERATION, TIME, STATUS_CODE, TIME, STRING, STRING),
    *(BOOLEAN, STRING, TIME, STRING),
    *(UINT32, STRING, STRING, array(STRING)),
)
"""The binary encoding of RobotSummaryDataType."""
MOST_TEXT: Final = 200
"""Characters of a text."""
MOST_CAPACITIES: Final = 50
"""Of a robot: a definition of 64 KiB may name thousands."""
ROBOTS_AT_ONCE: Final = 500
GROUPS_AT_ONCE: Final = 5
"""What is done in one turn: some 5 ms of work either way."""
_STRUCTURES: Final = int(BuiltinType.EXTENSION_OBJECT | ARRAY)
_ENCODING: Final = NodeId(TYPES_INDEX, TypeId.ROBOT_SUMMARY_BINARY.value)


class SummaryNodes:
    """Keeps these nodes true. A part of the core's timetable."""

    def __init__(
        self,
        parts: NodeFactory,
        state: FleetState,
        activities: RobotActivities,
        put: Callable[[ValueChanged], None],
        wall_ticks: Callable[[], int],
        mistakes: Mistakes,
        told: Callable[[SummaryRecord], None] | None = None,
    ) -> None:
        """Prepare to make the nodes.

        Args:
            parts: of the fleet whose Object is there; its values are those that `put` writes to.
            state: of the fleet.
            activities: of its robots.
            put: has a value written.
            wall_ticks: the wall clock.
            mistakes: counts what has cost a robot its summary.
            told: gets the summary of each robot of which something may have changed.
        """
        self._told = told
        self._parts, self._state, self._activities = parts, state, activities
        self._put, self._wall_ticks, self._mistakes = put, wall_ticks, mistakes
        self._summaries = Summaries()
        self._encoded: dict[str, tuple[SummaryRecord, ExtensionObject]] = {}
        self._made = 0

    def build(self) -> None:
        """Make the nodes, with the robots that are there."""
        self._parts.folder(SUMMARIES, "Summaries", self._parts.id("Fleet"))
        self._look_at(self._state.moved.take(len(self._state.robots)))
        self._make_nodes()

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next, or None."""
        if self._state.moved or self._activities.moved:
            return now
        return self._summaries.next_deadline()

    def poll(self, now: float) -> None:
        """Take in what has changed; when all of it is taken in, write what is due. A part of either at a time."""
        for moved in (self._activities.moved, self._state.moved):
            self._look_at(moved.take(ROBOTS_AT_ONCE))
        if self._state.moved or self._activities.moved:
            return
        self._make_nodes()
        for number in self._summaries.take_due(now, GROUPS_AT_ONCE):
            value = self._value(number)
            self._put(ValueChanged(self._key(number), _STRUCTURES, value, 0, self._wall_ticks(), can_wait=True))

    def _look_at(self, names: Iterable[str]) -> None:
        for name in names:
            try:
                self._look_at_one(name)
            except Exception as error:  # noqa: BLE001 - the other robots are shown all the same
                self._forget(name)  # what was said of it last may be good no more
                self._mistakes.caught("summaries", error, robot=name)

    def _look_at_one(self, name: str) -> None:
        robot = self._state.robot_status(name)
        if robot is None:
            self._forget(name)
            return
        summary = self._summary(robot)
        if self._told is not None:
            self._told(summary)
        known = self._encoded.get(name)
        if known is None or known[0] != summary:
            body = bytearray()
            SUMMARY_SHAPE.encode(body, summary)
            self._encoded[name] = summary, ExtensionObject(_ENCODING, bytes(body))
            self._summaries.put(summary)

    def _forget(self, name: str) -> None:
        self._summaries.remove(name)
        self._encoded.pop(name, None)

    def _summary(self, robot: RobotLiveness) -> SummaryRecord:
        model = robot.model
        activity = self._activities.of(model.name)
        hold = activity.hold
        return SummaryRecord(
            model.name,
            RobotState.OFFLINE if robot.shown is None else robot.shown,
            robot.shown_since or 0,
            self._state.quality(robot),
            robot.told_update or 0,
            ", ".join(activity.tasks or robot.skills or ((robot.driven_by,) if robot.driven_by else ()))[:MOST_TEXT],
            activity.run_id,
            hold is not None,
            "" if hold is None else hold.by[:MOST_TEXT],
            0 if hold is None else ticks_of(hold.since),
            "" if hold is None else hold.reason[:MOST_TEXT],
            activity.faults,
            activity.fault[:MOST_TEXT],
            model.bridge,
            self._state.capacities.of(model.name)[:MOST_CAPACITIES],
        )

    def _key(self, number: int) -> NodeId:
        return NodeId(self._parts.ns, f"{SUMMARIES}.{number + 1}")

    def _make_nodes(self) -> None:
        """Make the nodes of groups that are new."""
        parts = self._parts
        for number in range(self._made, len(self._summaries)):
            now = parts.now
            value = data_value(_STRUCTURES, self._value(number), 0, now, now)
            data_type = parts.types[TypeId.ROBOT_SUMMARY]
            parts.variable(
                self._key(number), str(number + 1), parts.id(SUMMARIES), data_type, value, own_name=True, is_array=True
            )
        self._made = len(self._summaries)

    def _value(self, number: int) -> tuple[ExtensionObject, ...]:
        return tuple([self._encoded[summary.name][1] for summary in self._summaries.group(number)])
