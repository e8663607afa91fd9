"""Whose clock the time of a message comes from."""

from __future__ import annotations

from typing import Final

__all__ = ["source_time_ns"]

EARLIEST_NS: Final = 946_684_800 * 1_000_000_000
"""2000-01-01: a stamp before it counts from a robot's start, or from that of a simulation, and is no time of day."""
MOST_AHEAD_NS: Final = 60 * 1_000_000_000
"""A clock further ahead is wrong, and Timestamps must increase: all later messages would carry its error on."""


def source_time_ns(stamp_ns: int, received_ns: int) -> int:
    """The robot's time of a message (ns since 1970): its Header's stamp where that is plausible, else its arrival."""
    return stamp_ns if EARLIEST_NS <= stamp_ns <= received_ns + MOST_AHEAD_NS else received_ns
