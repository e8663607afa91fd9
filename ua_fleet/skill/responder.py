"""The responder of Actions: has each execution begun once at most, and says the same of it however often it is asked.

States of an execution; every arrow is journaled before anybody hears of it, and before the robot is told:

    state     event                                                   then
    (none)    request that is late, or only asks (TimeoutHint 0)      TIMED_OUT: never begun, whatever comes later
    (none)    request that must not or cannot begin                   REFUSED: the same
    (none)    request that may begin                                  RUNNING, Execute
    RUNNING   `refused`: the robot's side could not begin it          REFUSED; nobody was told that it was accepted yet
    RUNNING   `ended`                                                 DONE, FAILED or UNKNOWN
    RUNNING   restart                                                 ASKING, Query (not journaled: it follows)
    RUNNING   `suspended`: the robot stands in the middle of it       SUSPENDED (not journaled: it is asked again)
    SUSPENDED `resumed`                                               RUNNING
    SUSPENDED `ended`                                                 DONE, FAILED or UNKNOWN
    ASKING    `running`: the robot is still at it                     RUNNING
    ASKING    `suspended`                                             SUSPENDED
    ASKING    `ended`                                                 DONE, FAILED or UNKNOWN (the robot cannot tell)
    ASKING    `not_begun`: the robot says for sure that it is not     RUNNING, Execute; TIMED_OUT where it is late
    UNKNOWN   `ended`: it can be told after all                       DONE or FAILED
    any       the same request again                                  what is recorded is said again
    any       another request with this id                            refused; the record stays

What is said of it (OPC 10000-14 6.2.11.2.2; of table 84 only the requestor's counterpart could be read): Executing
while there is nothing to say yet, then Done with what is recorded, repeated in the interval until the requestor sends
Idle, which is answered with Idle, or until it falls silent. An Action accepts or refuses, so Done comes at once; of an
immediate skill it comes with the end, or with "running" shortly before the requestor's timeout.

Forgetting is safe. A request has an issue time that belongs to its execution id, and those of one space strictly
increase. When an execution is forgotten, its issue time becomes the space's mark; a request at or below the mark that
is not remembered is answered with Unknown and never begun, for it may be one that was forgotten. So nothing depends on
how long a datagram can be on its way, or on clocks that agree.

Clocks matter for lateness alone: issue time plus TimeoutHint, with a tolerance. A clock that differs by more than that
has requests refused, with both times in the message, rather than begun late. A halt is never late or early.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError, StorageUnavailable
from ua_fleet.skill.exchanges import Exchanges, Respond, answer
from ua_fleet.skill.executions import (
    EXECUTION_ID_BYTES,
    OPEN,
    ExecutionReport,
    ExecutionState,
    RequestorName,
    Target,
    is_control,
    is_halt,
    is_same_content,
    pack,
)
from ua_fleet.skill.journal import RecordedExecution, ResponderJournal
from ua_fleet.skill.offers import ActionOffers, Offer, OfferDecision
from ua_fleet.values import TICKS_PER_SECOND, StatusCode
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.packed_fields import PackedFields, unpack_fields

__all__ = [
    "ActionResponder",
    "Execute",
    "ExecutionChanged",
    "Offer",
    "Query",
    "Respond",
    "ResponderEffect",
    "ResponderLimits",
]

_S: Final = ExecutionState
TRANSITIONS: Final = {
    None: frozenset({_S.RUNNING, _S.REFUSED, _S.TIMED_OUT}),
    _S.RUNNING: frozenset({_S.DONE, _S.FAILED, _S.UNKNOWN, _S.REFUSED}),
    _S.SUSPENDED: frozenset({_S.DONE, _S.FAILED, _S.UNKNOWN}),
    _S.ASKING: frozenset({_S.RUNNING, _S.DONE, _S.FAILED, _S.UNKNOWN, _S.TIMED_OUT}),
    _S.UNKNOWN: frozenset({_S.DONE, _S.FAILED}),
    _S.DONE: frozenset[ExecutionState](),
    _S.FAILED: frozenset[ExecutionState](),
    _S.REFUSED: frozenset[ExecutionState](),
    _S.TIMED_OUT: frozenset[ExecutionState](),
}
"""What of the table above is journaled: from each state, None for an execution that is not known."""


@dataclass(frozen=True, slots=True)
class ResponderLimits:
    """What a responder takes at most, and its pace."""

    requests_at_once: int = 64
    """Executions under way, of all offers together."""
    most_remembered: int = 1000
    """Executions that are remembered; the oldest that are over are forgotten."""
    clock_tolerance_s: float = 10.0
    """So far clocks may differ."""
    late_tolerance_s: float | None = None
    """So long after its TimeoutHint a request is taken; None: as far as clocks may differ, since UDP keeps nothing."""
    interval_s: float = 0.1
    """PublishingInterval."""
    most_repeats: int = 5
    """So often is Done repeated where nothing comes back."""


@dataclass(frozen=True, slots=True)
class Execute:
    """Tell the robot, once. Then say `begun`, or `refused` where nothing was begun."""

    execution: RecordedExecution
    decoded: tuple[Any, ...] | None = field(default=None, compare=False)
    """The arguments that the execution's content was decoded into; None: it is of the journal, or was packed here."""

    def arguments(self) -> tuple[Any, ...]:
        """The arguments of the execution."""
        return tuple(unpack_fields(self.execution.content) if self.decoded is None else self.decoded)


@dataclass(frozen=True, slots=True)
class Query:
    """Find out what became of an execution. Then say `running`, `ended` or `not_begun`."""

    execution: RecordedExecution


@dataclass(frozen=True, slots=True)
class ExecutionChanged:
    """An execution is new, or has a new state: for SkillStatus."""

    execution: RecordedExecution


ResponderEffect = Execute | Query | Respond | ExecutionChanged


class ActionResponder:
    """Answers the requests to one space. `now` is a monotonic clock in seconds, `utc` the wall clock in ticks.

    Effects are to be carried out in their order. Whatever the journal cannot write raises StorageUnavailable; then
    nothing has happened, and the requestor asks again.
    """

    def __init__(
        self,
        space: int,
        journal: ResponderJournal,
        counters: Counters,
        *,
        offers: Iterable[Offer] = (),
        allowed_spaces: Iterable[int] = (0,),
        must_be_verified: bool = False,
        limits: ResponderLimits = ResponderLimits(),
    ) -> None:
        """Make a responder that goes on where its journal ends; call `recover` before all else.

        Args:
            space: PublisherId of this process.
            journal: of this responder alone.
            counters: requests that are dropped are counted here.
            offers: what can be asked for; more and fewer with `offer` and `withdraw`.
            allowed_spaces: whose requestors may command.
            must_be_verified: whether keys are configured: a request that does not carry the signature of the command
                group is dropped then.
            limits: what is taken at most.
        """
        if limits.most_remembered <= limits.requests_at_once:
            raise ValueError("a responder remembers more executions than it takes at once")
        self._space, self._journal, self._counters, self._limits = space, journal, counters, limits
        self._allowed = frozenset(allowed_spaces)
        self._must_be_verified = must_be_verified
        self._executions = {execution.execution_id: execution for execution in journal.executions()}
        self._offers = ActionOffers(offers, self._executions.values())
        self._under_way = {key for key, execution in self._executions.items() if execution.report.state in OPEN}
        self._forgotten = dict(journal.forgotten())
        self._to_begin: set[bytes] = set()
        """Executions whose Execute was not confirmed yet."""
        self._exchanges = Exchanges(limits.interval_s, limits.most_repeats)

    def offer(self, offer: Offer) -> None:
        """Take requests for it from now on."""
        self._offers.put(offer)

    def withdraw(self, target: Target) -> None:
        """Refuse requests for it from now on."""
        self._offers.remove(target)

    def executions(self) -> list[RecordedExecution]:
        """All that are remembered, in the order in which they came."""
        return list(self._executions.values())

    def execution(self, execution_id: bytes) -> RecordedExecution | None:
        """One of them; None where it is not remembered."""
        return self._executions.get(execution_id)

    def learn(self, executions: Collection[RecordedExecution]) -> list[ResponderEffect]:
        """Know what else the journal has now, from a run before, and ask the robots about it as in `recover`."""
        self._executions |= {execution.execution_id: execution for execution in executions}
        self._under_way |= {one.execution_id for one in executions if one.report.state in OPEN}
        self._forgotten = dict(self._journal.forgotten())
        self._offers.learn(executions)
        return self._asked_about(executions)

    def recover(self) -> list[ResponderEffect]:
        """After a restart: ask the robots about executions without an end."""
        return self._asked_about(self.executions())

    def _asked_about(self, executions: Iterable[RecordedExecution]) -> list[ResponderEffect]:
        effects: list[ResponderEffect] = []
        for execution in executions:
            if execution.report.state is _S.RUNNING:
                asking = execution._replace(report=execution.report._replace(state=_S.ASKING))
                self._executions[execution.execution_id] = asking
                effects += [ExecutionChanged(asking), Query(asking)]
        return effects

    def receive(
        self, message: ActionMessage, reply_to: object, now: float, utc: int, *, verified: bool = False
    ) -> list[ResponderEffect]:
        """Take a request with its `others`.

        Args:
            message: what was decoded.
            reply_to: where responses go: the ResponseAddress, else where the request came from.
            now: monotonic seconds.
            utc: ticks.
            verified: whether it carried the signature of this space's command group.
        """
        if not message.is_request or message.publisher_id != self._space:
            return []
        parts = (message, *message.others)
        if self._must_be_verified and not verified:
            self._counters.drop(Drop.NOT_SECURED, len(parts))
            return []
        name = RequestorName.parse(message.requestor_id)
        if name is None or name.space not in self._allowed:
            self._counters.drop(Drop.REQUESTOR, len(parts))
            if name is None:
                return []
            report = ExecutionReport(
                _S.REFUSED, StatusCode.BAD_USER_ACCESS_DENIED, f"space {name.space} may not command"
            )
            return [answer(part, ActionState.DONE, report, reply_to) for part in parts]
        effects: list[ResponderEffect] = []
        for part in parts:
            try:
                effects += self._receive_one(part, name, reply_to, now, utc)
            except StorageUnavailable:
                if not effects:
                    raise
                break  # what was journaled before has to be done and told
        return effects

    def halt_of(self, message: ActionMessage, *, verified: bool) -> Target | None:
        """The target of a request to halt that may be carried out, also where it cannot be recorded; else None."""
        name, target = RequestorName.parse(message.requestor_id), _target_of(message)
        if name is None or name.space not in self._allowed or (self._must_be_verified and not verified):
            return None
        asks = message.is_request and message.action_state == ActionState.EXECUTING
        is_offered = self._offers.get(target) is not None and not self._offers.is_hidden(target, name.space)
        is_wanted = asks and (message.timeout_hint_ms or 0.0) > 0 and is_halt(target)
        return target if is_wanted and is_offered else None

    def begun(self, execution_id: bytes, now: float) -> list[ResponderEffect]:
        """The robot was told: whoever asked may hear that it was accepted."""
        self._to_begin.discard(execution_id)
        return self._tell(execution_id, now)

    def refused(self, execution_id: bytes, status: int, message: str, now: float) -> list[ResponderEffect]:
        """After Execute, in place of `begun`: nothing was begun, and nothing will be."""
        if execution_id not in self._to_begin:
            return []
        return self._become(execution_id, ExecutionReport(_S.REFUSED, status, message), now)

    def running(self, execution_id: bytes) -> list[ResponderEffect]:
        """The answer to Query: the robot is still at it."""
        return self._go_over(execution_id, frozenset({_S.ASKING}), _S.RUNNING)

    def suspended(self, execution_id: bytes, message: str = "") -> list[ResponderEffect]:
        """The robot stands in the middle of it; also an answer to Query."""
        return self._go_over(execution_id, frozenset({_S.RUNNING, _S.ASKING}), _S.SUSPENDED, message)

    def resumed(self, execution_id: bytes) -> list[ResponderEffect]:
        """The robot that stood goes on."""
        return self._go_over(execution_id, frozenset({_S.SUSPENDED}), _S.RUNNING)

    def not_begun(self, execution_id: bytes, now: float, utc: int) -> list[ResponderEffect]:
        """The answer to Query: the robot knows for sure that it was never told."""
        effects = self.running(execution_id)
        if not effects:
            return []
        execution = self._executions[execution_id]
        ahead_s = (execution.issued - utc) / TICKS_PER_SECOND
        if -execution.timeout_ms / 1000 <= ahead_s <= self._limits.clock_tolerance_s:  # where no clock was set back
            self._to_begin.add(execution_id)
            return [*effects, Execute(execution)]
        self._executions[execution_id] = execution._replace(report=execution.report._replace(state=_S.ASKING))
        late = ExecutionReport(
            _S.TIMED_OUT, StatusCode.BAD_TIMEOUT, "a restart came before it began, and its time is over"
        )
        return self._become(execution_id, late, now)

    def ended(self, execution_id: bytes, report: ExecutionReport, now: float) -> list[ResponderEffect]:
        """An execution is over: DONE, FAILED, or UNKNOWN where nobody can tell. Said twice, the first counts."""
        if report.state not in (_S.DONE, _S.FAILED, _S.UNKNOWN):
            raise ValueError(f"an execution does not end as {report.state.name}")
        return self._become(execution_id, report, now)

    def poll(self, now: float) -> list[ResponderEffect]:
        """What time has brought: responses that are repeated, and immediate skills that take too long for that."""
        effects: list[ResponderEffect] = []
        for execution_id in self._exchanges.take_due(now):
            effects += self._tell(execution_id, now)
        return effects

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return self._exchanges.next_deadline()

    def _receive_one(
        self, message: ActionMessage, name: RequestorName, reply_to: object, now: float, utc: int
    ) -> list[ResponderEffect]:
        execution_id = message.correlation_data or b""
        if message.action_state == ActionState.IDLE:
            self._exchanges.close(execution_id)
            return [answer(message, ActionState.IDLE, None, reply_to)]
        if message.action_state != ActionState.EXECUTING:
            return []
        if len(execution_id) != EXECUTION_ID_BYTES or message.timestamp is None or message.timeout_hint_ms is None:
            what = f"CorrelationData of {EXECUTION_ID_BYTES} bytes, a Timestamp and a TimeoutHint"
            report = ExecutionReport(_S.REFUSED, StatusCode.BAD_INVALID_ARGUMENT, f"a request needs {what}")
            return [answer(message, ActionState.DONE, report, reply_to)]
        try:
            content = pack(message.types, message.values)
        except LocalWireError as error:  # what was decoded, but has no bytes of ours
            report = ExecutionReport(_S.REFUSED, StatusCode.BAD_NOT_SUPPORTED, str(error))
            return [answer(message, ActionState.DONE, report, reply_to)]
        execution = self._executions.get(execution_id)
        effects: list[ResponderEffect] = []
        if execution is None:
            if message.timestamp <= self._forgotten.get(name.space, -1):
                report = ExecutionReport(
                    _S.UNKNOWN, StatusCode.UNCERTAIN, "older than what is remembered; it may be done"
                )
                return [answer(message, ActionState.DONE, report, reply_to)]
            if self._offers.is_hidden(_target_of(message), name.space):
                # Not recorded: who may not ask for this must not use up the id of who may.
                self._counters.drop(Drop.REQUESTOR)
                said = f"this skill is not for space {name.space}"
                report = ExecutionReport(_S.REFUSED, StatusCode.BAD_USER_ACCESS_DENIED, said)
                return [answer(message, ActionState.DONE, report, reply_to)]
            execution = self._record(message, content, name, now, utc)
            effects.append(ExecutionChanged(execution))
            if execution.report.state is _S.RUNNING:
                self._to_begin.add(execution_id)
                decoded = message.values if isinstance(message.values, PackedFields) else None
                effects.append(Execute(execution, decoded))
        elif (execution.space, execution.target) != (name.space, _target_of(message)) or not is_same_content(
            execution.content, content
        ):
            said = "this execution id belongs to another request"
            report = ExecutionReport(_S.REFUSED, StatusCode.BAD_INVALID_ARGUMENT, said)
            return [answer(message, ActionState.DONE, report, reply_to)]
        wait_until = now
        if self._is_immediate(execution.target):
            left_s = (execution.issued - utc) / TICKS_PER_SECOND + execution.timeout_ms / 1000
            wait_until = now + max(0.0, min(left_s, execution.timeout_ms / 1000) - 2 * self._limits.interval_s)
        self._exchanges.open(execution_id, message, reply_to, wait_until, now)
        if effects and execution.report.state is _S.RUNNING:
            self._exchanges.said(execution_id, now, is_done=False)
            return effects  # `begun` and `refused` go on
        return effects + self._tell(execution_id, now)

    def _record(
        self, message: ActionMessage, content: bytes, name: RequestorName, now: float, utc: int
    ) -> RecordedExecution:
        """Decide on a new request, and journal it."""
        self._make_room()
        timestamp, hint_ms = message.timestamp or 0, message.timeout_hint_ms or 0.0
        execution = RecordedExecution(
            message.correlation_data or b"",
            name.text,
            name.space,
            _target_of(message),
            content,
            # Forgetting it must not set a mark that other requests, of a right clock, would be below.
            min(timestamp, utc + round(self._limits.clock_tolerance_s * TICKS_PER_SECOND)),
            min(round(hint_ms), 0x7FFF_FFFF),
            ExecutionReport(_S.RUNNING),
        )
        decision = self._decide(execution, message, now, utc)
        execution = execution._replace(report=decision.report)
        self._journal.recorded(execution)
        self._executions[execution.execution_id] = execution
        if execution.report.state in OPEN:
            self._under_way.add(execution.execution_id)
            self._offers.accepted(execution, now)
        elif decision.drop is not None:
            self._counters.drop(decision.drop)
        return execution

    def _decide(self, execution: RecordedExecution, message: ActionMessage, now: float, utc: int) -> OfferDecision:
        """RUNNING, or why not."""
        limits, hint_ms = self._limits, message.timeout_hint_ms or 0.0
        late_s = limits.clock_tolerance_s if limits.late_tolerance_s is None else limits.late_tolerance_s
        ahead_s = ((message.timestamp or 0) - utc) / TICKS_PER_SECOND
        if is_halt(execution.target) and hint_ms > 0:
            ahead_s = 0.0  # it names what is to stop: whatever clocks say, it can harm nothing else
        if hint_ms <= 0 or -ahead_s > hint_ms / 1000 + late_s:
            late = ExecutionReport(
                _S.TIMED_OUT, StatusCode.BAD_TIMEOUT, f"it came {-ahead_s:.3f} s after it was issued"
            )
            return OfferDecision(late, Drop.REFUSED)
        if ahead_s > limits.clock_tolerance_s:
            said = f"it was issued {ahead_s:.3f} s ahead of this clock; set the clocks of both sides"
            return OfferDecision(ExecutionReport(_S.REFUSED, StatusCode.BAD_INVALID_TIMESTAMP, said), Drop.REFUSED)
        # To halt, suspend and resume is over at once, and must not wait until there is room.
        under_way = [one for key in self._under_way if not is_control((one := self._executions[key]).target)]
        decision = self._offers.decide(
            execution, message.types, message.values, under_way, now, utc, version=message.major_version
        )
        has_room = len(under_way) < self._limits.requests_at_once or is_control(execution.target)
        if decision.report.state is _S.RUNNING and not has_room:
            said = f"{len(under_way)} executions are under way"
            return OfferDecision(ExecutionReport(_S.REFUSED, StatusCode.BAD_TOO_MANY_OPERATIONS, said), Drop.TOO_MANY)
        return decision

    def _go_over(
        self, execution_id: bytes, before: frozenset[ExecutionState], state: ExecutionState, message: str = ""
    ) -> list[ResponderEffect]:
        """Between states of what is under way: the journal says RUNNING all the time, and the robot knows better."""
        execution = self._executions.get(execution_id)
        if execution is None or execution.report.state not in before:
            return []
        execution = execution._replace(report=execution.report._replace(state=state, message=message))
        self._executions[execution_id] = execution
        return [ExecutionChanged(execution)]

    def _become(self, execution_id: bytes, report: ExecutionReport, now: float) -> list[ResponderEffect]:
        """Journal a new state and say it; nothing where the table has no such transition."""
        execution = self._executions.get(execution_id)
        if execution is None or report.state not in TRANSITIONS[execution.report.state]:
            return []
        self._journal.reported(execution_id, report)
        execution = execution._replace(report=report)
        self._executions[execution_id] = execution
        self._under_way.discard(execution_id)  # every state that the table leads to from here is an end
        self._to_begin.discard(execution_id)
        return [ExecutionChanged(execution), *self._tell(execution_id, now)]

    def _tell(self, execution_id: bytes, now: float) -> list[ResponderEffect]:
        """Say in an open exchange what there is to say now."""
        exchange = self._exchanges.get(execution_id)
        execution = self._executions.get(execution_id)
        if exchange is None:
            return []
        if execution is None:
            self._exchanges.close(execution_id)
            return []
        report = execution.report
        is_at_it = report.state in (_S.RUNNING, _S.SUSPENDED)
        waits = is_at_it and (execution_id in self._to_begin or now < exchange.wait_until)
        if report.state is _S.ASKING or waits:
            self._exchanges.said(execution_id, now, is_done=False)
            return [answer(exchange.request, ActionState.EXECUTING, None, exchange.reply_to)]
        self._exchanges.said(execution_id, now, is_done=True)
        return [answer(exchange.request, ActionState.DONE, report, exchange.reply_to)]

    def _is_immediate(self, target: Target) -> bool:
        offer = self._offers.get(target)
        return offer is not None and offer.immediate

    def _make_room(self) -> None:
        """Forget the oldest executions that are over, an eighth at a time, and mark that they are forgotten."""
        if len(self._executions) < self._limits.most_remembered:
            return
        over = sorted(
            (execution for execution in self._executions.values() if execution.report.state not in OPEN),
            key=lambda execution: execution.issued,
        )
        oldest = over[: -(-self._limits.most_remembered // 8)]
        if not oldest:
            return
        marks: dict[int, int] = {}
        for execution in oldest:
            marks[execution.space] = max(execution.issued, self._forgotten.get(execution.space, execution.issued))
        self._journal.forget_executions([execution.execution_id for execution in oldest], marks)
        self._forgotten.update(marks)
        for execution in oldest:
            del self._executions[execution.execution_id]
            self._exchanges.close(execution.execution_id)


def _target_of(message: ActionMessage) -> Target:
    """The target of a request to us; without a WriterGroupId it is none that is offered."""
    publisher_id = message.publisher_id if isinstance(message.publisher_id, int) else 0
    return Target(publisher_id, message.writer_group_id or 0, message.data_set_writer_id, message.action_target_id)
