"""Values of robots by the names that conditions and criteria use: `ur3.battery`, `rover.pose.x`, and without the robot
where only one has such a value.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.scenario import FleetView, RobotView, Value, ValueUnknown
from ua_fleet.topics import Topic
from ua_fleet.values import NodeId, StatusCode, status_name

__all__ = ["FleetValues", "fleet_view", "own_fields"]

_BAD = 0x8000_0000


class FleetValues:
    """The latest value of everything in a fleet that a condition can be about."""

    def __init__(self, model: FleetModel) -> None:
        self._full: dict[NodeId, str] = {}
        self._values: dict[str, Value] = {}
        self._status: dict[str, int] = {}
        self._own: dict[str, str] = {}
        """Each name without its robot."""
        self._short: dict[str, str] = {}
        self.meanings: Counter[str] = Counter()
        """Names with the number of values that each may mean."""
        for robot in model.robots:
            self._take_in(robot)
        self._count()

    def add(self, robot: RobotModel) -> None:
        """A robot has come."""
        self._take_in(robot)
        self._count()

    def remove(self, robot: RobotModel) -> None:
        """A robot is gone."""
        for data_set in robot.data_sets:
            for field in data_set.fields:
                full = self._full.pop(field.key)
                for known in (self._own, self._status, self._values):
                    known.pop(full, None)
        self._count()

    def _take_in(self, robot: RobotModel) -> None:
        for data_set in robot.data_sets:
            for field in data_set.fields:
                own = data_set.name if data_set.is_single else f"{data_set.name}.{field.name}"
                full = self._full[field.key] = f"{robot.name}.{own}"
                self._own[full] = own
                self._status[full] = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
                if field.initial is not None:
                    self._values[full], self._status[full] = field.initial, 0

    def _count(self) -> None:
        """Find out what each name means now."""
        short: dict[str, list[str]] = {}
        for full, own in self._own.items():
            short.setdefault(own, []).append(full)
        self.meanings = Counter(self._full.values())
        self._short = {}
        for own, fulls in short.items():
            if own not in self.meanings:
                self.meanings[own] = len(fulls)
                if len(fulls) == 1:
                    self._short[own] = fulls[0]

    def take(self, key: NodeId, value: object, status: int) -> bool:
        """A node has another value; whether that is one that a condition can be about."""
        name = self._full.get(key)
        if name is None:
            return False
        self._status[name] = status
        if isinstance(value, bool | int | float | str):
            self._values[name] = value
        else:
            self._values.pop(name, None)
        return True

    def change(self, change: ValueChanged) -> bool:
        """See `take`."""
        return self.take(change.key, change.value, change.status)

    def look_up(self, name: str) -> Value:
        """The value of a name now.

        Raises:
            ValueUnknown: there is no such value, or it is not known now.
        """
        full = self._short.get(name, name)
        status = self._status.get(full)
        if status is None:
            raise ValueUnknown(f"there is no value {name!r}")
        value = self._values.get(full)
        if status & _BAD or value is None:
            reason = status_name(status) if status & _BAD else "no number, text or truth value"
            raise ValueUnknown(f"{name} is not known now ({reason})")
        return value


def fleet_view(robots: Iterable[RobotModel], meanings: Mapping[str, int]) -> FleetView:
    """What scenarios are held against."""
    views = {
        robot.name: RobotView(robot.name, frozenset(robot.capacities), {skill.name: skill for skill in robot.skills})
        for robot in robots
    }
    return FleetView(views, meanings)


def own_fields(robots: Iterable[RobotModel]) -> dict[Topic, tuple[NodeId, ...]]:
    """The fields of the data that clients write."""
    return {
        data_set.topic: tuple([field.key for field in data_set.fields])
        for robot in robots
        for data_set in robot.data_sets
        if data_set.writable
    }
