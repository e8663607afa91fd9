from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from tests.unit.bridge.mute import Mute
from ua_fleet.bridge import (
    BridgeCore,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
    Skill,
    SkillTarget,
)
from ua_fleet.bridge.actions import Actions
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import SkillRejected, StorageUnavailable
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.skill import ExecutionReport, ExecutionState, MemoryJournal
from ua_fleet.skill import RecordedExecution as Recorded
from ua_fleet.skill.answers import read_answer
from ua_fleet.skill.status import read_result
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.messages import NetworkMessage

SPACE = 300
ACTION, STATUS = Topic(SPACE, 2, 1501), Topic(SPACE, 2, 1500)
SENDER = ("192.0.2.7", 50_000)
WALL = ticks_from_unix_ns(1_700_000_000_000_000_000)
PICK = Skill(
    ACTION,
    "pick",
    (SkillTarget(1, "arm", STATUS),),
    (make_field("place", BuiltinType.STRING),),
    (make_field("grams", BuiltinType.DOUBLE),),
)


class FullDisk(MemoryJournal):
    """A journal that may not be writable."""

    is_full = False

    def _check(self) -> None:
        if self.is_full:
            raise StorageUnavailable("journal.db: the disk is full; free some space")

    def recorded(self, execution: Recorded) -> None:
        self._check()
        super().recorded(execution)

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        self._check()
        super().reported(execution_id, report)


class Robot(Mute):
    """A driver whose robot is the test."""

    def __init__(self) -> None:
        self.offered: Sequence[Skill] = (PICK,)
        self.begun: list[Execution] = []
        self.asked: list[Execution] = []
        self.error: Exception | None = None

    def skills(self) -> Sequence[Skill]:
        return self.offered

    def execute(self, execution: Execution) -> None:
        self.begun.append(execution)
        if self.error is not None:
            raise self.error

    def query(self, execution: Execution) -> None:
        self.asked.append(execution)
        if self.error is not None:
            raise self.error


class Bench:
    """The Actions of one bridge, with all around them."""

    def __init__(
        self, *, robot: Robot | None = None, journal: MemoryJournal | None = None, must_be_verified: bool = False
    ) -> None:
        self.robot = robot or Robot()
        self.journal = journal or FullDisk()
        self.counters, self.now = Counters(), 0.0
        self.sent: list[bytes] = []
        self.answers: list[tuple[ActionMessage, tuple[str, int]]] = []
        self.failures: list[str] = []
        codec, timing = Codec(), PubSubTiming()
        publisher = Publisher(SPACE, timing, self.counters, codec)
        subscriber = Subscriber(SPACE, timing, self.counters, codec)
        self.core = BridgeCore(
            SPACE, publisher, subscriber, self.counters, send=self.sent.append, publish=self.robot.publish
        )
        self.actions = self.core.actions = Actions(
            SPACE,
            publisher,
            self.counters,
            driver=self.robot if robot is not NO_ROBOT else Mute(),
            journal=self.journal,
            requestors=(0, 9),
            must_be_verified=must_be_verified,
            core=self.core,
            send=self.sent.append,
            send_to=self._answer,
            wall_ticks=lambda: WALL + round(self.now * 1e7),
            failed=lambda text, _: self.failures.append(text),
        )
        self.answered_own = 0
        self.actions.answer_own = self._answer_own
        self.actions.begin(0.0)

    def _answer_own(self, _datagram: bytes) -> None:
        self.answered_own += 1

    def _answer(self, datagram: bytes, address: tuple[str, int]) -> None:
        message = Codec().decode(datagram)
        assert isinstance(message, ActionMessage)
        self.answers.append((message, address))

    def ask(
        self,
        number: int = 1,
        values: tuple[Any, ...] = ("bin",),
        *,
        verified: bool = False,
        own: bool = False,
        **rest: Any,
    ) -> None:
        """A request; an own one is of a run that the bridge carries."""
        message = ActionMessage(
            SPACE,
            ACTION.ns,
            ACTION.id,
            1,
            1,
            ActionState.EXECUTING,
            is_request=True,
            requestor_id="0.server",
            correlation_data=number.to_bytes(16, "big"),
            timeout_hint_ms=2000.0,
            types=(int(BuiltinType.STRING),),
            values=values,
            timestamp=WALL + number,
        )
        message = message._replace(**rest)
        if own:
            self.actions.receive_own(message, self.now)
        else:
            self.actions.receive(ActionReceived(message, SENDER, verified), self.now)

    def tell(self, fact: Any) -> None:
        """What the driver says."""
        self.core.from_space(fact, now=self.now, wall_ticks=WALL)

    def reports(self) -> list[ExecutionReport]:
        """What was answered with Done."""
        return [read_answer(message) for message, _ in self.answers if message.action_state == ActionState.DONE]

    def states(self) -> list[ExecutionState]:
        return [execution.report.state for execution in self.journal.executions()]

    def status(self) -> tuple[Any, ...]:
        """The fields of the last SkillStatus."""
        messages = [message for message in map(Codec().decode, self.sent) if isinstance(message, NetworkMessage)]
        frames = [part for message in messages for part in message.messages if part.data_set_writer_id == STATUS.id]
        return [frame for frame in frames if frame.values][-1].values

    def announced(self) -> list[ActionMetaDataAnnouncement]:
        decoded = map(Codec().decode, self.sent)
        return [message for message in decoded if isinstance(message, ActionMetaDataAnnouncement)]


NO_ROBOT = Robot()
MANY = Drop.TOO_MANY_REQUESTORS
ID, OTHER = (1).to_bytes(16, "big"), (2).to_bytes(16, "big")


def test_a_skill_is_announced_accepted_and_shown() -> None:
    bench = Bench()
    assert [(one.request.name, len(one.targets)) for one in bench.announced()] == [("pick", 1)]
    bench.ask()
    assert bench.robot.begun == [Execution(ID, ACTION, 1, ("bin",), 2.0)]
    assert [report.state for report in bench.reports()] == [ExecutionState.RUNNING]
    assert bench.answers[0][1] == SENDER
    bench.tell(ExecutionProgressed(ID, 0.25, "on my way"))
    assert bench.status()[:4] == ((ID,), ("pick",), (ExecutionState.RUNNING,), (0.25,))
    bench.tell(ExecutionEnded(ID, 0, (12.5,)))
    _, _, states, progress, results, *_ = bench.status()
    assert (states, progress, read_result(results[0])) == ((ExecutionState.DONE,), (1.0,), {"grams": 12.5})
    bench.ask()
    assert len(bench.robot.begun) == 1
    assert bench.reports()[-1].state is ExecutionState.DONE


def test_what_the_driver_refuses_is_refused() -> None:
    bench = Bench()
    bench.robot.error = SkillRejected("the gripper is open")
    bench.ask()
    report = bench.reports()[-1]
    assert (report.state, report.message) == (ExecutionState.REFUSED, "the gripper is open")
    assert report.status == StatusCode.BAD_REQUEST_NOT_ALLOWED
    assert bench.status()[-1] == (StatusCode.BAD_REQUEST_NOT_ALLOWED,)


def test_a_driver_that_breaks_leaves_the_execution_unknown() -> None:
    bench = Bench()
    bench.robot.error = RuntimeError("a mistake")
    bench.ask()
    assert bench.states() == [ExecutionState.UNKNOWN]
    assert bench.failures == ["the driver failed while it began an execution"]
    bench.robot.error = None
    bench.ask()
    assert len(bench.robot.begun) == 1


@pytest.mark.parametrize(
    ("values", "state", "status"),
    [
        ((12.5,), ExecutionState.DONE, StatusCode.GOOD),
        ((), ExecutionState.DONE, StatusCode.UNCERTAIN),
        (("heavy",), ExecutionState.DONE, StatusCode.UNCERTAIN),
    ],
)
def test_results_that_do_not_fit_are_counted(values: tuple[Any, ...], state: ExecutionState, status: int) -> None:
    bench = Bench()
    bench.ask()
    bench.tell(ExecutionEnded(ID, 0, values))
    [execution] = bench.journal.executions()
    assert (execution.report.state, execution.report.status) == (state, status)
    assert bench.counters.drops[Drop.CONVERSION] == (status != StatusCode.GOOD)


def test_nothing_is_begun_or_said_while_it_cannot_be_recorded() -> None:
    journal = FullDisk()
    bench = Bench(journal=journal)
    journal.is_full = True
    bench.ask()
    bench.ask()
    assert (bench.robot.begun, bench.answers) == ([], [])
    assert bench.actions.problem == "journal.db: the disk is full; free some space"
    assert len(bench.failures) == 1, "said once"
    journal.is_full = False
    bench.ask()
    assert len(bench.robot.begun) == 1
    assert bench.actions.problem == ""


class Unsynced(MemoryJournal):
    """A journal whose disk could not be synced: nobody knows what of the last commits is there."""

    is_failed = False

    def settle(self) -> None:
        if self.is_failed:
            raise StorageUnavailable("carried.db: the disk could not be synced")

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        self.settle()
        super().reported(execution_id, report)


def with_own_under_way() -> tuple[Bench, Unsynced]:
    """ID is the server's, OTHER of a run that the bridge carries itself; the disk of this run fails."""
    robot = Robot()
    robot.offered = (replace(PICK, limits=SkillLimits(requests_at_once=8)),)
    bench, own = Bench(robot=robot, journal=MemoryJournal()), Unsynced()
    bench.ask(1)
    bench.actions.record_own_in(own, 0.0)
    bench.ask(2, requestor_id=f"{SPACE}.carrier", own=True)
    own.is_failed = True
    return bench, own


def test_a_failed_sync_of_own_runs_keeps_nothing_of_others_back() -> None:
    bench, own = with_own_under_way()
    bench.tell(ExecutionEnded(OTHER, 0, (2.0,)))
    assert bench.actions.unrecorded == 1
    bench.tell(ExecutionSuspended(ID, "a person stands there"))
    bench.tell(ExecutionEnded(ID, 0, (1.0,)))
    assert bench.states() == [ExecutionState.DONE], "at once, not with what waits"
    bench.ask(3)
    assert [each.execution_id[-1] for each in bench.robot.begun] == [1, 2, 3]
    assert bench.actions.problem == "carried.db: the disk could not be synced"
    for second in (1.0, 2.0):
        bench.now = second
        bench.actions.poll(second)
    assert bench.actions.unrecorded == 1, "the end of the own one waits"
    assert len(bench.failures) == 1, "said once"
    own.is_failed = False
    bench.now = 3.0
    bench.actions.poll(3.0)
    assert [each.report.state for each in own.executions()] == [ExecutionState.DONE]
    assert bench.actions.problem == ""


def test_an_own_execution_whose_sync_fails_is_neither_begun_nor_answered() -> None:
    bench, _ = with_own_under_way()
    for _ in range(2):  # the second time it is known
        bench.ask(4, requestor_id=f"{SPACE}.carrier", own=True)
    assert [each.execution_id[-1] for each in bench.robot.begun] == [1, 2]
    assert bench.answered_own == 1, "of the one before"
    bench.ask(5)
    assert bench.robot.begun[-1].execution_id[-1] == 5


def test_an_end_that_cannot_be_recorded_waits() -> None:
    journal = FullDisk()
    bench = Bench(journal=journal)
    bench.ask()
    journal.is_full = True
    bench.tell(ExecutionEnded(ID, 0, (1.0,)))
    bench.now = 0.5
    bench.actions.poll(bench.now)
    assert bench.states() == [ExecutionState.RUNNING]
    deadline = bench.actions.next_deadline()
    assert deadline is not None
    assert deadline <= 1.0
    journal.is_full = False
    bench.now = 1.0
    bench.actions.poll(bench.now)
    assert bench.states() == [ExecutionState.DONE]


def test_what_a_robot_repeats_while_nothing_can_be_recorded_takes_no_memory() -> None:
    journal = FullDisk()
    bench = Bench(journal=journal)
    bench.ask()
    journal.is_full = True
    bench.tell(ExecutionEnded(OTHER, 0, (9.0,)))  # nobody has asked for that
    for number in range(1000):
        bench.tell(ExecutionSuspended(ID, f"{number}"))
        bench.tell(ExecutionResumed(ID))
    assert bench.actions.unrecorded == 0, "what is not recorded need not wait"
    bench.tell(ExecutionEnded(ID, 0, (1.0,)))
    for number in range(1000):
        bench.tell(ExecutionSuspended(ID, f"{number}"))
        bench.tell(ExecutionEnded(ID, 0, (2.0,)))
        bench.tell(ExecutionEnded(OTHER, 0, (9.0,)))
    assert bench.actions.unrecorded == 1
    assert bench.counters.drops[Drop.UNASKED] == 2000
    journal.is_full = False
    bench.now = 1.0
    bench.actions.poll(bench.now)
    assert (bench.states(), bench.actions.unrecorded) == ([ExecutionState.DONE], 0)
    assert read_result(bench.status()[4][0]) == {"grams": 1.0}, "the first end counts"


def test_the_last_word_of_a_robot_that_stands_waits_behind_the_end_of_another() -> None:
    journal = FullDisk()
    bench = two_under_way(journal)
    journal.is_full = True
    bench.tell(ExecutionEnded(ID, 0, (1.0,)))
    for number in range(1000):
        bench.tell(ExecutionResumed(OTHER))
        bench.tell(ExecutionSuspended(OTHER, f"{number}"))
    assert bench.actions.unrecorded == 2
    journal.is_full = False
    bench.now = 1.0
    bench.actions.poll(bench.now)
    assert bench.status()[2] == (ExecutionState.DONE, ExecutionState.SUSPENDED)
    assert bench.status()[5][1] == "999"


def two_under_way(journal: MemoryJournal) -> Bench:
    """Executions ID and OTHER."""
    robot = Robot()
    robot.offered = (replace(PICK, limits=SkillLimits(requests_at_once=2)),)
    bench = Bench(robot=robot, journal=journal)
    bench.ask(1)
    bench.ask(2)
    return bench


def test_progress_does_not_wait_for_what_cannot_be_recorded() -> None:
    journal = FullDisk()
    bench = two_under_way(journal)
    journal.is_full = True
    bench.tell(ExecutionEnded(ID, 0, (1.0,)))
    for percent in range(1, 51):
        bench.tell(ExecutionProgressed(OTHER, percent / 100, "on my way"))
    assert bench.status()[3] == (0.0, 0.5)
    assert bench.actions.problem == "journal.db: the disk is full; free some space"
    journal.is_full = False
    bench.now = 1.0
    bench.actions.poll(bench.now)
    assert bench.states() == [ExecutionState.DONE, ExecutionState.RUNNING]
    assert bench.status()[3] == (1.0, 0.5)


def test_a_mistake_in_recording_one_fact_keeps_no_other_back(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = two_under_way(MemoryJournal())
    reported = bench.journal.reported

    def mistaken(execution_id: bytes, report: ExecutionReport) -> None:
        if execution_id == ID:
            raise KeyError(execution_id)
        reported(execution_id, report)

    monkeypatch.setattr(bench.journal, "reported", mistaken)
    with pytest.raises(KeyError):
        bench.tell(ExecutionEnded(ID, 0, (1.0,)))
    bench.tell(ExecutionEnded(OTHER, 0, (1.0,)))
    assert bench.states() == [ExecutionState.RUNNING, ExecutionState.DONE]


def test_a_refusal_that_cannot_be_recorded_waits() -> None:
    journal = FullDisk()
    bench = Bench(journal=journal)

    def execute(execution: Execution) -> None:
        journal.is_full = True
        raise SkillRejected("no")

    bench.robot.execute = execute  # type: ignore[method-assign]  # the disk fills up at this moment
    bench.ask()
    assert bench.reports() == [], "nobody may hear that it is refused before it is recorded"
    journal.is_full = False
    bench.now = 1.0
    bench.actions.poll(bench.now)
    assert bench.states() == [ExecutionState.REFUSED]


@pytest.mark.parametrize(
    ("fact", "state"),
    [
        (ExecutionProgressed(ID), ExecutionState.RUNNING),
        (ExecutionEnded(ID, 0, (1.0,)), ExecutionState.DONE),
        (ExecutionEnded(ID, StatusCode.BAD_OUT_OF_SERVICE, (), "broken"), ExecutionState.FAILED),
        (ExecutionForgotten(ID, "switched off meanwhile"), ExecutionState.UNKNOWN),
    ],
)
def test_after_a_restart_the_driver_says_what_became_of_it(fact: Any, state: ExecutionState) -> None:
    before = Bench()
    before.ask()
    after = Bench(journal=before.journal)
    assert after.robot.asked == before.robot.begun
    assert after.status()[2] == (ExecutionState.ASKING,)
    after.tell(fact)
    assert after.states() == [state]
    assert after.status()[2] == (state,)
    assert after.robot.begun == []


def test_what_was_surely_not_begun_is_begun_after_a_restart() -> None:
    before = Bench()
    before.ask()
    after = Bench(journal=before.journal)
    after.tell(ExecutionNotBegun(ID))
    assert after.robot.begun == before.robot.begun


def test_a_driver_that_breaks_when_it_is_asked_leaves_the_execution_unknown() -> None:
    before = Bench()
    before.ask()
    robot = Robot()
    robot.error = RuntimeError("a mistake")
    after = Bench(robot=robot, journal=before.journal)
    assert after.states() == [ExecutionState.UNKNOWN]


def test_skills_may_come_and_go() -> None:
    bench = Bench()
    bench.robot.offered = ()
    bench.now = 1.0
    bench.actions.poll(bench.now)
    bench.ask(1)
    assert bench.reports()[-1].message == "there is no such skill here"
    bench.robot.offered = (PICK,)
    bench.now = 2.0
    bench.actions.poll(bench.now)
    bench.core.poll(3.0)
    bench.ask(2)
    assert [execution.execution_id for execution in bench.robot.begun] == [(2).to_bytes(16, "big")]
    assert [len(one.targets) for one in bench.announced()][-1] == 1


@pytest.mark.parametrize(
    ("limits", "second", "status", "drop"),
    [
        (SkillLimits(least_interval_s=2.0), {}, StatusCode.BAD_SERVER_TOO_BUSY, Drop.TOO_SOON),
        (
            SkillLimits(largest_message_bytes=8),
            {"values": ("shelf",)},
            StatusCode.BAD_REQUEST_TOO_LARGE,
            Drop.TOO_LARGE,
        ),
        (SkillLimits(most_requestors=1), {"requestor_id": "0.b"}, StatusCode.BAD_MAX_CONNECTIONS_REACHED, MANY),
        (SkillLimits(visible_to=(0,)), {"requestor_id": "9.b"}, StatusCode.BAD_USER_ACCESS_DENIED, Drop.REQUESTOR),
    ],
)
def test_the_limits_of_a_skill_hold_at_the_robot(
    limits: SkillLimits, second: dict[str, Any], status: StatusCode, drop: Drop
) -> None:
    robot = Robot()
    robot.offered = (replace(PICK, limits=limits),)
    bench = Bench(robot=robot)
    bench.ask(1)
    bench.tell(ExecutionEnded(ID, 0, (12.5,)))
    bench.ask(1)
    bench.ask(2, **second)
    assert [execution.execution_id for execution in robot.begun] == [ID]
    assert [report.state for report in bench.reports()[-2:]] == [ExecutionState.DONE, ExecutionState.REFUSED]
    assert bench.reports()[-1].status == status
    assert bench.counters.drops == {drop: 1}


def test_a_bridge_without_skills_refuses() -> None:
    bench = Bench(robot=NO_ROBOT)
    bench.ask()
    assert bench.reports()[-1].status == StatusCode.BAD_NOT_SUPPORTED
    assert bench.announced() == []


@pytest.mark.parametrize(
    ("change", "drop"),
    [
        ({"requestor_id": f"{SPACE}.x"}, Drop.LOOP),
        ({"requestor_id": "77.x"}, Drop.REQUESTOR),
        ({"requestor_id": None}, Drop.REQUESTOR),
        ({"response_address": "opc.udp://somewhere:1"}, Drop.MALFORMED),
    ],
)
def test_requests_that_are_not_done_are_counted(change: dict[str, Any], drop: Drop) -> None:
    bench = Bench()
    bench.ask(**change)
    assert bench.robot.begun == []
    assert bench.counters.drops[drop] == 1


def test_the_response_address_is_answered() -> None:
    bench = Bench()
    bench.ask(response_address="opc.udp://192.0.2.9:4841")
    assert bench.answers[0][1] == ("192.0.2.9", 4841)


def test_an_unsigned_request_is_not_done_when_there_are_keys() -> None:
    bench = Bench(must_be_verified=True)
    bench.ask()
    assert (bench.robot.begun, bench.answers) == ([], [])
    assert bench.counters.drops[Drop.NOT_SECURED] == 1
    bench.ask(verified=True)
    assert len(bench.robot.begun) == 1


def test_facts_of_executions_that_nobody_asked_for_are_left_alone() -> None:
    bench = Bench()
    facts: list[Callable[[], Any]] = [
        lambda: ExecutionEnded(b"x" * 16, 0, (1.0,)),
        lambda: ExecutionProgressed(b"x" * 16, 0.5),
        lambda: ExecutionForgotten(b"x" * 16),
        lambda: ExecutionNotBegun(b"x" * 16),
    ]
    for fact in facts:
        bench.tell(fact())
    assert bench.states() == []
