"""The facts of carried runs as the server fetches them from a bridge, page by page: it says which one it has last.

They come from the file, in the order in which they were written, by their numbers there: these are the same after a
restart, and where facts before them were forgotten.
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
    last: int
    """The number behind which the server asks on: that of the last of them; on the last page the highest of the file,
    so that what other runs do is not gone over for each page of a quiet one."""
    is_last: bool
    """Whether there are no more."""


class FactPages:
    """The pages of all runs of a bridge."""

    def __init__(self, records: Callable[[], CarriedRecords]) -> None:
        """`records` gives the file, or raises StorageUnavailable."""
        self._records = records

    def after(self, run_id: str, last: int) -> FactPage:
        """As many facts after the one with a number as one answer has room for; raises StorageUnavailable."""
        lines, size = list[str](), 0
        for number, line in self._records().lines_beyond(run_id, last):
            size += len(line.encode())
            if lines and size > PAGE_BYTES:
                return FactPage(lines, last, False)
            lines.append(line)
            last = number
        return FactPage(lines, max(last, self._records().last_number()), True)
