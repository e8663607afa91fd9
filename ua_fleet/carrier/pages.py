"""The facts of carried runs as the server fetches them from a bridge, page by page: it says how many it has.

They come from the file, in the order in which they were written: this order is the same after a restart, and what is in
memory does not grow with the run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from ua_fleet.storage.carried_records import CarriedRecords

__all__ = ["PAGE_BYTES", "FactPage", "FactPages"]

PAGE_BYTES: Final = 24_000
"""Facts of one answer to the server, before they are compressed."""


class FactPage(NamedTuple):
    """Facts that the server has not."""

    lines: list[str]
    is_last: bool
    """Whether there are no more."""


class FactPages:
    """The pages of all runs of a bridge."""

    def __init__(self, records: Callable[[], CarriedRecords]) -> None:
        """Begin with none; `records` gives the file, or raises StorageUnavailable."""
        self._records = records
        self._told: dict[str, tuple[int, int]] = {}
        """Of each run: how many facts were told, and the number in the file of the last of them."""

    def after(self, run_id: str, count: int) -> FactPage:
        """As many facts after the first `count` as one answer has room for; raises StorageUnavailable."""
        place, last = self._told.get(run_id, (0, 0))
        if count < place:  # the server was restarted, or has not heard the answer
            place, last = 0, 0
        lines, size = list[str](), 0
        for number, line in self._records().lines_beyond(run_id, last):
            if place >= count:
                size += len(line.encode())
                if lines and size > PAGE_BYTES:
                    return FactPage(lines, False)
                lines.append(line)
            place += 1
            self._told[run_id] = place, number
        return FactPage(lines, True)

    def forget(self, run_id: str) -> None:
        """A run is not in the file any more."""
        self._told.pop(run_id, None)
