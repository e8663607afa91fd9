from __future__ import annotations

import asyncio
from typing import Any

import pytest
import structlog

from tests.outcomes import Outcomes
from ua_fleet.errors import RobotOffline, SkillRejected, StorageUnavailable
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.skill import ExecutionReport, ExecutionState, MemoryJournal, OutcomeKind, RecordedRequest, RequestOutcome
from ua_fleet.skill.exchanges import answer
from ua_fleet.skill.executions import SUSPEND_TARGETS
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ActionTarget
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, PublisherIdType

ACTION = Topic(300, 2, 1501)
METADATA = DataSetMetaData("pick", (make_field("place", BuiltinType.STRING),), ConfigurationVersion(1, 1))
ANNOUNCED = ActionMetaDataAnnouncement(
    300, PublisherIdType.UINT16, 0, ACTION.id, (ActionTarget(1, "arm"),), METADATA, METADATA._replace(fields=())
)
WALL = ticks_from_unix_ns(1_700_000_000_000_000_000)
DONE = ExecutionReport(ExecutionState.DONE)


class FullDisk(MemoryJournal):
    is_full = False

    def requested(self, request: RecordedRequest) -> None:
        self._check()
        super().requested(request)

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self._check()
        super().concluded(execution_id, outcome)

    def _check(self) -> None:
        if self.is_full:
            raise StorageUnavailable("commands.db: the disk is full; free some space")


class Bench:
    def __init__(self, journal: MemoryJournal | None = None, *, must_be_verified: bool = False) -> None:
        self.sent: list[bytes] = []
        self.wanted: list[tuple[int, int]] = []
        self.told: list[OutcomeKind] = []
        self.journal = journal or FullDisk()
        self._outcomes = Outcomes()
        self.commands = SkillCommands(
            self.journal,
            send=self.sent.append,
            want=self._want,
            sooner=lambda: None,
            wall_ticks=lambda: WALL,
            must_be_verified=must_be_verified,
            told=self._tell,
            clock=lambda: asyncio.get_running_loop().time(),
            log=structlog.get_logger(),
        )

    def _want(self, space: int, data_set_writer_id: int, now: float) -> bool:
        del now
        self.wanted.append((space, data_set_writer_id))
        return True

    def requests(self) -> list[ActionMessage]:
        decoded = [Codec().decode(datagram) for datagram in self.sent]
        return [message for message in decoded if isinstance(message, ActionMessage)]

    async def asked(self, count: int = 1) -> ActionMessage:
        """The last request, once so many were sent."""
        async with asyncio.timeout(60):
            while len(self.sent) < count:
                await asyncio.sleep(0)
        return self.requests()[-1]

    def respond(
        self, request: ActionMessage, report: ExecutionReport = DONE, *, verified: bool = False, now: float = 0
    ) -> None:
        response = answer(request, ActionState.DONE, report, None).message
        self.commands.receive(ActionReceived(response, ("192.0.2.1", 1), verified), now)

    def invoke(self, *values: Any, timeout_s: float = 5.0, **rest: Any) -> asyncio.Task[RequestOutcome]:
        return asyncio.ensure_future(self._outcomes.invoke(self.commands, ACTION, values, timeout_s, **rest))

    def outcome(self, execution_id: bytes) -> asyncio.Task[RequestOutcome]:
        return asyncio.ensure_future(self._outcomes.of(self.commands, execution_id))

    def _tell(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self.told.append(outcome.kind)
        self._outcomes.tell(execution_id, outcome)


def announced(bench: Bench) -> Bench:
    bench.commands.announced(ANNOUNCED)
    return bench


async def test_an_action_is_asked_for_once_it_is_announced() -> None:
    bench = Bench()
    asking = bench.invoke("bin")
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert (bench.wanted, bench.sent) == ([(300, 1501)], [])
    bench.commands.announced(ANNOUNCED._replace(data_set_writer_id=7))
    await asyncio.sleep(0)
    bench.commands.announced(ANNOUNCED)
    request = await bench.asked()
    assert (request.publisher_id, request.writer_group_id, request.data_set_writer_id) == ACTION
    assert (request.requestor_id, request.values, request.timeout_hint_ms) == ("0.server", ("bin",), 5000.0)
    bench.respond(request)
    assert (await asking).kind is OutcomeKind.ACCEPTED
    assert bench.commands.outcomes == {"accepted": 1}
    assert bench.told == [OutcomeKind.ACCEPTED]


async def test_an_action_that_nobody_announces_is_told() -> None:
    with pytest.raises(RobotOffline, match=r"no bridge announces the Action ua_300_2_1501; check that the bridge"):
        await Bench().invoke("bin", timeout_s=0.01)


@pytest.mark.parametrize(
    ("values", "robot", "reason"),
    [
        ((), "arm", "pick takes 'place', which is not given"),
        ((5,), "arm", "pick: "),
        (
            ("bin",),
            "leg",
            "announces pick of arm, hand at ua_300_2_1501, and .* has pick of leg",
        ),
    ],
)
async def test_what_cannot_be_asked_is_not_sent(values: tuple[Any, ...], robot: str, reason: str) -> None:
    bench = Bench()
    bench.commands.announced(ANNOUNCED._replace(targets=(*ANNOUNCED.targets, ActionTarget(2, "hand"))))
    with pytest.raises(SkillRejected, match=reason):
        await bench.invoke(*values, robot=robot)
    assert bench.sent == []


async def test_a_request_that_cannot_be_recorded_is_not_sent() -> None:
    journal = FullDisk()
    bench = announced(Bench(journal))
    journal.is_full = True
    with pytest.raises(StorageUnavailable, match="free some space"):
        await bench.invoke("bin")
    assert bench.sent == []


async def test_a_control_that_cannot_be_recorded_is_not_sent_and_leaves_nothing() -> None:
    journal = FullDisk()
    bench = Bench(journal)
    bench.commands.announced(ANNOUNCED._replace(targets=(*ANNOUNCED.targets, ActionTarget(1 | SUSPEND_TARGETS, "arm"))))
    journal.is_full = True
    with pytest.raises(StorageUnavailable, match="free some space"):
        bench.commands.suspend_execution(ACTION, "arm", b"x" * 16)
    assert bench.sent == []
    assert bench.commands._controls == {}  # pyright: ignore[reportPrivateUsage]
    journal.is_full = False
    bench.commands.suspend_execution(ACTION, "arm", b"x" * 16)
    assert len(bench.sent) == 1


async def test_an_outcome_that_cannot_be_recorded_is_told_once_it_is() -> None:
    journal = FullDisk()
    bench = announced(Bench(journal))
    asking = bench.invoke("bin")
    request = await bench.asked()
    journal.is_full = True
    bench.respond(request)
    bench.respond(request)
    assert (asking.done(), bench.commands.outcomes) == (False, {"problems": 2})
    journal.is_full = False
    bench.respond(request)
    assert (await asking).kind is OutcomeKind.ACCEPTED


async def test_requests_of_a_run_before_are_asked_again() -> None:
    before = announced(Bench())
    first = before.invoke("bin", execution_id=b"x" * 16)
    request = await before.asked()
    first.cancel()
    after = Bench(before.journal)
    after.commands.resume(0.0)
    again = await after.asked()
    assert (again.correlation_data, again.timestamp, again.values) == (
        request.correlation_data,
        request.timestamp,
        request.values,
    )
    waiting = after.outcome(b"x" * 16)
    await asyncio.sleep(0)
    after.respond(again)
    assert (await waiting).kind is OutcomeKind.ACCEPTED
    assert (await after.outcome(b"x" * 16)).kind is OutcomeKind.ACCEPTED
    with pytest.raises(KeyError):
        await after.outcome(b"y" * 16)


async def test_an_unsigned_response_is_not_taken_when_there_are_keys() -> None:
    bench = announced(Bench(must_be_verified=True))
    asking = bench.invoke("bin")
    request = await bench.asked()
    bench.respond(request)
    assert not asking.done()
    bench.respond(request, verified=True)
    assert (await asking).kind is OutcomeKind.ACCEPTED


async def test_silence_is_unknown_and_may_be_corrected() -> None:
    bench = announced(Bench())
    asking = bench.invoke("bin")
    request = await bench.asked()
    later = asyncio.get_running_loop().time() + 60
    assert bench.commands.next_deadline() is not None
    bench.commands.poll(later)
    assert (await asking).kind is OutcomeKind.UNKNOWN
    bench.respond(request, now=later)
    assert bench.told == [OutcomeKind.UNKNOWN, OutcomeKind.ACCEPTED]
    assert bench.commands.outcomes == {"unknown": 1, "corrected": 1}


async def test_what_is_halted_before_its_robot_has_answered_is_begun_no_more() -> None:
    """The robot may be away, and hear of the request when it comes back."""
    bench = announced(Bench())
    bench.commands.request(ACTION, "arm", "pick", {"place": "bin"}, 5.0, bytes(16))
    with pytest.raises(SkillRejected, match="no way to stop"):
        bench.commands.halt(ACTION, "arm", bytes(16))
    assert [request.timeout_hint_ms for request in bench.requests()] == [5000.0, 0.0]
