"""Whether a carried run has begun, where the server has not heard that: what its bridges say of it. Pure.

The server writes down that a run has begun when the first bridge has acknowledged the token. One that ends before that
knows neither whether the token was sent nor whether it was taken; one that hears no answer does not know the latter.
The bridges do: each writes a token down before it acknowledges it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from enum import Enum
from typing import Any, Final

__all__ = ["Beginning", "beginning_of", "has_begun", "has_not_begun", "why_not_begun"]


_ENDED_BY_BRIDGES: Final = ("done", "failed")
"""How the bridges themselves end a run that has begun."""


class Beginning(Enum):
    """What one bridge says of the beginning of a run."""

    UNSAID = "unsaid"
    """It has not answered, or could not say it."""
    UNKNOWN = "unknown"
    """It knows no such run: it has no part of it, or has none any more."""
    NO_TOKEN = "no token"  # noqa: S105 - of a run
    """It has its part, and has had no token."""
    BEGUN = "begun"
    """It has a token, or has done something; or it knows that the run is over, as one that had nothing to do does."""


def beginning_of(page: Mapping[str, Any]) -> Beginning:
    """What the first page of a bridge's facts says; `page` has the words of an answer to FETCH."""
    is_over = page["closed"] is not None and page["closed"][1] in _ENDED_BY_BRIDGES
    has_done = page["facts"] or page["active"] or page["holds"]
    return Beginning.BEGUN if is_over or has_done else Beginning.NO_TOKEN


def has_begun(said: Collection[Beginning]) -> bool:
    """Whether any bridge proves that a run has begun."""
    return Beginning.BEGUN in said


def has_not_begun(said: Mapping[int, Beginning], first: int, spaces: Collection[int]) -> bool:
    """Whether bridges prove that a run has not begun.

    Args:
        said: what each has said, by its space.
        first: the space of the one that gets the first token; 0: not known.
        spaces: of all bridges of the run.
    """
    if has_begun(said.values()):
        return False
    if said.get(first) is Beginning.NO_TOKEN:
        return True
    return all(said.get(space, Beginning.UNSAID) is not Beginning.UNSAID for space in spaces)


def why_not_begun(said: Mapping[int, Beginning], first: int, names: Mapping[int, str]) -> str:
    """What `has_not_begun` goes by: one that does not know the run may have had it, and lost it or left it out.

    Args:
        said: what each has said, by its space.
        first: the space of the one that gets the first token; 0: not known.
        names: of bridges, by their spaces.
    """
    unknown = [space for space, one in said.items() if one is Beginning.UNKNOWN]
    if said.get(first) is Beginning.NO_TOKEN or not unknown:
        return "nothing was begun, as its bridges say"
    if len(unknown) == len(said):
        return "no bridge knows the run any more; see what its robots do"
    who = names[first if first in unknown else unknown[0]]
    return f"{who} does not know the run, and no other bridge has begun it; see what its robots do"
