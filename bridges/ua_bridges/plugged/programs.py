"""The programs on the D-Bus whose signals are read: which are there, what they say, and which are put aside. Pure.

Aside goes who says ten signals in a row that are not what the data has, or comes and goes all the time: each time costs
every client two messages.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from ua_bridges.plugged.bus import Signal
from ua_bridges.plugged.sensor import Sensor
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.counters import Drop

__all__ = ["MOST_BAD", "MOST_LEAVES", "Programs"]

MOST_BAD: Final = 10
"""So many signals in a row that are malformed, and their program is put aside."""
MOST_LEAVES: Final = 8
LEAVES_WITHIN_S: Final = 10.0
"""A program that leaves the D-Bus more often within that time is put aside."""

logger = logging.getLogger(__name__)


class Programs:
    """By their well-known names."""

    def __init__(self, signals: Mapping[Signal, Sequence[Sensor]], offenders: Offenders) -> None:
        """Nobody is there yet.

        Args:
            signals: what is read of each signal.
            offenders: the programs that are put aside.
        """
        self._signals, self._offenders = signals, offenders
        self._owned: set[str] = set()
        self._bad: Counter[str] = Counter()
        """Malformed signals in a row, by the name of their program."""
        self._leaves: dict[str, deque[float]] = {}
        """When each program left the D-Bus."""
        self._aside: dict[str, float] = {}
        """Programs that are put aside, and until when."""

    def is_there(self, name: str) -> bool:
        """Whether a program has this name now."""
        return name in self._owned

    def owned(self, name: str, is_owned: bool, now: float, time_ns: int) -> None:
        """A program has come, or has left."""
        (self._owned.add if is_owned else self._owned.discard)(name)
        if not is_owned:
            leaves = self._leaves.setdefault(name, deque(maxlen=MOST_LEAVES))
            if len(leaves) == MOST_LEAVES and now < leaves[0] + LEAVES_WITHIN_S and name not in self._aside:
                self._put_aside(name, f"it left the D-Bus {MOST_LEAVES} times within {LEAVES_WITHIN_S:g} s", now)
            leaves.append(now)
        if name in self._aside:
            return
        if is_owned:
            self._plug(name, now, time_ns)
        else:
            self._unplug(name, f"{name} has left the D-Bus", now)

    def heard(self, signal: Signal, body: Sequence[Any], now: float, time_ns: int) -> None:
        """A program has said something."""
        name = signal.sender
        if name in self._aside:
            return
        is_bad = False
        for sensor in self._signals[signal]:
            fields = tuple(sensor.data.types)
            if len(body) == len(fields):
                sensor.take(dict(zip(fields, body, strict=True)), now, time_ns)
                continue
            is_bad = True
            said = f"{sensor.data.label}: the signal has {len(body)} arguments, and the data {len(fields)} fields"
            sensor.dropped(Drop.MALFORMED, said)
        self._bad[name] = self._bad[name] + 1 if is_bad else 0
        if self._bad[name] >= MOST_BAD:
            self._put_aside(name, f"{MOST_BAD} signals in a row have not as many arguments as the data has fields", now)

    def turn(self, now: float, time_ns: int) -> list[float | None]:
        """Do what is due; when the next things are."""
        times: list[float | None] = []
        for name, until in list(self._aside.items()):
            if now < until:
                times.append(until)
                continue
            del self._aside[name]
            if name in self._owned:
                self._plug(name, now, time_ns)
        for signal, sensors in self._signals.items():
            try:
                times += [sensor.turn(now) for sensor in sensors]
            except Exception as error:  # one program, one mistake
                logger.exception("%s made the bridge fail", signal.sender)
                self._put_aside(signal.sender, f"a mistake of the bridge ({error!r}); report its log", now)
                times.append(self._aside[signal.sender])
        return times

    def _put_aside(self, name: str, reason: str, now: float) -> None:
        self._aside[name] = now + self._offenders.put_aside(name, reason, now)
        self._bad.pop(name, None)
        self._unplug(name, f"{name} is put aside: {reason}", now)

    def _of(self, name: str) -> Iterable[Sensor]:
        return [sensor for signal, sensors in self._signals.items() if signal.sender == name for sensor in sensors]

    def _plug(self, name: str, now: float, time_ns: int) -> None:
        for sensor in self._of(name):
            sensor.plugged(now, time_ns)

    def _unplug(self, name: str, why: str, now: float) -> None:
        for sensor in self._of(name):
            sensor.unplugged(why, now)
