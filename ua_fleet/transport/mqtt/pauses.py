"""How long to wait before the next connection to a broker: longer each time, and never as long as others wait.

When a broker of a fleet is started anew, all its clients have lost their connection in the same moment. Were their
pauses equal, they would come back in the same moments too, and overrun it each time.

Pure: the randomness is an argument.
"""

from __future__ import annotations

from random import Random
from typing import Final

__all__ = ["FIRST_S", "LONGEST_S", "SPREAD", "Pauses"]

FIRST_S: Final = 0.2
LONGEST_S: Final = 5.0
SPREAD: Final = (0.5, 1.5)
"""A pause is between these times its length in the middle, each as likely."""


class Pauses:
    """The pauses of one client."""

    def __init__(self, random: Random) -> None:
        """Begin with the shortest; `random` makes the spread."""
        self._random, self._middle_s = random, FIRST_S

    def next_s(self) -> float:
        """The next pause, in seconds; the one after it is twice as long in the middle, up to LONGEST_S."""
        pause_s = self._middle_s * self._random.uniform(*SPREAD)
        self._middle_s = min(2.0 * self._middle_s, LONGEST_S)
        return pause_s

    def begin_anew(self) -> None:
        """A connection has lasted: the next pause is one of the shortest again."""
        self._middle_s = FIRST_S
