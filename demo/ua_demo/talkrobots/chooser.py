"""The person in the hall who chooses a replacement."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence

from ua_fleet.client import NotDone, ScenarioClient

__all__ = ["Ask", "Chooser"]

Ask = Callable[[str, Sequence[str]], Awaitable[str | None]]
"""Has an operator choose one of some robots, the best first, for the decision of this id; None where nobody is there.
Cancelled when somebody else has decided."""


class Chooser:
    """Asks an operator until a choice is taken, or the decision is over."""

    def __init__(self, ask: Ask, say: Callable[[str], None]) -> None:
        """`say` prints why a choice was not taken."""
        self._ask, self._say = ask, say
        self._robots: Sequence[str] = ()
        """Who could take over now, the best first."""
        self._asking: asyncio.Task[None] | None = None

    def choose(
        self, decision_id: str, robots: Sequence[str], scenarios: ScenarioClient, tasks: asyncio.TaskGroup
    ) -> None:
        """Have one of these chosen; while somebody is asked already, they are the candidates of the next question."""
        self._robots = robots
        if robots and self._asking is None:
            self._asking = tasks.create_task(self._choose(decision_id, scenarios))

    def stop(self) -> None:
        """Nobody needs a choice any more."""
        if self._asking is not None:
            self._asking.cancel()
            self._asking = None

    async def _choose(self, decision_id: str, scenarios: ScenarioClient) -> None:
        while (robot := await self._ask(decision_id, self._robots)) is not None:
            try:
                await scenarios.confirm(decision_id, robot)
            except NotDone as error:
                self._say(f"{'':11}not done: {error}")
            else:
                return
