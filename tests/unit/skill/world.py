"""One random schedule of a requestor, a responder and robots over the in-memory network, and what came of it.

Both sides crash: at any time, between any two effects, and in the journal, before and after it wrote. The network
loses, delays, reorders and duplicates, and is cut for a while. The world sees what neither side can: how often a robot
was really told, and which answers reached a requestor that lived.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from random import Random

from ua_fleet.counters import Counters
from ua_fleet.skill import (
    ActionRequestor,
    ActionResponder,
    Contradicted,
    Execute,
    ExecutionReport,
    ExecutionState,
    MemoryJournal,
    Offer,
    OutcomeCorrected,
    OutcomeKind,
    Query,
    RecordedExecution,
    RecordedRequest,
    RequestorEffect,
    RequestorName,
    RequestOutcome,
    RequestPace,
    Respond,
    ResponderEffect,
    ResponderLimits,
    Send,
    Target,
    pack,
)
from ua_fleet.skill.executions import NEVER_BEGUN
from ua_fleet.transport.base import Address
from ua_fleet.transport.memory import MemoryNetwork
from ua_fleet.values import UNIX_EPOCH_TICKS, BuiltinType, StatusCode
from ua_fleet.wire import ActionMessage, ActionState, Codec, encode_action

SPACE = 7
TICKS_AT_START = UNIX_EPOCH_TICKS + 17 * 10**15
NAME = RequestorName(0, "server")
LONG = Target(SPACE, 3, 100, 1)
IMMEDIATE = Target(SPACE, 3, 100, 2)
UNKIND = Target(SPACE, 3, 100, 3)
"""Its robot refuses to begin."""
NOWHERE = Target(SPACE, 3, 100, 9)
"""It is not offered."""
OFFERS = (
    Offer(LONG, (BuiltinType.INT32,), requests_at_once=2),
    Offer(IMMEDIATE, (BuiltinType.INT32,), immediate=True, requests_at_once=2, least_interval_s=0.5),
    Offer(UNKIND, (BuiltinType.INT32,), requests_at_once=2),
)
PACE = RequestPace(interval_s=0.1, longest_interval_s=0.4, grace_s=1.5)
LIMITS = ResponderLimits(requests_at_once=3, most_remembered=6, clock_tolerance_s=0.5, interval_s=0.1, most_repeats=3)
SET_BACK_AT = 1.5
CALM = 15.0
"""Nothing crashes any more."""
END = 60.0
"""By then all is quiet."""


class Crash(Exception):
    """This side stops here."""


class CrashingJournal(MemoryJournal):
    """Crashes now and then, before or after it wrote."""

    def __init__(self, maybe_crash: Callable[[str], None]) -> None:
        super().__init__()
        self._maybe_crash = maybe_crash

    def _write(self, name: str, write: Callable[[], None]) -> None:
        self._maybe_crash(f"before {name}")
        write()
        self._maybe_crash(f"after {name}")

    def requested(self, request: RecordedRequest) -> None:
        self._write("requested", lambda: super(CrashingJournal, self).requested(request))

    def withdrawn(self, execution_id: bytes) -> None:
        self._write("withdrawn", lambda: super(CrashingJournal, self).withdrawn(execution_id))

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self._write("concluded", lambda: super(CrashingJournal, self).concluded(execution_id, outcome))

    def recorded(self, execution: RecordedExecution) -> None:
        self._write("recorded", lambda: super(CrashingJournal, self).recorded(execution))

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        self._write("reported", lambda: super(CrashingJournal, self).reported(execution_id, report))

    def forget_executions(self, execution_ids: Collection[bytes], forgotten: Mapping[int, int]) -> None:
        self._write("forgotten", lambda: super(CrashingJournal, self).forget_executions(execution_ids, forgotten))


@dataclass
class Robot:
    """What really happened to one execution."""

    told: int = 0
    late: bool = False
    """Whether that was later than its request allows."""
    told_withdrawn: bool = False
    """Whether that was after the request was withdrawn, and nothing of it on its way any more."""
    tells: bool = True
    """Whether it can say later what became of an execution."""
    report: ExecutionReport | None = None


@dataclass
class Wish:
    """One execution that the application wants."""

    execution_id: bytes
    target: Target
    argument: int
    timeout_s: float
    robot: Robot
    lasts_s: float
    outcome: RequestOutcome | None = None
    answered: bool = False
    """A Done for it reached the requestor while it still asked, and it lived to journal that."""
    from_silence: bool = False
    withdrawn_at: float | None = None
    """When the requestor said that it must not be begun any more."""


@dataclass(frozen=True)
class Makers:
    """What the two sides are made of; a test puts something wrong in their place."""

    requestor: type[ActionRequestor] = ActionRequestor
    responder: type[ActionResponder] = ActionResponder
    journal: type[CrashingJournal] = CrashingJournal
    pace: RequestPace = PACE
    limits: ResponderLimits = LIMITS
    set_back_s: float = 0.0
    """So far the clock of both sides is set back in the middle of the schedule."""


@dataclass
class Result:
    """What came of a schedule."""

    wishes: list[Wish]
    seen: Counter[str] = field(default_factory=Counter[str])
    problems: list[str] = field(default_factory=list[str])


class World:
    """One schedule."""

    def __init__(self, seed: int, *, through_codec: bool = False, makers: Makers = Makers()) -> None:
        chance = self.chance = Random(seed)
        self.seen: Counter[str] = Counter()
        self.crashes: Counter[str] = Counter()
        self.network = MemoryNetwork(
            chance.getrandbits(32),
            loss=chance.choice((0.0, 0.1, 0.3, 0.6)),
            duplicate=chance.choice((0.0, 0.3)),
            max_delay_s=chance.choice((0.0, 0.05, 0.5, 2.0)),
        )
        self._codec = Codec() if through_codec else None
        self._carried: list[ActionMessage] = []
        self._makers = makers
        self._crash = chance.choice((0.0, 0.0, 0.02, 0.1))
        self._skew_ticks = chance.choice((0, 0, -3_000_000, 3_000_000))
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._here, self._there = self.network.endpoint(), self.network.endpoint()
        self._requestor: ActionRequestor | None = None
        self._responder: ActionResponder | None = None
        self._requestor_journal = makers.journal(self._maybe_crash)
        self._responder_journal = makers.journal(self._maybe_crash)
        self.wishes: dict[bytes, Wish] = {}
        self.quiet = not makers.set_back_s
        """No crash, no loss, no cut: nothing can justify Unknown."""
        self._plan()

    @property
    def now(self) -> float:
        return self.network.now

    def _utc(self, skew_ticks: int = 0) -> int:
        back_s = self._makers.set_back_s if self.now >= SET_BACK_AT else 0.0
        return TICKS_AT_START + round((self.now - back_s) * 10_000_000) + skew_ticks

    def _at(self, when: float, what: Callable[[], None]) -> None:
        heapq.heappush(self._events, (when, next(self._order), what))

    def _plan(self) -> None:
        chance = self.chance
        self._at(0.0, self._responder_up)
        self._at(0.0, self._requestor_up)
        tells = chance.random() < 0.7
        for number in range(chance.choice((1, 2, 3, 8))):
            target = chance.choice((LONG, LONG, IMMEDIATE, UNKIND, NOWHERE))
            wish = Wish(
                chance.randbytes(16),
                target,
                number,
                chance.choice((0.2, 1.0, 2.0)),
                Robot(tells=tells),
                chance.choice((0.05, 0.6, 3.0)),
            )
            self.wishes[wish.execution_id] = wish
            when = chance.uniform(0.0, 3.0)
            self._at(when, partial(self._wish, wish))
            if chance.random() < 0.2:
                self._at(when + chance.uniform(0.0, 2.0), partial(self._wish, wish))
            if chance.random() < 0.2:
                self._at(when + chance.uniform(0.0, 1.5), partial(self._withdraw, wish))
        if self._crash:
            for down in (self._requestor_down, self._responder_down):
                if chance.random() < 0.3:
                    self._at(chance.uniform(0.0, 5.0), down)
        if chance.random() < 0.15:
            begin = chance.uniform(0.0, 3.0)
            self.quiet = False
            self._at(begin, lambda: self._reach(reachable=False))
            self._at(begin + chance.choice((0.5, 5.0)), lambda: self._reach(reachable=True))
        if self.network.loss or self._crash or self.network.max_delay_s > 0.1 or self._skew_ticks:
            self.quiet = False

    def _reach(self, *, reachable: bool) -> None:
        self._there.reachable = reachable

    # The requestor's process

    def _requestor_up(self) -> None:
        self._here.attach(self._hear_response)
        self._requestor = self._makers.requestor(NAME, self._requestor_journal, pace=self._makers.pace)
        self._in_requestor(lambda requestor: requestor.resume(self.now, self._utc()))
        for request in self._requestor_journal.requests():  # an application reads outcomes that were not told
            if request.outcome is not None:
                self._learn(request.execution_id, request.outcome)

    def _requestor_down(self) -> None:
        if self._requestor is not None:
            self.seen["requestor restarted"] += 1
            self._requestor = None
            self._here.detach()
            self._at(self.now + self.chance.choice((0.05, 1.0, 4.0)), self._requestor_up)

    def _start(self, requestor: ActionRequestor, wish: Wish) -> list[RequestorEffect]:
        types, values = (BuiltinType.INT32,), (wish.argument,)
        return requestor.start(wish.execution_id, wish.target, types, values, wish.timeout_s, self.now, self._utc())

    def _prepare(self, requestor: ActionRequestor, wish: Wish) -> list[RequestorEffect]:
        """As the owner does that writes requests down with what they follow from."""
        types, values = (BuiltinType.INT32,), (wish.argument,)
        request = requestor.prepare(wish.execution_id, wish.target, types, values, wish.timeout_s, self._utc())
        if request is None:
            return self._start(requestor, wish)
        self._requestor_journal.requested(request)
        requestor.prepared([request])
        return requestor.begin(wish.execution_id, self.now)

    def _wish(self, wish: Wish) -> None:
        if self._requestor is None:
            self._at(self.now + 0.5, lambda: self._wish(wish))
            return
        is_prepared = wish.execution_id[-1] % 2 == 1
        self._in_requestor(
            lambda requestor: self._prepare(requestor, wish) if is_prepared else self._start(requestor, wish)
        )
        if all(request.execution_id != wish.execution_id for request in self._requestor_journal.requests()):
            self._at(self.now + 0.5, lambda: self._wish(wish))  # the application never heard that it was journaled

    def _withdraw(self, wish: Wish) -> None:
        self._in_requestor(lambda requestor: requestor.withdraw(wish.execution_id, self.now))
        wish_is_there = self._requestor is not None and wish.execution_id in {
            request.execution_id for request in self._requestor_journal.requests()
        }
        if wish_is_there and wish.outcome is None:
            wish.withdrawn_at = self.now

    def _hear_response(self, datagram: bytes, _: Address) -> None:
        message = self._unwrap(datagram)
        wish = self.wishes.get(message.correlation_data or b"")
        in_time = wish is not None and wish.outcome is None
        self._in_requestor(lambda requestor: requestor.receive(message, self.now))
        said = not message.is_request and message.action_state == ActionState.DONE
        if wish is not None and in_time and said and self._requestor is not None:
            wish.answered = True

    def _in_requestor(self, step: Callable[[ActionRequestor], Iterable[RequestorEffect]]) -> None:
        if self._requestor is None:
            return
        try:
            for effect in step(self._requestor):
                self._maybe_crash("requestor between effects")
                if isinstance(effect, Send):
                    self._here.send(self._wrap(effect.message))
                else:
                    assert not isinstance(effect, Contradicted), "one responder has refused and accepted one execution"
                    self.seen["corrected"] += isinstance(effect, OutcomeCorrected)
                    self._learn(effect.execution_id, effect.outcome)
        except Crash:
            self._requestor_down()

    def _learn(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        wish = self.wishes[execution_id]
        if wish.outcome is not None and wish.outcome.kind is not OutcomeKind.UNKNOWN and wish.outcome != outcome:
            self.seen["contradicted"] += 1
        wish.outcome = outcome
        wish.from_silence = outcome.report.status == StatusCode.BAD_NO_COMMUNICATION

    # The responder's process, and the robots behind it

    def _responder_up(self) -> None:
        self._there.attach(self._hear_request)
        self._responder = self._makers.responder(
            SPACE, self._responder_journal, Counters(), offers=OFFERS, limits=self._makers.limits
        )
        self._in_responder(lambda responder: responder.recover())

    def _responder_down(self) -> None:
        if self._responder is not None:
            self.seen["responder restarted"] += 1
            self._responder = None
            self._there.detach()
            self._at(self.now + self.chance.choice((0.05, 1.0, 4.0)), self._responder_up)

    def _hear_request(self, datagram: bytes, sender: Address) -> None:
        message = self._unwrap(datagram)
        utc = self._utc(self._skew_ticks)
        self._in_responder(lambda responder: responder.receive(message, sender, self.now, utc))

    def _in_responder(self, step: Callable[[ActionResponder], Iterable[ResponderEffect]]) -> None:
        if self._responder is None:
            return
        try:
            for effect in step(self._responder):
                self._maybe_crash("responder between effects")
                if isinstance(effect, Respond):
                    self._there.send(self._wrap(effect.message))
                elif isinstance(effect, Execute):
                    self._execute(effect.execution)
                elif isinstance(effect, Query):
                    self._query(effect.execution.execution_id)
        except Crash:
            self._responder_down()

    def _execute(self, execution: RecordedExecution) -> None:
        execution_id, wish = execution.execution_id, self.wishes[execution.execution_id]
        if wish.target == UNKIND:
            status = StatusCode.BAD_NOT_EXECUTABLE
            self._in_responder(lambda responder: responder.refused(execution_id, status, "no", self.now))
            return
        deadline = execution.issued + execution.timeout_ms * 10_000 + round(LIMITS.clock_tolerance_s * 10_000_000)
        wish.robot.late = wish.robot.late or self._utc(self._skew_ticks) > deadline
        wish.robot.told += 1
        on_its_way_s = self.network.max_delay_s + 0.001
        if wish.withdrawn_at is not None and self.now > wish.withdrawn_at + on_its_way_s and not self._crash:
            wish.robot.told_withdrawn = True
        self._at(self.now + wish.lasts_s, lambda: self._robot_ends(wish))
        self._maybe_crash("responder when the robot was told")
        self._in_responder(lambda responder: responder.begun(execution_id, self.now))

    def _robot_ends(self, wish: Wish) -> None:
        if wish.argument % 4 == 3:
            wish.robot.report = ExecutionReport(ExecutionState.FAILED, StatusCode.BAD_OUT_OF_SERVICE, "it fell over")
        else:
            result = pack((BuiltinType.INT32,), (wish.argument * 2,))
            wish.robot.report = ExecutionReport(ExecutionState.DONE, StatusCode.GOOD, "", result)
        report = wish.robot.report
        self._in_responder(lambda responder: responder.ended(wish.execution_id, report, self.now))

    def _query(self, execution_id: bytes) -> None:
        self.seen["queried"] += 1
        robot = self.wishes[execution_id].robot
        if not robot.tells:
            lost = ExecutionReport(ExecutionState.UNKNOWN, StatusCode.UNCERTAIN, "the robot cannot tell")
            self._in_responder(lambda responder: responder.ended(execution_id, lost, self.now))
        elif not robot.told:
            utc = self._utc(self._skew_ticks)
            self._in_responder(lambda responder: responder.not_begun(execution_id, self.now, utc))
        elif robot.report is None:
            self._in_responder(lambda responder: responder.running(execution_id))
        else:
            report = robot.report
            self._in_responder(lambda responder: responder.ended(execution_id, report, self.now))

    # The network between them

    def _maybe_crash(self, where: str) -> None:
        if self._crash and self.now < CALM and self.chance.random() < self._crash:
            self.crashes[where] += 1
            raise Crash

    def _wrap(self, message: ActionMessage) -> bytes:
        if self._codec is not None:
            return encode_action(message)
        self._carried.append(message)
        return (len(self._carried) - 1).to_bytes(4, "big")

    def _unwrap(self, datagram: bytes) -> ActionMessage:
        if self._codec is None:
            return self._carried[int.from_bytes(datagram, "big")]
        message = self._codec.decode(datagram)
        assert isinstance(message, ActionMessage)
        return message

    def run(self) -> Result:
        """Let it all happen. Who has nothing due is not asked: that is most of what there is to compute."""
        network, events = self.network, self._events
        while True:
            requestor_due, responder_due = _due(self._requestor), _due(self._responder)
            delivery = network.next_delivery()
            due = min(
                requestor_due,
                responder_due,
                END if delivery is None else delivery,
                events[0][0] if events else END,
            )
            if due >= END:
                break
            network.advance_to(due)
            while events and events[0][0] <= network.now:
                heapq.heappop(events)[2]()
            if requestor_due <= network.now:
                self._in_requestor(lambda requestor: requestor.poll(network.now))
            if responder_due <= network.now:
                self._in_responder(lambda responder: responder.poll(network.now))
        return self._judge()

    def _judge(self) -> Result:
        result = Result(list(self.wishes.values()), self.seen)
        if self.seen["contradicted"]:
            result.problems.append("an outcome that was certain was contradicted")
        records = {execution.execution_id: execution.report for execution in self._responder_journal.executions()}
        for wish in result.wishes:
            problem = self._problem_of(wish, records.get(wish.execution_id))
            if problem:
                result.problems.append(f"{problem}: {wish}")
            self._count(wish, records.get(wish.execution_id))
        for where in self.crashes:
            self.seen[f"crash {where}"] += 1
        return result

    def _problem_of(self, wish: Wish, record: ExecutionReport | None) -> str:
        told = wish.robot.told
        if told > 1:
            return f"done {told} times"
        if wish.robot.late:
            return "begun late"
        if wish.robot.told_withdrawn:
            return "begun after it was withdrawn"
        if wish.outcome is None:
            return "no outcome"
        kind = wish.outcome.kind
        if kind is OutcomeKind.ACCEPTED and told != 1:
            return "accepted, and never done"
        if kind in (OutcomeKind.REFUSED, OutcomeKind.TIMED_OUT) and told:
            return f"{kind}, and done"
        if record is not None and not _agree(kind, record.state):
            return f"{kind}, and the responder has {record.state.name}"
        if wish.outcome.report.state is ExecutionState.DONE and wish.outcome.report != wish.robot.report:
            return "another result than the robot's"
        if kind is not OutcomeKind.UNKNOWN:
            return ""
        if self.quiet:
            return "unknown, and nothing justifies it"
        if wish.from_silence:
            return "unknown, though an answer came" if wish.answered else ""
        if record is not None and record.state is not ExecutionState.UNKNOWN and wish.robot.tells:
            return "unknown, though the responder knows"
        return ""

    def _count(self, wish: Wish, record: ExecutionReport | None) -> None:
        if wish.outcome is None:
            return
        kind, report = wish.outcome.kind, wish.outcome.report
        self.seen[kind] += 1
        self.seen[f"withdrawn, {kind}"] += wish.withdrawn_at is not None
        if kind is OutcomeKind.UNKNOWN:
            self.seen[f"unknown, done {wish.robot.told} times"] += 1
            self.seen["unknown for want of an answer" if wish.from_silence else "unknown to the responder"] += 1
            self.seen["unknown because forgotten"] += not wish.from_silence and record is None
        elif kind is OutcomeKind.ACCEPTED:
            self.seen[f"accepted, {report.state.name}"] += 1
        elif kind is OutcomeKind.REFUSED:
            self.seen[f"refused, {StatusCode(report.status).name}"] += 1


def _due(side: ActionRequestor | ActionResponder | None) -> float:
    """When a side is to be asked next; END where nothing is due, or where it is down."""
    deadline = None if side is None else side.next_deadline()
    return END if deadline is None else deadline


def _agree(kind: OutcomeKind, state: ExecutionState) -> bool:
    """Whether a requestor may believe this while the responder's record is that."""
    if kind is OutcomeKind.ACCEPTED:
        return state not in NEVER_BEGUN
    if kind is OutcomeKind.REFUSED:
        return state is ExecutionState.REFUSED
    return kind is OutcomeKind.UNKNOWN or state is ExecutionState.TIMED_OUT
