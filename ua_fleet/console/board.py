"""A feed's map as it is now, each value encoded once, however many browsers look at it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final, Protocol, cast

__all__ = ["MOST_KEYS", "Board", "BoardListener", "encoded"]

MOST_KEYS: Final = 20_000
"""Keys of a map; what would be one more is not taken, and counted."""


class BoardListener(Protocol):
    """Who is told what has changed on a board."""

    def changed(self, key: str, part: str | None) -> None:
        """A value was set, or is gone.

        Args:
            key: of the value.
            part: what of a JSON object is another than before, encoded, while all else is the same. None: it is gone,
                or it is told whole.
        """

    def replaced(self) -> None:
        """The whole map is another."""

    def failed(self) -> None:
        """The feed has an error, or has none any more."""


_ENCODER: Final = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def encoded(value: Any) -> str:
    """A value as JSON; what no JSON can hold is a mistake of ours, and raises ValueError."""
    return _ENCODER.encode(value)


def _fields(value: Any) -> Mapping[str, str] | None:
    """The members of what is a JSON object, each encoded; None: it is none."""
    if not isinstance(value, dict):
        return None
    members = cast("dict[object, Any]", value)
    fields = {name: encoded(one) for name, one in members.items() if isinstance(name, str)}
    return fields if len(fields) == len(members) else None


def _object(fields: Mapping[str, str]) -> str:
    return f"{{{','.join([f'{encoded(name)}:{text}' for name, text in fields.items()])}}}"


def _part(before: Mapping[str, str] | None, now: Mapping[str, str] | None) -> str | None:
    """The members that have changed; None where others are there, for a part takes none away."""
    if before is None or now is None or before.keys() != now.keys():
        return None
    return _object({name: text for name, text in now.items() if before[name] != text})


class Board:
    """The map of one feed. Until `ready` nothing of it is shown: a map that is half filled looks like a small fleet."""

    def __init__(self, most_keys: int = MOST_KEYS) -> None:
        self._texts: dict[str, str] = {}
        self._fields: dict[str, Mapping[str, str]] = {}
        """The members of those values that are JSON objects."""
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
        fields = _fields(value)
        text = encoded(value) if fields is None else _object(fields)
        before = self._texts.get(key)
        if before == text:
            return
        if before is None and len(self._texts) >= self._most:
            self.too_many += 1
            return
        self._texts[key] = text
        part = _part(self._fields.pop(key, None), fields)
        if fields is not None:
            self._fields[key] = fields
        self._tell(key, part)

    def gone(self, key: str) -> None:
        """Remove a key."""
        if self._texts.pop(key, None) is not None:
            self._fields.pop(key, None)
            self._tell(key, None)

    def keep(self, keys: set[str]) -> None:
        """Remove all other keys."""
        for key in [key for key in self._texts if key not in keys]:
            self.gone(key)

    def restart(self) -> None:
        """Begin anew: what is shown stays until the new map is whole."""
        self._texts = {}
        self._fields = {}
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

    def _tell(self, key: str, part: str | None) -> None:
        if self.is_ready:
            for listener in self._listeners:
                listener.changed(key, part)
