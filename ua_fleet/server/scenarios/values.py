"""Values of robots by the names that conditions and criteria use: `ur3.battery`, `rover.pose.x`, and without the robot
where only one has such a value.
"""

from __future__ import annotations

from collections import Counter

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import FleetModel
from ua_fleet.scenario import Value, ValueUnknown
from ua_fleet.values import NodeId, StatusCode, status_name

__all__ = ["FleetValues"]

_BAD = 0x8000_0000


class FleetValues:
    """The latest value of everything in a fleet that a condition can be about."""

    def __init__(self, model: FleetModel) -> None:
        self._full: dict[NodeId, str] = {}
        self._values: dict[str, Value] = {}
        self._status: dict[str, int] = {}
        short: dict[str, list[str]] = {}
        for robot in model.robots:
            for data_set in robot.data_sets:
                for field in data_set.fields:
                    own = data_set.name if data_set.is_single else f"{data_set.name}.{field.name}"
                    full = f"{robot.name}.{own}"
                    self._full[field.key] = full
                    self._status[full] = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
                    short.setdefault(own, []).append(full)
                    if field.initial is not None:
                        self._values[full], self._status[full] = field.initial, 0
        self.meanings: Counter[str] = Counter(self._full.values())
        """Names with the number of values that each may mean."""
        self._short: dict[str, str] = {}
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
