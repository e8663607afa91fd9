from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from tests.unit.bridge.test_runner import STATUS, Line, Robot, turns, until
from ua_fleet.bridge import STATUS_FIELDS, SampleRead, run_bridge, shell
from ua_fleet.config.schema import BridgeConfig, FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.counters import Counters
from ua_fleet.errors import BridgeUnavailable, ConfigError, KeySourceUnavailable, KeysRefused
from ua_fleet.keys import keeper
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Topic
from ua_fleet.wire import Codec
from ua_fleet.wire.security import SecurityMode, SecurityPolicy, read_security

POLICY = SecurityPolicy.AES256_CTR
CONFIG = FleetConfig(
    version=1,
    pubsub=PubSubConfig(security=PubSubSecurity.SIGN_AND_ENCRYPT),
    bridges={"robot": BridgeConfig(kind="ros2", space=2, status_id=STATUS.id)},
)


def keys_of(group_id: str) -> GroupKeys:
    return GroupKeys(POLICY, 1, (group_id.encode().ljust(POLICY.key_data_bytes, b"."),), 600.0, 600.0)


class Source:
    """A source of keys that may be away, or refuse a group."""

    refresh_s = 0.001
    generation = 0

    def __init__(self, *, is_away: bool = False) -> None:
        self.is_away = is_away
        self.refused: set[str] = set()

    async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        assert (starting_token_id, count) == (0, 5)
        if self.is_away:
            raise KeySourceUnavailable("opc.tcp://a:1: connection refused")
        if group_id in self.refused:
            raise KeysRefused(group_id, "there is no such key file")
        return keys_of(group_id)


class Reader:
    """The server's side, with the keys of the bridge's data."""

    def __init__(self, line: Line) -> None:
        counters = Counters()
        self._line = line
        self._envelope = Envelope(0, counters, mode=SecurityMode.SIGN_AND_ENCRYPT, nonces=MemoryNonces())
        self._envelope.install("t-2", keys_of("t-2"), 0.0)
        self._subscriber = Subscriber(0, PubSubTiming(), counters, Codec(), envelope=self._envelope)

    def read(self) -> list[DataReceived]:
        sent, self._line.sent[:] = list(self._line.sent), []
        events = [event for datagram in sent for event in self._subscriber.receive(datagram, 0.0)]
        return [event for event in events if isinstance(event, DataReceived)]


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:  # pyright: ignore[reportUnusedFunction]
    monkeypatch.setattr(keeper, "PERIOD_S", 0.001)
    monkeypatch.setattr(keeper, "FIRST_DELAY_S", 0.001)
    monkeypatch.setattr(shell, "STATUS_INTERVAL_S", 0.001)


@asynccontextmanager
async def running(robot: Robot, line: Line, source: Source, folder: Path) -> AsyncGenerator[asyncio.Event]:
    ready = asyncio.Event()
    task = asyncio.ensure_future(
        run_bridge(CONFIG, "robot", robot, line, state_dir=folder, keys=source, ready=ready.set)
    )
    try:
        yield ready
        assert not task.done()
    finally:
        task.cancel()
        await asyncio.wait([task])
    assert task.cancelled()


async def test_what_is_sent_is_signed_and_encrypted(tmp_path: Path) -> None:
    robot, line = Robot(), Line()
    reader = Reader(line)
    async with running(robot, line, Source(), tmp_path) as ready:
        await ready.wait()
        await turns()
        robot.put(SampleRead(Topic(2, 2, 1), (1.5,), 10**18))
        modes: set[SecurityMode] = set()

        def heard() -> bool:
            modes.update(read_security(datagram).mode for datagram in line.sent)
            return (Topic(2, 2, 1), (1.5,)) in [(event.topic, event.message.values) for event in reader.read()]

        await until(heard)
        assert modes == {SecurityMode.SIGN_AND_ENCRYPT}


async def test_without_its_key_a_bridge_does_nothing_and_says_why(tmp_path: Path) -> None:
    robot, line, source = Robot(), Line(), Source(is_away=True)
    with capture_logs() as logs:
        async with running(robot, line, source, tmp_path) as ready:
            await asyncio.sleep(0.02)
            assert (robot.inlet, line.receive, line.sent, ready.is_set()) == (None, None, [], False)
            source.is_away = False
            await asyncio.wait_for(ready.wait(), 10)
    events = [entry["event"] for entry in logs]
    assert events[:2] == [
        "waiting for keys",
        "the key source is not reachable; known keys stay in use",
    ]
    assert logs[1]["reason"] == "opc.tcp://a:1: connection refused"
    assert events.index("the key source is reachable again") < events.index("connected to the space")


async def test_a_bridge_that_waits_can_be_ended(tmp_path: Path) -> None:
    robot, line = Robot(), Line()
    async with running(robot, line, Source(is_away=True), tmp_path):
        await turns()
    assert (robot.stopped, line.closed, line.sent) == (1, 1, [])


async def test_the_status_says_that_the_source_of_keys_is_away(tmp_path: Path) -> None:
    robot, line, source = Robot(), Line(), Source()
    reader, details = Reader(line), [""]
    position = [field.name for field in STATUS_FIELDS].index("Detail")

    def detail() -> str:
        details.extend(event.message.values[position] for event in reader.read() if event.topic == STATUS)
        return details[-1]

    async with running(robot, line, source, tmp_path) as ready:
        await ready.wait()
        await until(lambda: detail() == "up")
        source.is_away = True
        await until(lambda: detail() == "up; the key source is not reachable: opc.tcp://a:1: connection refused")
        source.is_away = False
        await until(lambda: detail() == "up")
        source.refused.add("t-0")
        await until(lambda: detail() == "up; no keys of t-0: there is no such key file")


async def test_without_a_source_of_keys_nothing_starts(tmp_path: Path) -> None:
    robot, line = Robot(), Line()
    with pytest.raises(ConfigError, match="and no key source is configured"):
        await run_bridge(CONFIG, "robot", robot, line, state_dir=tmp_path)
    assert robot.inlet is None


async def test_a_failed_start_is_told_as_it_is(tmp_path: Path) -> None:
    robot, line = Robot(BridgeUnavailable("rospy is missing")), Line()
    with pytest.raises(BridgeUnavailable, match="rospy is missing"):
        await run_bridge(CONFIG, "robot", robot, line, state_dir=tmp_path, keys=Source())
    assert (robot.stopped, line.closed) == (1, 1)


async def test_a_failed_start_is_told_also_where_its_end_fails(tmp_path: Path) -> None:
    class Broken(Source):
        async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
            if group_id == "t-2":
                return keys_of(group_id)
            with suppress(asyncio.CancelledError):
                await asyncio.Event().wait()
            raise RuntimeError("cannot hang up")

    robot = Robot(BridgeUnavailable("rospy is missing"))
    with capture_logs() as logs, pytest.raises(BridgeUnavailable, match="rospy is missing"):
        await run_bridge(CONFIG, "robot", robot, Line(), state_dir=tmp_path, keys=Broken())
    [other] = [log for log in logs if log["log_level"] == "error"]
    assert (other["event"], repr(other["exc_info"])) == (
        "this failed, too, while the bridge ended",
        "RuntimeError('cannot hang up')",
    )


async def test_what_weakens_security_is_said_at_the_start(tmp_path: Path) -> None:
    config = CONFIG.model_copy(update={"pubsub": PubSubConfig(security=PubSubSecurity.SIGN, relaxed_replay=(7,))})
    with capture_logs() as logs, pytest.raises(BridgeUnavailable):
        await run_bridge(config, "robot", Robot(BridgeUnavailable("x")), Line(), state_dir=tmp_path, keys=Source())
    said = [entry["event"] for entry in logs if entry["log_level"] == "warning"]
    assert "PubSub messages are signed and not encrypted" in said[0]
    assert said[1].endswith("without a check for replays: 7")
