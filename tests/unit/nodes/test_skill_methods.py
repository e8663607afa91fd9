"""What Start and the other Methods check, and what they ask for."""

from __future__ import annotations

import asyncio
import importlib
from collections.abc import Mapping
from typing import Any

import pytest

from tests.unit.nodes.skilled import STATUS, TURN, model, said
from ua_fleet.endpoint.convert import node_id
from ua_fleet.endpoint.sessions import Session, current_session
from ua_fleet.endpoint.stack import StatusCodes
from ua_fleet.endpoint.users import Role, User
from ua_fleet.errors import NotAnnounced, RobotOffline, UaFleetError
from ua_fleet.nodes.skill_methods import SkillMethods
from ua_fleet.operation.skills.tracker import SkillTracker, SkillTransitioned
from ua_fleet.pubsub.events import SourceSilent
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.topics import Topic

ua: Any = importlib.import_module("asyncua.ua")
TURN_NODE = node_id(TURN)


class Bench:
    """SkillMethods with a server, robots and a clock that are the test."""

    def __init__(self) -> None:
        self.now, self.linked = 0.0, dict[str, Any]()
        self.asked: list[tuple[Any, ...]] = []
        self.halted: list[bytes] = []
        self.suspended: list[bytes] = []
        self.resumed: list[bytes] = []
        self.moves: list[str] = []
        self.error: Exception | None = None
        self.tracker = SkillTracker(model())
        self.methods = SkillMethods(
            self, self, self.tracker, put=self._put, clock=lambda: self.now, wall_ticks=lambda: int(self.now)
        )
        self.methods.add(model().robots[0])

    def link_method(self, node: Any, callback: Any) -> None:
        self.linked[node.to_string()] = callback

    def get_node(self, nodeid: Any) -> Any:
        return nodeid

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        if self.error is not None:
            raise self.error
        self.asked.append((topic, robot, tuple(arguments.values()), timeout_s, execution_id))

    def halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        assert (topic, robot) == (Topic(2, 2, 1500), "arm")
        self.halted.append(execution_id)

    def suspend_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        assert (topic, robot) == (Topic(2, 2, 1500), "arm")
        self.suspended.append(execution_id)

    def resume_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        assert (topic, robot) == (Topic(2, 2, 1500), "arm")
        self.resumed.append(execution_id)

    def _put(self, changes: Any) -> None:
        self.moves += [change.transition.text for change in changes if isinstance(change, SkillTransitioned)]

    async def start(self, angle: float = 20.0, times: int = 1, how: Any = "slowly") -> Any:
        values = (
            ua.Variant(angle, ua.VariantType.Double),
            ua.Variant(times, ua.VariantType.Int32),
            ua.Variant(how, ua.VariantType.String),
        )
        return await self.linked["ns=2;s=1500.Start"](TURN_NODE, *values)

    async def other(self, number: int, parent: Any = TURN_NODE) -> Any:
        return await self.linked[f"ns=3;i={number}"](parent)


async def refused(call: Any) -> int:
    with pytest.raises(UaFleetError) as caught:
        await call
    return int(caught.value.ua_status)


async def test_a_start_asks_the_robot_and_returns_the_executions_id() -> None:
    bench = Bench()
    (returned,) = await bench.start(angle=-5.0)
    (asked,) = bench.asked
    assert asked[:4] == (Topic(2, 2, 1500), "arm", (-5.0, 1, "slowly"), 30.0)
    assert returned.Value == asked[4].hex()
    assert bench.moves == ["ReadyToRunning"]
    assert bench.tracker.under_way(TURN) == 1


async def test_values_out_of_range_are_named_and_nothing_is_asked() -> None:
    bench = Bench()
    result = await bench.start(angle=91.0, times=6, how=None)
    assert result.StatusCode.name == "BadInvalidArgument"
    assert [one.name for one in result.InputArgumentResults] == ["BadOutOfRange", "BadOutOfRange", "BadTypeMismatch"]
    assert bench.asked == []


async def test_limits_are_kept() -> None:
    bench = Bench()
    assert await refused(bench.start(how="x" * 100)) == StatusCodes.BadRequestTooLarge
    await bench.start()
    assert await refused(bench.start()) == StatusCodes.BadServerTooBusy
    bench.now = 2.0
    await bench.start()
    bench.now = 4.0
    assert await refused(bench.start()) == StatusCodes.BadTooManyOperations
    bench.tracker.concluded(
        bench.asked[0][4], RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.DONE)), 5
    )
    await bench.start()
    assert len(bench.asked) == 3


async def test_what_could_not_be_asked_leaves_no_trace() -> None:
    bench = Bench()
    bench.error = RobotOffline("nobody there")
    assert await refused(bench.start()) == StatusCodes.BadNoCommunication
    assert (bench.moves, bench.tracker.under_way(TURN)) == ([], 0)
    bench.error = None
    await bench.start()


async def test_a_start_waits_for_the_actions_announcement() -> None:
    bench = Bench()
    bench.error = NotAnnounced("asked for")
    call = asyncio.ensure_future(bench.start())
    await asyncio.sleep(0)
    assert (call.done(), bench.asked, bench.moves) == (False, [], [])
    bench.error = None
    (returned,) = await call
    assert [returned.Value] == [asked[4].hex() for asked in bench.asked]
    assert bench.moves == ["ReadyToRunning"]


async def test_a_start_that_waits_asks_nothing_of_a_robot_that_fell_silent() -> None:
    bench = Bench()
    bench.tracker.apply(said(), 1)
    bench.error = NotAnnounced("asked for")
    call = asyncio.ensure_future(bench.start())
    await asyncio.sleep(0)
    bench.tracker.apply(SourceSilent(STATUS), 2)
    bench.error = None
    assert await refused(call) == StatusCodes.BadNoCommunication
    assert bench.asked == []


async def test_a_start_that_waits_ends_with_the_session_of_who_asked() -> None:
    bench = Bench()
    bench.error = NotAnnounced("asked for")
    link: Any = object()
    session = Session(link, b"", "client", 60.0, user=User("oscar", Role.OPERATOR))
    before = current_session.set(session)
    call = asyncio.ensure_future(bench.start())
    current_session.reset(before)
    await asyncio.sleep(0)
    session.closed, bench.error = True, None
    assert await refused(call) == StatusCodes.BadSessionClosed
    assert bench.asked == []


async def test_an_action_that_nobody_announces_is_refused_in_time_for_the_client() -> None:
    bench = Bench()
    bench.error = NotAnnounced("asked for")
    call = asyncio.ensure_future(bench.start())
    await asyncio.sleep(0)
    bench.now = 2.0
    assert await refused(call) == StatusCodes.BadNoCommunication
    assert (bench.moves, bench.asked) == ([], [])


async def test_a_silent_robot_is_not_asked() -> None:
    bench = Bench()
    bench.tracker.apply(said(), 1)
    bench.tracker.apply(SourceSilent(STATUS), 2)
    assert await refused(bench.start()) == StatusCodes.BadNoCommunication
    assert bench.asked == []


async def test_reset_is_for_what_is_halted() -> None:
    bench = Bench()
    assert await refused(bench.other(71005)) == StatusCodes.BadInvalidState
    await bench.start()
    bench.tracker.concluded(
        bench.asked[0][4], RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.FAILED)), 5
    )
    assert await bench.other(71005) == []
    assert bench.moves[-1] == "HaltedToReady"


async def test_halt_stops_all_that_is_under_way() -> None:
    bench = Bench()
    assert await refused(bench.other(71004)) == StatusCodes.BadInvalidState
    for bench.now in (0.0, 2.0):
        await bench.start()
    assert await bench.other(71004) == []
    assert bench.halted == [asked[4] for asked in bench.asked]


async def test_suspend_is_for_what_runs_and_resume_for_what_stands() -> None:
    bench = Bench()
    assert await refused(bench.other(71002)) == StatusCodes.BadInvalidState
    for bench.now in (0.0, 2.0):
        await bench.start()
    first, second = [asked[4] for asked in bench.asked]
    assert await refused(bench.other(71003)) == StatusCodes.BadInvalidState
    assert await bench.other(71002) == []
    assert bench.suspended == [first, second]
    bench.tracker.apply(said(ExecutionStatus(first, "turn", ExecutionState.SUSPENDED)), 5)
    assert await bench.other(71002) == []
    assert bench.suspended == [first, second, second]
    assert await bench.other(71003) == []
    assert bench.resumed == [first]
    assert await bench.other(71004) == []
    assert bench.halted == [first, second], "what stands can be halted"


async def test_what_is_no_skill_is_refused() -> None:
    bench = Bench()
    assert await refused(bench.other(71004, ua.NodeId(1010, 3))) == StatusCodes.BadNodeIdInvalid
    bench.methods.remove(model().robots[0])
    assert await refused(bench.start()) == StatusCodes.BadNodeIdInvalid
