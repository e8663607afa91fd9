# pyright: basic, reportMissingImports=false
"""What the skills' thread hears: the topics on which robots say how they get on, apart from all values.

The watch, in the thread of the values, sees in the graph who publishes them, and says so here. Subscriptions are made
and served in the skills' thread, so that an image, or a backlog of values, keeps no word of a robot waiting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from ua_bridges.ros2.graph import Publisher
from ua_bridges.ros2.source import RosSource

__all__ = ["Ear"]

Step = Callable[[], None]


class Ear:
    """One topic that skills hear."""

    def __init__(self, name: str, make: Callable[[], RosSource], call: Callable[[Step], None]) -> None:
        """Hear nothing yet.

        Args:
            name: full name of the topic.
            make: makes the subscription's source; called in the skills' thread.
            call: has a step done in the skills' thread, soon.
        """
        self.name = name
        self._make, self._call = make, call
        self._source: RosSource | None = None

    # The watch's thread

    def follow(self, publishers: Sequence[Publisher]) -> None:
        """Take note of the publishers that are there now, our own left out."""
        self._call(partial(self._follow, publishers))

    def looked(self) -> None:
        """The graph was looked at: what has waited for that is handed on."""
        source = self._source
        if source is not None and source.is_waiting:
            self._call(source.looked)

    # The skills' thread

    def _follow(self, publishers: Sequence[Publisher]) -> None:
        if self._source is None:
            self._source = self._make()
        self._source.follow(publishers)

    def close(self) -> None:
        """End the subscription."""
        if self._source is not None:
            self._source.close()
