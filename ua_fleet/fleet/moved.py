"""Robots of which something has changed, until somebody looks at them. Pure."""

from __future__ import annotations

from itertools import islice

__all__ = ["MovedRobots"]


class MovedRobots:
    """Names of robots, each once, in the order in which they first moved."""

    def __init__(self) -> None:
        self._names: dict[str, None] = {}

    def __bool__(self) -> bool:
        """Whether `take` has something."""
        return bool(self._names)

    def add(self, name: str) -> None:
        """Something of a robot has changed, or it is gone."""
        self._names[name] = None

    def take(self, most: int) -> list[str]:
        """The first of them, which are looked at now."""
        taken = list(islice(self._names, most))
        for name in taken:
            del self._names[name]
        return taken
