"""One data source and its fields: from messages to the values of its nodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.fleet.changes import Change, Noticed, ValueChanged
from ua_fleet.fleet.check import Misfit, is_analog, misfit, type_name
from ua_fleet.fleet.matching import find_field
from ua_fleet.fleet.model import DataSetModel, FieldModel
from ua_fleet.pubsub.metadata import max_age_s
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, StatusCode, status_name
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["Source", "SourceField"]

_WAITING: Final = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)
_REFUSED: Final = int(StatusCode.BAD_SECURITY_CHECKS_FAILED)
_LAST_USABLE: Final = int(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE)
_DOUBLE: Final = int(BuiltinType.DOUBLE)
_STATUS: Final = int(BuiltinType.STATUS_CODE)
_QUIET_TICKS: Final = 60 * TICKS_PER_SECOND
_RECENT: Final = 64
"""Timestamps that a source remembers, to see a message that is delivered twice."""


class SourceField:
    """One node and the last that was heard of it."""

    __slots__ = (
        "analog",
        "model",
        "plain",
        "problem",
        "quiet_until",
        "shown",
        "status",
        "timestamp",
        "told",
        "type",
        "value",
    )

    def __init__(self, model: FieldModel) -> None:
        self.model = model
        self.analog = model.can_wait and is_analog(model.type)
        self.plain = model.range is None and not model.length
        """Whether every value of the type fits."""
        self.type = 0
        self.value: Any = None
        self.status = _WAITING
        """Status of the last value heard, without what silence makes of it."""
        self.timestamp: int | None = None
        self.shown = _WAITING
        """Status that the node has."""
        self.problem = ""
        """Why the values do not fit the node; empty where they do."""
        self.told = False
        """Whether the log knows of the problem."""
        self.quiet_until = 0
        """No new problem is told before: a value may go to and fro at the edge of its range."""

    def show(self, status: int) -> ValueChanged:
        """The last value with another status."""
        self.shown = status
        return ValueChanged(self.model.key, self.type, self.value, status, self.timestamp, False)


class Source:
    """One data source as the server knows it."""

    __slots__ = (
        "alive",
        "fields",
        "has_moved",
        "is_refused",
        "lost",
        "max_age_s",
        "metadata",
        "model",
        "newest",
        "plan",
        "recent",
    )

    def __init__(self, model: DataSetModel) -> None:
        self.model = model
        self.fields = tuple(SourceField(field) for field in model.fields)
        self.metadata: DataSetMetaData | None = None
        self.max_age_s = model.max_age_s
        """What its node says: what its publisher announces, or what is configured."""
        self.plan: tuple[tuple[int, SourceField], ...] = ()
        """Where in a message each field stands."""
        self.alive = False
        self.lost = False
        """Whether the source itself said that it is gone, in place of mere silence."""
        self.is_refused = False
        """Whether messages in its name were refused since it was last alive."""
        self.has_moved = False
        """Whether a status that is shown has changed; who has looked at it sets it back."""
        self.newest = -1
        self.recent: list[int] = []

    def bind(self, metadata: DataSetMetaData, counters: Counters, wall_ticks: int) -> list[Change]:
        """Find the node's fields in the layout of the messages."""
        self.metadata = metadata
        found: list[tuple[int, SourceField]] = []
        changes: list[Change] = []
        announced_s = max_age_s(metadata.fields)
        age_s = self.model.max_age_s if announced_s is None else announced_s
        if age_s != self.max_age_s:
            self.max_age_s = age_s
            age_ms = 0.0 if age_s is None else age_s * 1000
            changes.append(ValueChanged(self.model.max_age_key, _DOUBLE, age_ms, 0, wall_ticks, False))
        for field in self.fields:
            index = find_field(metadata.fields, field.model.name, field.model.path, is_only=self.model.is_single)
            if index is None:
                counters.drop(Drop.LAYOUT)
                names = ", ".join(announced.name for announced in metadata.fields[:8])
                changes += self._refuse(
                    field,
                    Misfit(StatusCode.BAD_CONFIGURATION_ERROR, f"its messages have no such field, but {names}"),
                    None,
                    wall_ticks,
                )
            else:
                found.append((index, field))
        self.plan = tuple(found)
        return changes

    def take(self, message: DataSetMessage, counters: Counters, wall_ticks: int) -> list[Change]:
        """The changes that a message with new data makes."""
        timestamp = message.timestamp
        if timestamp is not None:
            if timestamp > self.newest:
                self.newest = timestamp
            elif timestamp in self.recent:
                counters.looped += 1
            self.remember(timestamp)
        status = message.status or 0
        if status >> 16 == _NO_COMMUNICATION >> 16:
            self.alive, self.lost = False, True
            return self.silence()
        self.alive, self.lost = True, False
        if message.field_status is not None or message.field_source_timestamps is not None:
            return self._take_data_values(message, status, counters, wall_ticks)
        changes: list[Change] = []
        types, values = message.types, message.values
        for index, field in self.plan:
            type_code = types[index]
            if field.plain and type_code == field.model.type and not field.problem:
                field.type, field.value, field.status, field.timestamp = type_code, values[index], status, timestamp
                is_same = field.shown == status
                if not is_same:
                    field.shown, self.has_moved = status, True
                can_wait = field.analog and is_same
                changes.append(ValueChanged(field.model.key, type_code, values[index], status, timestamp, can_wait))
            else:
                changes += self._take_checked(field, type_code, values[index], status, timestamp, counters, wall_ticks)
        return changes

    def remember(self, timestamp: int) -> None:
        """A message with this Timestamp has been delivered to the nodes."""
        recent = self.recent
        if len(recent) >= _RECENT:
            del recent[: _RECENT // 2]
        recent.append(timestamp)
        if timestamp > self.newest:
            self.newest = timestamp

    def _take_data_values(
        self, message: DataSetMessage, status: int, counters: Counters, wall_ticks: int
    ) -> list[Change]:
        """DataValue encoding: each field may have a status and a time of its own."""
        changes: list[Change] = []
        stamps = message.field_source_timestamps
        for index, field in self.plan:
            own = message.field_status[index] if message.field_status is not None else 0
            stamp = stamps[index] if stamps is not None else None
            changes += self._take_checked(
                field,
                message.types[index],
                message.values[index],
                max(own, status, key=lambda code: code >> 30),
                message.timestamp if stamp is None else stamp,
                counters,
                wall_ticks,
            )
        return changes

    def _take_checked(
        self,
        field: SourceField,
        type_code: int,
        value: Any,
        status: int,
        timestamp: int | None,
        counters: Counters,
        wall_ticks: int,
    ) -> list[Change]:
        if type_code == _STATUS and field.model.type != _STATUS:  # a Bad field of the Variant encoding
            return [self._set(field, field.type, field.value, int(value), timestamp)]
        if type_code == 0 and status >> 31:
            return [self._set(field, field.type, field.value, status, timestamp)]
        problem = misfit(field.model, type_code, value)
        if problem is None:
            changes: list[Change] = []
            if field.problem:
                field.problem = ""
                if field.told:
                    field.told = False
                    changes.append(Noticed(False, f"{self._name(field)} fits its node again", self.model.topic))
            changes.append(self._set(field, type_code, value, status, timestamp))
            return changes
        if problem.is_usable:
            changes = self._notice(field, problem, wall_ticks)
            changes.append(self._set(field, type_code, value, max(status, problem.status), timestamp))
            return changes
        counters.drop(Drop.CONVERSION)
        return self._refuse(field, problem, timestamp, wall_ticks)

    def _refuse(self, field: SourceField, problem: Misfit, timestamp: int | None, wall_ticks: int) -> list[Change]:
        changes = self._notice(field, problem, wall_ticks)
        changes.append(self._set(field, 0, None, problem.status, timestamp))
        return changes

    def _notice(self, field: SourceField, problem: Misfit, wall_ticks: int) -> list[Change]:
        if field.problem == problem.reason:
            return []
        field.problem = problem.reason
        if wall_ticks < field.quiet_until:
            return []
        field.told = True
        field.quiet_until = wall_ticks + _QUIET_TICKS
        text = f"{self._name(field)} does not fit its node ({status_name(problem.status)}): {problem.reason}"
        return [Noticed(True, text, self.model.topic)]

    def _name(self, field: SourceField) -> str:
        return f"{self.model.topic.name} {field.model.name} ({type_name(field.model.type)})"

    def _set(self, field: SourceField, type_code: int, value: Any, status: int, timestamp: int | None) -> ValueChanged:
        field.type, field.value, field.status, field.timestamp = type_code, value, status, timestamp
        can_wait = field.analog and field.shown == status and status >> 31 == 0
        if field.shown != status:
            field.shown, self.has_moved = status, True
        return ValueChanged(field.model.key, type_code, value, status, timestamp, can_wait)

    def silence(self) -> list[Change]:
        """The source is not heard any more: its last values stay, and are Bad."""
        return self._show([(field, _NO_COMMUNICATION) for field in self.fields])

    def refuse(self) -> list[Change]:
        """Messages of the source, which is not heard, are refused for their security."""
        self.is_refused = True
        return self._show([(field, _REFUSED) for field in self.fields])

    def return_(self, *, is_followed: bool = False) -> list[Change]:
        """The source says that its last values are of now; where new ones follow, these are not, and never look so."""
        return self._show([(field, field.status) for field in self.fields if field.status >> 31 or not is_followed])

    def age(self) -> list[Change]:
        """The source is there, and its last values may be of an earlier life of it, or too old."""
        return self._show([(field, field.status if field.status >> 31 else _LAST_USABLE) for field in self.fields])

    def _show(self, statuses: Iterable[tuple[SourceField, int]]) -> list[Change]:
        """The last values with other statuses."""
        changes: list[Change] = [field.show(status) for field, status in statuses if field.shown != status]
        self.has_moved = self.has_moved or bool(changes)
        return changes

    def shown(self) -> Iterator[int]:
        """The status of each of its nodes."""
        return (field.shown for field in self.fields)
