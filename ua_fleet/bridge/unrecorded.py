"""What drivers and robots said that the journal could not record yet, in its order.

Of each execution that is remembered there wait at most: one answer that it was never begun, the last word whether it
stands or goes on, and its first end, after which nothing of it counts. So a full disk costs no memory, however long it
lasts and whatever robots repeat, and no end is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum, auto

from ua_fleet.skill.responder import ResponderEffect

__all__ = ["Said", "Step", "Unrecorded"]

Step = Callable[[float], Sequence[ResponderEffect]]
"""Records something at a time (monotonic seconds), and returns what follows."""


class Said(Enum):
    """What was said of an execution."""

    NOT_BEGUN = auto()
    STANDING = auto()
    """That it stands in the middle of it, or goes on: the last word counts."""
    END = auto()
    """Whatever ends it: the first word counts."""


class Unrecorded:
    """The steps that wait."""

    def __init__(self) -> None:
        self._steps: dict[tuple[bytes, Said], Step] = {}

    def __len__(self) -> int:
        return len(self._steps)

    def add(self, execution_id: bytes, said: Said, step: Step) -> bool:
        """Have a step wait behind all others; False where nothing of it counts any more."""
        if (execution_id, Said.END) in self._steps:
            return False
        if said is Said.STANDING:
            self._steps.pop((execution_id, said), None)
        self._steps.setdefault((execution_id, said), step)
        return True

    def first(self) -> tuple[tuple[bytes, Said], Step]:
        """The step whose turn it is, with its key."""
        return next(iter(self._steps.items()))

    def remove(self, key: tuple[bytes, Said]) -> None:
        """A step was done, or cannot be."""
        del self._steps[key]
