"""The node's thread, with a node of no ROS at all."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from structlog.testing import capture_logs
from ua_bridges.ros2 import thread as module
from ua_bridges.ros2.thread import NodeThread

from ua_fleet.errors import BridgeUnavailable, DriverFailed


class Destroyed(RuntimeError):
    """As rclpy has it."""


class Executor:
    def __init__(self) -> None:
        self.late_events = 0
        """Events of what is destroyed, one for each spin."""

    def spin_once(self, *, timeout_sec: float) -> None:
        del timeout_sec
        if self.late_events:
            self.late_events -= 1
            raise Destroyed("cannot use Destroyable because destruction was requested")

    def create_task(self, _task: Any) -> None:
        pass


class Node:
    closed = 0
    destroyed = Destroyed

    def __init__(self, *_arguments: Any) -> None:
        self.executor = Executor()

    def close(self) -> None:
        Node.closed += 1


class Full(Node):
    def __init__(self, *_arguments: Any) -> None:
        raise OSError(28, "No space left on device")


@pytest.fixture
def thread(monkeypatch: pytest.MonkeyPatch) -> NodeThread:
    monkeypatch.setattr(module, "Ros2Node", Node)
    monkeypatch.setattr(Node, "closed", 0)
    return NodeThread(5, "ua_bridge", "localhost")


def mistaken(*_: Any) -> float:
    raise KeyError("x")


def missing(*_: Any) -> None:
    raise BridgeUnavailable("it would hear itself")


def nothing(*_: Any) -> None:
    pass


async def test_start_is_told_why_there_is_no_node(thread: NodeThread, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "Ros2Node", Full)
    with capture_logs() as logs, pytest.raises(DriverFailed, match=r"domain 5: .*No space left on device.*report"):
        await asyncio.wait_for(thread.start(nothing, mistaken, nothing), 5)
    assert [entry["log_level"] for entry in logs] == ["error"]
    await thread.stop()


@pytest.mark.parametrize(("opened", "error"), [(mistaken, DriverFailed), (missing, BridgeUnavailable)])
async def test_start_is_told_what_went_wrong_with_the_node(
    thread: NodeThread, opened: Any, error: type[Exception]
) -> None:
    with capture_logs(), pytest.raises(error):
        await asyncio.wait_for(thread.start(opened, mistaken, nothing), 5)
    await thread.stop()
    assert Node.closed == 1
    assert not thread.running


async def test_node_that_a_mistake_ends_is_over_and_leaves_its_domain(thread: NodeThread) -> None:
    closing: list[str] = []
    with capture_logs() as logs:
        await thread.start(nothing, mistaken, lambda: closing.append("closing"))
        async with asyncio.timeout(60):
            while not closing or not Node.closed:
                await asyncio.sleep(0.001)
    assert [entry["log_level"] for entry in logs] == ["error"]
    assert thread.failure == (
        "the ROS 2 node ended: a mistake of the bridge (KeyError('x')); report its log, and start it again"
    )
    await thread.stop()


async def test_events_of_a_destroyed_subscription_end_no_node(thread: NodeThread) -> None:
    def late(node: Any) -> None:
        node.executor.late_events = 100

    turns: list[float] = []

    def turn(now: float) -> float:
        turns.append(now)
        return now

    await thread.start(late, turn, nothing)
    async with asyncio.timeout(60):
        while len(turns) < 300:
            await asyncio.sleep(0.001)
    assert thread.failure is None
    await thread.stop()


async def test_a_node_that_says_nothing_else_has_failed(thread: NodeThread) -> None:
    def broken(node: Any) -> None:
        node.executor.late_events = 1_000_000

    with capture_logs():
        await thread.start(broken, lambda now: now, nothing)
        async with asyncio.timeout(60):
            while thread.failure is None:
                await asyncio.sleep(0.001)
    assert "destruction was requested" in thread.failure
    await thread.stop()
