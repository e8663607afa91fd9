from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from ua_fleet.bridge import (
    STATUS_FIELDS,
    Driver,
    DriverStatus,
    Dropped,
    Inlet,
    Rule,
    SampleRead,
    SourceFound,
    run_bridge,
    shell,
)
from ua_fleet.config.schema import BridgeConfig, FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import BridgeUnavailable, DriverFailed, NotConnected, StorageUnavailable
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import LoopVerdict, Side, Topic, loop_verdict
from ua_fleet.transport.base import Address, Receive, TransportStats
from ua_fleet.values import BuiltinType
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

DATA = (make_field("data", BuiltinType.DOUBLE, properties={"RosType": "std_msgs/Float64"}),)
STATUS = Topic(2, 2, 900)
NOWHERE = Path("/proc/nowhere")
"""Without message security a bridge needs no folder: not even root makes one there."""
CONFIG = FleetConfig(
    version=1,
    pubsub=PubSubConfig(security=PubSubSecurity.NONE),
    bridges={"robot": BridgeConfig(kind="ros2", space=2, status_id=STATUS.id)},
)


class Line:
    """A transport whose other end is the test; it hears itself, as multicast does."""

    def __init__(self, error: Exception | None = None) -> None:
        self.stats = TransportStats(kernel_drops=3, send_failed=4)
        self.sent: list[bytes] = []
        self.closed = 0
        self.receive: Receive | None = None
        self._error = error

    async def start(self, receive: Receive) -> None:
        if self._error is not None:
            raise self._error
        self.receive = receive

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        del address
        assert self.receive is not None, "sent before the transport was started"
        self.sent.append(datagram)
        self.receive(datagram, ("127.0.0.1", 1))

    async def close(self) -> None:
        self.closed += 1


class Robot(Driver):
    """A driver whose robot is the test."""

    def __init__(self, error: Exception | None = None) -> None:
        self.inlet: Inlet | None = None
        self.published: list[tuple[Topic, tuple[Any, ...]]] = []
        self.stopped = 0
        self.state = DriverStatus(True, "up")
        self._error = error

    async def start(self, inlet: Inlet) -> None:
        if self._error is not None:
            raise self._error
        self.inlet = inlet
        inlet.put(SourceFound(Topic(2, 2, 1), "early", DATA))
        await asyncio.sleep(0)

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        self.published.append((topic, message.values))
        return True

    def status(self) -> DriverStatus:
        return self.state

    async def stop(self) -> None:
        self.stopped += 1

    def put(self, *events: Any) -> None:
        """From another thread, as drivers do."""
        inlet = self.inlet
        assert inlet is not None

        def feed() -> None:
            for event in events:
                inlet.put(event)

        thread = threading.Thread(target=feed)
        thread.start()
        thread.join()


class Reader:
    """What a subscriber in another space hears."""

    def __init__(self, line: Line) -> None:
        self._line, self._subscriber = line, Subscriber(0, PubSubTiming(), Counters(), Codec())

    def read(self) -> list[DataReceived]:
        sent, self._line.sent[:] = list(self._line.sent), []
        events = [event for datagram in sent for event in self._subscriber.receive(datagram, 0.0)]
        return [event for event in events if isinstance(event, DataReceived)]


@asynccontextmanager
async def running(robot: Robot, line: Line, rule: Rule = loop_verdict) -> AsyncGenerator[None]:
    ready = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        task = group.create_task(
            run_bridge(CONFIG, "robot", robot, line, state_dir=NOWHERE, ready=ready.set, rule=rule)
        )
        await ready.wait()
        await turns()
        yield
        task.cancel()


async def turns(count: int = 5) -> None:
    for _ in range(count):
        await asyncio.sleep(0)


async def until(condition: Callable[[], Any]) -> None:
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.001)


async def test_samples_go_out_and_others_data_goes_into_the_space() -> None:
    robot, line = Robot(), Line()
    reader = Reader(line)
    other = Publisher(1, PubSubTiming(), Counters(), Codec())
    async with running(robot, line):
        robot.put(SampleRead(Topic(2, 2, 1), (1.5,), 10**18))
        await turns()
        assert [(e.topic, e.message.values) for e in reader.read() if e.topic != STATUS] == [(Topic(2, 2, 1), (1.5,))]
        foreign = Topic(1, 2, 7)
        datagrams = other.announce(foreign, "arm", DATA, now=0.0, wall_ticks=10**17)
        datagrams += other.publish(foreign, (2.5,), timestamp=10**17, now=0.0)
        assert line.receive is not None
        for datagram in datagrams:
            line.receive(datagram, ("127.0.0.1", 1))
        assert robot.published == [(foreign, (2.5,))]
    assert (robot.stopped, line.closed) == (1, 1)


async def test_status_is_published_with_the_figures_of_the_transport(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "STATUS_INTERVAL_S", 0.001)
    robot, line = Robot(), Line()
    reader = Reader(line)
    async with running(robot, line):
        await until(lambda: len(line.sent) > 4)
        robot.put(Dropped(Drop.CONVERSION, 2, "field data: nan is not an integer"))
        seen: list[dict[str, Any]] = []

        def counted() -> bool:
            names = [field.name for field in STATUS_FIELDS]
            seen.extend(dict(zip(names, e.message.values, strict=True)) for e in reader.read() if e.topic == STATUS)
            return bool(seen) and seen[-1]["Drops.conversion"] == 2

        await until(counted)
    status = seen[-1]
    assert (status["Name"], status["Kind"], status["Connected"], status["Detail"]) == ("robot", "ros2", True, "up")
    assert (status["Drops.kernel"], status["Drops.send_failed"]) == (3, 4)
    assert status["Drops.loop"] > 0
    assert status["Looped"] == 0
    assert status["FromSpace"] == 0


async def test_connection_is_logged_once_each_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "STATUS_INTERVAL_S", 0.001)
    robot, line = Robot(), Line()
    robot.state = DriverStatus(False, "no master at http://127.0.0.1:11311; start one")
    with capture_logs() as logs:

        def told() -> list[str]:
            return [entry["event"] for entry in logs if "connected" in entry["event"]]

        async with running(robot, line):
            await until(lambda: len(told()) == 1)
            robot.state = DriverStatus(True, "now")
            await until(lambda: len(told()) == 2)
            robot.state = DriverStatus(False, "now")
            await until(lambda: len(told()) == 3)
            line.sent.clear()
            await until(lambda: len(line.sent) > 5)
    assert told() == ["not connected to the space", "connected to the space", "not connected to the space"]
    logs = [entry for entry in logs if "connected" in entry["event"]]
    assert logs[0]["detail"].startswith("no master")


async def test_a_clock_that_is_set_back_is_logged_once() -> None:
    robot, line = Robot(), Line()
    day_ns, source = 86_400 * 10**9, Topic(2, 2, 1)
    with capture_logs() as logs:
        async with running(robot, line):
            for _ in range(3):
                now_ns = time.time_ns()
                robot.put(SampleRead(source, (1.0,), now_ns + day_ns), SampleRead(source, (2.0,), now_ns))
                await turns()
            [entry] = [entry for entry in logs if "clock" in entry["event"]]
    assert (entry["log_level"], entry["source"]) == ("warning", source.name)
    assert abs(entry["back_s"] - 86_400) < 60


async def test_reason_of_a_drop_and_malformed_datagrams_are_logged_without_a_flood(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shell, "STATUS_INTERVAL_S", 0.001)
    robot, line = Robot(), Line()
    with capture_logs() as logs:
        async with running(robot, line):
            for _ in range(3):
                robot.put(Dropped(Drop.TYPE_MISSING, 1, "p/T"))
                await turns()
            assert line.receive is not None
            for _ in range(100):
                line.receive(b"\x00", ("127.0.0.1", 1))
            line.sent.clear()
            await until(lambda: len(line.sent) > 5)
    assert [entry["event"] for entry in logs].count("dropped") == 1
    assert [entry["event"] for entry in logs].count("malformed datagrams") == 1


async def test_timers_repeat_messages_and_keep_sources_alive() -> None:
    config = CONFIG.model_copy(
        update={"pubsub": CONFIG.pubsub.model_copy(update={"keep_alive_s": 0.02, "repeat_interval_s": 0.05})}
    )
    robot, line = Robot(), Line()
    messages: list[DataSetMessage] = []
    ready = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_bridge(config, "robot", robot, line, state_dir=NOWHERE, ready=ready.set))
        await ready.wait()
        robot.put(SampleRead(Topic(2, 2, 1), (1.5,), 10**18))
        codec = Codec()

        def repeated() -> bool:
            for datagram in line.sent:
                decoded = codec.decode(datagram)
                messages.extend(m for m in getattr(decoded, "messages", ()) if m.data_set_writer_id == 1)
            line.sent.clear()
            kinds = [message.kind for message in messages]
            return kinds.count(0) >= 3 and kinds.count(3) >= 3

        await until(repeated)
        task.cancel()
    assert len({message.timestamp for message in messages if message.kind == 0}) == 1


async def test_with_the_rule_off_the_status_shows_looped_deliveries(monkeypatch: pytest.MonkeyPatch) -> None:
    def always_forward(side: Side, _origin: int, _own_space: int, _own: bool) -> LoopVerdict:
        return LoopVerdict.TO_SPACE if side is Side.PUBSUB else LoopVerdict.TO_PUBSUB

    robot, line = Robot(), Line()
    async with running(robot, line, always_forward):
        robot.put(SampleRead(Topic(2, 2, 1), (1.5,), 10**18))
        await turns()
        assert (Topic(2, 2, 1), (1.5,)) in robot.published


@pytest.mark.parametrize(
    ("robot", "line", "error"),
    [
        (Robot(BridgeUnavailable("rospy is missing")), Line(), BridgeUnavailable),
        (Robot(), Line(NotConnected("no multicast route")), NotConnected),
    ],
)
async def test_failed_start_releases_everything(robot: Robot, line: Line, error: type[Exception]) -> None:
    with pytest.raises(error):
        await run_bridge(CONFIG, "robot", robot, line, state_dir=NOWHERE)
    assert (robot.stopped, line.closed) == (1, 1)


async def test_a_second_process_of_a_bridge_ends_at_once(tmp_path: Path) -> None:
    """Also of one without skills: two would publish with one PublisherId, and each would void the other's values."""
    ready = asyncio.Event()
    first = asyncio.create_task(
        run_bridge(CONFIG, "robot", Robot(), Line(), state_dir=tmp_path / "state", ready=ready.set)
    )
    await ready.wait()
    robot, line = Robot(), Line()
    with pytest.raises(StorageUnavailable, match="bridge robot runs already"):
        await run_bridge(CONFIG, "robot", robot, line, state_dir=tmp_path / "state")
    assert (line.sent, robot.published) == ([], [])
    first.cancel()
    await asyncio.gather(first, return_exceptions=True)


async def test_bridge_whose_driver_is_over_says_why_and_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "STATUS_INTERVAL_S", 0.001)
    robot, line = Robot(), Line()
    reader = Reader(line)
    ready = asyncio.Event()
    task = asyncio.create_task(run_bridge(CONFIG, "robot", robot, line, state_dir=NOWHERE, ready=ready.set))
    await ready.wait()
    robot.state = DriverStatus(False, "away; it is tried again")
    seen = reader.read()
    await until(lambda: len(line.sent) > 5)
    assert not task.done(), "a robot that is away is no end"
    robot.state = DriverStatus(
        False, "the driver failed: KeyError('x'); report it,\nand start the bridge again", is_over=True
    )
    with pytest.raises(DriverFailed) as failed:
        await asyncio.wait_for(task, 10)
    assert str(failed.value) == "bridge robot: the driver failed: KeyError('x'); report it, and start the bridge again"
    assert (robot.stopped, line.closed) == (1, 1)
    told = [e.message.values for e in (*seen, *reader.read()) if e.topic == STATUS]
    assert "KeyError" in dict(zip([field.name for field in STATUS_FIELDS], told[-1], strict=True))["Detail"]
