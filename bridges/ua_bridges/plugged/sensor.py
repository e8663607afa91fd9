"""One thing that is read: found while it is plugged in, read while somebody needs it. Pure.

    unplugged  --plugged-->   there     SourceFound, and Bad_WaitingForInitialData until it is read
    there      --needed, and nothing heard for `silent_after_s`-->  silent     SourceLost; it goes on being asked
    silent     --heard-->     there     SourceFound
    any        --unplugged--> unplugged SourceLost, and readings that wait have failed

It is needed while it is `wanted` (or is read `always`), while a reading waits, and while it is silent, so that it is
met again. When the need ends the last value is told once more as Uncertain_LastUsableValue: nobody looks after it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from ua_bridges.plugged.config import PluggedSource
from ua_bridges.plugged.data import Put, as_type
from ua_fleet.bridge.configured import ConfiguredData, ConfiguredSkill
from ua_fleet.bridge.driver import Dropped, Execution, SampleRead, SourceFound, SourceLost
from ua_fleet.bridge.executing import Ended, Executing
from ua_fleet.counters import Drop
from ua_fleet.rate import RateLimit
from ua_fleet.values import BuiltinType, StatusCode, Variant

__all__ = ["Sensor"]

MISSED_ANSWERS: Final = 3
LEAST_SILENCE_S: Final = 2.0
_MOST_TOLD: Final = 100
_WAITING: Final = Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
_BAD_FIELD: Final = Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_TYPE_MISMATCH)


class Sensor:
    """See the module. All calls come from one thread."""

    def __init__(self, data: ConfiguredData[PluggedSource], put: Put, executing: Executing) -> None:
        self.data, self.source = data, data.side
        self._put, self._executing = put, executing
        rate_hz = data.side.max_rate_hz
        self._limit = RateLimit[SampleRead](rate_hz, burst=max(rate_hz, 1.0))
        self._is_plugged = self._is_there = False
        self._is_wanted = data.side.when == "always"
        self._reads: list[bytes] = []
        self._needed_since = self._heard_at = 0.0
        self._was_needed = False
        self._last: SampleRead | None = None
        """What was told last, until it is said that nobody looks after it."""
        self._told: set[str] = set()

    @property
    def silent_after_s(self) -> float | None:
        """After how long without an answer it is lost."""
        source = self.source
        if source.silent_after_s is None and (source.ask is not None or source.attribute is not None):
            return max(MISSED_ANSWERS * source.period_s, LEAST_SILENCE_S)
        return source.silent_after_s

    @property
    def is_plugged(self) -> bool:
        """Whether what it is read from is there, silent or not."""
        return self._is_plugged

    @property
    def is_needed(self) -> bool:
        """Whether it is to be read now."""
        return self._is_plugged and (self._is_wanted or bool(self._reads) or not self._is_there)

    # What happens to it

    def plugged(self, now: float, time_ns: int) -> None:
        """What it is read from is there."""
        if not self._is_plugged:
            self._is_plugged = True
            self._found()
            # That it is there counts before its first value: its robot can do something now.
            waiting = tuple([_WAITING] * len(self.data.fields))
            status = StatusCode.BAD_WAITING_FOR_INITIAL_DATA
            self._put(SampleRead(self.data.topic, waiting, time_ns, status))
            self._look(now)

    def unplugged(self, why: str, now: float) -> None:
        """What it is read from is gone."""
        if not self._is_plugged:
            return
        self._is_plugged = False
        self._lost()
        self._told.clear()
        reads, self._reads = self._reads, []
        for execution_id in reads:
            self._executing.end(execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), why))
        self._look(now)

    def want(self, is_wanted: bool, now: float) -> None:
        """Somebody follows its values, or nobody does."""
        self._is_wanted = is_wanted or self.source.when == "always"
        self._look(now)

    def read(self, skill: ConfiguredSkill[Any], execution: Execution, now: float) -> None:
        """Answer with the next value that is read."""
        self._executing.begin(skill, execution, now)
        self._reads.append(execution.execution_id)
        self._look(now)

    def leave(self, execution_id: bytes, now: float) -> bool:
        """Nobody waits for this reading any more; False where nobody did."""
        if execution_id not in self._reads:
            return False
        self._reads.remove(execution_id)
        self._look(now)
        return True

    def take(self, values: Mapping[str, Any], now: float, time_ns: int) -> None:
        """It was read because it is needed: its fields by name."""
        if self.is_needed:
            self.show(values, now, time_ns)

    def show(self, values: Mapping[str, Any], now: float, time_ns: int) -> None:
        """Tell its fields, needed or not. What does not fit its type is Bad in its field alone."""
        self._heard_at = now
        self._found()
        read: list[Any] = []
        problems: list[str] = []
        for name, kind in self.data.types.items():
            value = as_type(name, kind, values.get(name))
            if isinstance(value, ValueError):
                problems.append(str(value))
                value = _BAD_FIELD
                self.dropped(Drop.CONVERSION, f"{self.data.label}: {problems[-1]}")
            read.append(value)
        self._tell(SampleRead(self.data.topic, tuple(read), time_ns), now)
        ended = Ended(StatusCode.GOOD, tuple(read))
        if problems:
            ended = Ended(StatusCode.BAD_TYPE_MISMATCH, (), f"what was read does not fit: {'; '.join(problems)}")
        reads, self._reads = self._reads, []
        for execution_id in reads:
            self._executing.end(execution_id, ended)
        self._look(now)

    def dropped(self, cause: Drop, detail: str, count: int = 1) -> None:
        """Count what cannot be handed on; the same words are told once while it is plugged in."""
        is_new = detail not in self._told and len(self._told) < _MOST_TOLD
        if is_new:
            self._told.add(detail)
        self._put(Dropped(cause, count, detail if is_new else ""))

    # Time

    def turn(self, now: float) -> float | None:
        """Do what is due; when to be called again."""
        if (held := self._limit.pop(now)) is not None:
            self._say(held)
        times = [self._limit.due]
        limit = self.silent_after_s
        if self._is_there and self.is_needed and limit is not None:
            silent_at = max(self._heard_at, self._needed_since) + limit
            if now >= silent_at:
                self._lost()
                self.dropped(Drop.NO_ANSWER, f"{self.data.label}: it says nothing; it is asked until it does")
            else:
                times.append(silent_at)
        return min((at for at in times if at is not None), default=None)

    def _look(self, now: float) -> None:
        """The need may have begun or ended."""
        is_needed = self.is_needed
        if is_needed and not self._was_needed:
            self._needed_since = now
        elif self._was_needed and not is_needed and self._is_there:
            self._rest()
        self._was_needed = is_needed

    def _rest(self) -> None:
        if (held := self._limit.drain()) is not None:
            self._say(held)
        last, self._last = self._last, None
        if last is not None and self.source.url is None and self.source.plugged is None:
            self._put(last._replace(status=StatusCode.UNCERTAIN_LAST_USABLE_VALUE))

    def _found(self) -> None:
        if not self._is_there:
            self._is_there = True
            self._put(SourceFound(self.data.topic, self.data.label, self.data.fields))

    def _lost(self) -> None:
        self._limit.drain()
        self._last = None
        if self._is_there:
            self._is_there = False
            self._put(SourceLost(self.data.topic))

    def _tell(self, sample: SampleRead, now: float) -> None:
        passed, is_replaced = self._limit.offer(sample, now)
        if is_replaced:
            self._put(Dropped(Drop.RATE_LIMITED))
        if passed is not None:
            self._say(passed)

    def _say(self, sample: SampleRead) -> None:
        self._last = sample
        self._put(sample)
