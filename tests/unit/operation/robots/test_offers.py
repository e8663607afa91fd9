"""What becomes of a request to clients: every way it can go, with the journal and without a clock."""

from __future__ import annotations

from typing import Any

import pytest
import structlog

from tests.unit.fleet.fleet_of import fleet_config
from ua_fleet.config.registration import CLIENTS, RobotText, read_robot
from ua_fleet.errors import RobotOffline, SkillRejected, StorageUnavailable
from ua_fleet.operation.robots.offered_results import OfferRefused, read_results
from ua_fleet.operation.robots.offers import MOST_REMEMBERED, ClientOffers, OfferedExecution
from ua_fleet.pubsub.events import DataReceived, SourceReturned, SourceSilent, SubscriberEvent
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.skill.journal import MemoryJournal, RecordedExecution
from ua_fleet.skill.status import read_status
from ua_fleet.topics import Topic
from ua_fleet.values import TICKS_PER_SECOND, StatusCode

TEXT = """\
skills:
  fix:
    id: 1100
    arguments: {what: {type: String}}
    results: {fixed: {type: Boolean}, cost: {type: Double, range: [0, 9]}}
    timeout_s: 10
    limits: {requests_at_once: 3}
  look: {id: 1101}
skill_status_id: 1102
"""
ROBOT = read_robot(RobotText("mechanic", CLIENTS, text=TEXT), fleet_config({}), lambda _: None).model
FIX, LOOK, STATUS = Topic(0, 2, 1100), Topic(0, 2, 1101), Topic(0, 2, 1102)
ONE, TWO, THREE, FOUR = (bytes([number]) * 16 for number in range(1, 5))
RESULTS = {"fixed": True, "cost": 1.0}


class Full(MemoryJournal):
    """A journal whose disk may be full."""

    is_full = False

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        if self.is_full:
            raise StorageUnavailable("the disk is full")
        super().reported(execution_id, report)

    def recorded(self, execution: Any) -> None:
        if self.is_full:
            raise StorageUnavailable("the disk is full")
        super().recorded(execution)


class Hall:
    def __init__(self, journal: Full | None = None) -> None:
        self.journal = journal or Full()
        self.now = 1000 * TICKS_PER_SECOND
        self.ahead = 0
        """Of the wall clock, which somebody has set."""
        self.events: list[SubscriberEvent] = []
        self.outcomes: list[tuple[bytes, RequestOutcome]] = []
        self.changes: list[OfferedExecution] = []
        self.offers = ClientOffers(
            self.journal,
            show=self.events.append,
            told=lambda execution_id, outcome: self.outcomes.append((execution_id, outcome)),
            wall_ticks=lambda: self.now + self.ahead,
            log=structlog.get_logger(),
            steady_ticks=lambda: self.now,
        )
        self.offers.changed = self.changes.append
        self.offers.follow(ROBOT)

    def ask(self, execution_id: bytes = ONE) -> None:
        self.offers.request(FIX, "mechanic", "fix", {"what": "belt"}, 5, execution_id)

    def taken(self, execution_id: bytes = ONE) -> None:
        self.offers.offer("s1", "anna", FIX)
        self.ask(execution_id)
        self.offers.accept("s1", "anna", execution_id)

    def later(self, seconds: float) -> None:
        self.now += round(seconds * TICKS_PER_SECOND)
        self.offers.poll()

    def said(self) -> dict[bytes, tuple[ExecutionState, str]]:
        """What the last SkillStatus says."""
        last = next(event for event in reversed(self.events) if isinstance(event, DataReceived))
        rows = read_status(last.metadata.fields, last.message.values)
        return {row.execution_id: (row.state, row.message) for row in rows}

    def state(self, execution_id: bytes = ONE) -> ExecutionState:
        """What the server knows, which is also what a restart would find."""
        report = self.offers.known_outcome(execution_id).report
        assert {one.execution_id: one.report for one in self.journal.executions()}[execution_id] == report
        return report.state


@pytest.fixture
def hall() -> Hall:
    return Hall()


def test_what_is_asked_is_taken_done_and_brings_results(hall: Hall) -> None:
    hall.taken()
    assert hall.outcomes == [(ONE, RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.RUNNING)))]
    hall.offers.progressed("s1", "anna", ONE, 0.5, "half way")
    assert hall.said() == {ONE: (ExecutionState.RUNNING, "half way")}
    hall.offers.complete("s1", "anna", ONE, RESULTS, "as new")
    assert hall.said() == {ONE: (ExecutionState.DONE, "as new")}
    assert [asked.state for asked in hall.changes] == ["asked", "taken", "taken", "done"]
    assert hall.state() is ExecutionState.DONE
    assert hall.offers.due_in_s() is None


def test_the_same_request_is_meant_when_it_is_said_again(hall: Hall) -> None:
    hall.taken()
    hall.ask()
    assert len(hall.offers.open) == len(hall.outcomes) == 1


def test_a_robot_is_there_while_any_of_its_skills_is_offered(hall: Hall) -> None:
    with pytest.raises(RobotOffline, match=r"no client offers mechanic\.fix now"):
        hall.ask()
    hall.offers.offer("s1", "anna", LOOK)
    hall.offers.offer("s2", "bert", FIX)
    assert [type(event) for event in hall.events] == [SourceReturned, DataReceived]
    hall.offers.withdraw("s1", LOOK)
    assert len(hall.events) == 2
    hall.offers.departed("s2")
    assert hall.events[-1] == SourceSilent(STATUS)
    with pytest.raises(OfferRefused, match=r"does not offer mechanic\.fix"):
        hall.offers.withdraw("s2", FIX)


def test_one_client_takes_it(hall: Hall) -> None:
    hall.offers.offer("s2", "bert", FIX)
    hall.taken()
    with pytest.raises(OfferRefused, match="anna has taken it before"):
        hall.offers.accept("s2", "bert", ONE)
    with pytest.raises(OfferRefused, match="anna has taken it"):
        hall.offers.complete("s2", "bert", ONE, RESULTS, "")
    with pytest.raises(OfferRefused, match="anna has taken it"):
        hall.offers.fail("s2", "bert", ONE, "")
    with pytest.raises(OfferRefused, match="anna has taken it"):
        hall.offers.progressed("s2", "bert", ONE, 0.5, "")
    with pytest.raises(OfferRefused, match=r"this session does not offer mechanic\.fix"):
        hall.offers.accept("s3", "carl", ONE)
    with pytest.raises(OfferRefused, match="no robot is asked for"):
        hall.offers.accept("s2", "bert", TWO)
    with pytest.raises(OfferRefused, match="it goes from 0 to 1"):
        hall.offers.progressed("s1", "anna", ONE, 2, "")


def test_who_has_not_taken_it_cannot_end_it_but_refuse_it(hall: Hall) -> None:
    hall.offers.offer("s1", "anna", FIX)
    hall.ask()
    with pytest.raises(OfferRefused, match="accept it first"):
        hall.offers.complete("s1", "anna", ONE, RESULTS, "")
    hall.offers.fail("s1", "anna", ONE, "")
    assert hall.said() == {ONE: (ExecutionState.REFUSED, "anna does not do it")}
    with pytest.raises(OfferRefused, match="it is over: refused"):
        hall.offers.accept("s1", "anna", ONE)


def test_what_fails_is_failed(hall: Hall) -> None:
    hall.taken()
    hall.offers.fail("s1", "anna", ONE, "no spare part")
    report = hall.offers.known_outcome(ONE).report
    assert (report.state, report.status) == (ExecutionState.FAILED, StatusCode.BAD_UNEXPECTED_ERROR)


def test_time_runs_out(hall: Hall) -> None:
    hall.taken()
    hall.ask(TWO)
    assert hall.offers.due_in_s() == 10
    hall.later(9.9)
    assert len(hall.offers.open) == 2
    hall.later(0.1)
    assert (hall.state(ONE), hall.state(TWO)) == (ExecutionState.UNKNOWN, ExecutionState.TIMED_OUT)
    hall.offers.complete("s1", "anna", ONE, RESULTS, "late, and done")
    assert hall.state(ONE) is ExecutionState.DONE
    with pytest.raises(OfferRefused, match="it is over: timed_out"):
        hall.offers.complete("s1", "anna", TWO, RESULTS, "")


def test_the_end_of_a_client_ends_what_only_it_could_do(hall: Hall) -> None:
    hall.taken()
    hall.ask(TWO)
    hall.offers.offer("s2", "bert", FIX)
    hall.offers.departed("s1")
    assert (hall.state(ONE), hall.state(TWO)) == (ExecutionState.UNKNOWN, ExecutionState.RUNNING)
    hall.offers.departed("s2")
    assert hall.state(TWO) is ExecutionState.REFUSED
    hall.offers.offer("s3", "anna", FIX)
    assert hall.said()[TWO] == (ExecutionState.REFUSED, "the last client that offered it is gone")
    hall.offers.complete("s3", "anna", ONE, RESULTS, "")
    assert hall.state(ONE) is ExecutionState.DONE


def test_a_halt_is_told_to_who_has_taken_it_and_ends_what_nobody_has(hall: Hall) -> None:
    hall.taken()
    hall.ask(TWO)
    hall.offers.halt(FIX, "mechanic", ONE)
    hall.offers.halt(FIX, "mechanic", TWO)
    assert (hall.changes[-2].state, hall.state(TWO)) == ("halt", ExecutionState.REFUSED)
    hall.offers.fail("s1", "anna", ONE, "stopped")
    assert hall.offers.known_outcome(ONE).report.status == StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT
    with pytest.raises(SkillRejected, match="not under way"):
        hall.offers.halt(FIX, "mechanic", ONE)


def test_a_client_cannot_be_suspended(hall: Hall) -> None:
    hall.taken()
    for ask in (hall.offers.suspend_execution, hall.offers.resume_execution):
        with pytest.raises(SkillRejected, match="can only be halted") as caught:
            ask(FIX, "mechanic", ONE)
        assert caught.value.ua_status == StatusCode.BAD_NOT_SUPPORTED
    assert hall.state(ONE) is ExecutionState.RUNNING


def test_limits_and_arguments_are_kept(hall: Hall) -> None:
    hall.taken()
    with pytest.raises(SkillRejected, match="fix: "):
        hall.offers.request(FIX, "mechanic", "fix", {"what": object()}, 5, TWO)
    hall.ask(TWO)
    hall.ask(THREE)
    with pytest.raises(SkillRejected, match=r"3 executions of mechanic\.fix are under way") as caught:
        hall.ask(FOUR)
    assert caught.value.ua_status == StatusCode.BAD_TOO_MANY_OPERATIONS
    with pytest.raises(SkillRejected, match="no skill that clients do"):
        hall.offers.request(Topic(0, 2, 5), "x", "y", {}, 5, FOUR)


def test_a_restart_ends_what_was_under_way(hall: Hall) -> None:
    hall.taken()
    hall.ask(TWO)
    again = Hall(hall.journal)
    kinds = [again.offers.known_outcome(one).kind for one in (ONE, TWO)]
    assert kinds == [OutcomeKind.UNKNOWN, OutcomeKind.REFUSED]
    assert again.state(ONE) is ExecutionState.UNKNOWN
    again.offers.offer("s1", "anna", FIX)
    assert again.said() == {
        ONE: (ExecutionState.UNKNOWN, "the server was restarted while it was taken by anna"),
        TWO: (ExecutionState.REFUSED, "the server was restarted before anybody took it"),
    }
    again.ask(ONE)
    assert again.offers.open == []
    with pytest.raises(KeyError):
        again.offers.known_outcome(THREE)


def test_what_cannot_be_written_has_not_happened_and_is_tried_again(hall: Hall) -> None:
    hall.taken()
    hall.ask(TWO)
    hall.journal.is_full = True
    with pytest.raises(StorageUnavailable):
        hall.ask(THREE)
    with pytest.raises(StorageUnavailable):
        hall.offers.complete("s1", "anna", ONE, RESULTS, "")
    hall.later(10)
    hall.offers.departed("s1")
    assert (hall.state(ONE), hall.state(TWO)) == (ExecutionState.RUNNING, ExecutionState.RUNNING)
    assert hall.offers.due_in_s() == 1
    hall.later(1)
    hall.journal.is_full = False
    hall.later(1)
    assert (hall.state(ONE), hall.state(TWO)) == (ExecutionState.UNKNOWN, ExecutionState.TIMED_OUT)
    assert hall.offers.due_in_s() is None


@pytest.mark.parametrize("set_s", [-3600, 3600])
def test_what_is_waited_for_does_not_go_by_a_clock_that_is_set(hall: Hall, set_s: int) -> None:
    hall.offers.offer("s1", "anna", FIX)
    hall.ask()
    hall.ahead = set_s * TICKS_PER_SECOND
    assert hall.offers.due_in_s() == 10
    hall.later(9)
    assert hall.state() is ExecutionState.RUNNING
    hall.journal.is_full = True
    hall.later(1)
    hall.ahead = 0
    assert hall.offers.due_in_s() == 1
    hall.journal.is_full = False
    hall.later(1)
    assert hall.state() is ExecutionState.TIMED_OUT


def test_old_executions_are_forgotten(hall: Hall) -> None:
    hall.offers.offer("s1", "anna", FIX)
    for number in range(MOST_REMEMBERED + 5):
        execution_id = number.to_bytes(16, "big")
        hall.ask(execution_id)
        hall.offers.fail("s1", "anna", execution_id, "")
    assert len(hall.journal.executions()) == MOST_REMEMBERED + 1


def test_offers_stay_when_the_robot_is_changed(hall: Hall) -> None:
    hall.offers.offer("s1", "anna", FIX)
    hall.offers.unfollow(ROBOT)
    hall.events.clear()
    hall.offers.follow(ROBOT)
    assert [type(event) for event in hall.events] == [SourceReturned, DataReceived]
    hall.ask()


def test_nothing_more_is_said_of_a_robot_that_is_gone(hall: Hall) -> None:
    hall.taken()
    hall.later(10)
    hall.offers.unfollow(ROBOT)
    with pytest.raises(SkillRejected, match="no skill that clients do"):
        hall.offers.complete("s1", "anna", ONE, RESULTS, "")
    assert hall.state() is ExecutionState.UNKNOWN


@pytest.mark.parametrize(
    ("names", "texts", "problem"),
    [
        (["fixed"], ["true"], "the result 'cost' is missing"),
        (["fixed", "cost", "x"], ["true", "1", "2"], "fix has no result 'x'"),
        (["fixed", "fixed"], ["true", "1"], "each once"),
        (["fixed"], [], "as many values; there are 0"),
        (["fixed", "cost"], ["1", "cheap"], "fixed is 1; it has to be true or false; cost is 'cheap'"),
    ],
)
def test_results_that_do_not_fit_are_named(names: list[str], texts: list[str], problem: str) -> None:
    with pytest.raises(OfferRefused, match=problem):
        read_results(ROBOT.skills[0], names, texts)


def test_results_are_read_in_their_types() -> None:
    assert read_results(ROBOT.skills[0], ["cost", "fixed"], ["100", "false"]) == {"fixed": False, "cost": 100.0}


def prepared(hall: Hall, execution_id: bytes = ONE) -> RecordedExecution:
    """A request that its owner has written down."""
    record = hall.offers.prepare(FIX, "mechanic", "fix", {"what": "belt"}, 5, execution_id)
    assert record is not None
    hall.journal.recorded(record)
    hall.offers.recorded([record], [])
    return record


def test_what_the_owner_has_recorded_is_asked_and_not_recorded_again(hall: Hall) -> None:
    hall.offers.offer("s1", "anna", FIX)
    prepared(hall)
    assert hall.offers.open == []
    assert hall.outcomes == []
    with pytest.raises(KeyError):
        hall.offers.known_outcome(ONE)
    assert hall.offers.prepare(FIX, "mechanic", "fix", {"what": "belt"}, 5, ONE) is None
    hall.journal.is_full = True
    hall.ask()
    hall.journal.is_full = False
    assert [asked.execution_id for asked in hall.offers.open] == [ONE]
    assert hall.outcomes == [(ONE, RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.RUNNING)))]
    hall.offers.accept("s1", "anna", ONE)
    assert hall.state() is ExecutionState.RUNNING


def test_what_nobody_offers_any_more_is_left_and_asked_for_anew(hall: Hall) -> None:
    with pytest.raises(RobotOffline):
        hall.offers.prepare(FIX, "mechanic", "fix", {"what": "belt"}, 5, ONE)
    hall.offers.offer("s1", "anna", FIX)
    prepared(hall)
    hall.offers.departed("s1")
    with pytest.raises(RobotOffline):
        hall.ask()
    hall.offers.leave(ONE)
    assert list(hall.offers.left) == [ONE]
    hall.offers.offer("s2", "bert", FIX)
    hall.ask()
    assert not hall.offers.left
    assert hall.state() is ExecutionState.RUNNING
    prepared(hall, TWO)
    hall.offers.leave(TWO)
    hall.journal.forget_executions([TWO], {})
    hall.offers.recorded([], [TWO])
    hall.ask(TWO)
    assert [one.execution_id for one in hall.journal.executions()] == [ONE, TWO]


def test_a_restart_refuses_what_was_recorded_and_nobody_was_asked(hall: Hall) -> None:
    hall.offers.offer("s1", "anna", FIX)
    prepared(hall)
    again = Hall(hall.journal)
    assert again.state() is ExecutionState.REFUSED
