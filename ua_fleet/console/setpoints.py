"""The setpoints of one page on their way to the server. Pure; time is an argument.

What a page sends is one of

    taken       it goes on; where the server has not answered the one before, the newest waits and the others are
                `setpoint_overtaken`: a wish waits behind one other at most, and no queue of them comes into being
    setpoint_repeated   its number is not greater than that of the one before
    setpoint_forged     it echoes a counter that this page was never told
    setpoint_late       it echoes a counter that the page was told longer ago than the bridge would take it

Whether a setpoint is fresh the bridge alone decides. What is late here is late there too, since a counter is told to
the page after the bridge has published it; so the server is spared it.
"""

from __future__ import annotations

from collections import Counter
from typing import Final, NamedTuple

__all__ = ["SETPOINT_CAUSES", "SetpointDesk", "Wish"]

SETPOINT_CAUSES: Final = ("setpoint_repeated", "setpoint_forged", "setpoint_late", "setpoint_overtaken")
_KEEP: Final = 1000
"""Numbers of setpoints that were sent, of which the bridge has said nothing yet."""


class Wish(NamedTuple):
    """A setpoint of a page."""

    number: int
    """The page's own."""
    echo: int
    values: tuple[float, ...]


class SetpointDesk:
    """The setpoints of one lease."""

    def __init__(self, deadman_s: float) -> None:
        """Begin with none."""
        self._deadman_s = deadman_s
        self._told: dict[int, float] = {}
        """Counters that are not too old, and when the page was told them first."""
        self._first = self._newest = 0
        self._number = 0
        self._waiting: Wish | None = None
        self._sent: dict[int, int] = {}
        """By the number that the bridge knows, that of the page."""
        self._taken = 0
        self.answered = 0
        """The page's number of the newest setpoint that the server has sent on."""
        self.drops: Counter[str] = Counter()
        """By cause."""

    def told(self, counter: int, now: float) -> None:
        """The page is told a counter."""
        if counter == self._newest:
            return
        self._first, self._newest = self._first or counter, counter
        self._told[counter] = now
        for one, at in list(self._told.items()):
            if now - at < self._deadman_s:
                break
            del self._told[one]

    def take(self, wish: Wish, now: float) -> str:
        """Take what a page wishes; why it was dropped, or that another one was for it, by cause; empty: neither."""
        cause = self._refused(wish, now)
        if not cause:
            self._number = wish.number
            cause = "setpoint_overtaken" if self._waiting is not None else ""
            self._waiting = wish
        if cause:
            self.drops[cause] += 1
        return cause

    def _refused(self, wish: Wish, now: float) -> str:
        if wish.number <= self._number:
            return "setpoint_repeated"
        at = self._told.get(wish.echo)
        if at is None:
            was_told = _not_before(wish.echo, self._first) and _not_before(self._newest, wish.echo)
            return "setpoint_late" if was_told else "setpoint_forged"
        return "setpoint_late" if now - at >= self._deadman_s else ""

    def next(self) -> Wish | None:
        """What is to go to the server now; None: nothing waits."""
        wish, self._waiting = self._waiting, None
        return wish

    def sent(self, wish: Wish, number: int) -> None:
        """The server has sent it to the bridge under this number."""
        self.answered = wish.number
        self._sent[number] = wish.number
        while len(self._sent) > _KEEP:
            del self._sent[next(iter(self._sent))]

    def taken(self, number: int) -> int:
        """The page's number of the newest setpoint that the bridge has taken, by the number that the bridge says."""
        for one in [one for one in self._sent if one <= number]:
            self._taken = self._sent.pop(one)
        return self._taken


def _not_before(one: int, other: int) -> bool:
    """Whether a counter is not older than another; after the greatest comes 1."""
    return (one - other) & 0xFFFF_FFFF < 0x8000_0000
