"""The UA topics of one space among the names of a graph. Pure."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final, NamedTuple

from ua_fleet.errors import TopicInvalid
from ua_fleet.topics import Topic

__all__ = ["NamesSeen", "UaNames"]

_PREFIX: Final = "/ua_"


class NamesSeen(NamedTuple):
    """What is new among the names."""

    found: list[Topic]
    """Topics of the own space that were not there before."""
    illegal: list[tuple[str, TopicInvalid]]
    """Names that have just appeared, begin like a UA topic and are none."""


class UaNames:
    """Finds the UA topics of one space."""

    def __init__(self, space: int) -> None:
        self._space = space
        self._own: set[str] = set()
        self._others: set[str] = set()
        self._illegal: set[str] = set()

    def forget(self, name: str) -> None:
        """A topic of the own space is not watched any more: it is found again where it is there."""
        self._own.discard(name)

    def look(self, names: Collection[str]) -> NamesSeen:
        """The news among all names that are there now."""
        found: list[Topic] = []
        illegal: list[tuple[str, TopicInvalid]] = []
        others: set[str] = set()
        still_illegal: set[str] = set()
        for name in names:
            if not name.startswith(_PREFIX) or name in self._own:
                continue
            if name in self._others:
                others.add(name)
            elif name in self._illegal:
                still_illegal.add(name)
            else:
                try:
                    topic = Topic.parse(name[1:])
                except TopicInvalid as error:
                    illegal.append((name, error))
                    still_illegal.add(name)
                    continue
                if topic.space == self._space:
                    self._own.add(name)
                    found.append(topic)
                else:
                    others.add(name)
        self._others, self._illegal = others, still_illegal  # a name that goes and comes back is counted again
        return NamesSeen(found, illegal)
