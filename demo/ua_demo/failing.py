"""Errors of several tasks at once, of which one is told."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from ua_fleet.errors import UaFleetError

__all__ = ["first_failure"]


@contextmanager
def first_failure() -> Generator[None]:
    """Raise the first error of a task group by itself, where all of them are ours; to be entered before the group."""
    try:
        yield
    except ExceptionGroup as group:
        failed, other = group.split(UaFleetError)
        if failed is None or other is not None:
            raise
        raise _first(failed) from None


def _first(group: ExceptionGroup[UaFleetError]) -> UaFleetError:
    first = group.exceptions[0]
    return _first(first) if isinstance(first, ExceptionGroup) else first
