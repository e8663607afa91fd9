"""Where this room's lines and mistakes go: to whoever has the log, so that nothing here writes one."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Protocol

__all__ = ["Log", "MistakeLog"]


class Log(Protocol):
    """Lines of a log, each a sentence without values and the values by their names."""

    def info(self, event: str, /, **values: object) -> object:
        """What people follow."""
        ...

    def warning(self, event: str, /, **values: object) -> object:
        """What somebody should look at."""
        ...

    def error(self, event: str, /, **values: object) -> object:
        """What keeps something from working."""
        ...


class MistakeLog(Protocol):
    """Mistakes of ours that cost one item of a loop; see `ua_fleet.monitoring.mistakes.Mistakes`."""

    def caught(self, loop: str, error: BaseException, **ids: object) -> None:
        """Count a mistake that cost one item."""
        ...

    def guard(self, loop: str, **ids: object) -> AbstractContextManager[object]:
        """A context whose exceptions cost what stands in it and no more."""
        ...
