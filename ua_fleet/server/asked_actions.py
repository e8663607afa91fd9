"""Actions that the server asks bridges to do, outside of skills: each is asked for once, and answered at once.

They stand in no journal: what a bridge was asked to do before a restart of the server is not asked for again.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Mapping
from typing import Any, Final

from ua_fleet.errors import UaFleetError
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.skill.executions import EXECUTION_ID_BYTES, OutcomeKind, RequestOutcome
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.skill.requestor import RequestPace
from ua_fleet.topics import Topic
from ua_fleet.values import Quality, StatusCode, quality_of

__all__ = ["ANSWER_S", "AskedActions", "refusal"]

ANSWER_S: Final = 2.0
"""So long a bridge may take to answer. A Method has three seconds."""
_BAD: Final = 0x8000_0000


def refusal(outcome: RequestOutcome) -> int | None:
    """The StatusCode with which a request was not done; None where it was."""
    status = outcome.report.status
    if outcome.kind is OutcomeKind.ACCEPTED and quality_of(status) is Quality.GOOD:
        return None
    return status if status & _BAD else int(StatusCode.BAD_TIMEOUT)


class AskedActions:
    """The requests of one kind."""

    def __init__(
        self,
        instance: str,
        *,
        send: Callable[[bytes], None],
        want: Callable[[int, int, float], bool],
        sooner: Callable[[], None],
        must_be_verified: bool,
        clock: Callable[[], float],
        wall_ticks: Callable[[], int],
        most_remembered: int,
        log: Any,
    ) -> None:
        """Prepare to ask.

        Args:
            instance: second part of the RequestorId, which no other kind of requests has.
            send: sends a plain message to all.
            want: asks for Actions until they are announced.
            sooner: called when the next deadline may have come nearer.
            must_be_verified: only signed responses are taken.
            clock: monotonic seconds.
            wall_ticks: the wall clock.
            most_remembered: requests that are remembered.
            log: for what goes wrong.
        """
        self._asked: dict[bytes, Callable[[RequestOutcome], None]] = {}
        self.commands = SkillCommands(
            MemoryJournal(),
            send=send,
            want=want,
            sooner=sooner,
            wall_ticks=wall_ticks,
            must_be_verified=must_be_verified,
            instance=instance,
            pace=RequestPace(),
            told=self._told,
            clock=clock,
            log=log,
            most_remembered=most_remembered,
        )

    def request(
        self,
        topic: Topic,
        target: str,
        name: str,
        arguments: Mapping[str, Any],
        timeout_s: float,
        told: Callable[[RequestOutcome], None],
    ) -> None:
        """Ask, and have `told` called once it is known what became of it; raises as `SkillCommands.request`."""
        execution_id = secrets.token_bytes(EXECUTION_ID_BYTES)
        self._asked[execution_id] = told
        try:
            self.commands.request(topic, target, name, arguments, timeout_s, execution_id)
        except UaFleetError:
            del self._asked[execution_id]
            raise

    async def ask(
        self,
        topic: Topic,
        target: str,
        name: str,
        arguments: Mapping[str, Any],
        *,
        unwanted: Callable[[RequestOutcome], None] = lambda _outcome: None,
    ) -> RequestOutcome:
        """Ask and wait for the answer, which is `unwanted` where it comes too late, or to nobody any more.

        Raises:
            TimeoutError: there is none within `ANSWER_S`.
            UaFleetError: as `SkillCommands.request`.
        """
        answered: asyncio.Future[RequestOutcome] = asyncio.get_running_loop().create_future()

        def told(outcome: RequestOutcome) -> None:
            if answered.done():
                unwanted(outcome)
            else:
                answered.set_result(outcome)

        self.request(topic, target, name, arguments, ANSWER_S, told)
        try:
            async with asyncio.timeout(ANSWER_S):
                return await answered
        except TimeoutError:
            if answered.cancelled():
                raise
            return answered.result()
        except asyncio.CancelledError:
            if answered.done() and not answered.cancelled():
                unwanted(answered.result())
            raise

    def _told(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        if (told := self._asked.pop(execution_id, None)) is not None:
            told(outcome)
