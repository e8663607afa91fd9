"""What has changed of a set of things with names and facts."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

__all__ = ["Difference", "Part", "difference"]

Key = TypeVar("Key", bound=Hashable)


class Part(NamedTuple):
    """One thing that is shown as an Object."""

    name: str
    """Its BrowseName."""
    facts: Any
    """What its values that never change follow from: with other facts it is another Object."""


class Difference(NamedTuple, Generic[Key]):
    """First what is gone, then what is new; what has changed is both."""

    gone: tuple[Key, ...]
    new: tuple[Key, ...]


def difference(before: Mapping[Key, Part], after: Mapping[Key, Part]) -> Difference[Key]:
    """What is to be removed and added so that `before` becomes `after`."""
    return Difference(
        tuple([key for key, part in before.items() if after.get(key) != part]),
        tuple([key for key, part in after.items() if before.get(key) != part]),
    )
