"""Events that one subscription is told by and by: as its queues empty, and never so many at a time that others wait.

Nothing of it is kept but what makes the next event. So it takes no more memory, however many there are, and an event
that happens meanwhile displaces none of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Final

__all__ = ["MOST_WAITING", "Backlog"]

MOST_WAITING: Final = 200
"""Events that wait for an item before it is told more; of a queue that is shorter, a half."""
_PIECE_S: Final = 0.005
"""So long a piece may hold the loop."""


class Backlog:
    """The events of one subscription."""

    def __init__(
        self,
        events: Iterator[None],
        must_wait: Callable[[], bool],
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Tell nothing yet.

        Args:
            events: tells of one at most with each step.
            must_wait: whether the queues have to empty first.
            clock: seconds.
        """
        self._events, self._must_wait, self._clock = events, must_wait, clock
        self.is_over = False

    def tell(self) -> bool:
        """Tell a piece; whether more can be told as soon as others had their turn."""
        until = self._clock() + _PIECE_S
        while not self.is_over and not self._must_wait():
            if self._clock() >= until:
                return True
            self.is_over = True  # also where it raises
            for _ in self._events:
                self.is_over = False
                break
        return False
