"""When to probe for what is not known (OPC 10000-14 7.2.4.6.12.2).

The first probe comes after a random 100 to 500 ms, so that many subscribers do not ask at once, and only if the
answer has not come by itself. The next follow after 500 ms and then twice as long each time.
"""

from __future__ import annotations

from random import Random
from typing import Final

from ua_fleet.pubsub.due import DueTimes
from ua_fleet.pubsub.mapped import PublisherKey

__all__ = ["ProbeSchedule"]

_FIRST_DELAY_S: Final = (0.1, 0.5)
_FIRST_PERIOD_S: Final = 0.5
_LONGEST_PERIOD_S: Final = 30.0
"""The specification leaves it to the subscriber."""

_Key = tuple[PublisherKey, int]


class ProbeSchedule:
    """The due times of probes, each for a (PublisherId, DataSetWriterId)."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._due = DueTimes[_Key]()
        self._period: dict[_Key, float] = {}

    def want(self, key: _Key, now: float) -> None:
        """Ask for this one, unless it is being asked for already."""
        if self._due.get(key) is None:
            period = self._period.get(key)
            self._due.put(key, now + (self._random.uniform(*_FIRST_DELAY_S) if period is None else period))

    def asked_by_another(self, publisher_id: PublisherKey, writer_ids: tuple[int, ...], now: float) -> None:
        """Somebody asks for these, or with no id for all of a publisher: wait for that answer."""
        keys: list[_Key] = [(publisher_id, writer_id) for writer_id in writer_ids] or [
            key for key in self._due if key[0] == publisher_id
        ]
        for key in keys:
            due = self._due.get(key)
            if due is not None and due < now + _FIRST_PERIOD_S:
                self._due.put(key, now + _FIRST_PERIOD_S)

    def answered(self, key: _Key) -> None:
        """An announcement came. If it does not help, the next `want` goes on with the longer period."""
        self._due.discard(key)

    def settled(self, key: _Key) -> None:
        """All is known: forget the period."""
        self._due.discard(key)
        self._period.pop(key, None)

    def take_due(self, now: float) -> list[_Key]:
        """The keys to probe for now; each is entered again for its next time."""
        keys: list[_Key] = []
        while self._due.is_due(now):
            key = self._due.pop()
            keys.append(key)
            period = self._period.get(key, _FIRST_PERIOD_S)
            self._period[key] = min(2 * period, _LONGEST_PERIOD_S)
            self._due.put(key, now + period)
        return keys

    def next_deadline(self) -> float | None:
        """When the next probe is due, or None."""
        return self._due.next()
