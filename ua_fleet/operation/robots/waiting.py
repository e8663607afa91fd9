"""Announcements of robots that could not be taken, and which of them to look at again. Pure.

Why one could not be taken may be over at any time: a disk was full, a name or an id was another's, a robot was at work.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import Final, NamedTuple

from ua_fleet.topics import Topic

__all__ = ["MOST_AT_ONCE", "WaitingAnnouncements"]

MOST_AT_ONCE: Final = 8
"""Looked at again at a time, of robots that there are and of others: a definition may have 64 KiB."""


class _Waiting(NamedTuple):
    text: str
    reason: str


class WaitingAnnouncements:
    """The last text of each SkillStatus whose robot could not be taken."""

    def __init__(self, most: int) -> None:
        """Begin with none; of those that no robot belongs to, at most `most` are kept."""
        self._most = most
        self._waiting: dict[Topic, _Waiting] = {}
        """Those that were looked at last are the last."""

    def __len__(self) -> int:
        return len(self._waiting)

    def waits(self, topic: Topic, text: str) -> bool:
        """Whether this text waits already."""
        waiting = self._waiting.get(topic)
        return waiting is not None and waiting.text == text

    def discard(self, topic: Topic) -> None:
        """It was taken, or is not to be."""
        self._waiting.pop(topic, None)

    def put(self, topic: Topic, text: str, reason: str, *, is_known: bool, is_heard: Callable[[Topic], bool]) -> bool:
        """Keep one that could not be taken, in place of one that is not heard where there are too many.

        Args:
            topic: the SkillStatus that announces it.
            text: what it announces.
            reason: why it was not taken.
            is_known: whether a robot belongs to it, which has another definition.
            is_heard: whether a source is heard now.

        Returns:
            Whether it is kept. One that is not is looked at again when it is announced again.
        """
        self._waiting.pop(topic, None)
        if len(self._waiting) >= self._most and not is_known:
            gone = next((other for other in self._waiting if not is_heard(other)), None)
            if gone is None:
                return False
            del self._waiting[gone]
        self._waiting[topic] = _Waiting(text, reason)
        return True

    def was_told(self, topic: Topic, text: str, reason: str) -> bool:
        """Whether it waits with this text for this reason, which is in the log then."""
        return self._waiting.get(topic) == (text, reason)

    def due(self, robots: Container[Topic], is_heard: Callable[[Topic], bool]) -> list[tuple[Topic, str]]:
        """What to look at again now. A bridge that is gone makes no robot by what it announced once.

        Args:
            robots: the SkillStatus of each robot.
            is_heard: whether a source is heard now.
        """
        known = [topic for topic in self._waiting if topic in robots][:MOST_AT_ONCE]
        others: list[Topic] = []
        for topic in self._waiting:
            if len(others) == MOST_AT_ONCE:
                break
            if topic not in robots and is_heard(topic):
                others.append(topic)
        return [(topic, self._waiting[topic].text) for topic in (*known, *others)]
