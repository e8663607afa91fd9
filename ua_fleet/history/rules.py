"""What is kept of a node's values."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Rule"]


@dataclass(frozen=True, slots=True)
class Rule:
    """Which values of a node are kept, and for how long.

    A value is kept when it differs by more than the deadband from the one that was kept last. What came between the two
    and was the same is kept once, at its end: so a reader that draws a line from value to value sees where it was flat.
    """

    deadband: float = 0.0
    """By how much a number has to differ; 0: at all. Values of other types, and arrays, have none."""
    at_most_each_s: float = 0.0
    """Seconds from a kept value to the next one at least; what changes in between is kept when they are over, the last
    one of it. It has the time at which it came, so that two may be closer; in the long run there is one in such a time
    at most. The end of a flat part is one of them, and left out where it would come too soon: flat parts of twice that
    time and more always have it. Changes of quality do not wait."""
    at_least_each_s: float = 0.0
    """A value that comes so many seconds after the kept one is kept even though it is the same; 0: never."""
    days: float = 30.0
    """For how long."""
