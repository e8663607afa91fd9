"""The requestor of Actions: asks until it knows what became of a request, and asks for nothing twice.

A request is journaled, then sent as ActionState Executing, and repeated (OPC 10000-14 6.2.11.2.2, table 83):

    state    event                                                     then
    (none)   start                                                     journal, send Executing           -> ASKING
    ASKING   interval over, neither Executing nor Done heard in it     send Executing again
    ASKING   Executing heard                                           wait for Done, ask again if it falls silent
    ASKING   timeout over, or `withdraw`                               ask on with TimeoutHint 0
    ASKING   Done heard                                                journal outcome, tell it, send Idle -> CLOSING
    ASKING   Done heard, of a pace without Idle                        journal outcome, tell it          -> closed
    ASKING   Done with a refusal heard, and `refusal_wait_s` is not 0  the same after so long; an acceptance that is
                                                                       heard in it wins
    ASKING   timeout and grace over                                    journal Unknown, tell it          -> closed
    CLOSING  interval over, no Idle heard                              send Idle again, a few times      -> closed
    CLOSING  Idle heard                                                                                  -> closed
    any      Done contradicts the outcome: refused and accepted        tell that; accepted wins, and corrects the other
    closed   Done heard                                                send Idle; where the outcome was Unknown and is
                                                                       known now: journal it, tell the correction
    closed   Done heard, the answer to a copy of a request that had    nothing
             none, of a pace without Idle
    closed   `inquire`, the outcome Unknown because no answer came     ask with TimeoutHint 0            -> ASKING
    any      restart                                                   requests without an outcome       -> ASKING

An owner that writes requests down itself, with what they follow from, calls `prepare`, writes, and calls `prepared`;
`begin` sends what is recorded so. What is not to be sent after all (`leave`) is deleted by the owner with what it
writes next: until then a restart asks for it as for any other request.

A TimeoutHint of 0 only asks: a responder that does not know the execution never begins it, and says and records so.
That makes the outcomes sharp. Accepted, Refused and TimedOut are the responder's word: the robot was told exactly
once; never was and never will be; never was, because it was too late. Unknown is all else, and says that somebody has
to look: no answer came in time, whatever happened, or the responder cannot tell itself. An answer that comes after that
is a fact like any other, and corrects it.

A pace without Idle is the sequence of a reliable transport (figure 26), for Actions of which each side can say again
what it has said: the request is repeated until its answer comes, and nothing is said of the answer. A responder that
repeats Done wants to hear Idle, and does.

All that is sent for an execution is the same in each run of the requestor: its id, its arguments, when it was issued.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

from ua_fleet.errors import SkillRejected, StorageUnavailable
from ua_fleet.skill.answers import outcome_of, read_answer
from ua_fleet.skill.executions import (
    EXECUTION_ID_BYTES,
    ExecutionReport,
    ExecutionState,
    OutcomeKind,
    RequestorName,
    RequestOutcome,
    Target,
    pack,
)
from ua_fleet.skill.journal import RecordedRequest, RequestorJournal
from ua_fleet.skill.prepared import PreparedRequests
from ua_fleet.values import TICKS_PER_SECOND, StatusCode
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.packed_fields import PackedFields, pack_fields, unpack_fields

__all__ = ["ActionRequestor", "Concluded", "Contradicted", "OutcomeCorrected", "RequestPace", "RequestorEffect", "Send"]

REQUEST_ID: Final = 1
"""Unique within RequestorId and CorrelationData, as the specification wants it: each execution has its own of those."""
_MOST_AHEAD_S: Final = 5.0
"""So far issue times stay ahead of a clock that was set back: half of what responders take (`clock_tolerance_s`)."""
_NO_ANSWER: Final = RequestOutcome(
    OutcomeKind.UNKNOWN,
    ExecutionReport(ExecutionState.UNKNOWN, StatusCode.BAD_NO_COMMUNICATION, "no answer came; see what the robot does"),
)
_CONTRADICTION: Final = {OutcomeKind.ACCEPTED, OutcomeKind.REFUSED}


@dataclass(frozen=True, slots=True)
class Send:
    """Send a request to the Responder that its PublisherId names. It may be lost: nothing depends on it."""

    message: ActionMessage


@dataclass(frozen=True, slots=True)
class Concluded:
    """The outcome of a request is known, and journaled."""

    execution_id: bytes
    outcome: RequestOutcome


@dataclass(frozen=True, slots=True)
class OutcomeCorrected:
    """An outcome that was Unknown is known after all, and journaled."""

    execution_id: bytes
    outcome: RequestOutcome


@dataclass(frozen=True, slots=True)
class Contradicted:
    """One responder has refused a request that another one has accepted: two processes say that they are one bridge."""

    execution_id: bytes
    target: Target


RequestorEffect = Send | Concluded | OutcomeCorrected | Contradicted


@dataclass(frozen=True, slots=True)
class RequestPace:
    """How often a request is repeated, and how long."""

    interval_s: float = 0.1
    """The PublishingInterval of the Responder; doubled with each repetition, up to `longest_interval_s`."""
    longest_interval_s: float = 1.0
    grace_s: float = 3.0
    """So long after its timeout it is asked what became of a request."""
    most_closing: int = 5
    """So often is Idle sent where nothing comes back."""
    says_idle: bool = True
    """Whether each Done is answered with Idle (OPC 10000-14 6.2.11.2.2, figure 27), or only one that is repeated."""
    refusal_wait_s: float = 0.0
    """So long after a refusal it is listened whether another responder accepts the request; then the refusal counts."""


class _Phase(Enum):
    ASKING = "asking"
    CLOSING = "closing"


@dataclass(slots=True)
class _Exchange:
    """What is said of a request at present."""

    phase: _Phase
    deadline: float
    give_up: float
    """When Unknown is the outcome; never once there is another."""
    next_at: float
    arguments: PackedFields
    sent: int = 0
    """Messages of this phase, since the last answer."""
    copies: int = 0
    """Requests that were sent."""
    refused: RequestOutcome | None = None
    """A refusal that counts at `next_at`, unless an acceptance comes before."""


class ActionRequestor:
    """Asks responders for executions. `now` is a monotonic clock in seconds, `utc` the wall clock in ticks.

    Whatever the journal cannot write raises StorageUnavailable; then nothing has happened.
    """

    def __init__(
        self,
        name: RequestorName,
        journal: RequestorJournal,
        *,
        pace: RequestPace = RequestPace(),
        must_be_verified: bool = False,
        most_remembered: int = 10_000,
    ) -> None:
        """Make a requestor that goes on where its journal ends; call `resume` before all else.

        Args:
            name: RequestorId of this process.
            journal: of this requestor alone.
            pace: of repetition.
            must_be_verified: responses without the signature of the command group are not looked at.
            most_remembered: requests that are kept. The oldest with an outcome are forgotten; their ids must not come
                back, since `start` would then ask anew.
        """
        self._name, self._journal, self._pace = name, journal, pace
        self._must_be_verified = must_be_verified
        self._most_remembered = most_remembered
        self._requests = {request.execution_id: request for request in journal.requests()}
        self._last_issued = max((request.issued for request in self._requests.values()), default=0)
        self._exchanges: dict[bytes, _Exchange] = {}
        self._prepared = PreparedRequests[RecordedRequest]()
        self._unanswered: dict[bytes, int] = {}
        """Copies of closed requests whose answers may come yet, the oldest first; of a pace without Idle."""
        self._contradicted: dict[bytes, None] = {}
        """Executions of which that was told, the oldest first."""

    def outcome(self, execution_id: bytes) -> RequestOutcome | None:
        """What is known of a request; None while it is asked for, KeyError where it was never made or is forgotten."""
        return self._requests[execution_id].outcome

    def target(self, execution_id: bytes) -> Target:
        """What a request was asked of; KeyError where it was never made or is forgotten."""
        return self._requests[execution_id].target

    def resume(self, now: float, utc: int, withdrawn: Collection[bytes] = ()) -> list[RequestorEffect]:
        """After a restart: ask on for all requests without an outcome.

        Args:
            now: monotonic seconds.
            utc: ticks.
            withdrawn: executions that must not begin any more; of them it is only asked what they have come to.
        """
        effects: list[RequestorEffect] = []
        for request in list(self._requests.values()):
            if request.outcome is None and request.execution_id in withdrawn and request.timeout_ms > 0:
                self._journal.withdrawn(request.execution_id)
                request = self._requests[request.execution_id] = request._replace(timeout_ms=0)
            if request.outcome is None:
                timeout_s = request.timeout_ms / 1000
                left_s = (request.issued - utc) / TICKS_PER_SECOND + timeout_s
                effects += self._ask(request, now, now + min(max(left_s, 0.0), timeout_s))
        return effects

    def start(
        self,
        execution_id: bytes,
        target: Target,
        types: tuple[int, ...],
        values: tuple[Any, ...],
        timeout_s: float,
        now: float,
        utc: int,
        *,
        version: int = 0,
    ) -> list[RequestorEffect]:
        """Ask for an execution. Said again for an id that is known, it asks for nothing: the outcome is what it was.

        `version` is the major one of the announcement by which the values were put in order; 0 says none.

        Raises:
            SkillRejected: the id has not 16 bytes, or belongs to another request, or the timeout is none.
            LocalWireError: the values do not fit their types.
        """
        known = self._requests.get(execution_id)
        if known is not None:
            if (known.target, known.content) != (target, pack(types, values)):
                raise SkillRejected(f"execution {execution_id.hex()} is another request already")
            return [] if known.outcome is None else [Concluded(execution_id, known.outcome)]
        self._make_room()
        if execution_id in self._prepared:
            self._journal.forget_requests([execution_id])
            self._prepared.left_out([execution_id])
        arguments = pack_fields(types, values)
        request = self._new(execution_id, target, arguments, timeout_s, utc, version)
        self._journal.requested(request)
        self._requests[execution_id] = request
        return self._ask(request, now, now + request.timeout_ms / 1000, arguments)

    def prepare(
        self,
        execution_id: bytes,
        target: Target,
        types: tuple[int, ...],
        values: tuple[Any, ...],
        timeout_s: float,
        utc: int,
        *,
        version: int = 0,
    ) -> RecordedRequest | None:
        """The record of a request that the owner writes down; None where one of this id was. Raises as `start` does."""
        if execution_id in self._requests or execution_id in self._prepared:
            return None
        return self._new(execution_id, target, pack_fields(types, values), timeout_s, utc, version)

    def prepared(self, requests: Iterable[RecordedRequest]) -> None:
        """These were written down; nothing was sent."""
        for request in requests:
            self._prepared.add(request.execution_id, request)

    def is_prepared(self, execution_id: bytes) -> bool:
        """Whether `begin` would send a request."""
        return self._prepared.is_next(execution_id)

    def begin(self, execution_id: bytes, now: float) -> list[RequestorEffect]:
        """Ask for what is prepared; KeyError where it is not."""
        self._make_room()
        request = self._requests[execution_id] = self._prepared.take(execution_id)
        return self._ask(request, now, now + request.timeout_ms / 1000)

    def leave(self, execution_id: bytes) -> None:
        """What is prepared is not to be sent; where nothing is, nothing happens."""
        self._prepared.leave(execution_id)

    @property
    def left(self) -> tuple[bytes, ...]:
        """What was written down and left: the owner deletes it, and calls `left_out`."""
        return self._prepared.left

    def left_out(self, execution_ids: Iterable[bytes]) -> None:
        """These are not written down any more."""
        self._prepared.left_out(execution_ids)

    def withdraw(self, execution_id: bytes, now: float) -> list[RequestorEffect]:
        """Have a request that nobody has answered yet begun no more: from now on it only asks.

        Where the journal cannot write that, it holds until a restart.
        """
        exchange = self._exchanges.get(execution_id)
        if exchange is None or exchange.phase is not _Phase.ASKING or exchange.deadline <= now or exchange.refused:
            return []
        exchange.deadline = exchange.next_at = now
        self._journal.withdrawn(execution_id)
        request = self._requests[execution_id] = self._requests[execution_id]._replace(timeout_ms=0)
        return [self._say(request, exchange, now)]

    def inquire(self, execution_id: bytes, now: float) -> list[RequestorEffect]:
        """Ask once more what became of a request that nobody has answered, and have it begun no more.

        The outcome is told again, also where it is Unknown still. Nothing happens where another one is known, or while
        it is asked for; KeyError where it was never made or is forgotten.
        """
        request = self._requests[execution_id]
        if execution_id in self._exchanges or request.outcome != _NO_ANSWER:
            return []
        return self._ask(request, now, now)

    def receive(self, message: ActionMessage, now: float, *, verified: bool = False) -> list[RequestorEffect]:
        """Take a response with its `others`. What is not for us is left alone."""
        if message.is_request or message.requestor_id != self._name.text or (self._must_be_verified and not verified):
            return []
        request = self._requests.get(message.correlation_data or b"")
        if request is None:
            return []
        for part in (message, *message.others):  # one at most is ours: each of our requests has a message of its own
            if part.request_id == REQUEST_ID and _target_of(part) == request.target:
                return self._receive_one(request, part, now)
        return []

    def poll(self, now: float) -> list[RequestorEffect]:
        """What time has brought: repetitions, and requests that are given up."""
        effects: list[RequestorEffect] = []
        for execution_id, exchange in list(self._exchanges.items()):
            request = self._requests[execution_id]
            if exchange.refused is not None:
                if now < exchange.next_at:
                    continue
                try:
                    effects += self._conclude(request, exchange.refused)
                except StorageUnavailable:
                    exchange.next_at = now + self._pace.longest_interval_s
                    if not effects:
                        raise
                    break  # what was journaled before has to be told
                effects += self._close(request, exchange, now)
            elif now >= exchange.give_up:
                try:
                    again = request.outcome is not None  # an inquiry: it is as unknown as it was
                    effects += [Concluded(execution_id, _NO_ANSWER)] if again else self._conclude(request, _NO_ANSWER)
                except StorageUnavailable:
                    exchange.give_up = exchange.next_at = now + self._pace.longest_interval_s
                    if not effects:
                        raise
                    break  # what was journaled before has to be told
                del self._exchanges[execution_id]
            elif exchange.next_at > now:
                continue
            elif exchange.phase is _Phase.CLOSING and exchange.sent >= self._pace.most_closing:
                del self._exchanges[execution_id]
            else:
                effects.append(self._say(request, exchange, now))
        return effects

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        nearest = math.inf
        for exchange in self._exchanges.values():
            due = exchange.next_at
            if exchange.refused is None and exchange.give_up < due:
                due = exchange.give_up
            if due < nearest:
                nearest = due
        return None if nearest == math.inf else nearest

    def _new(
        self,
        execution_id: bytes,
        target: Target,
        arguments: PackedFields,
        timeout_s: float,
        utc: int,
        version: int,
    ) -> RecordedRequest:
        """A request with the next issue time; raises as `start` does."""
        timeout_ms = round(timeout_s * 1000)
        if len(execution_id) != EXECUTION_ID_BYTES:
            raise SkillRejected(f"an execution id has {EXECUTION_ID_BYTES} bytes, not {len(execution_id)}")
        if timeout_ms <= 0:
            raise SkillRejected(f"a request needs a timeout of 1 ms at least, not {timeout_s} s")
        # No responder takes what is issued far ahead of its clock: issue times go back with ours where it was set back.
        is_set_back = self._last_issued - utc > _MOST_AHEAD_S * TICKS_PER_SECOND
        self._last_issued = utc if is_set_back else max(utc, self._last_issued + 1)
        return RecordedRequest(execution_id, target, arguments.content, self._last_issued, timeout_ms, version=version)

    def _ask(
        self, request: RecordedRequest, now: float, deadline: float, arguments: PackedFields | None = None
    ) -> list[RequestorEffect]:
        """Begin to ask; without its arguments a request is one of the journal, and they are read from its content."""
        give_up = deadline + self._pace.grace_s
        if arguments is None:
            arguments = unpack_fields(request.content)
        exchange = _Exchange(_Phase.ASKING, deadline, give_up, now, arguments)
        self._exchanges[request.execution_id] = exchange
        return [self._say(request, exchange, now)]

    def _say(self, request: RecordedRequest, exchange: _Exchange, now: float) -> Send:
        """The message of the present phase, and when it is due again."""
        pause = min(self._pace.interval_s * 2.0 ** min(exchange.sent, 32), self._pace.longest_interval_s)
        exchange.sent += 1
        exchange.next_at = now + pause
        if exchange.phase is _Phase.CLOSING:
            return Send(self._message(request, ActionState.IDLE))
        exchange.copies += 1
        hint_ms = 0.0
        if now < exchange.deadline:
            exchange.next_at = min(exchange.next_at, exchange.deadline)
            hint_ms = float(request.timeout_ms)
        message = self._message(request, ActionState.EXECUTING)
        return Send(
            message._replace(
                timeout_hint_ms=hint_ms,
                types=exchange.arguments.types,
                values=exchange.arguments,
                timestamp=request.issued,
                major_version=request.version or None,
            )
        )

    def _message(self, request: RecordedRequest, state: ActionState) -> ActionMessage:
        target = request.target
        return ActionMessage(
            target.publisher_id,
            target.writer_group_id,
            target.data_set_writer_id,
            target.action_target_id,
            REQUEST_ID,
            state,
            is_request=True,
            requestor_id=self._name.text,
            correlation_data=request.execution_id,
        )

    def _receive_one(self, request: RecordedRequest, message: ActionMessage, now: float) -> list[RequestorEffect]:
        exchange = self._exchanges.get(request.execution_id)
        if message.action_state == ActionState.DONE:
            return self._receive_done(request, exchange, message, now)
        if exchange is None:
            return []
        if exchange.refused is not None:
            return []
        if message.action_state == ActionState.EXECUTING and exchange.phase is _Phase.ASKING:
            # It repeats that by itself; should it fall silent, it was started anew and has to be asked again.
            exchange.sent = 0
            exchange.next_at = now + self._pace.longest_interval_s
            if now < exchange.deadline:
                exchange.next_at = min(exchange.next_at, exchange.deadline)
        elif message.action_state == ActionState.IDLE and exchange.phase is _Phase.CLOSING:
            del self._exchanges[request.execution_id]
        return []

    def _receive_done(
        self, request: RecordedRequest, exchange: _Exchange | None, message: ActionMessage, now: float
    ) -> list[RequestorEffect]:
        outcome = outcome_of(read_answer(message))
        told = request.outcome
        before = exchange.refused if exchange is not None and exchange.refused is not None else told
        effects: list[RequestorEffect] = []
        if before is not None and {before.kind, outcome.kind} == _CONTRADICTION:
            if outcome.kind is OutcomeKind.ACCEPTED and told is before:
                effects += self._conclude(request, outcome)
            effects += self._contradicts(request)
        if exchange is not None and exchange.phase is _Phase.CLOSING:
            return effects  # Idle is repeated anyway
        if exchange is not None and told is None and outcome.kind is OutcomeKind.REFUSED and self._pace.refusal_wait_s:
            if exchange.refused is None:
                exchange.refused, exchange.next_at = outcome, now + self._pace.refusal_wait_s
            return effects
        if told is None or (told.kind is OutcomeKind.UNKNOWN and outcome.kind is not OutcomeKind.UNKNOWN):
            effects += self._conclude(request, outcome)
        if exchange is None:
            is_repeated = not self._is_answer_to_copy(request.execution_id)
            return [*effects, Send(self._message(request, ActionState.IDLE))] if is_repeated else effects
        return [*effects, *self._close(request, exchange, now)]

    def _close(self, request: RecordedRequest, exchange: _Exchange, now: float) -> list[RequestorEffect]:
        if not self._pace.says_idle:
            del self._exchanges[request.execution_id]
            if exchange.copies > 1:
                self._unanswered[request.execution_id] = exchange.copies - 1
                if len(self._unanswered) > self._most_remembered:
                    del self._unanswered[next(iter(self._unanswered))]
            return []
        exchange.phase, exchange.give_up, exchange.sent, exchange.refused = _Phase.CLOSING, math.inf, 0, None
        return [self._say(request, exchange, now)]

    def _is_answer_to_copy(self, execution_id: bytes) -> bool:
        """Whether a further Done may answer a request that was repeated before the first one came."""
        left = self._unanswered.pop(execution_id, 0)
        if left > 1:
            self._unanswered[execution_id] = left - 1
        return left > 0

    def _contradicts(self, request: RecordedRequest) -> list[RequestorEffect]:
        """Once for each request: both answers are repeated."""
        if request.execution_id in self._contradicted:
            return []
        self._contradicted[request.execution_id] = None
        if len(self._contradicted) > self._most_remembered:
            del self._contradicted[next(iter(self._contradicted))]
        return [Contradicted(request.execution_id, request.target)]

    def _conclude(self, request: RecordedRequest, outcome: RequestOutcome) -> list[RequestorEffect]:
        self._journal.concluded(request.execution_id, outcome)
        self._requests[request.execution_id] = request._replace(outcome=outcome)
        kind: Callable[[bytes, RequestOutcome], RequestorEffect] = (
            Concluded if request.outcome is None else OutcomeCorrected
        )
        return [kind(request.execution_id, outcome)]

    def _make_room(self) -> None:
        """Forget the oldest requests that are closed, an eighth at a time."""
        if len(self._requests) < self._most_remembered:
            return
        newest = max(request.issued for request in self._requests.values())  # from which issue times go on
        closed = [
            execution_id
            for execution_id, request in self._requests.items()
            if request.outcome is not None and execution_id not in self._exchanges and request.issued != newest
        ]
        oldest = closed[: -(-self._most_remembered // 8)]
        if oldest:
            self._journal.forget_requests(oldest)
            for execution_id in oldest:
                del self._requests[execution_id]


def _target_of(message: ActionMessage) -> Target | None:
    if not isinstance(message.publisher_id, int) or message.writer_group_id is None:
        return None
    return Target(message.publisher_id, message.writer_group_id, message.data_set_writer_id, message.action_target_id)
