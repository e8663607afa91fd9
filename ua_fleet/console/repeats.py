"""The answers to commands that a page may ask for again, since none reached it: each press is carried out once.

A page gives each press a key, and the same key again until an answer to it came. Pure but for the futures: time is an
argument, in seconds of a clock that never goes back.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Final

from ua_fleet.console.board import encoded

__all__ = ["KEY_CHARACTERS", "NOT_KNOWN", "KeptAnswer", "KeptAnswers"]

KEY_CHARACTERS: Final = 64
_CHARACTERS: Final = 16_384
"""Of an answer that is kept: those to commands are short."""
_MOST: Final = 32
_KEPT_S: Final = 120.0
"""From the answer on. A page gives the same key for 90 s from the first time on."""

Asked = tuple[str, ...]
"""Key, fleet, user, operation and a hash of the parameters: what differs in one of them is another command."""
KeptAnswer = tuple[int, str]
"""The status of HTTP, and the body as JSON."""


def _said(message: str) -> KeptAnswer:
    return 409, encoded({"error": {"message": message}})


NOT_KNOWN: Final = _said("this was sent before, and whether it was done is not known; look before you do it again")
_TOO_LARGE: Final = _said("this was sent before, and was answered; load the page again to see what became of it")


@dataclass(slots=True)
class _Kept:
    answer: asyncio.Future[KeptAnswer] = field(default_factory=asyncio.Future[KeptAnswer])
    until_s: float = float("inf")


class KeptAnswers:
    """Those of one browser."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Asked, _Kept] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    def find(self, asked: Asked, now: float) -> asyncio.Future[KeptAnswer] | None:
        """What this command was answered, or will be; None: it was not asked for before."""
        for old in [one for one, kept in self._kept.items() if kept.until_s <= now]:
            del self._kept[old]
        kept = self._kept.get(asked)
        return None if kept is None else kept.answer

    def begin(self, asked: Asked) -> bool:
        """A command is carried out; False where the oldest one had to be forgotten for it."""
        self._kept[asked] = _Kept()
        if len(self._kept) <= _MOST:
            return True
        _, oldest = self._kept.popitem(last=False)
        if not oldest.answer.done():
            oldest.answer.set_result(NOT_KNOWN)
        return False

    def end(self, asked: Asked, answer: KeptAnswer, now: float) -> None:
        """It was answered."""
        kept = self._kept.get(asked)
        if kept is not None and not kept.answer.done():
            kept.until_s = now + _KEPT_S
            kept.answer.set_result(answer if len(answer[1]) <= _CHARACTERS else _TOO_LARGE)
