"""The bridge around a robot that is driven by hand: what its driver is told, and what a mistake costs."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import structlog
from structlog.testing import capture_logs

from tests.outcomes import Outcomes
from tests.unit.bridge.test_runner import Line, Robot, until
from tests.unit.config.test_teleoperation import FILE
from ua_fleet.bridge import run_bridge, shell, teleoperation
from ua_fleet.config.load import load_content
from ua_fleet.config.teleoperation import teleoperations
from ua_fleet.counters import Counters
from ua_fleet.monitoring import Monitor, ProcessKind
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.pubsub.events import ActionReceived, AnnouncementReceived, DataReceived, ProbeDue, SourceUnknown
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.skill.executions import OutcomeKind, RequestOutcome, named_results
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.teleoperation import Setpoint, State, Status
from ua_fleet.teleoperation.messages import STATUS_FIELDS, encode_setpoint, read_granted, read_status
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

CONFIG = load_content(FILE.encode(), "f.yaml", {})
(MODEL,) = teleoperations(CONFIG, "floor")
BRIDGE = Topic(2, 2, 1001)
SERVER = ("127.0.0.1", 1)


class DrivenRobot(Robot):
    """A driver whose robot takes setpoints, and fails as it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.written: list[tuple[float, ...]] = []
        self.problem = ""
        self.failure: Exception | None = None

    def setpoint_problem(self, topic: Topic) -> str:
        assert topic == MODEL.data
        return self.problem

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None:
        assert topic == MODEL.data
        if self.failure is not None:
            raise self.failure
        self.written.append(values)


class Server:
    """The other end of the line, as far as it drives robots."""

    def __init__(self, line: Line) -> None:
        self._line, self.counters = line, Counters()
        self._subscriber = Subscriber(0, PubSubTiming(), self.counters, Codec())
        self._outcomes = Outcomes()
        self.statuses: list[Status] = []
        self.bridge: dict[str, Any] = {}
        """The latest status of the bridge itself."""
        self.end_bridge: Callable[[], object] = lambda: None
        self._commands = SkillCommands(
            MemoryJournal(),
            send=self.send,
            want=self._subscriber.want_action,
            sooner=lambda: None,
            wall_ticks=lambda: ticks_from_unix_ns(time.time_ns()),
            must_be_verified=False,
            told=self._outcomes.tell,
            clock=lambda: asyncio.get_running_loop().time(),
            log=structlog.get_logger(),
        )

    def send(self, datagram: bytes) -> None:
        assert self._line.receive is not None
        self._line.receive(datagram, SERVER)

    def hear(self) -> None:
        now = asyncio.get_running_loop().time()
        sent, self._line.sent[:] = list(self._line.sent), []
        events = [event for datagram in sent for event in self._subscriber.receive(datagram, now, SERVER)]
        for event in (*events, *self._subscriber.poll(now)):
            if isinstance(event, ActionReceived):
                self._commands.receive(event, now)
            elif isinstance(event, AnnouncementReceived):
                if isinstance(event.announcement, ActionMetaDataAnnouncement):
                    self._commands.announced(event.announcement)
            elif isinstance(event, ProbeDue | SourceUnknown) and event.datagram is not None:
                self.send(event.datagram)
            elif isinstance(event, DataReceived) and event.topic == MODEL.status:
                names = [field.name for field in STATUS_FIELDS]
                status = read_status(dict(zip(names, event.message.values, strict=True)))
                assert status is not None
                self.statuses.append(status)
            elif isinstance(event, DataReceived) and event.topic == BRIDGE:
                names = [field.name for field in event.metadata.fields]
                self.bridge = dict(zip(names, event.message.values, strict=True))
        self._commands.poll(now)

    async def hear_on(self) -> None:
        while True:
            self.hear()
            await asyncio.sleep(0.002)

    async def ask(self, topic: Topic, *values: Any) -> RequestOutcome:
        return await self._outcomes.invoke(self._commands, topic, values, 5.0)

    async def acquire(self, holder: str = "anna") -> int:
        outcome = await self.ask(MODEL.acquire, holder, f"session of {holder}", False)
        assert outcome.kind is OutcomeKind.ACCEPTED, outcome.report.message
        granted = read_granted(named_results(outcome, ()))
        assert granted is not None
        assert granted[2] == ("linear", "angular")
        return granted[0]

    def drive(self, lease: int, number: int, *values: float) -> None:
        setpoint = Setpoint(lease, number, self.statuses[-1].counter, values)
        self.send(encode_setpoint(Codec(), MODEL.setpoints, setpoint))

    async def until(self, is_so: Callable[[Status], bool]) -> Status:
        await until(lambda: self.statuses and is_so(self.statuses[-1]))
        return self.statuses[-1]


@asynccontextmanager
async def driven(robot: DrivenRobot, folder: Path, monitor: Monitor | None = None) -> AsyncGenerator[Server]:
    line, ready = Line(), asyncio.Event()
    server = Server(line)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shell, "STATUS_INTERVAL_S", 0.02)
        bridge = run_bridge(CONFIG, "floor", robot, line, state_dir=folder, ready=ready.set, monitor=monitor)
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(bridge)]
            server.end_bridge = tasks[0].cancel
            await ready.wait()
            tasks.append(group.create_task(server.hear_on()))
            yield server
            for task in tasks:
                task.cancel()


async def test_the_driver_is_told_each_period_what_the_robot_is_to_do(tmp_path: Path) -> None:
    robot = DrivenRobot()
    with capture_logs() as logs:
        async with driven(robot, tmp_path) as server:
            lease = await server.acquire()
            await server.until(lambda status: status.state is State.HELD)
            await until(lambda: robot.written)
            assert set(robot.written) == {(0.0, 0.0)}
            for number in range(1, 40):
                server.drive(lease, number, 0.3, 0.0)
                await asyncio.sleep(0.02)
            assert robot.written[-1][0] > 0.05
            await server.ask(MODEL.renew, lease)
            await server.ask(MODEL.release, lease, "released")
            await server.until(lambda status: status.state is State.IDLE)
            assert robot.written[-1] == (0.0, 0.0)
    assert [entry["detail"] for entry in logs if "lease" in entry["event"]] == [
        f"lease {lease}: anna",
        "anna: released",
    ]
    assert (tmp_path / "lease_numbers.json").exists()


async def test_a_driver_that_fails_costs_the_lease_and_nothing_else(tmp_path: Path) -> None:
    robot, monitor = DrivenRobot(), Monitor(ProcessKind.BRIDGE)
    async with driven(robot, tmp_path, monitor) as server:
        await server.acquire()
        await server.until(lambda status: status.state is State.HELD)
        robot.failure = OSError("the robot's library is broken")
        status = await server.until(lambda status: status.lease == 0)
        assert status.last_end == "anna: the bridge failed while it drove the robot"
        assert monitor.mistakes.counts["teleoperation"] > 0
        robot.failure = None
        await server.until(lambda status: status.state is State.IDLE)
        await server.acquire("ben")
        status = await server.until(lambda status: status.state is State.HELD)
        assert status.holder == "ben"


async def test_what_waited_while_the_machine_slept_is_old_when_it_wakes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = DrivenRobot()
    async with driven(robot, tmp_path) as server:
        lease, number = await server.acquire(), 0
        await server.until(lambda status: status.state is State.HELD)
        while not robot.written or robot.written[-1][0] < 0.05:
            number += 1
            server.drive(lease, number, 0.3, 0.0)
            await asyncio.sleep(0.02)
        before, slept = len(robot.written), teleoperation.slept_s()
        monkeypatch.setattr(teleoperation, "slept_s", lambda: slept + 3600.0)
        server.drive(lease, number + 1, 0.3, 0.0)
        status = await server.until(lambda status: status.state is State.IDLE)
        assert status.last_end == "anna: the bridge stood still, and the robot has stopped by itself"
        assert status.drops[0] == 1
        assert set(robot.written[before:]) == {(0.0, 0.0)}
        assert await server.acquire() > lease
        await server.until(lambda status: status.state is State.HELD)


async def test_a_robot_that_is_away_is_not_given_out_and_taken_back(tmp_path: Path) -> None:
    robot = DrivenRobot()
    async with driven(robot, tmp_path) as server:
        robot.problem = "/cmd_vel has no subscriber"
        refused = await server.ask(MODEL.acquire, "anna", "s", False)
        assert (refused.kind, refused.report.status) == (OutcomeKind.REFUSED, StatusCode.BAD_INVALID_STATE)
        assert refused.report.message == "carrier cannot be driven: /cmd_vel has no subscriber"
        robot.problem = ""
        await server.acquire()
        robot.problem = "/cmd_vel has no subscriber"
        status = await server.until(lambda status: status.lease == 0 and bool(status.last_end))
        assert status.last_end == "anna: /cmd_vel has no subscriber"


async def test_without_a_number_that_is_new_nobody_gets_the_robot(tmp_path: Path) -> None:
    (tmp_path / "lease_numbers.json").write_text("{")
    async with driven(DrivenRobot(), tmp_path) as server:
        refused = await server.ask(MODEL.acquire, "anna", "s", False)
        assert (refused.kind, refused.report.status) == (OutcomeKind.REFUSED, StatusCode.BAD_RESOURCE_UNAVAILABLE)
        assert "is no file of lease numbers" in refused.report.message


async def test_what_takes_setpoints_takes_nothing_else(tmp_path: Path) -> None:
    robot = DrivenRobot()
    fields = tuple(make_field(name, BuiltinType.DOUBLE) for name in ("linear", "angular"))
    other = Publisher(0, PubSubTiming(), Counters(), Codec())
    async with driven(robot, tmp_path) as server:
        for datagram in other.announce(MODEL.data, "cmd_vel", fields, now=0.0, wall_ticks=10**17):
            server.send(datagram)
        for datagram in other.publish(MODEL.data, (0.5, 0.0), timestamp=10**17, now=0.0):
            server.send(datagram)
        await until(lambda: server.bridge.get("Drops.not_a_setpoint") == 1)
        assert robot.published == []
        assert robot.written == []


async def test_drops_are_counted_for_the_robot_and_among_those_of_the_bridge(tmp_path: Path) -> None:
    robot = DrivenRobot()
    async with driven(robot, tmp_path) as server:
        lease = await server.acquire()
        await server.until(lambda status: status.state is State.HELD)
        server.drive(lease, 5, 0.1, 0.0)
        server.drive(lease, 5, 0.1, 0.0)
        server.drive(lease + 1, 6, 0.1, 0.0)
        server.drive(lease, 7, float("nan"), 0.0)
        status = await server.until(lambda status: status.lease == 0)
        assert status.drops == (1, 1, 0, 1)
        assert status.last_end == "anna: a setpoint with a value that is no number, or with another number of axes"
        counted = {"Drops.lease": 1, "Drops.number": 1, "Drops.setpoint": 1, "Drops.echo": 0}
        await until(lambda: counted.items() <= server.bridge.items())


async def test_a_bridge_that_ends_gives_nobody_the_robot_that_it_stops(tmp_path: Path) -> None:
    robot = DrivenRobot()
    async with driven(robot, tmp_path) as server:
        lease = await server.acquire()
        await server.until(lambda status: status.state is State.HELD)
        number = 0
        while not robot.written or robot.written[-1][0] < 0.2:
            number += 1
            server.drive(lease, number, 0.5, 0.0)
            await asyncio.sleep(0.02)
        server.end_bridge()
        await server.until(lambda status: status.state is State.STOPPING)
        refused = await server.ask(MODEL.acquire, "ben", "s", False)
        assert (refused.kind, refused.report.status) == (OutcomeKind.REFUSED, StatusCode.BAD_INVALID_STATE)
        assert refused.report.message == "carrier cannot be driven: its bridge ends"
        await until(lambda: robot.written[-1] == (0.0, 0.0))
