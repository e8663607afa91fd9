"""What is said of sources and waits for the bridge's event loop, in its order among the samples. Pure.

Its owner has the lock. All of it is told, unless a source comes and goes faster than the loop can hear: then the latest
word of it is enough, and its samples of the time before that are of a source that nobody has heard of. So each source
has a bound of its own.
"""

from __future__ import annotations

from collections import OrderedDict

from ua_fleet.bridge.driver import SourceForgotten, SourceFound, SourceLost, SourceRead
from ua_fleet.topics import Topic

__all__ = ["MOST_OF_SOURCE", "SourceFacts"]

MOST_OF_SOURCE = 16
"""Facts of one source that wait; with one more, those before go."""

SourceFact = SourceFound | SourceLost | SourceForgotten | SourceRead


class SourceFacts:
    """A queue whose length is bounded by the sources that there are."""

    def __init__(self) -> None:
        self.facts: OrderedDict[int, tuple[int, SourceFact]] = OrderedDict()
        """Each with the number of samples that were put before it. To ask it whether any waits costs less than to ask
        the queue."""
        self._next = 0
        self._of: dict[Topic, list[int]] = {}
        """Which of them say that a source is there or not."""
        self._reads: dict[Topic, int] = {}
        """The SourceRead of each source that waits."""
        self._void: dict[Topic, int] = {}
        """Of a source that came and went too fast, how many samples had been put by then."""

    def __len__(self) -> int:
        return len(self.facts)

    @property
    def first(self) -> int | None:
        """How many samples go before the fact that has waited longest; None where none waits."""
        return next(iter(self.facts.values()))[0] if self.facts else None

    @property
    def topics(self) -> frozenset[Topic]:
        """The sources that are to be found or lost."""
        return frozenset(self._of)

    def put(self, fact: SourceFact, samples: int) -> None:
        """Take a fact before which so many samples were put."""
        topic, number = fact.topic, self._next
        self._next += 1
        if isinstance(fact, SourceRead):
            self.facts.pop(self._reads.get(topic, -1), None)  # the newer one says it too
            self._reads[topic] = number
        else:
            of = self._of.setdefault(topic, [])
            if len(of) >= MOST_OF_SOURCE:
                kept = of[-1:] if isinstance(fact, SourceForgotten) else []  # only what was lost is forgotten
                for each in of[: len(of) - len(kept)]:
                    del self.facts[each]
                self._of[topic] = of = kept
                self._void[topic] = samples
            of.append(number)
        self.facts[number] = (samples, fact)

    def pop(self) -> SourceFact:
        """The fact that has waited longest."""
        number, (samples, fact) = self.facts.popitem(last=False)
        topic = fact.topic
        if self._reads.get(topic) == number:
            del self._reads[topic]
        elif not isinstance(fact, SourceRead):
            self._of[topic].remove(number)
            if not self._of[topic]:
                del self._of[topic]
        if samples >= self._void.get(topic, samples + 1):
            del self._void[topic]
        return fact

    def is_void(self, topic: Topic, number: int) -> bool:
        """Whether a sample belongs to a time of its source that is not told: before it so many samples were put."""
        return number < self._void.get(topic, 0)

    def clear(self) -> None:
        """Forget all of them."""
        for each in (self.facts, self._of, self._reads, self._void):
            each.clear()
