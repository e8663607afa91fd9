"""Actions that are no skills and that a bridge does at once: a request in, an answer out. Pure.

They have no journal: what they do is done before they are answered, and a bridge that was restarted begins anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import UaFleetError
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.pubsub.metadata import fields_version, type_codes
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, Target
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.skill.offers import Offer
from ua_fleet.skill.responder import ActionResponder, Execute, Respond, ResponderEffect, ResponderLimits
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.transport.party import Answers
from ua_fleet.values import StatusCode
from ua_fleet.wire.actions import encode_action
from ua_fleet.wire.discovered import ActionTarget
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["TARGET_ID", "ImmediateActions"]

TARGET_ID: Final = 1
"""ActionTargetId of the one target of such an Action."""

Do = Callable[[int, list[Any], float], bytes]
"""Does what the Action of a DataSetWriter asks for, with its arguments at a time, and gives its results packed.

Raises UaFleetError where it refuses.
"""


class ImmediateActions:
    """See the module."""

    def __init__(
        self,
        space: int,
        publisher: Publisher,
        counters: Counters,
        do: Do,
        *,
        about: str,
        requestors: Iterable[int],
        spaces: Iterable[int] = (SERVER_SPACE,),
        must_be_verified: bool,
        requests_at_once: int,
        send: Callable[[bytes], None],
        send_to: Callable[[bytes, tuple[str, int]], None],
        wall_ticks: Callable[[], int],
        caught: Callable[[str, Exception], None],
        answers: Answers,
        limits: ResponderLimits | None,
    ) -> None:
        """Connect the parts; nothing is offered yet.

        Args:
            space: the bridge's.
            publisher: announces the Actions.
            counters: of the bridge.
            do: does what is asked for.
            about: what the Actions are about, for who is told of a mistake.
            requestors: spaces that may command this one.
            spaces: those of them that may ask for these Actions.
            must_be_verified: whether keys are configured: unsigned requests are dropped then.
            requests_at_once: of each Action.
            send: sends a plain message to all.
            send_to: sends a plain message to one address.
            wall_ticks: the time of the wall clock.
            caught: told of a mistake, and what it was about.
            answers: finds where a response goes.
            limits: of the responder; None: the usual ones.
        """
        self._publisher, self._counters, self._do, self._about = publisher, counters, do, about
        self._send, self._send_to, self._wall_ticks, self._caught = send, send_to, wall_ticks, caught
        self._answer_address, self._requests_at_once = answers, requests_at_once
        self._spaces = frozenset(spaces)
        self.asked_by = SERVER_SPACE
        """The space of whoever asks for what is being done."""
        self._responder = ActionResponder(
            space,
            MemoryJournal(),
            counters,
            allowed_spaces=requestors,
            must_be_verified=must_be_verified,
            limits=limits or ResponderLimits(),
        )

    def offer(
        self,
        topic: Topic,
        name: str,
        target: str,
        request: tuple[FieldMetaData, ...],
        response: tuple[FieldMetaData, ...],
        now: float,
    ) -> None:
        """Announce an Action with its one target, and take requests for it; raises LocalWireError."""
        targets = (ActionTarget(TARGET_ID, target),)
        for datagram in self._publisher.announce_action(
            topic, name, targets, request, response, now=now, wall_ticks=self._wall_ticks()
        ):
            self._send(datagram)
        self._responder.offer(
            Offer(
                Target(*topic, TARGET_ID),
                type_codes(request),
                version=fields_version(request, response),
                immediate=True,
                requests_at_once=self._requests_at_once,
                spaces=self._spaces,
            )
        )

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take a request."""
        message = event.message
        reply_to = self._answer_address(message.response_address, event.sender) if event.sender is not None else None
        if reply_to is None:
            self._counters.drop_malformed("response_address")
            return
        self._carry_out(
            self._responder.receive(message, reply_to, now, self._wall_ticks(), verified=event.verified), now
        )

    def poll(self, now: float) -> None:
        """Do what is due."""
        self._carry_out(self._responder.poll(now), now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return self._responder.next_deadline()

    def _carry_out(self, effects: Iterable[ResponderEffect], now: float) -> None:
        for effect in effects:
            if isinstance(effect, Execute):
                self._carry_out(self._answered(effect, now), now)
            elif isinstance(effect, Respond):
                to: Any = effect.to
                self._send_to(encode_action(effect.message), to)

    def _answered(self, effect: Execute, now: float) -> list[ResponderEffect]:
        """Do what was asked for; what there is to say of it."""
        execution, responder, execution_id = effect.execution, self._responder, effect.execution.execution_id
        self.asked_by = execution.space
        try:
            result = self._do(execution.target.data_set_writer_id, list(effect.arguments()), now)
        except UaFleetError as error:
            self._counters.drop(Drop.REFUSED)
            return responder.refused(execution_id, error.ua_status, str(error), now)
        except Exception as error:  # noqa: BLE001 - one request must not keep the others from being answered
            self._caught(self._about, error)
            said = "the bridge failed while it did this"
            return responder.refused(execution_id, StatusCode.BAD_INTERNAL_ERROR, said, now)
        return responder.ended(execution_id, ExecutionReport(ExecutionState.DONE, result=result), now)
