"""What a store of history does: one for each kind of database, and one suite of tests for all.

A store belongs to one process, and is called from one thread. Every method raises StorageUnavailable where the database
does not do its part; what was not taken may be given again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, Protocol

from ua_fleet.history.events import AUDIT_EVENTS
from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import Series
from ua_fleet.values import NodeId

__all__ = ["BOUNDED", "BOUNDED_PART", "HistoryStore", "cut_of", "node_of", "node_text", "over_limit_text"]

BOUNDED: Final = AUDIT_EVENTS
"""The series that anybody who reaches the server makes rows of, with or without a user. It takes at most a part of the
store, and its oldest rows go before any other's: nobody pushes out what the robots have said."""
BOUNDED_PART: Final = 4
"""A quarter."""
_ROW_BYTES: Final = 50
"""Of a row or block beside its value, with its index."""


class HistoryStore(Protocol):
    """A store."""

    @property
    def secret(self) -> bytes:
        """What continuation points are signed with; as old as the store."""
        ...

    @property
    def stopped_at(self) -> int:
        """When the last process that wrote to it was last alive, in ticks; 0 where none was."""
        ...

    @property
    def over_limit(self) -> str:
        """Why it takes more bytes than `tend` was told, with all that is old removed, and the remedy; else empty."""
        ...

    def last_times(self) -> Mapping[NodeId, int]:
        """The time of the last row of each node that has any."""
        ...

    def write(self, batch: Sequence[Kept], now: int) -> None:
        """Store rows: all are on the disk when it returns. A row that is not later than the last one of its node is
        there already, and left out.

        Args:
            batch: the rows of each node in the order of their times.
            now: the time, in ticks.
        """
        ...

    def series(self, key: NodeId) -> Series:
        """The rows of a node; none for one that is not known."""
        ...

    def tend(self, now: int, days_of: Callable[[NodeId], float], most_bytes: int) -> bool:
        """Do a small piece of what keeps the store small and quick: compact, or remove what is too old or too much.

        Args:
            now: the time, in ticks.
            days_of: for how long the rows of a node are kept.
            most_bytes: that the store may take; `BOUNDED` of these at most one `BOUNDED_PART`-th.

        Returns:
            Whether there is more to do now.
        """
        ...

    def used_bytes(self) -> int:
        """Bytes that it takes."""
        ...

    def close(self) -> None:
        """Give the database free. Safe to call twice."""
        ...


def cut_of(newest_first: Iterable[tuple[int, int]], most_bytes: int) -> int | None:
    """Where a series is cut off that takes more than it may: a quarter below that, so that it is not done all the time.

    Args:
        newest_first: of its rows and blocks the last time and the bytes.
        most_bytes: that they may take.

    Returns:
        The newest time that goes; None where nothing does.
    """
    used, cut = 0, None
    for time, size in newest_first:
        used += size + _ROW_BYTES
        if cut is None and used > most_bytes * 3 // 4:
            cut = time
        if used > most_bytes:
            return cut
    return None


def over_limit_text(used: int, most: int) -> str:
    """What `HistoryStore.over_limit` says of so many bytes."""
    text = f"takes {used / 1e6:.0f} MB with its old values removed, and history.megabytes is {most / 1e6:.0f}"
    return f"{text}; raise that, or record fewer nodes" if used > most else ""


def node_text(key: NodeId) -> str:
    """A NodeId as stores and continuation points name it."""
    kind = "i" if isinstance(key.identifier, int) else "s"
    return f"{key.namespace};{kind}={key.identifier!s}"


def node_of(text: str) -> NodeId:
    """The NodeId that `node_text` names."""
    namespace, _, rest = text.partition(";")
    kind, _, identifier = rest.partition("=")
    return NodeId(int(namespace), int(identifier) if kind == "i" else identifier)
