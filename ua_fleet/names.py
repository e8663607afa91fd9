"""Names for people: lists of them in a sentence, and the one that was probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Final

__all__ = ["closest", "listed"]

_LISTED: Final = 16


def listed(names: Iterable[str]) -> str:
    """Names for a sentence: `a`, `b`; not too many."""
    all_names = list(names)
    more = f" and {len(all_names) - _LISTED} more" if len(all_names) > _LISTED else ""
    return ", ".join(f"`{name}`" for name in all_names[:_LISTED]) + more


def closest(word: str, known: Iterable[str]) -> str:
    """`did you mean ...?` where a known word is near, else the empty text."""
    by_lower = {name.lower(): name for name in known}
    if len(word) < 3:  # `on` is near to `none`
        return ""
    longer = [name for name in by_lower if name.startswith(word.lower())]
    matches = longer or difflib.get_close_matches(word.lower(), by_lower, n=1, cutoff=0.6)
    return f"did you mean `{by_lower[matches[0]]}`?" if matches else ""
