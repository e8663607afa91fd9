"""The facts of executions that wait for the bridge's event loop, in their order. Pure; its owner has the lock.

Of one execution at most four wait: how far it is, that it stood, that it goes on, and its end. A robot that says them
without end pushes out what it said before, as far as that makes no difference to whoever hears the rest. Of how far it
is the newest stays; of standing and going on the newest too, and before `resumed` the last `suspended`, without which
it says nothing to whoever does not know yet what the robot does.
"""

from __future__ import annotations

from collections import OrderedDict

from ua_fleet.bridge.driver import ExecutionFact, ExecutionProgressed, ExecutionResumed, ExecutionSuspended

__all__ = ["ExecutionLane"]


class ExecutionLane:
    """A queue whose length is bounded by the executions that are under way."""

    def __init__(self) -> None:
        self.facts: OrderedDict[int, ExecutionFact] = OrderedDict()
        """By their number, in their order. To ask it whether any waits costs less than to ask the lane."""
        self._next = 0
        self._of: dict[bytes, list[int]] = {}
        """The numbers of the facts of each execution that newer ones may push out."""

    def __len__(self) -> int:
        return len(self.facts)

    def put(self, fact: ExecutionFact) -> int:
        """Take a fact; how many others it has pushed out."""
        self.facts[self._next] = fact
        before = len(self.facts)
        if isinstance(fact, ExecutionProgressed | ExecutionSuspended | ExecutionResumed):
            numbers = [number for number in self._of.get(fact.execution_id, ()) if number in self.facts]
            self._of[fact.execution_id] = self._needed([*numbers, self._next])
        else:
            self._of.pop(fact.execution_id, None)
        self._next += 1
        return before - len(self.facts)

    def pop(self) -> ExecutionFact:
        """The fact that has waited longest."""
        _, fact = self.facts.popitem(last=False)
        if not self.facts:
            self._of.clear()
        return fact

    def clear(self) -> None:
        """Forget all of them."""
        self.facts.clear()
        self._of.clear()

    def _needed(self, numbers: list[int]) -> list[int]:
        """Of the facts of one execution those that are still to be told; the others go."""
        facts = self.facts
        progress: list[int] = []
        stood: list[int] = []
        for number in numbers:
            if isinstance(facts[number], ExecutionProgressed):
                progress = [number]
            elif isinstance(facts[number], ExecutionSuspended):
                stood = [number]
            else:
                stood = [*(each for each in stood[:1] if isinstance(facts[each], ExecutionSuspended)), number]
        needed = sorted(progress + stood)
        for number in set(numbers).difference(needed):
            del facts[number]
        return needed
