"""The responder alone: what it has begun, what it refuses, and what it says again."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import StorageUnavailable
from ua_fleet.skill import (
    ActionResponder,
    Execute,
    ExecutionChanged,
    ExecutionReport,
    ExecutionState,
    MemoryJournal,
    Offer,
    Query,
    RecordedExecution,
    Respond,
    ResponderEffect,
    ResponderLimits,
    Target,
    pack,
)
from ua_fleet.skill.answers import read_answer
from ua_fleet.skill.exchanges import MOST_OPEN, PATIENCE_S
from ua_fleet.skill.executions import HALT_TARGETS
from ua_fleet.skill.responder import TRANSITIONS
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, StatusCode
from ua_fleet.wire import ActionMessage, ActionState
from ua_fleet.wire.packed_fields import PackedFields, unpack_fields

S = ExecutionState
MOVE, GRAB = Target(7, 3, 100, 1), Target(7, 3, 100, 2)
ID, OTHER_ID = bytes(16), bytes([1]) * 16
UTC = 10**17
LIMITS = ResponderLimits(requests_at_once=4, most_remembered=8, clock_tolerance_s=2.0, interval_s=0.1, most_repeats=2)
DONE = ExecutionReport(S.DONE, StatusCode.GOOD, "", pack((BuiltinType.INT32,), (9,)))
REQUEST = ActionMessage(
    *MOVE,
    1,
    ActionState.EXECUTING,
    is_request=True,
    requestor_id="0.server",
    correlation_data=ID,
    timeout_hint_ms=5000.0,
    types=(BuiltinType.INT32,),
    values=(5,),
    timestamp=UTC,
)  # fmt: skip
IDLE = REQUEST._replace(action_state=ActionState.IDLE, types=(), values=(), timestamp=None, timeout_hint_ms=None)
OFFERS = (
    Offer(MOVE, (BuiltinType.INT32,), problem=lambda values: "too far" if values[0] > 10 else None),
    Offer(GRAB, immediate=True, requests_at_once=2, spaces=frozenset({0})),
)


def make(
    journal: MemoryJournal | None = None, *, keys: bool = False, counters: Counters | None = None
) -> ActionResponder:
    return ActionResponder(
        7,
        journal or MemoryJournal(),
        counters or Counters(),
        offers=OFFERS,
        allowed_spaces=(0, 2),
        must_be_verified=keys,
        limits=LIMITS,
    )


def receive(
    responder: ActionResponder, request: ActionMessage = REQUEST, now: float = 0.0, utc: int = UTC
) -> list[ResponderEffect]:
    return responder.receive(request, "there", now, utc)


def of(number: int) -> ActionMessage:
    """The request of another execution, issued a second later each."""
    return REQUEST._replace(
        correlation_data=bytes([number]) * 16, timestamp=UTC + number * TICKS_PER_SECOND, action_target_id=2
    )


def response(effects: list[ResponderEffect]) -> ActionMessage:
    (message,) = [effect.message for effect in effects if isinstance(effect, Respond)]
    return message


def report(effects: list[ResponderEffect]) -> ExecutionReport:
    message = response(effects)
    assert message.action_state == ActionState.DONE
    return read_answer(message)


def state(responder: ActionResponder, execution_id: bytes = ID) -> ExecutionState:
    return next(e.report.state for e in responder.executions() if e.execution_id == execution_id)


def test_a_request_is_journaled_begun_and_accepted() -> None:
    journal = MemoryJournal()
    responder = make(journal)
    changed, execute = receive(responder)
    (recorded,) = journal.executions()
    assert changed == ExecutionChanged(recorded)
    assert execute == Execute(recorded)
    content = pack((BuiltinType.INT32,), (5,))
    assert recorded == RecordedExecution(ID, "0.server", 0, MOVE, content, UTC, 5000, ExecutionReport(S.RUNNING))
    (accepted,) = responder.begun(ID, 0.0)
    assert isinstance(accepted, Respond)
    assert accepted.to == "there"
    message = accepted.message
    assert (message.is_request, message.action_state, message.status) == (False, ActionState.DONE, StatusCode.GOOD)
    assert message[:5] == REQUEST[:5]
    assert (message.requestor_id, message.correlation_data) == ("0.server", ID)
    assert (message.types, message.values) == ((BuiltinType.BYTE, BuiltinType.STRING), (S.RUNNING, ""))


def test_a_repeated_request_gets_the_record_and_begins_nothing() -> None:
    responder = make()
    receive(responder)
    assert response(receive(responder)).action_state == ActionState.EXECUTING, "the robot was not told yet"
    responder.begun(ID, 0.0)
    assert report(receive(responder)).state is S.RUNNING
    (changed, said) = responder.ended(ID, DONE, 1.0)
    assert isinstance(changed, ExecutionChanged)
    assert isinstance(said, Respond)
    assert report(receive(responder, now=9.0, utc=UTC + 10**9)) == DONE, "however late"
    assert responder.ended(ID, ExecutionReport(S.FAILED), 9.0) == [], "the first end counts"


def test_arguments_that_were_decoded_are_not_decoded_again() -> None:
    journal = MemoryJournal()
    marked = PackedFields((BuiltinType.INT32,), (5,), bytes.fromhex("06 06000000"))
    _, execute = receive(make(journal), REQUEST._replace(values=marked))
    assert isinstance(execute, Execute)
    assert execute.arguments() == (5,), "as they came, and not as their bytes say"
    assert [execution.content for execution in journal.executions()] == [marked.content]
    assert Execute(execute.execution).arguments() == (6,), "after a restart there are the bytes alone"


@pytest.mark.parametrize(("written", "is_same"), [("01 01", True), ("01 02", True), ("01 00", False), ("03 01", False)])
def test_a_repeated_request_may_write_the_same_values_otherwise(written: str, is_same: bool) -> None:
    responder = make()
    first = REQUEST._replace(action_target_id=2, types=(BuiltinType.BOOLEAN,), values=(True,))
    receive(responder, first)
    responder.begun(ID, 0.0)
    again = unpack_fields(bytes.fromhex(written))
    said = response(receive(responder, first._replace(types=again.types, values=again)))
    assert (said.status == StatusCode.BAD_INVALID_ARGUMENT) is not is_same


def test_an_end_before_the_robot_side_has_said_begun() -> None:
    responder = make()
    receive(responder)
    assert report(responder.ended(ID, DONE, 0.0)) == DONE
    assert report(responder.begun(ID, 0.1)) == DONE


def test_the_robot_side_may_refuse_before_it_has_begun_and_not_after() -> None:
    responder = make()
    receive(responder)
    no = ExecutionReport(S.REFUSED, StatusCode.BAD_NOT_EXECUTABLE, "the gripper is off")
    assert report(responder.refused(ID, no.status, no.message, 0.0)) == no
    assert report(receive(responder)) == no
    receive(responder, of(1))
    responder.begun(of(1).correlation_data or b"", 0.0)
    assert responder.refused(of(1).correlation_data or b"", no.status, "", 0.0) == []
    with pytest.raises(ValueError, match="does not end as REFUSED"):
        responder.ended(ID, no, 0.0)


@pytest.mark.parametrize(
    ("request_", "status", "states"),
    [
        (REQUEST._replace(timeout_hint_ms=0.0), StatusCode.BAD_TIMEOUT, S.TIMED_OUT),
        (REQUEST._replace(timestamp=UTC - 71 * TICKS_PER_SECOND // 10), StatusCode.BAD_TIMEOUT, S.TIMED_OUT),
        (REQUEST._replace(timestamp=UTC + 21 * TICKS_PER_SECOND // 10), StatusCode.BAD_INVALID_TIMESTAMP, S.REFUSED),
        (REQUEST._replace(action_target_id=9), StatusCode.BAD_NOT_SUPPORTED, S.REFUSED),
        (REQUEST._replace(writer_group_id=None), StatusCode.BAD_NOT_SUPPORTED, S.REFUSED),
        (REQUEST._replace(types=(BuiltinType.STRING,), values=("5",)), StatusCode.BAD_TYPE_MISMATCH, S.REFUSED),
        (REQUEST._replace(values=(11,)), StatusCode.BAD_OUT_OF_RANGE, S.REFUSED),
    ],
)
def test_what_never_begins_is_recorded_as_that(request_: ActionMessage, status: int, states: ExecutionState) -> None:
    journal = MemoryJournal()
    responder = make(journal)
    refused = report(receive(responder, request_))
    assert (refused.state, refused.status) == (states, status)
    assert [execution.report for execution in journal.executions()] == [refused]
    assert not any(
        isinstance(effect, Execute) for effect in receive(make(journal), request_, utc=request_.timestamp or 0)
    )


def test_a_copy_that_comes_after_the_requestor_only_asked_is_not_begun() -> None:
    responder = make()
    receive(responder, REQUEST._replace(timeout_hint_ms=0.0))
    assert report(receive(responder)).state is S.TIMED_OUT


def test_over_a_network_that_holds_back_nothing_is_begun_after_its_timeout() -> None:
    strict = replace(LIMITS, late_tolerance_s=0.0)
    for seconds, begins in ((-4.9, True), (-5.1, False), (1.9, True)):
        responder = ActionResponder(7, MemoryJournal(), Counters(), offers=OFFERS, allowed_spaces=(0, 2), limits=strict)
        issued = UTC + round(seconds * TICKS_PER_SECOND)
        effects = receive(responder, REQUEST._replace(timestamp=issued, timeout_hint_ms=5000.0))
        assert any(isinstance(effect, Execute) for effect in effects) is begins


def test_a_broker_that_keeps_an_action_for_an_hour_moves_nothing() -> None:
    counters, journal = Counters(), MemoryJournal()
    limits = replace(LIMITS, late_tolerance_s=0.0)  # as over a broker
    responder = ActionResponder(7, journal, counters, offers=OFFERS, allowed_spaces=(0, 2), limits=limits)
    for _ in range(2):  # and delivers it twice
        effects = receive(responder, REQUEST, now=3600.0, utc=UTC + 3600 * TICKS_PER_SECOND)
        assert not any(isinstance(effect, Execute) for effect in effects)
        assert (report(effects).state, report(effects).status) == (S.TIMED_OUT, StatusCode.BAD_TIMEOUT)
    assert counters.drops == {Drop.REFUSED: 1}
    assert len(journal.executions()) == 1


def test_clocks_may_differ_a_little() -> None:
    for seconds in (-6.9, 1.9):
        issued = UTC + round(seconds * TICKS_PER_SECOND)
        assert isinstance(receive(make(), REQUEST._replace(timestamp=issued))[1], Execute)


@pytest.mark.parametrize("seconds", [-3600, 3600])
def test_a_robot_is_halted_whatever_clocks_say(seconds: int) -> None:
    halt = REQUEST._replace(
        action_target_id=REQUEST.action_target_id | HALT_TARGETS, timestamp=UTC + seconds * TICKS_PER_SECOND
    )
    offers = (*OFFERS, replace(OFFERS[0], target=OFFERS[0].target._replace(action_target_id=halt.action_target_id)))
    limits = replace(LIMITS, late_tolerance_s=0.0)
    for request, begins in ((halt, True), (halt._replace(timeout_hint_ms=0.0), False), (REQUEST, True)):
        responder = ActionResponder(7, MemoryJournal(), Counters(), offers=offers, allowed_spaces=(0, 2), limits=limits)
        assert any(isinstance(effect, Execute) for effect in receive(responder, request)) is begins
    responder = ActionResponder(7, MemoryJournal(), Counters(), offers=offers, allowed_spaces=(0, 2), limits=limits)
    effects = receive(responder, REQUEST._replace(timestamp=halt.timestamp))
    assert report(effects).state in (S.TIMED_OUT, S.REFUSED), "what begins something is looked at as before"


@pytest.mark.parametrize(
    "request_",
    [
        REQUEST._replace(correlation_data=None),
        REQUEST._replace(correlation_data=bytes(15)),
        REQUEST._replace(timestamp=None),
        REQUEST._replace(timeout_hint_ms=None),
    ],
)
def test_what_a_request_must_have(request_: ActionMessage) -> None:
    responder = make()
    assert report(receive(responder, request_)).status == StatusCode.BAD_INVALID_ARGUMENT
    assert responder.executions() == []


@pytest.mark.parametrize(
    "request_",
    [
        REQUEST._replace(values=(6,)),
        REQUEST._replace(action_target_id=2),
        REQUEST._replace(requestor_id="2.x"),
        REQUEST._replace(types=(), values=()),
    ],
)
def test_another_request_with_a_known_id_is_refused_and_changes_nothing(request_: ActionMessage) -> None:
    responder = make()
    receive(responder)
    responder.begun(ID, 0.0)
    assert report(receive(responder, request_)).state is S.REFUSED
    assert state(responder) is S.RUNNING
    assert report(receive(responder, REQUEST._replace(requestor_id="0.another", timestamp=UTC + 1))).state is S.RUNNING


def test_who_may_command() -> None:
    counters = Counters()
    responder = make(counters=counters)
    assert report(receive(responder, REQUEST._replace(requestor_id="3.x"))).status == StatusCode.BAD_USER_ACCESS_DENIED
    assert receive(responder, REQUEST._replace(requestor_id="x")) == []
    assert receive(responder, REQUEST._replace(requestor_id=None)) == []
    hidden = REQUEST._replace(action_target_id=2, requestor_id="2.x")
    assert report(receive(responder, hidden)).status == StatusCode.BAD_USER_ACCESS_DENIED
    assert counters.drops[Drop.REQUESTOR] == 4
    assert receive(responder, REQUEST._replace(publisher_id=8)) == []
    assert receive(responder, REQUEST._replace(is_request=False)) == []
    assert responder.executions() == []
    assert isinstance(receive(responder, hidden._replace(requestor_id="0.x"))[1], Execute), "its id was not used up"


def test_with_keys_nothing_unsigned_is_begun() -> None:
    counters = Counters()
    responder = make(keys=True, counters=counters)
    assert responder.receive(REQUEST, "there", 0.0, UTC) == []
    assert counters.drops[Drop.NOT_SECURED] == 1
    assert responder.receive(REQUEST, "there", 0.0, UTC, verified=True)


def test_how_many_at_once() -> None:
    responder = make()
    receive(responder)
    busy = report(receive(responder, REQUEST._replace(correlation_data=OTHER_ID)))
    assert busy.status == StatusCode.BAD_TOO_MANY_OPERATIONS
    responder.begun(ID, 0.0)
    responder.ended(ID, DONE, 0.0)
    assert report(receive(responder, REQUEST._replace(correlation_data=OTHER_ID))) == busy, "refused is refused"
    assert isinstance(receive(responder, REQUEST._replace(correlation_data=bytes([2]) * 16))[1], Execute)


def test_several_requests_in_one_message() -> None:
    responder = make()
    other = REQUEST._replace(request_id=2, action_target_id=2)
    effects = receive(responder, REQUEST._replace(others=(other,)))
    assert [type(effect) for effect in effects] == [ExecutionChanged, Execute, Respond]
    assert response(effects).request_id == 2
    assert report(effects).state is S.REFUSED, "they have one CorrelationData, which is the execution id"


def test_done_is_repeated_until_idle_is_heard_or_nobody_is_there() -> None:
    responder = make()
    receive(responder)
    responder.begun(ID, 0.0)
    assert responder.next_deadline() == pytest.approx(0.1)
    assert responder.poll(0.05) == []
    assert report(responder.poll(0.11)).state is S.RUNNING
    idle = response(receive(responder, IDLE))
    assert (idle.action_state, idle.types) == (ActionState.IDLE, ())
    assert responder.next_deadline() is None
    assert response(receive(responder, IDLE._replace(correlation_data=OTHER_ID))).action_state == ActionState.IDLE
    receive(responder, now=1.0)
    said = 0
    while (due := responder.next_deadline()) is not None:
        said += len(responder.poll(due))
    assert said == LIMITS.most_repeats
    assert receive(responder, REQUEST._replace(action_state=ActionState.DONE)) == []


def test_an_immediate_skill_answers_with_its_end() -> None:
    responder = make()
    request = REQUEST._replace(action_target_id=2)
    receive(responder, request)
    assert response(responder.begun(ID, 0.0)).action_state == ActionState.EXECUTING
    assert response(responder.poll(0.2)).action_state == ActionState.EXECUTING
    ended = response(responder.ended(ID, DONE, 1.0))
    assert (ended.types[2:], ended.values[2:], ended.values[0]) == ((BuiltinType.INT32,), (9,), S.DONE)


def test_an_immediate_skill_that_takes_too_long_is_accepted_in_time() -> None:
    responder = make()
    receive(responder, REQUEST._replace(action_target_id=2))
    responder.begun(ID, 0.0)
    while response(responder.poll(now := responder.next_deadline() or 0.0)).action_state == ActionState.EXECUTING:
        pass
    assert 4.8 <= now < 5.0
    again = receive(responder, REQUEST._replace(action_target_id=2), now, UTC + round(now * TICKS_PER_SECOND))
    assert report(again).state is S.RUNNING


def restarted(journal: MemoryJournal) -> ActionResponder:
    receive(make(journal))
    responder = make(journal)
    changed, query = responder.recover()
    assert isinstance(changed, ExecutionChanged)
    assert isinstance(query, Query)
    assert changed.execution.report.state is query.execution.report.state is S.ASKING
    return responder


@pytest.mark.parametrize(
    "end",
    [DONE, ExecutionReport(S.FAILED, StatusCode.BAD, "it fell"), ExecutionReport(S.UNKNOWN, StatusCode.UNCERTAIN)],
)
def test_after_a_restart_the_robot_is_asked_what_became_of_it(end: ExecutionReport) -> None:
    journal = MemoryJournal()
    responder = restarted(journal)
    assert response(receive(responder)).action_state == ActionState.EXECUTING
    assert report(responder.ended(ID, end, 0.0)) == end
    assert make(journal).recover() == [], "what has ended is not asked for"


def test_after_a_restart_the_robot_is_still_at_it() -> None:
    responder = restarted(MemoryJournal())
    (changed,) = responder.running(ID)
    assert isinstance(changed, ExecutionChanged)
    assert report(receive(responder)).state is S.RUNNING
    assert responder.running(ID) == []
    assert responder.running(OTHER_ID) == []


def test_after_a_restart_what_was_surely_not_begun_begins_if_it_is_in_time() -> None:
    journal = MemoryJournal()
    responder = restarted(journal)
    changed, execute = responder.not_begun(ID, 0.0, UTC + 5 * TICKS_PER_SECOND)
    assert isinstance(changed, ExecutionChanged)
    assert isinstance(execute, Execute)
    assert execute.execution.report.state is S.RUNNING
    assert responder.refused(ID, StatusCode.BAD_NOT_EXECUTABLE, "", 0.0), "it may still be refused"
    late = make(journal := MemoryJournal())
    receive(late)
    late = make(journal)
    late.recover()
    (changed,) = late.not_begun(ID, 0.0, UTC + 5 * TICKS_PER_SECOND + 1)
    assert isinstance(changed, ExecutionChanged)
    assert state(late) is S.TIMED_OUT
    assert late.not_begun(ID, 0.0, UTC) == []


def test_after_a_restart_nothing_begins_that_is_late_by_more_than_a_clock_tells() -> None:
    """It was set back since: how late it is nobody knows."""
    responder = restarted(MemoryJournal())
    (changed,) = responder.not_begun(ID, 0.0, UTC - 3600 * TICKS_PER_SECOND)
    assert isinstance(changed, ExecutionChanged)
    assert state(responder) is S.TIMED_OUT


def test_an_unknown_end_may_be_known_later() -> None:
    responder = restarted(MemoryJournal())
    responder.ended(ID, ExecutionReport(S.UNKNOWN, StatusCode.UNCERTAIN), 0.0)
    responder.ended(ID, DONE, 1.0)
    assert state(responder) is S.DONE
    assert responder.ended(OTHER_ID, DONE, 1.0) == []


def test_what_was_forgotten_is_not_begun_again() -> None:
    journal = MemoryJournal()
    responder = make(journal)
    for number in range(1, 12):
        receive(responder, of(number), utc=UTC + number * TICKS_PER_SECOND)
        responder.begun(of(number).correlation_data or b"", 0.0)
        responder.ended(of(number).correlation_data or b"", DONE, 0.0)
    assert len(journal.executions()) == LIMITS.most_remembered
    assert journal.forgotten() == {0: UTC + 3 * TICKS_PER_SECOND}
    for one in (responder, make(journal)):
        forgotten = report(receive(one, of(2), utc=UTC + 2 * TICKS_PER_SECOND))
        assert forgotten.state is S.UNKNOWN
        assert report(receive(one, REQUEST._replace(correlation_data=OTHER_ID[:15] + b"x"))).state is S.UNKNOWN
        assert report(receive(one, of(11), utc=UTC)).state is S.DONE
    assert isinstance(receive(responder, of(12), utc=UTC + 12 * TICKS_PER_SECOND)[1], Execute)
    other_space = REQUEST._replace(correlation_data=bytes([99]) * 16, requestor_id="2.x")
    assert isinstance(receive(responder, other_space)[1], Execute), "each space has its own mark"


def test_a_wrong_clock_does_not_set_the_mark() -> None:
    journal = MemoryJournal()
    responder = make(journal)
    for number in range(1, 20):
        ahead = REQUEST._replace(correlation_data=bytes([number]) * 16, timestamp=UTC + 10**15)
        assert report(receive(responder, ahead)).status == StatusCode.BAD_INVALID_TIMESTAMP
    assert journal.forgotten()[0] <= UTC + 2 * TICKS_PER_SECOND


def test_what_is_under_way_is_not_forgotten() -> None:
    responder = make()
    receive(responder)
    responder.begun(ID, 0.0)
    for number in range(1, 30):
        receive(responder, REQUEST._replace(correlation_data=bytes([number]) * 16, timestamp=UTC + number))
    assert state(responder) is S.RUNNING
    assert len(responder.executions()) <= LIMITS.most_remembered


def test_a_responder_remembers_more_than_it_does_at_once() -> None:
    with pytest.raises(ValueError, match="remembers more"):
        ActionResponder(7, MemoryJournal(), Counters(), limits=ResponderLimits(requests_at_once=8, most_remembered=8))


def test_offers_come_and_go() -> None:
    responder = make()
    responder.withdraw(MOVE)
    responder.withdraw(MOVE)
    assert report(receive(responder)).status == StatusCode.BAD_NOT_SUPPORTED
    responder.offer(OFFERS[0])
    assert isinstance(receive(responder, REQUEST._replace(correlation_data=OTHER_ID))[1], Execute)


class BrokenJournal(MemoryJournal):
    left = 0

    def recorded(self, execution: RecordedExecution) -> None:
        self._check()
        super().recorded(execution)

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        self._check()
        super().reported(execution_id, report)

    def _check(self) -> None:
        if not self.left:
            raise StorageUnavailable("the disk is full")
        self.left -= 1


def test_what_cannot_be_journaled_is_not_begun_and_not_said() -> None:
    journal = BrokenJournal()
    responder = make(journal)
    with pytest.raises(StorageUnavailable):
        receive(responder)
    assert responder.executions() == []
    assert responder.next_deadline() is None
    journal.left = 1
    assert isinstance(receive(responder)[1], Execute)
    with pytest.raises(StorageUnavailable):
        responder.ended(ID, DONE, 0.0)
    assert state(responder) is S.RUNNING
    journal.left = 1
    assert responder.ended(ID, DONE, 0.0)


def test_what_was_journaled_before_the_journal_broke_is_begun() -> None:
    journal = BrokenJournal()
    journal.left = 1
    responder = make(journal)
    second = REQUEST._replace(correlation_data=OTHER_ID, action_target_id=2)
    effects = receive(responder, REQUEST._replace(others=(second,)))
    assert [type(effect) for effect in effects] == [ExecutionChanged, Execute]


def test_open_exchanges_are_bounded_and_end() -> None:
    responder = ActionResponder(
        7, MemoryJournal(), Counters(), limits=ResponderLimits(requests_at_once=1, most_remembered=1000)
    )
    for number in range(MOST_OPEN + 50):
        receive(responder, REQUEST._replace(correlation_data=number.to_bytes(16, "big"), timestamp=UTC + number))
    assert len(responder.poll(1.0)) == MOST_OPEN
    waiting = restarted(MemoryJournal())
    receive(waiting)
    now = 0.0
    while (due := waiting.next_deadline()) is not None:
        waiting.poll(now := due)
    assert 5.0 + PATIENCE_S <= now < 5.2 + PATIENCE_S, "there is nothing to say, and it was said long enough"
    assert report(waiting.ended(ID, DONE, 99.0)) == DONE, "the end is told whenever it comes"


def test_the_table_has_every_state_but_the_first() -> None:
    assert set(TRANSITIONS) == {None, *S}
    assert not any(TRANSITIONS[end] for end in (S.DONE, S.FAILED, S.REFUSED, S.TIMED_OUT))
