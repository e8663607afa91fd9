"""One alarm as a state machine (OPC 10000-9 5.5, 5.7, 5.8).

    Enabled   disabled: not looked at, Retain false; enabled again: as the last value is
    Active    by the value, once it has been beyond a limit for `delay_s`; a value that is not Good keeps the state
    Acked     false where it becomes active, or more severe; true by Acknowledge
    Confirmed false by Acknowledge, true by Confirm and where it becomes active; always true where none is needed
    Shelving  Unshelved, TimedShelved until a time, OneShotShelved until it is inactive
    Suppressed

Retain: enabled, and active, not acknowledged or not confirmed. There are no branches: what is not acknowledged of an
earlier time is so of the present one. Each change makes one notification with an EventId of its own, which Acknowledge,
Confirm and AddComment name; the last `MOST_EVENT_IDS` are known.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import inf
from typing import Any, Final

from ua_fleet.errors import UaFleetError
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind
from ua_fleet.operation.alarms.levels import Level
from ua_fleet.values import StatusCode

__all__ = ["MAX_SHELVED_S", "MOST_EVENT_IDS", "Condition", "ConditionRefused", "ConditionState", "Shelving"]

MOST_EVENT_IDS: Final = 32
MAX_SHELVED_S: Final = 7 * 24 * 3600.0
"""MaxTimeShelved: OneShotShelved ends then, too."""
MOST_COMMENT: Final = 1000


class Shelving(StrEnum):
    """States of ShelvedStateMachineType (OPC 10000-9 5.8.10)."""

    UNSHELVED = "Unshelved"
    TIMED = "TimedShelved"
    ONE_SHOT = "OneShotShelved"


class ConditionRefused(UaFleetError):
    """A Method of an alarm or a dialog is not possible in its state; the StatusCode is that of OPC 10000-9."""

    remedy = "Read the state of the alarm, and call what is possible in it."

    def __init__(self, ua_status: StatusCode, message: str) -> None:
        super().__init__(message)
        self.ua_status = ua_status


@dataclass(frozen=True, slots=True)
class ConditionState:
    """All of an alarm that outlives a restart. Times are seconds of the wall clock."""

    enabled: bool = True
    level: int = 0
    """0: inactive; of limits a `Level`, else 1: active."""
    since: float = 0.0
    """Since when it is active or inactive, or in this level."""
    acked: bool = True
    confirmed: bool = True
    severity: int = 0
    last_severity: int = 0
    shelving: Shelving = Shelving.UNSHELVED
    unshelve_at: float | None = None
    suppressed: bool = False
    quality: int = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
    comment: str = ""
    comment_by: str = ""
    comment_at: float | None = None
    message: str = ""
    event_id: bytes = b""
    """Of the last notification; empty before the first one."""
    told_at: float = 0.0
    """Its time."""

    @property
    def active(self) -> bool:
        """Whether what it is about is there."""
        return self.level != 0

    @property
    def retain(self) -> bool:
        """Whether a client that looks at what is should see it (OPC 10000-9 5.5.2)."""
        return self.enabled and (self.active or not self.acked or not self.confirmed)

    @property
    def suppressed_or_shelved(self) -> bool:
        """Whether people are not to be bothered with it now."""
        return self.suppressed or self.shelving is not Shelving.UNSHELVED

    @property
    def is_put_aside(self) -> bool:
        """Whether a person has disabled, suppressed or shelved it."""
        return not self.enabled or self.suppressed_or_shelved


@dataclass(slots=True)
class _Pending:
    """A level that has not lasted long enough."""

    level: int
    at: float


@dataclass(slots=True, eq=False)
class Condition:
    """An alarm with its state. Each method tells whether there is something to notify of; `notified` makes it known."""

    definition: AlarmDefinition
    make_event_id: Callable[[], bytes]
    state: ConditionState = field(default_factory=ConditionState)
    floor: float = inf
    """A Good number from here ..."""
    ceiling: float = -inf
    """... up to here changes nothing."""
    value: Any = None
    _status: int = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
    _pending: _Pending | None = None
    _silent_since: float | None = None
    """Since when values say nothing; None while they do."""
    _event_ids: deque[bytes] = field(default_factory=lambda: deque(maxlen=MOST_EVENT_IDS))

    def __post_init__(self) -> None:
        if self.state.event_id:
            self._event_ids.append(self.state.event_id)

    # What happens.

    def take(self, value: Any, status: int, now: float) -> bool:
        """A new value of what is watched; whether that is to be notified."""
        self.value, self._status = value, status
        return self._look(now)

    def _look(self, now: float) -> bool:
        state = self.state
        if not state.enabled:
            return False
        level = self._level_of(self.value, self._status)
        told = self._set_quality(level)
        if level is None:
            # The next value that says something decides: a sensor that fails now and then puts off no alarm.
            self._silent_since = now if self._silent_since is None else self._silent_since
            self._set_band()
            return told
        if self._silent_since is not None and now - self._silent_since > self.definition.delay_s:
            self._pending = None  # nobody knows what was meanwhile
        self._silent_since = None
        if level != state.level:
            return self._offer(level, now) or told
        self._pending = None
        self._set_band()
        return told

    def _level_of(self, value: Any, status: int) -> int | None:
        """The level that a value stands for; None for one that says nothing."""
        if status >> 30 or value is None or value != value:
            return None
        if self.definition.kind is AlarmKind.LEVEL:
            try:
                return int(self.definition.levels.level(float(value), Level(self.state.level)))
            except (TypeError, ValueError, OverflowError):
                return None
        if self.definition.kind is AlarmKind.OFF_NORMAL:
            return int(bool(value) is not self.definition.normal)
        return int(value)

    def _set_quality(self, level: int | None) -> bool:
        quality = self._status if level is not None or self._status >> 30 else int(StatusCode.UNCERTAIN)
        if quality == self.state.quality:
            return False
        self.state = replace(self.state, quality=quality)
        return self.state.retain  # else nobody looks at it

    def _offer(self, level: int, now: float) -> bool:
        """Take another level, at once or once it has lasted."""
        if self.definition.delay_s and _is_worse(level, self.state.level):
            pending = self._pending
            if pending is None or pending.level * level < 0:
                pending = self._pending = _Pending(level, now + self.definition.delay_s)
            if abs(level) < abs(pending.level):
                pending.level = level  # it is beyond this limit for as long; the other one waits anew
            level = pending.level
            if now < pending.at:
                self.floor, self.ceiling = inf, -inf  # until then each value is looked at
                return False
        self._pending = None
        self._enter(level, now)
        if self.definition.delay_s:
            self._look(now)  # it may be beyond the next limit, too, which has not lasted long enough
        return True

    def _enter(self, level: int, now: float) -> None:
        before, severity = self.state, self.definition.severity_at(level)
        changes: dict[str, Any] = {"level": level, "since": now}
        if level:
            changes |= {"last_severity": before.severity or severity, "severity": severity}
            if _is_worse(level, before.level):
                changes |= {"acked": False, "confirmed": True}
        elif before.shelving is Shelving.ONE_SHOT:
            changes |= {"shelving": Shelving.UNSHELVED, "unshelve_at": None}
        self.state = replace(before, **changes)
        self._set_band()

    def _set_band(self) -> None:
        if self.definition.kind is AlarmKind.LEVEL and not self.state.quality and self._pending is None:
            self.floor, self.ceiling = self.definition.levels.band(Level(self.state.level))
        else:
            self.floor, self.ceiling = inf, -inf

    def poll(self, now: float) -> bool:
        """Do what is due: a level has lasted, or a shelving is over."""
        told = False
        due = self._due()
        if due is not None and now >= due.at:
            level, self._pending = due.level, None
            self._enter(level, now)
            self._look(now)
            told = True
        until = self.state.unshelve_at
        if until is not None and now >= until:
            self.state = replace(self.state, shelving=Shelving.UNSHELVED, unshelve_at=None)
            told = True
        return told

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        due = self._due()
        pending = None if due is None else due.at
        return min((at for at in (pending, self.state.unshelve_at) if at is not None), default=None)

    def _due(self) -> _Pending | None:
        """The level that is taken once its time has come, whatever is said meanwhile."""
        return self._pending if self.state.enabled and self._silent_since is None else None

    # What people do. Each raises ConditionRefused with the StatusCode of OPC 10000-9.

    def acknowledge(self, event_id: bytes | None, comment: str | None, by: str, now: float) -> None:
        """Acknowledge (5.7.3)."""
        self._check_event(event_id)
        if self.state.acked:
            raise ConditionRefused(
                StatusCode.BAD_CONDITION_BRANCH_ALREADY_ACKED, f"{self.definition.id} is acknowledged already"
            )
        self._comment(comment, by, now)
        self.state = replace(self.state, acked=True, confirmed=not self.definition.needs_confirmation)

    def confirm(self, event_id: bytes | None, comment: str | None, by: str, now: float) -> None:
        """Confirm (5.7.4)."""
        self._check_event(event_id)
        if not self.definition.needs_confirmation:
            raise ConditionRefused(StatusCode.BAD_NOT_SUPPORTED, f"{self.definition.id} is not to be confirmed")
        if self.state.confirmed:
            raise ConditionRefused(
                StatusCode.BAD_CONDITION_BRANCH_ALREADY_CONFIRMED,
                f"{self.definition.id} is confirmed already, or not acknowledged yet",
            )
        self._comment(comment, by, now)
        self.state = replace(self.state, confirmed=True)

    def add_comment(self, event_id: bytes | None, comment: str | None, by: str, now: float) -> None:
        """AddComment (5.5.6); None leaves the comment as it is."""
        self._check_event(event_id)
        self._comment(comment, by, now)

    def enable(self, now: float) -> None:
        """Enable (5.5.4): it is as the last value is."""
        if self.state.enabled:
            raise ConditionRefused(StatusCode.BAD_CONDITION_ALREADY_ENABLED, f"{self.definition.id} is enabled")
        self.state = replace(self.state, enabled=True)
        self._pending = None
        self._look(now)

    def disable(self) -> None:
        """Disable (5.5.5): it keeps its state, and is not looked at."""
        if not self.state.enabled:
            raise ConditionRefused(StatusCode.BAD_CONDITION_ALREADY_DISABLED, f"{self.definition.id} is disabled")
        self.floor, self.ceiling = inf, -inf
        self.state = replace(self.state, enabled=False)

    def suppress(self, *, suppressed: bool) -> bool:
        """Suppress and Unsuppress (5.8.5, 5.8.6); whether that is new."""
        self._check_enabled()
        is_new = self.state.suppressed is not suppressed
        self.state = replace(self.state, suppressed=suppressed)
        return is_new

    def shelve_for(self, time_s: float, now: float) -> None:
        """TimedShelve (5.8.10.3)."""
        self._check_enabled()
        if self.state.shelving is Shelving.TIMED:
            raise ConditionRefused(StatusCode.BAD_CONDITION_ALREADY_SHELVED, f"{self.definition.id} is shelved")
        if not 0 < time_s <= MAX_SHELVED_S:
            raise ConditionRefused(
                StatusCode.BAD_SHELVING_TIME_OUT_OF_RANGE, f"shelving takes more than 0 and at most {MAX_SHELVED_S} s"
            )
        self.state = replace(self.state, shelving=Shelving.TIMED, unshelve_at=now + time_s)

    def shelve_once(self, now: float) -> None:
        """OneShotShelve (5.8.10.4)."""
        self._check_enabled()
        if self.state.shelving is Shelving.ONE_SHOT:
            raise ConditionRefused(StatusCode.BAD_CONDITION_ALREADY_SHELVED, f"{self.definition.id} is shelved")
        self.state = replace(self.state, shelving=Shelving.ONE_SHOT, unshelve_at=now + MAX_SHELVED_S)

    def unshelve(self) -> None:
        """Unshelve (5.8.10.2)."""
        self._check_enabled()
        if self.state.shelving is Shelving.UNSHELVED:
            raise ConditionRefused(StatusCode.BAD_CONDITION_NOT_SHELVED, f"{self.definition.id} is not shelved")
        self.state = replace(self.state, shelving=Shelving.UNSHELVED, unshelve_at=None)

    def notified(self, now: float) -> ConditionState:
        """Make the notification of what has changed: its EventId, its time and its message."""
        event_id = self.make_event_id()
        self._event_ids.append(event_id)
        self.state = replace(self.state, event_id=event_id, told_at=now, message=self._message())
        return self.state

    def restored_state(self, state: ConditionState) -> None:
        """Take back the state before something that could not be recorded; its events stay known."""
        self.state = state
        self._set_band()

    def _check_event(self, event_id: bytes | None) -> None:
        self._check_enabled()
        if event_id not in self._event_ids:
            raise ConditionRefused(StatusCode.BAD_EVENT_ID_UNKNOWN, f"no event of {self.definition.id}")

    def _check_enabled(self) -> None:
        if not self.state.enabled:
            raise ConditionRefused(StatusCode.BAD_CONDITION_DISABLED, f"{self.definition.id} is disabled")

    def _comment(self, text: str | None, by: str, now: float) -> None:
        if text is not None:
            self.state = replace(self.state, comment=text[:MOST_COMMENT], comment_by=by, comment_at=now)

    def _message(self) -> str:
        """One line for people."""
        definition, state = self.definition, self.state
        if not state.enabled:
            return f"{definition.id}: disabled"
        unit = f" {definition.unit}" if definition.unit else ""
        if definition.kind is AlarmKind.LEVEL:
            if not state.active:
                return f"{definition.id}: within its limits"
            limit = getattr(definition.levels, Level(state.level).name.lower())
            side = "above" if state.level > 0 else "below"
            shown = f"{self.value:g}" if isinstance(self.value, int | float) else "?"
            return f"{definition.id}: {shown}{unit} is {side} {limit:g}{unit}"
        if state.active and definition.certificate is not None:
            return f"{definition.source_name}: {definition.certificate.notice}"
        return f"{definition.id}: {'not as it should be' if state.active else 'normal'}"


def _is_worse(level: int, before: int) -> bool:
    """Whether it is more severe, or another alarm: of the other side."""
    return abs(level) > abs(before) or level * before < 0
