"""Where HistoryRead finds the history of nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from ua_fleet.history.continuation import Continuations
from ua_fleet.history.rows import Series
from ua_fleet.values import NodeId

__all__ = ["MOST_EVENTS", "MOST_RETURNED", "HistorySource"]

MOST_RETURNED: Final = 2_000
"""Values of one node in one answer: what follows has a continuation point."""
MOST_EVENTS: Final = 1_000
"""Likewise events."""

Found = TypeVar("Found")


class HistorySource(Protocol):
    """The history of a server."""

    @property
    def continuations(self) -> Continuations:
        """What makes continuation points."""
        ...

    def is_stepped(self, key: NodeId) -> bool | None:
        """Whether a node's value holds until the next one; None for a node without a history."""
        ...

    async def look(self, key: NodeId, work: Callable[[Series], Found]) -> Found:
        """Do work on the rows of a node, those included that wait to be stored; raises StorageUnavailable."""
        ...

    @property
    def has_events(self) -> bool:
        """Whether events are kept."""
        ...

    async def look_at_events(self, work: Callable[[Series], Found], *, audit: bool) -> Found:
        """The same on events, with AuditEvents or without."""
        ...
