"""The data that originates in the server: clients write it, the robots' spaces receive it. Pure.

A DataSet travels as a whole, so a write of one field publishes all of them; a field that nobody has written yet is Bad
in it. Writes that arrive together (both fields of a velocity, in one Write request) make one publication; a second
write of the same field makes a second one, since none may be lost.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final, NamedTuple

from ua_fleet.fleet.check import misfit
from ua_fleet.fleet.model import DataSetModel, FleetModel, RobotModel
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, Matrix, NodeId, StatusCode
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["Commands", "Publication", "metadata_of"]

MAX_BYTES: Final = 60_000
"""Most bytes of a DataSet's values: it has to fit into one datagram."""
_STATUS: Final = int(BuiltinType.STATUS_CODE)
_WAITING: Final = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)


class Publication(NamedTuple):
    """A DataSet of space 0 to be sent now."""

    topic: Topic
    types: tuple[int, ...]
    values: tuple[Any, ...]
    timestamp: int


class _DataSet:
    __slots__ = ("model", "newest", "pending", "sent", "types", "values")

    def __init__(self, model: DataSetModel) -> None:
        self.model = model
        self.types = [_STATUS] * len(model.fields)
        self.values: list[Any] = [_WAITING] * len(model.fields)
        self.newest = 0
        self.sent = 0
        """Time of the last publication."""
        self.pending: dict[int, int] = {}
        """Fields that were written and not published yet, with their times."""

    def floor(self, index: int) -> int:
        """The time after which a write of a field has to be; fields that are published together may have the same."""
        return self.newest if index in self.pending else self.sent

    def publication(self) -> Publication:
        timestamp = self.sent = max(self.pending.values())
        self.pending.clear()
        return Publication(self.model.topic, tuple(self.types), tuple(self.values), timestamp)


class Commands:
    """The last values of all DataSets that originate in the server. Times are ticks of the wall clock."""

    def __init__(self, model: FleetModel) -> None:
        """Take the configured initial values."""
        self._data_sets: dict[Topic, _DataSet] = {}
        self._fields: dict[NodeId, tuple[_DataSet, int]] = {}
        for data_set in model.data_sets():
            if data_set.writable:
                self._add(data_set)

    def add(self, robot: RobotModel, wall_ticks: int) -> list[Publication]:
        """Know the data for a robot; what has a value from the start is to be published, once it is announced."""
        added = [self._add(data_set) for data_set in robot.data_sets if data_set.writable]
        return _initial(added, wall_ticks)

    def remove(self, robot: RobotModel) -> None:
        """Forget the data for a robot."""
        for data_set in robot.data_sets:
            self._data_sets.pop(data_set.topic, None)
            for field in data_set.fields:
                self._fields.pop(field.key, None)

    def _add(self, data_set: DataSetModel) -> _DataSet:
        state = self._data_sets[data_set.topic] = _DataSet(data_set)
        for index, field in enumerate(data_set.fields):
            self._fields[field.key] = state, index
            if field.initial is not None:
                state.types[index], state.values[index] = field.type, field.initial
        return state

    def sources(self) -> Iterator[tuple[DataSetModel, tuple[FieldMetaData, ...]]]:
        """What is to be announced: each DataSet with the metadata of its fields."""
        for state in self._data_sets.values():
            yield state.model, metadata_of(state.model)

    def initial(self, wall_ticks: int) -> list[Publication]:
        """The DataSets that have a value from the start."""
        return _initial(self._data_sets.values(), wall_ticks)

    def check(self, key: NodeId, type_code: int, value: Any) -> StatusCode:
        """Whether a client may write this value to this node."""
        found = self._fields.get(key)
        if found is None:
            return StatusCode.BAD_NOT_WRITABLE
        state, index = found
        if value is None and type_code & 0x3F != BuiltinType.STRING:
            return StatusCode.BAD_TYPE_MISMATCH
        problem = misfit(state.model.fields[index], type_code, value)
        if problem is not None:
            return StatusCode.BAD_OUT_OF_RANGE if problem.is_usable else StatusCode(problem.status)
        others = sum(_size(state.types[i], state.values[i]) for i in range(len(state.types)) if i != index)
        if others + _size(type_code, value) > MAX_BYTES:
            return StatusCode.BAD_OUT_OF_RANGE
        return StatusCode.GOOD

    def check_time(self, key: NodeId, source_timestamp: int | None, wall_ticks: int) -> StatusCode:
        """Whether a write may have the time that a client gives it: after the last publication, and not to come."""
        state, index = self._fields[key]
        if source_timestamp is None or state.floor(index) < source_timestamp <= wall_ticks:
            return StatusCode.GOOD
        return StatusCode.BAD_WRITE_NOT_SUPPORTED

    def write(
        self, key: NodeId, type_code: int, value: Any, source_timestamp: int | None, wall_ticks: int
    ) -> tuple[int, Publication | None]:
        """Take a write that has been checked.

        A time that the client gives has passed `check_time`: Timestamps of publications strictly increase.

        Returns:
            the write's time, and what has to be sent before it.
        """
        state, index = self._fields[key]
        timestamp = max(wall_ticks, state.newest + 1)
        if source_timestamp is not None and state.floor(index) < source_timestamp <= wall_ticks:
            timestamp = source_timestamp
        before = state.publication() if index in state.pending else None
        if not state.pending or timestamp > state.newest:
            state.newest = timestamp
        state.types[index], state.values[index] = type_code, value
        state.pending[index] = timestamp
        return timestamp, before

    def flush(self) -> list[Publication]:
        """The DataSets that were written since the last time."""
        return [state.publication() for state in self._data_sets.values() if state.pending]


def _initial(states: Iterable[_DataSet], wall_ticks: int) -> list[Publication]:
    publications: list[Publication] = []
    for state in states:
        written = [index for index, kind in enumerate(state.types) if kind != _STATUS]
        if written:
            state.newest = wall_ticks
            state.pending = dict.fromkeys(written, wall_ticks)
            publications.append(state.publication())
    return publications


def metadata_of(model: DataSetModel) -> tuple[FieldMetaData, ...]:
    """What is announced of a DataSet.

    The message type is announced where it has fields of these names; a single field has a std_msgs type anyway.
    """
    properties: dict[str, str] = {}
    is_flat = all(field.path is None or field.path == field.name for field in model.fields)
    if model.message_type is not None and not model.is_single and is_flat:
        properties["RosType"] = model.message_type
    return tuple(
        make_field(
            field.name, field.type & 0x3F, array=bool(field.type & ARRAY), properties={} if index else properties
        )
        for index, field in enumerate(model.fields)
    )


def _size(type_code: int, value: Any) -> int:
    """About how many bytes a value takes on the wire; never too few."""
    if type_code & DIMENSIONS and isinstance(value, Matrix):
        value = value.values
    if type_code & ARRAY:
        return 8 + sum(_size(type_code & 0x3F, item) for item in value or ())
    if isinstance(value, str):
        return 5 + len(value.encode())
    return 5 + len(value) if isinstance(value, bytes) else 9
