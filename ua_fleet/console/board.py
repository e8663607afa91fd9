"""A feed's map as it is now, each value encoded once, however many browsers look at it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final, Protocol

__all__ = ["MOST_KEYS", "Board", "BoardListener", "encoded"]

MOST_KEYS: Final = 20_000
"""Keys of a map; what would be one more is not taken, and counted."""


class BoardListener(Protocol):
    """Who is told what has changed on a board."""

    def changed(self, key: str) -> None:
        """A value was set, or is gone."""

    def replaced(self) -> None:
        """The whole map is another."""

    def failed(self) -> None:
        """The feed has an error, or has none any more."""


def encoded(value: Any) -> str:
    """A value as JSON; what no JSON can hold is a mistake of ours, and raises ValueError."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


class Board:
    """The map of one feed. Until `ready` nothing of it is shown: a map that is half filled looks like a small fleet."""

    def __init__(self, most_keys: int = MOST_KEYS) -> None:
        self._texts: dict[str, str] = {}
        self._listeners: list[BoardListener] = []
        self._most = most_keys
        self.is_ready = False
        """Whether the map is whole."""
        self.error = ""
        """What is wrong with the feed, encoded; empty: nothing."""
        self.too_many = 0
        """Values that found no room."""

    def __len__(self) -> int:
        return len(self._texts)

    def get(self, key: str) -> str | None:
        """The encoded value of a key."""
        return self._texts.get(key)

    def items(self) -> Iterator[tuple[str, str]]:
        """All keys with their encoded values."""
        return iter(self._texts.items())

    def keys(self) -> list[str]:
        """All keys."""
        return list(self._texts)

    def attach(self, listener: BoardListener) -> None:
        """Tell somebody what changes from now on."""
        self._listeners.append(listener)

    def detach(self, listener: BoardListener) -> None:
        """Tell them no more."""
        self._listeners.remove(listener)

    def put(self, key: str, value: Any) -> None:
        """Set the value of a key; nothing happens where it has this value."""
        text = encoded(value)
        before = self._texts.get(key)
        if before == text:
            return
        if before is None and len(self._texts) >= self._most:
            self.too_many += 1
            return
        self._texts[key] = text
        self._tell(key)

    def gone(self, key: str) -> None:
        """Remove a key."""
        if self._texts.pop(key, None) is not None:
            self._tell(key)

    def keep(self, keys: set[str]) -> None:
        """Remove all other keys."""
        for key in [key for key in self._texts if key not in keys]:
            self.gone(key)

    def restart(self) -> None:
        """Begin anew: what is shown stays until the new map is whole."""
        self._texts = {}
        self.is_ready = False

    def ready(self) -> None:
        """The map is whole; it is shown, and an error that there was is over."""
        if self.is_ready and not self.error:
            return
        was_failed, self.error = bool(self.error), ""
        if not self.is_ready:
            self.is_ready = True
            for listener in self._listeners:
                listener.replaced()
        if was_failed:
            for listener in self._listeners:
                listener.failed()

    def fail(self, error: Any) -> None:
        """Say what is wrong with the feed. What was shown stays, as what was seen last."""
        text = encoded(error)
        if text != self.error:
            self.error = text
            for listener in self._listeners:
                listener.failed()

    def _tell(self, key: str) -> None:
        if self.is_ready:
            for listener in self._listeners:
                listener.changed(key)
