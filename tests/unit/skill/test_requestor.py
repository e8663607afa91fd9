"""The requestor alone: what it sends, how often, and what it concludes."""

from __future__ import annotations

import pytest

from ua_fleet.errors import LocalWireError, SkillRejected, StorageUnavailable
from ua_fleet.skill import (
    ActionRequestor,
    Concluded,
    Contradicted,
    ExecutionReport,
    ExecutionState,
    MemoryJournal,
    OutcomeCorrected,
    OutcomeKind,
    RecordedRequest,
    RequestorEffect,
    RequestorName,
    RequestOutcome,
    RequestPace,
    Send,
    Target,
    unpack,
)
from ua_fleet.skill.answers import answer_fields
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, StatusCode, Variant
from ua_fleet.wire import ActionMessage, ActionState

TARGET = Target(7, 3, 100, 1)
ID, OTHER_ID = bytes(16), bytes([1]) * 16
UTC = 10**17
PACE = RequestPace(interval_s=0.1, longest_interval_s=0.4, grace_s=2.0, most_closing=2)


class BrokenJournal(MemoryJournal):
    broken = False

    def requested(self, request: RecordedRequest) -> None:
        self._check()
        super().requested(request)

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self._check()
        super().concluded(execution_id, outcome)

    def _check(self) -> None:
        if self.broken:
            raise StorageUnavailable("the disk is full")


def make(journal: MemoryJournal | None = None, *, verified: bool = False, most: int = 100) -> ActionRequestor:
    name = RequestorName.checked(0, "server")
    return ActionRequestor(name, journal or MemoryJournal(), pace=PACE, must_be_verified=verified, most_remembered=most)


def start(
    requestor: ActionRequestor, now: float = 0.0, execution_id: bytes = ID, utc: int = UTC
) -> list[RequestorEffect]:
    return requestor.start(execution_id, TARGET, (BuiltinType.INT32,), (5,), 1.0, now, utc)


def sent(effects: list[RequestorEffect]) -> ActionMessage:
    (message,) = [effect.message for effect in effects if isinstance(effect, Send)]
    return message


def said(
    state: ActionState, report: ExecutionReport | None = None, execution_id: bytes = ID, requestor: str = "0.server"
) -> ActionMessage:
    types, values = answer_fields(report) if report is not None else ((), ())
    status = report.status if report is not None else None
    return ActionMessage(
        *TARGET, 1, state, False, requestor, execution_id, types=types, values=values, status=status
    )  # fmt: skip


RUNNING = said(ActionState.DONE, ExecutionReport(ExecutionState.RUNNING))


def test_a_request_is_repeated_in_the_interval_until_it_is_heard() -> None:
    requestor = make()
    first = sent(start(requestor))
    assert first.action_state == ActionState.EXECUTING
    assert (first.requestor_id, first.correlation_data, first.timeout_hint_ms) == ("0.server", ID, 1000.0)
    assert (first.types, first.values, first.timestamp) == ((BuiltinType.INT32,), (5,), UTC)
    assert requestor.poll(0.09) == []
    times = [requestor.next_deadline()]
    while len(times) < 4:
        assert sent(requestor.poll(times[-1] or 0.0)) == first, "each copy is the same"
        times.append(requestor.next_deadline())
    assert times == pytest.approx([0.1, 0.3, 0.7, 1.0]), "the pauses double up to the longest, and end at the timeout"


def test_after_the_timeout_it_only_asks_and_then_knows_nothing() -> None:
    requestor = make()
    start(requestor)
    assert sent(requestor.poll(1.0)).timeout_hint_ms == 0.0
    effects = requestor.poll(3.0)
    (concluded,) = effects
    assert isinstance(concluded, Concluded)
    assert concluded.outcome.kind is OutcomeKind.UNKNOWN
    assert requestor.outcome(ID) == concluded.outcome
    assert requestor.next_deadline() is None


def test_executing_stops_the_repetition_for_a_while() -> None:
    requestor = make()
    start(requestor)
    assert requestor.receive(said(ActionState.EXECUTING), 0.05) == []
    assert requestor.next_deadline() == pytest.approx(0.45)
    requestor.receive(said(ActionState.EXECUTING), 0.9)
    assert requestor.next_deadline() == 1.0
    requestor.poll(1.0)
    requestor.receive(said(ActionState.EXECUTING), 1.1)
    assert requestor.next_deadline() == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("state", "kind"),
    [
        (ExecutionState.RUNNING, OutcomeKind.ACCEPTED),
        (ExecutionState.DONE, OutcomeKind.ACCEPTED),
        (ExecutionState.FAILED, OutcomeKind.ACCEPTED),
        (ExecutionState.REFUSED, OutcomeKind.REFUSED),
        (ExecutionState.TIMED_OUT, OutcomeKind.TIMED_OUT),
        (ExecutionState.UNKNOWN, OutcomeKind.UNKNOWN),
    ],
)
def test_done_is_the_outcome_and_acknowledged_until_idle_comes(state: ExecutionState, kind: OutcomeKind) -> None:
    requestor = make()
    start(requestor)
    answer = said(ActionState.DONE, ExecutionReport(state, StatusCode.BAD, "so it is", b""))
    concluded, idle = requestor.receive(answer, 0.2)
    assert concluded == Concluded(ID, RequestOutcome(kind, ExecutionReport(state, StatusCode.BAD, "so it is")))
    assert isinstance(idle, Send)
    assert (idle.message.action_state, idle.message.types) == (ActionState.IDLE, ())
    assert requestor.receive(answer, 0.25) == [], "said again before it heard our Idle"
    assert sent(requestor.poll(0.31)) == idle.message
    assert requestor.receive(said(ActionState.IDLE), 0.35) == []
    assert requestor.next_deadline() is None
    assert requestor.receive(said(ActionState.IDLE), 0.4) == []


def test_idle_is_repeated_a_few_times_only() -> None:
    requestor = make()
    start(requestor)
    requestor.receive(RUNNING, 0.0)
    assert sent(requestor.poll(0.1)).action_state == ActionState.IDLE
    assert requestor.poll(10.0) == []
    assert requestor.next_deadline() is None


@pytest.mark.parametrize(
    ("status", "kind", "state"),
    [
        (None, OutcomeKind.ACCEPTED, ExecutionState.DONE),
        (StatusCode.UNCERTAIN, OutcomeKind.UNKNOWN, ExecutionState.UNKNOWN),
        (StatusCode.BAD_TIMEOUT, OutcomeKind.TIMED_OUT, ExecutionState.TIMED_OUT),
        (StatusCode.BAD_NOT_EXECUTABLE, OutcomeKind.REFUSED, ExecutionState.REFUSED),
    ],
)
def test_the_status_of_a_foreign_responder_tells(status: int | None, kind: OutcomeKind, state: ExecutionState) -> None:
    requestor = make()
    start(requestor)
    answer = said(ActionState.DONE)._replace(status=status, types=(BuiltinType.INT32,), values=(9,))
    concluded, _ = requestor.receive(answer, 0.1)
    assert isinstance(concluded, Concluded)
    assert (concluded.outcome.kind, concluded.outcome.report.state) == (kind, state)
    assert unpack(concluded.outcome.report.result) == (Variant(BuiltinType.INT32, 9),)


def test_an_answer_that_comes_late_corrects_unknown_and_nothing_else() -> None:
    requestor = make()
    start(requestor)
    requestor.poll(3.0)
    corrected, idle = requestor.receive(RUNNING, 5.0)
    assert corrected == OutcomeCorrected(
        ID, RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.RUNNING))
    )
    assert isinstance(idle, Send)
    refused = said(ActionState.DONE, ExecutionReport(ExecutionState.REFUSED))
    assert [type(effect) for effect in requestor.receive(refused, 6.0)] == [Contradicted, Send]
    assert isinstance(corrected, OutcomeCorrected)
    assert requestor.outcome(ID) == corrected.outcome


@pytest.mark.parametrize(
    "message",
    [
        RUNNING._replace(is_request=True),
        RUNNING._replace(requestor_id="0.other"),
        RUNNING._replace(requestor_id=None),
        RUNNING._replace(correlation_data=OTHER_ID),
        RUNNING._replace(correlation_data=None),
        RUNNING._replace(request_id=2),
        RUNNING._replace(publisher_id=8),
        RUNNING._replace(publisher_id="7"),
        RUNNING._replace(writer_group_id=None),
        RUNNING._replace(action_target_id=2),
    ],
)
def test_what_is_not_for_us_is_left_alone(message: ActionMessage) -> None:
    requestor = make()
    start(requestor)
    assert requestor.receive(message, 0.1) == []
    assert requestor.outcome(ID) is None


def test_with_keys_only_what_is_verified_counts() -> None:
    requestor = make(verified=True)
    start(requestor)
    assert requestor.receive(RUNNING, 0.1) == []
    assert requestor.receive(RUNNING, 0.1, verified=True)


def test_the_same_request_again_asks_for_nothing() -> None:
    requestor = make()
    start(requestor)
    assert start(requestor, 0.1) == []
    requestor.receive(RUNNING, 0.2)
    assert start(requestor, 0.3) == [
        Concluded(ID, RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.RUNNING)))
    ]
    with pytest.raises(SkillRejected, match="another request"):
        requestor.start(ID, TARGET, (BuiltinType.INT32,), (6,), 1.0, 0.4, UTC)


def test_what_cannot_be_asked_for() -> None:
    requestor = make()
    with pytest.raises(SkillRejected, match="16 bytes"):
        start(requestor, execution_id=b"short")
    with pytest.raises(SkillRejected, match="timeout"):
        requestor.start(ID, TARGET, (), (), 0.0, 0.0, UTC)
    with pytest.raises(LocalWireError):
        requestor.start(ID, TARGET, (BuiltinType.INT32,), ("x",), 1.0, 0.0, UTC)
    assert requestor.next_deadline() is None


def test_after_a_restart_it_asks_on_with_the_same_message() -> None:
    journal = MemoryJournal()
    first = sent(start(make(journal)))
    again = make(journal)
    assert sent(again.resume(1000.0, UTC + TICKS_PER_SECOND // 2)) == first
    assert again.next_deadline() == pytest.approx(1000.1)
    assert sent(again.poll(1000.5)).timeout_hint_ms == 0.0, "half a second of its timeout was over"
    late = make(journal)
    assert sent(late.resume(0.0, UTC + 10 * TICKS_PER_SECOND)).timeout_hint_ms == 0.0
    assert late.poll(1.99) != []
    concluded = late.poll(2.0)
    assert isinstance(concluded[0], Concluded)
    assert make(journal).resume(0.0, UTC) == [], "an outcome is an outcome after a restart too"


def test_issue_times_increase_where_the_clock_goes_back_a_little() -> None:
    journal = MemoryJournal()
    requestor = make(journal)
    start(requestor)
    back = UTC - 4 * TICKS_PER_SECOND
    assert sent(start(requestor, execution_id=OTHER_ID, utc=back)).timestamp == UTC + 1
    assert sent(start(make(journal), execution_id=bytes([2]) * 16, utc=back)).timestamp == UTC + 2


def test_issue_times_go_with_a_clock_that_is_set_back() -> None:
    """No responder takes what is issued far ahead of its clock."""
    journal = MemoryJournal()
    requestor = make(journal)
    start(requestor)
    back = UTC - 3600 * TICKS_PER_SECOND
    assert sent(start(requestor, execution_id=OTHER_ID, utc=back)).timestamp == back
    assert sent(start(requestor, execution_id=bytes([2]) * 16, utc=back)).timestamp == back + 1
    later = back + 60 * TICKS_PER_SECOND
    assert sent(start(make(journal), execution_id=bytes([3]) * 16, utc=later)).timestamp == later


def test_the_oldest_are_forgotten_but_for_those_that_are_open() -> None:
    journal = MemoryJournal()
    requestor = make(journal, most=8)
    start(requestor)
    for number in range(1, 20):
        execution_id = bytes([number]) * 16
        start(requestor, execution_id=execution_id, utc=UTC + number)
        requestor.receive(said(ActionState.DONE, ExecutionReport(ExecutionState.DONE), execution_id), 0.0)
        requestor.receive(said(ActionState.IDLE, None, execution_id), 0.0)
    remembered = [request.execution_id for request in journal.requests()]
    assert len(remembered) <= 9
    assert ID in remembered
    assert bytes([19]) * 16 in remembered


def test_what_cannot_be_journaled_has_not_happened() -> None:
    journal = BrokenJournal()
    requestor = make(journal)
    journal.broken = True
    with pytest.raises(StorageUnavailable):
        start(requestor)
    assert requestor.next_deadline() is None
    journal.broken = False
    start(requestor)
    journal.broken = True
    with pytest.raises(StorageUnavailable):
        requestor.receive(RUNNING, 0.1)
    assert requestor.outcome(ID) is None
    requestor.poll(1.0)
    with pytest.raises(StorageUnavailable):
        requestor.poll(3.0)
    assert (requestor.next_deadline() or 0.0) > 3.0, "it is tried again, and not at once"
    journal.broken = False
    assert requestor.receive(RUNNING, 3.1)
    assert requestor.outcome(ID) is not None


def test_what_was_journaled_before_the_journal_broke_is_told() -> None:
    journal = BrokenJournal()
    requestor = make(journal)
    start(requestor)
    start(requestor, execution_id=OTHER_ID)
    requestor.poll(1.0)

    written: list[bytes] = []

    def concluded(execution_id: bytes, outcome: RequestOutcome) -> None:
        if written:
            raise StorageUnavailable("the disk is full")
        written.append(execution_id)

    journal.concluded = concluded  # type: ignore[method-assign]
    (told,) = requestor.poll(3.0)
    assert isinstance(told, Concluded)
    assert told.execution_id == ID


@pytest.mark.parametrize("text", ["", "0", "0.", ".server", "65536.a", "01.a", "0.a b", "-1.a", "0." + "a" * 65, None])
def test_what_is_no_requestor_id(text: str | None) -> None:
    assert RequestorName.parse(text) is None


def test_a_requestor_id() -> None:
    name = RequestorName.checked(65_535, "cell-1_b")
    assert RequestorName.parse(name.text) == name == (65_535, "cell-1_b")
    with pytest.raises(ValueError, match="cannot stand"):
        RequestorName.checked(0, "a.b")


def test_a_request_that_is_withdrawn_only_asks_from_then_on_also_after_a_restart() -> None:
    journal = MemoryJournal()
    requestor = make(journal)
    start(requestor)
    asks = sent(requestor.withdraw(ID, 0.25))
    assert (asks.action_state, asks.timeout_hint_ms, asks.timestamp) == (ActionState.EXECUTING, 0.0, UTC)
    assert requestor.withdraw(ID, 0.26) == []
    assert sent(requestor.poll(requestor.next_deadline() or 0.0)).timeout_hint_ms == 0.0
    again = make(journal)
    assert sent(again.resume(0.0, UTC + 100)).timeout_hint_ms == 0.0
    never = ExecutionReport(ExecutionState.TIMED_OUT, StatusCode.BAD_TIMEOUT)
    told = again.receive(said(ActionState.DONE, never), 0.5)
    assert Concluded(ID, RequestOutcome(OutcomeKind.TIMED_OUT, never)) in told


def test_what_was_answered_or_never_asked_is_not_withdrawn() -> None:
    requestor = make()
    start(requestor)
    requestor.receive(RUNNING, 0.1)
    assert requestor.withdraw(ID, 0.2) == []
    assert requestor.withdraw(OTHER_ID, 0.2) == []


def test_a_withdrawal_that_cannot_be_written_holds_until_a_restart() -> None:
    class NeverWithdrawn(MemoryJournal):
        def withdrawn(self, execution_id: bytes) -> None:
            raise StorageUnavailable("the disk is full")

    requestor = make(NeverWithdrawn())
    start(requestor)
    with pytest.raises(StorageUnavailable):
        requestor.withdraw(ID, 0.25)
    assert sent(requestor.poll(0.25)).timeout_hint_ms == 0.0


REFUSED = said(ActionState.DONE, ExecutionReport(ExecutionState.REFUSED, StatusCode.BAD_TOO_MANY_OPERATIONS, "busy"))


def kinds(effects: list[RequestorEffect]) -> list[OutcomeKind]:
    return [effect.outcome.kind for effect in effects if isinstance(effect, Concluded | OutcomeCorrected)]


def waiting(journal: MemoryJournal | None = None) -> ActionRequestor:
    pace = RequestPace(interval_s=0.1, longest_interval_s=0.4, grace_s=2.0, most_closing=2, refusal_wait_s=0.1)
    return ActionRequestor(RequestorName.checked(0, "server"), journal or MemoryJournal(), pace=pace)


def test_an_acceptance_soon_after_a_refusal_wins() -> None:
    requestor = waiting()
    start(requestor)
    assert requestor.receive(REFUSED, 0.01) == []
    effects = requestor.receive(RUNNING, 0.02)
    assert kinds(effects) == [OutcomeKind.ACCEPTED]
    assert Contradicted(ID, TARGET) in effects
    assert sent(effects).action_state == ActionState.IDLE
    later = requestor.receive(REFUSED, 0.03) + requestor.poll(0.2) + requestor.poll(3.0)
    assert kinds(later) == []
    assert not any(isinstance(effect, Contradicted) for effect in later), "said once"


def test_a_refusal_that_nobody_contradicts_counts_after_a_moment() -> None:
    journal = BrokenJournal()
    requestor = waiting(journal)
    start(requestor)
    assert requestor.receive(REFUSED, 0.01) == []
    assert requestor.receive(REFUSED, 0.05) == []
    assert requestor.poll(0.1) == []
    assert requestor.next_deadline() == pytest.approx(0.11)
    journal.broken = True
    with pytest.raises(StorageUnavailable):
        requestor.poll(0.12)
    journal.broken = False
    effects = requestor.poll(0.6)
    assert kinds(effects) == [OutcomeKind.REFUSED]
    assert sent(effects).action_state == ActionState.IDLE


@pytest.mark.parametrize("is_closed", [False, True])
def test_an_acceptance_corrects_a_refusal_that_was_told(is_closed: bool) -> None:
    requestor = make()
    start(requestor)
    assert kinds(requestor.receive(REFUSED, 0.1)) == [OutcomeKind.REFUSED]
    if is_closed:
        requestor.receive(said(ActionState.IDLE), 0.2)
    effects = requestor.receive(RUNNING, 0.3)
    assert kinds(effects) == [OutcomeKind.ACCEPTED]
    assert isinstance(effects[0], OutcomeCorrected)
    assert Contradicted(ID, TARGET) in effects
    assert requestor.outcome(ID) == effects[0].outcome


def test_a_refusal_after_an_acceptance_is_told_and_changes_nothing() -> None:
    requestor = make()
    start(requestor)
    assert kinds(requestor.receive(RUNNING, 0.1)) == [OutcomeKind.ACCEPTED]
    assert requestor.receive(REFUSED, 0.2) == [Contradicted(ID, TARGET)]
    assert requestor.receive(REFUSED, 0.3) == []
    outcome = requestor.outcome(ID)
    assert outcome is not None
    assert outcome.kind is OutcomeKind.ACCEPTED


def prepared(requestor: ActionRequestor, journal: MemoryJournal, execution_id: bytes = ID) -> RecordedRequest:
    """What the owner does before `begin`."""
    request = requestor.prepare(execution_id, TARGET, (BuiltinType.INT32,), (5,), 1.0, UTC)
    assert request is not None
    journal.requested(request)
    requestor.prepared([request])
    return request


def test_what_the_owner_has_recorded_is_sent_and_not_recorded_again() -> None:
    journal = BrokenJournal()
    requestor = make(journal)
    request = prepared(requestor, journal)
    with pytest.raises(KeyError):
        requestor.outcome(ID)
    assert requestor.next_deadline() is None
    journal.broken = True
    assert requestor.is_prepared(ID)
    first = sent(requestor.begin(ID, 7.0))
    assert (first.timestamp, first.timeout_hint_ms, first.values) == (request.issued, 1000.0, (5,))
    assert requestor.outcome(ID) is None
    assert not requestor.is_prepared(ID)
    assert requestor.next_deadline() == pytest.approx(7.1)
    journal.broken = False
    assert isinstance(requestor.receive(RUNNING, 7.05)[0], Concluded)


def test_what_is_prepared_twice_is_the_same_request() -> None:
    journal = MemoryJournal()
    requestor = make(journal)
    prepared(requestor, journal)
    values = (TARGET, (BuiltinType.INT32,), (5,), 1.0, UTC)
    assert requestor.prepare(ID, *values) is None
    requestor.begin(ID, 0.0)
    assert requestor.prepare(ID, *values) is None
    with pytest.raises(KeyError):
        requestor.begin(ID, 0.0)
    other = requestor.prepare(OTHER_ID, *values)
    assert other is not None
    assert other.issued > UTC, "issue times differ"
    with pytest.raises(SkillRejected, match="16 bytes"):
        requestor.prepare(b"short", *values)


def test_what_is_left_is_not_sent_until_it_is_asked_for_anew() -> None:
    journal = MemoryJournal()
    requestor = make(journal)
    before = prepared(requestor, journal)
    requestor.leave(ID)
    requestor.leave(OTHER_ID)
    assert list(requestor.left) == [ID]
    assert not requestor.is_prepared(ID)
    assert requestor.prepare(ID, TARGET, (BuiltinType.INT32,), (5,), 1.0, UTC) is None, "its record is in the journal"
    assert sent(start(requestor)).timestamp == before.issued + 1
    assert not requestor.left
    assert [request.issued for request in journal.requests()] == [before.issued + 1]


def test_what_is_left_is_forgotten_once_the_owner_has_deleted_it() -> None:
    journal = MemoryJournal()
    requestor = make(journal)
    prepared(requestor, journal)
    requestor.leave(ID)
    journal.forget_requests(requestor.left)
    requestor.left_out(requestor.left)
    assert not requestor.left
    assert requestor.poll(100.0) == []
    start(requestor)
    assert [request.execution_id for request in journal.requests()] == [ID]


def test_a_restart_asks_for_what_was_recorded_and_not_sent() -> None:
    journal = MemoryJournal()
    prepared(make(journal), journal)
    assert sent(make(journal).resume(0.0, UTC)).timeout_hint_ms == 1000.0
    assert sent(make(journal).resume(0.0, UTC, [ID])).timeout_hint_ms == 0.0, "it must not begin any more"


def test_the_record_from_which_issue_times_go_on_is_kept() -> None:
    """Also where a later issue time was given to a request that nobody has recorded."""
    journal = BrokenJournal()
    requestor = make(journal, most=1)
    start(requestor)
    requestor.receive(RUNNING, 0.0)
    requestor.receive(said(ActionState.IDLE), 0.0)
    requestor.prepare(OTHER_ID, TARGET, (BuiltinType.INT32,), (5,), 1.0, UTC)
    journal.broken = True
    with pytest.raises(StorageUnavailable):
        start(requestor, execution_id=OTHER_ID)
    assert [request.execution_id for request in journal.requests()] == [ID]


def without_idle(*, most: int = 100) -> ActionRequestor:
    pace = RequestPace(interval_s=0.1, longest_interval_s=0.4, grace_s=2.0, says_idle=False)
    return ActionRequestor(RequestorName.checked(0, "server"), MemoryJournal(), pace=pace, most_remembered=most)


def test_an_exchange_without_idle_is_over_with_the_answer() -> None:
    requestor = without_idle()
    start(requestor)
    (concluded,) = requestor.receive(RUNNING, 0.05)
    assert isinstance(concluded, Concluded)
    assert concluded.outcome.kind is OutcomeKind.ACCEPTED
    assert requestor.next_deadline() is None
    assert requestor.poll(9.0) == []


def test_a_responder_that_repeats_its_answer_hears_idle() -> None:
    requestor = without_idle()
    start(requestor)
    requestor.receive(RUNNING, 0.05)
    for at in (0.15, 0.25):
        assert sent(requestor.receive(RUNNING, at)).action_state == ActionState.IDLE


def test_answers_to_copies_of_a_request_are_not_repeated_answers() -> None:
    requestor = without_idle()
    start(requestor)
    for at in (0.1, 0.35):
        sent(requestor.poll(at))
    requestor.receive(RUNNING, 0.36)
    assert requestor.receive(RUNNING, 0.37) == requestor.receive(RUNNING, 0.38) == []
    assert sent(requestor.receive(RUNNING, 0.4)).action_state == ActionState.IDLE


def test_copies_without_an_answer_are_remembered_of_as_many_as_requests() -> None:
    requestor = without_idle(most=8)
    ids = [bytes([number]) * 16 for number in range(12)]
    for number, execution_id in enumerate(ids):
        start(requestor, 10.0 * number, execution_id, UTC + number)
        requestor.poll(10.0 * number + 0.1)
        requestor.receive(
            said(ActionState.DONE, ExecutionReport(ExecutionState.RUNNING), execution_id), 10 * number + 1
        )
    assert requestor.receive(said(ActionState.DONE, ExecutionReport(ExecutionState.RUNNING), ids[0]), 130.0) == []
    again = said(ActionState.DONE, ExecutionReport(ExecutionState.RUNNING), ids[-1])
    assert requestor.receive(again, 130.0) == []
    assert sent(requestor.receive(again, 130.1)).action_state == ActionState.IDLE


def test_a_refusal_of_an_exchange_without_idle_counts_after_a_moment() -> None:
    pace = RequestPace(interval_s=0.1, longest_interval_s=0.4, grace_s=2.0, refusal_wait_s=0.1, says_idle=False)
    requestor = ActionRequestor(RequestorName.checked(0, "server"), MemoryJournal(), pace=pace)
    start(requestor)
    assert requestor.receive(REFUSED, 0.01) == []
    (concluded,) = requestor.poll(0.12)
    assert kinds([concluded]) == [OutcomeKind.REFUSED]
    assert requestor.next_deadline() is None
