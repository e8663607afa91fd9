"""Waiting for what becomes of requests, which the server does not do: it is told."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from typing import Any

from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.skill.executions import EXECUTION_ID_BYTES, RequestOutcome
from ua_fleet.topics import Topic


class Outcomes:
    """The outcomes of one SkillCommands, for which `tell` is its `told`."""

    def __init__(self) -> None:
        self._waiting: dict[bytes, list[asyncio.Future[RequestOutcome]]] = {}

    def tell(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        for waiting in self._waiting.pop(execution_id, ()):
            if not waiting.done():
                waiting.set_result(outcome)

    async def invoke(
        self,
        commands: SkillCommands,
        topic: Topic,
        values: tuple[Any, ...],
        timeout_s: float,
        *,
        robot: str | None = None,
        execution_id: bytes | None = None,
    ) -> RequestOutcome:
        """Request a skill once it is announced, and wait until it is known whether the robot was told.

        Without `robot` it is the Action's first target. The execution id is a random one without.
        """
        commands.want(topic)
        with contextlib.suppress(TimeoutError):  # `request` says what is wrong then
            async with asyncio.timeout(timeout_s):
                while commands.action(topic) is None:
                    await asyncio.sleep(0.001)
        execution_id = execution_id or secrets.token_bytes(EXECUTION_ID_BYTES)
        waiting = self._wait(execution_id)
        action = commands.action(topic)
        names = [field.name for field in action.request.fields] if action is not None else []
        names += [f"more_{number}" for number in range(len(values) - len(names))]
        robot = robot or (action.targets[0].name if action is not None else None) or ""
        skill = (action.request.name if action is not None else None) or ""
        commands.request(topic, robot, skill, dict(zip(names, values, strict=False)), timeout_s, execution_id)
        return await waiting

    async def of(self, commands: SkillCommands, execution_id: bytes) -> RequestOutcome:
        """The outcome of a request that this run or one before has made; KeyError where there is none."""
        known = commands.known_outcome(execution_id)
        return known if known is not None else await self._wait(execution_id)

    def _wait(self, execution_id: bytes) -> asyncio.Future[RequestOutcome]:
        waiting: asyncio.Future[RequestOutcome] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(execution_id, []).append(waiting)
        return waiting
