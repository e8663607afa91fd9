"""Values of robots by the names that conditions and criteria use: `ur3.battery`, `rover.pose.x`, and without the robot
where only one has such a value.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import cast

from ua_fleet.fleet.capacities import Capacities
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import DataSetModel, FieldModel, FleetModel, RobotModel
from ua_fleet.scenario import FleetView, RobotView, Value, ValueUnknown, split_index
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, NodeId, StatusCode, status_name

__all__ = ["FleetValues", "fleet_view", "names_of", "own_fields"]

_BAD = 0x8000_0000
_LAST_USABLE = int(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE)


class FleetValues:
    """The latest value of everything in a fleet that a condition can be about."""

    def __init__(self, model: FleetModel) -> None:
        self._full: dict[NodeId, str] = {}
        self._values: dict[str, object] = {}
        self._status: dict[str, int] = {}
        self._own: dict[str, str] = {}
        """Each name without its robot."""
        self._short: dict[str, str] = {}
        self.meanings: Counter[str] = Counter()
        """Names with the number of values that each may mean."""
        self._demanding = {bridge.name for bridge in model.bridges if bridge.reads_on_demand}
        self._on_demand: set[str] = set()
        """Values that are read only while somebody needs them."""
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
                self._on_demand.discard(full)
                for known in (self._own, self._status, self._values):
                    known.pop(full, None)
        self._count()

    def keys_of(self, names: Collection[str]) -> set[NodeId]:
        """The nodes that names mean, as `look_up` takes them."""
        owns = [split_index(name)[0] for name in names]
        fulls = {self._short.get(own, own) for own in owns}
        return {key for key, full in self._full.items() if full in fulls} if fulls else set()

    def _take_in(self, robot: RobotModel) -> None:
        for data_set in robot.data_sets:
            for field in data_set.fields:
                own = _own_name(data_set, field)
                full = self._full[field.key] = f"{robot.name}.{own}"
                self._own[full] = own
                if robot.bridge in self._demanding:
                    self._on_demand.add(full)
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
        self._values[name] = value
        return True

    def change(self, change: ValueChanged) -> bool:
        """See `take`."""
        return self.take(change.key, change.value, change.status)

    def look_up(self, name: str) -> Value:
        """The value of a name now.

        Raises:
            ValueUnknown: there is no such value, or it is not known now.
        """
        own, index = split_index(name)
        full = self._short.get(own, own)
        status = self._status.get(full)
        if status is None:
            raise ValueUnknown(f"there is no value {name!r}")
        robot = full.partition(".")[0]
        if status & _BAD:
            raise ValueUnknown(f"{name} is not known now ({status_name(status)})", robot)
        if status >> 16 == _LAST_USABLE >> 16:
            raise ValueUnknown(f"{name} is not known now (its last value is too old, or of an earlier start)", robot)
        if status == StatusCode.UNCERTAIN_LAST_USABLE_VALUE and full in self._on_demand:
            raise ValueUnknown(
                f"{name} is not known now (it is read on demand, and was not read since the last demand)", robot
            )
        value = self._values.get(full)
        if index is not None:
            if not isinstance(value, tuple | list):
                raise ValueUnknown(f"{own} is no array", robot)
            elements = cast("Sequence[object]", value)
            if index >= len(elements):
                raise ValueUnknown(f"{own} has {len(elements)} elements now, and no {name}", robot)
            value = elements[index]
        if not isinstance(value, bool | int | float | str):
            raise ValueUnknown(f"{name} is not known now (no number, text or truth value)", robot)
        if isinstance(value, float) and math.isnan(value):  # each comparison with it is false, and its `not` true
            raise ValueUnknown(f"{name} is not known now (its robot says NaN)", robot)
        return value


def _own_name(data_set: DataSetModel, field: FieldModel) -> str:
    """The name of a value without its robot."""
    return data_set.name if data_set.is_single else f"{data_set.name}.{field.name}"


def names_of(robot: RobotModel, data_set: DataSetModel) -> list[str]:
    """All names that conditions have for the values of a DataSet of a robot."""
    own = [_own_name(data_set, field) for field in data_set.fields]
    return [*own, *(f"{robot.name}.{name}" for name in own)]


def fleet_view(
    robots: Collection[RobotModel], meanings: Mapping[str, int], capacities: Capacities | None = None
) -> FleetView:
    """What scenarios are held against; without `capacities` no device is plugged in."""
    able = Capacities(robots) if capacities is None else capacities
    views = {
        robot.name: RobotView(
            robot.name,
            frozenset(able.of(robot.name)),
            {skill.name: skill for skill in robot.skills},
            able.lacking(robot.name),
        )
        for robot in robots
    }
    arrays = {
        name
        for robot in robots
        for data_set in robot.data_sets
        for field in data_set.fields
        if field.type & ARRAY
        for name in (_own_name(data_set, field), f"{robot.name}.{_own_name(data_set, field)}")
    }
    return FleetView(views, meanings, arrays=frozenset(arrays))


def own_fields(robots: Iterable[RobotModel]) -> dict[Topic, tuple[NodeId, ...]]:
    """The fields of the data that clients write."""
    return {
        data_set.topic: tuple([field.key for field in data_set.fields])
        for robot in robots
        for data_set in robot.data_sets
        if data_set.writable
    }
