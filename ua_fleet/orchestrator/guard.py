"""A mistake of ours costs one item of the orchestrator its turn; `under_way` has those that cost a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVarTuple

__all__ = ["Guard"]

_Told = TypeVarTuple("_Told")


class Guard:
    """Does what is no run's."""

    def __init__(self) -> None:
        self.caught: Callable[[str, Exception], None] | None = None
        """Told of each mistake, with the loop whose item it cost; without it, the mistake is raised."""

    def do(self, loop: str, what: Callable[[*_Told], None], *told: *_Told) -> None:
        """Do something that may fail for a mistake."""
        try:
            what(*told)
        except Exception as error:  # noqa: BLE001 - counted, or raised by `catch`
            self.catch(loop, error)

    def catch(self, loop: str, error: Exception) -> None:
        """Tell of a mistake, or raise it."""
        if self.caught is None:
            raise error
        self.caught(loop, error)
