"""The bridge's side of `ua_fleet.fleet.wanted`: what the server wants, while the server is heard. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from ua_fleet.pubsub.events import DataReceived, SourceSilent
from ua_fleet.topics import Topic
from ua_fleet.values import Quality, quality_of

__all__ = ["Wants"]

_NOTHING = frozenset[Topic]()


class Wants:
    """The data of one bridge that somebody follows."""

    def __init__(
        self,
        topic: Topic,
        space: int,
        tell: Callable[[frozenset[Topic]], None],
        namespaces: Mapping[int, int] | None = None,
    ) -> None:
        """Make it for one bridge.

        Args:
            topic: of the DataSet.
            space: the bridge's own.
            tell: told of each change.
            namespaces: of the ids of the space that are not in the DataSet's own; an id is one in its space.
        """
        self.topic = topic
        self._namespaces = namespaces or {}
        self._space, self._tell = space, tell
        self._told = _NOTHING

    def hear(self, event: DataReceived | SourceSilent) -> None:
        """Take what PubSub says of the DataSet."""
        if isinstance(event, DataReceived):
            self._say(self._read(event))
        else:  # silent; what it said before may have been another server's, so a return alone says nothing
            self._say(_NOTHING)

    def _read(self, event: DataReceived) -> frozenset[Topic]:
        message = event.message
        ids: Any = message.values[0] if message.values else ()
        if quality_of(message.status or 0) is Quality.BAD or not isinstance(ids, list | tuple):
            return _NOTHING
        return frozenset(
            [
                Topic(self._space, self._namespaces.get(wanted, self.topic.ns), wanted)
                for wanted in cast("Sequence[object]", ids)
                if isinstance(wanted, int)
            ]
        )

    def _say(self, wanted: frozenset[Topic]) -> None:
        if wanted != self._told:
            self._told = wanted
            self._tell(wanted)
