"""Another process that says it is this bridge is told apart from our own echo, said, counted, and keeps both idle."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from tests.unit.bridge.test_actions import Bench
from tests.unit.bridge.test_runner import CONFIG as OPEN_CONFIG
from tests.unit.bridge.test_runner import STATUS, Line, Reader, Robot, turns, until
from tests.unit.bridge.test_secured_runner import CONFIG as SECURED_CONFIG
from tests.unit.bridge.test_secured_runner import Reader as SecuredReader
from tests.unit.bridge.test_secured_runner import Source, keys_of
from ua_fleet.bridge import STATUS_FIELDS, ExecutionEnded, run_bridge, shell
from ua_fleet.bridge.rival import RIVAL_S, Rival
from ua_fleet.counters import Counters
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.skill import ExecutionState
from ua_fleet.transport.base import Address
from ua_fleet.values import StatusCode
from ua_fleet.wire import Codec
from ua_fleet.wire.security import SecurityMode

OWN, ELSEWHERE = ("127.0.0.1", 1), ("127.0.0.9", 2)


class KnowingLine(Line):
    """A transport that knows where it sends from."""

    def is_own(self, sender: Address) -> bool:
        return sender == OWN


def test_a_rival_lasts_for_some_seconds_and_is_said_once_a_minute() -> None:
    rival = Rival()
    assert rival.problem(0.0) == ""
    said = 0
    for second in range(120):
        rival.heard(ELSEWHERE, float(second))
        said += rival.is_due(float(second))
    assert said == 2
    assert "another process at 127.0.0.9:2" in rival.problem(119.0 + RIVAL_S - 0.1)
    assert rival.problem(119.0 + RIVAL_S) == ""
    assert not rival.is_due(119.0 + RIVAL_S)


def messages_of_a_rival() -> list[bytes]:
    """Data with the bridge's PublisherId, as another process of it says it."""
    other = Publisher(STATUS.space, PubSubTiming(), Counters(), Codec())
    other.announce(STATUS, "robot status", STATUS_FIELDS[3:4], now=0.0, wall_ticks=10**17)
    return other.publish(STATUS, ("up",), timestamp=10**17, now=0.0)


@asynccontextmanager
async def running(line: Line, state_dir: Path, **how: Any) -> AsyncGenerator[None]:
    ready = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        config = SECURED_CONFIG if how else OPEN_CONFIG
        task = group.create_task(
            run_bridge(config, "robot", Robot(), line, state_dir=state_dir, ready=ready.set, **how)
        )
        await ready.wait()
        await turns()
        yield
        task.cancel()


def last_status(reader: Reader | SecuredReader) -> Callable[[], dict[str, Any]]:
    names = [field.name for field in STATUS_FIELDS]
    seen: list[dict[str, Any]] = [{}]

    def last() -> dict[str, Any]:
        seen.extend(dict(zip(names, e.message.values, strict=True)) for e in reader.read() if e.topic == STATUS)
        return seen[-1]

    return last


async def test_messages_of_another_process_are_said_and_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(shell, "STATUS_INTERVAL_S", 0.001)
    line = KnowingLine()
    last = last_status(Reader(line))
    with capture_logs() as logs:
        async with running(line, tmp_path):
            await until(lambda: last().get("Drops.loop", 0) > 3)  # it hears itself, and that is no other
            assert last()["Drops.conflict"] == 0
            assert line.receive is not None
            for datagram in messages_of_a_rival():
                line.receive(datagram, ELSEWHERE)
            await until(lambda: last()["Drops.conflict"] == 1)
            await until(lambda: "another process at 127.0.0.9:2" in last()["Detail"])
            await asyncio.sleep(0.02)
    assert len([entry for entry in logs if "another process" in entry["event"]]) == 1


async def test_in_a_secured_fleet_only_who_has_the_keys_is_another(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(shell, "STATUS_INTERVAL_S", 0.001)
    line = KnowingLine()
    last = last_status(SecuredReader(line))
    async with running(line, tmp_path, keys=Source()):
        await until(lambda: line.sent)
        ours = [datagram for datagram in list(line.sent) if datagram[:2] == b"\xf1\x11"]
        await until(lambda: last().get("Drops.loop", 0) > 3)
        other = Envelope(2, Counters(), mode=SecurityMode.SIGN_AND_ENCRYPT, nonces=MemoryNonces())
        other.install("t-2", keys_of("t-2"), 0.0)
        (theirs,) = other.seal(messages_of_a_rival()[0], 0.0)
        assert line.receive is not None
        assert ours
        forged = [*ours, *messages_of_a_rival(), theirs[:-1] + bytes([theirs[-1] ^ 1])]
        for datagram in forged:
            line.receive(datagram, ELSEWHERE)
        before = last()["Drops.loop"]
        await until(lambda: last()["Drops.loop"] > before)
        assert last()["Drops.conflict"] == 0
        for datagram in (theirs, theirs):  # the second is a replay
            line.receive(datagram, ELSEWHERE)
        await until(lambda: last()["Drops.conflict"] == 1)
        assert "another process" in last()["Detail"]


def test_nothing_is_begun_while_another_process_is_heard() -> None:
    bench, rival = Bench(), Rival()
    bench.actions.rival = rival.problem
    bench.ask(1)
    assert len(bench.robot.begun) == 1
    bench.tell(ExecutionEnded((1).to_bytes(16, "big"), 0, (1.0,)))
    rival.heard(ELSEWHERE, bench.now)
    bench.ask(2)
    report = bench.reports()[-1]
    assert (report.state, report.status) == (ExecutionState.REFUSED, StatusCode.BAD_NO_COMMUNICATION)
    assert "another process at 127.0.0.9:2" in report.message
    assert len(bench.robot.begun) == 1
    bench.now = RIVAL_S
    bench.ask(3)
    assert len(bench.robot.begun) == 2
