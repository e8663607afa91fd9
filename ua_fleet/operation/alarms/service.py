"""All alarms of a server: what becomes of them is written down, then told.

    values, time, people -> conditions -> one commit -> notifications, faults

A value within its band costs one comparison (`value_changed`). What changes by values and time is collected, and
written down by `poll`, which is called at once: a storm of alarms is a few commits. Where that is not possible the
alarms are told all the same, since a person must see them, and written down later. What a person asks for is written
down first, or not done.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from heapq import heappop, heappush
from math import inf
from typing import Final

from ua_fleet.errors import StorageUnavailable
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.operation.alarms.condition import Condition, ConditionRefused, ConditionState, Shelving
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind
from ua_fleet.operation.log import Log
from ua_fleet.orchestrator import FaultFound
from ua_fleet.scenario.consequences import ALARM
from ua_fleet.storage.alarm_states import AlarmStates, StoredAlarm
from ua_fleet.values import NodeId, StatusCode

__all__ = ["AlarmService"]

RETRY_S: Final = 1.0
_NUMBERS: Final = frozenset((float, int))
"""What may be compared; a robot may have sent anything."""

Notify = Callable[[AlarmDefinition, ConditionState], None]


class AlarmService:
    """The alarms of one server, a part of its core."""

    def __init__(
        self,
        definitions: Iterable[AlarmDefinition],
        states: AlarmStates,
        *,
        notify: Notify,
        found: Callable[[list[FaultFound]], None],
        make_event_id: Callable[[], bytes],
        wall_s: Callable[[], float],
        sooner: Callable[[], None],
        log: Log,
    ) -> None:
        """Take up the alarms as they were.

        Args:
            definitions: the alarms.
            states: as they are kept.
            notify: told of each notification, once it is written down.
            found: told of alarms that are faults, with whether they are active.
            make_event_id: makes EventIds.
            wall_s: seconds since 1970, which nobody sets.
            sooner: called when `next_deadline` has come nearer.
            log: gets the lines.

        Raises:
            StorageUnavailable: the states cannot be read.
        """
        self._states, self._notify, self._found = states, notify, found
        self._make_event_id, self._wall_s, self._sooner, self._log = make_event_id, wall_s, sooner, log
        self._kept = {stored.id: stored for stored in states.states()}
        self.conditions: dict[str, Condition] = {}
        self._watched: dict[NodeId, Condition] = {}
        self._dirty: dict[str, Condition] = {}
        """Those that are to be told."""
        self._unwritten: dict[str, Condition] = {}
        self._retry_at: float | None = None
        self._due: list[tuple[float, str]] = []
        self._waiting: set[tuple[float, str]] = set()
        """What is in `_due`: a value that comes a thousand times while an alarm is shelved adds nothing."""
        self._nearest: dict[str, float] = {}
        """When each alarm is next looked at."""
        self._away = ""
        self.added: Callable[[Condition], None] = lambda _condition: None
        """Told of alarms that come later, before they are anything."""
        self.told = 0
        """Notifications since the start."""
        for definition in definitions:
            self.add(definition)

    # What is there.

    @property
    def problem(self) -> str:
        """Why alarms are not written down; empty while they are."""
        return self._away

    def __iter__(self) -> Iterator[Condition]:
        return iter(self.conditions.values())

    @property
    def watched(self) -> Mapping[NodeId, Condition]:
        """Those that watch a node, by it; it changes with them."""
        return self._watched

    def condition(self, alarm_id: str) -> Condition | None:
        """An alarm by its id."""
        return self.conditions.get(alarm_id)

    def add(self, definition: AlarmDefinition) -> Condition:
        """Know an alarm from now on, as it was kept."""
        stored = self._kept.get(definition.id)
        state = ConditionState() if stored is None else _restored(stored)
        condition = Condition(definition, self._make_event_id, state)
        self.conditions[definition.id] = condition
        if definition.watched is not None:
            self._watched[definition.watched] = condition
        self._expect(condition)
        return condition

    def counts(self) -> dict[str, int]:
        """How many alarms are in each state that people look at; one may be in several."""
        states = [condition.state for condition in self]
        return {
            "active": sum(state.enabled and state.active for state in states),
            "unacknowledged": sum(state.enabled and not state.acked for state in states),
            "shelved": sum(state.shelving is not Shelving.UNSHELVED for state in states),
            "suppressed": sum(state.suppressed for state in states),
            "disabled": sum(not state.enabled for state in states),
        }

    def faults(self) -> list[FaultFound]:
        """The alarms that are faults, and whether they are active."""
        return [found for one in self if (found := _fault_of(one)) is not None]

    # What happens.

    def value_changed(self, change: ValueChanged) -> None:
        """A node of the fleet has another value or status."""
        condition = self._watched.get(change.key)
        if condition is not None:
            self.look(condition, change)

    def look(self, condition: Condition, change: ValueChanged) -> None:
        """The node that an alarm watches has another value or status."""
        value = change.value
        if not change.status and type(value) in _NUMBERS and condition.floor <= value <= condition.ceiling:
            condition.value = value
        else:
            self.take(condition, value, change.status)

    def take(self, condition: Condition, value: object, status: int) -> None:
        """Hand an alarm a value that may change it."""
        is_told = condition.take(value, status, self._wall_s())
        self._expect(condition)
        if is_told:
            self._mark(condition)

    def _mark(self, condition: Condition) -> None:
        self._dirty[condition.definition.id] = condition
        self._sooner()

    def _expect(self, condition: Condition) -> None:
        due, alarm_id = condition.next_deadline(), condition.definition.id
        if due is None or due >= self._nearest.get(alarm_id, inf):
            return
        self._nearest[alarm_id] = due
        if (due, alarm_id) not in self._waiting:
            self._waiting.add((due, alarm_id))
            heappush(self._due, (due, alarm_id))
        self._sooner()

    def certificates(self, found: Iterable[AlarmDefinition]) -> None:
        """All certificates there are, as alarms: active where there is something to say. One that is gone is none."""
        there: set[str] = set()
        for definition in found:
            there.add(definition.id)
            condition = self.conditions.get(definition.id)
            if condition is None:
                condition = self.add(definition)
                self.added(condition)
            condition.definition = definition
            is_due = definition.certificate is not None and bool(definition.certificate.notice)
            self.take(condition, int(is_due), 0)
        for condition in self:
            if condition.definition.kind is AlarmKind.CERTIFICATE and condition.definition.id not in there:
                self.take(condition, 0, 0)

    # Time.

    def poll(self, now: float) -> None:
        """Do what is due, write down what has changed, and tell it."""
        del now
        wall = self._wall_s()
        while self._due and self._due[0][0] <= wall:
            due, alarm_id = heappop(self._due)
            self._waiting.discard((due, alarm_id))
            self._nearest.pop(alarm_id, None)
            condition = self.conditions.get(alarm_id)
            if condition is not None and condition.poll(wall):
                self._dirty[alarm_id] = condition
            if condition is not None:
                self._expect(condition)
        if self._dirty:
            self._tell(wall)
        elif self._retry_at is not None and wall >= self._retry_at:
            self._write(wall)

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next, or None."""
        if self._dirty:
            return now
        times = [self._due[0][0]] if self._due else []
        if self._retry_at is not None:
            times.append(self._retry_at)
        return now + max(0.0, min(times) - self._wall_s()) if times else None

    def _tell(self, wall: float) -> None:
        dirty, self._dirty = self._dirty, {}
        for condition in dirty.values():
            condition.notified(wall)
        self._unwritten |= dirty
        self._write(wall)
        self._tell_of(dirty.values())

    def _write(self, wall: float) -> None:
        """Write down what is not yet; what cannot be waits for the next try."""
        try:
            self._states.put([_stored(condition) for condition in self._unwritten.values()])
        except StorageUnavailable as error:
            if not self._away:
                self._log.error("alarms cannot be written down; they are shown all the same", reason=str(error))
            self._away, self._retry_at = str(error), wall + RETRY_S
            return
        if self._away:
            self._log.info("alarms are written down again")
        self._unwritten.clear()
        self._away, self._retry_at = "", None

    def _tell_of(self, conditions: Iterable[Condition]) -> None:
        faults: list[FaultFound] = []
        for condition in conditions:
            self._notify(condition.definition, condition.state)
            self.told += 1
            if (fault := _fault_of(condition)) is not None:
                faults.append(fault)
        if faults:
            self._found(faults)

    # People.

    def do(self, condition: Condition, work: Callable[[float], object]) -> None:
        """Do what a person asks for: all of it, written down, or nothing.

        Raises:
            ConditionRefused: it is not possible now.
            StorageUnavailable: it cannot be written down.
        """
        if self._dirty:
            self._tell(self._wall_s())  # what has happened before is told before
        wall, before = self._wall_s(), condition.state
        if work(wall) is False:
            return
        condition.notified(wall)
        try:
            self._states.put([_stored(condition)])
        except StorageUnavailable:
            condition.restored_state(before)
            raise
        self._unwritten.pop(condition.definition.id, None)
        self._expect(condition)
        self._tell_of([condition])

    def known(self, alarm_id: str) -> Condition:
        """An alarm by its id; raises ConditionRefused where there is none."""
        condition = self.conditions.get(alarm_id)
        if condition is None:
            raise ConditionRefused(StatusCode.BAD_NODE_ID_UNKNOWN, "there is no such alarm")
        return condition


def _fault_of(condition: Condition) -> FaultFound | None:
    """The fault that an alarm is; None where it is none. A disabled alarm is no fault, an alarm that is shelved is."""
    definition, state = condition.definition, condition.state
    if not definition.robot:
        return None
    source = ALARM + definition.id.removeprefix(f"{definition.robot}.")
    is_active = state.enabled and state.active
    return FaultFound(definition.robot, source, is_active, state.message, definition.capacities)


def _stored(condition: Condition) -> StoredAlarm:
    return StoredAlarm(condition.definition.id, **asdict(condition.state))


def _restored(stored: StoredAlarm) -> ConditionState:
    kept = stored._asdict()
    del kept["id"]
    for name in ("enabled", "acked", "confirmed", "suppressed"):
        kept[name] = bool(kept[name])
    kept["shelving"] = Shelving(kept["shelving"])
    return ConditionState(**kept)
