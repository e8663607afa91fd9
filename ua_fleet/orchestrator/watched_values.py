"""The values that rankings were made of: each is looked at once for all of these, to find those that are not as they
were.
"""

from __future__ import annotations

from ua_fleet.scenario import Lookup, Value, ValueUnknown

__all__ = ["WatchedValues"]

_Seen = tuple[type, object]
"""The kind of a value, and the value; or why it is not known."""


class WatchedValues:
    """Values by their names, as rankings have read them."""

    def __init__(self, lookup: Lookup) -> None:
        """Begin with none; `lookup` has the values of robots."""
        self._lookup = lookup
        self._seen: dict[str, _Seen] = {}
        self._moved: set[str] = set()
        """Those that a ranking has read otherwise than one before."""

    def reader(self, names: set[str]) -> Lookup:
        """Looks up values, and puts the names of all that it was asked for into `names`."""

        def look_up(name: str) -> Value:
            names.add(name)
            try:
                value = self._lookup(name)
            except ValueUnknown as error:
                self._note(name, (ValueUnknown, str(error)))
                raise
            self._note(name, (type(value), value))
            return value

        return look_up

    def _note(self, name: str, seen: _Seen) -> None:
        if self._seen.setdefault(name, seen) != seen:
            self._moved.add(name)

    def changed(self) -> set[str]:
        """The names of which a ranking that was made before may have another value."""
        changed, self._moved = self._moved, set[str]()
        for name, seen in self._seen.items():
            now = self._look(name)
            if now != seen:
                self._seen[name] = now
                changed.add(name)
        return changed

    def clear(self) -> None:
        """No ranking is left."""
        self._seen.clear()
        self._moved.clear()

    def _look(self, name: str) -> _Seen:
        try:
            value = self._lookup(name)
        except ValueUnknown as error:
            return ValueUnknown, str(error)
        return type(value), value
