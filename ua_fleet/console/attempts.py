"""How often somebody may try: a bucket for each, which what fails empties and time fills."""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

__all__ = ["Attempts"]

_MOST: Final = 10_000


class Attempts:
    """Attempts of many, each by its name. The state of those who have not tried for long is forgotten."""

    def __init__(self, at_once: int, each_s: float, most: int = _MOST) -> None:
        """Let each try `at_once` times, and once more every `each_s` seconds."""
        self._at_once, self._each_s, self._most = at_once, each_s, most
        self._full_at: OrderedDict[str, float] = OrderedDict()
        """When the bucket of each will be full again."""

    def __len__(self) -> int:
        return len(self._full_at)

    def wait_s(self, name: str, now: float) -> float:
        """How long this one has to wait for the next attempt; 0: not at all."""
        missing_s = self._full_at.get(name, now) - now
        return max(0.0, missing_s - (self._at_once - 1) * self._each_s)

    def count(self, name: str, now: float) -> None:
        """An attempt was made."""
        self._full_at[name] = max(self._full_at.get(name, now), now) + self._each_s
        self._full_at.move_to_end(name)
        while len(self._full_at) > self._most:
            self._full_at.popitem(last=False)

    def forgive(self, name: str) -> None:
        """An attempt that was counted did not fail."""
        if name in self._full_at:
            self._full_at[name] -= self._each_s
