"""Floats that are exactly what a message's type asks for, gathered for one `struct.pack`. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ua_bridges.ros.scalars import is_array

__all__ = ["exact_floats"]


def exact_floats(lengths: Sequence[int | None]) -> Callable[[Sequence[Any]], list[Any] | None]:
    """A function that puts floats and arrays of them, as a pose and its covariance are, into one list.

    It gives None where a value is of another type or length, which has to be looked at by itself.

    Args:
        lengths: of each array, None for what is a single float.
    """
    runs: list[tuple[int, int, int | None]] = []
    """First and last place of singles that stand together, or the place and length of an array."""
    for index, length in enumerate(lengths):
        if length is None and runs and runs[-1][2] is None:
            runs[-1] = runs[-1][0], index + 1, None
        else:
            runs.append((index, index + 1, length))
    expected = tuple((float,) * (stop - start) for start, stop, _ in runs)

    def gather(values: Sequence[Any]) -> list[Any] | None:
        gathered: list[Any] = []
        for (start, stop, length), types in zip(runs, expected, strict=True):
            if length is None:
                singles = values[start:stop]
                if tuple(map(type, singles)) != types:
                    return None
                gathered += singles
            else:
                array = values[start]
                if not is_array(array) or len(array) != length:
                    return None
                gathered += array
        return gathered

    return gather
