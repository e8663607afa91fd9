"""The driver and a robot that takes commands in a language of its own, over real sockets."""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import suppress

import pytest

from tests.integration.tcp.conftest import StartRobot, direct_fleet, running
from tests.integration.tcp.test_interpreter import METADATA, SPEED, message
from tests.system import free_tcp_port
from tests.waiting import until
from ua_fleet.bridge.driver import (
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionProgressed,
    SampleRead,
    SourceFound,
    SourceLost,
)
from ua_fleet.counters import Drop
from ua_fleet.values import Quality, quality_of

ID, OTHER, THIRD = bytes(range(16)), bytes(range(16, 32)), bytes(range(32, 48))


async def test_skills_and_data(start_robot: StartRobot) -> None:
    robot = start_robot("--direct", "127.0.0.1:0")
    address = f"127.0.0.1:{robot.wait_for('ready').split()[1]}"
    async with running(direct_fleet(address)) as one:
        one.begin("weld", 0.2, ID)
        await until(lambda: len(one.facts(ExecutionEnded)) == 1, "the end")
        assert one.facts(ExecutionEnded) == [ExecutionEnded(ID, 0, ("weld", 0.2))]
        one.begin("fail", 0.1, OTHER)
        await until(lambda: len(one.facts(ExecutionEnded)) == 2, "the failure")
        one.begin("refuse", 0.1, THIRD)
        await until(lambda: len(one.facts(ExecutionEnded)) == 3, "the refusal")
        assert [quality_of(ended.status) for ended in one.facts(ExecutionEnded)[1:]] == [Quality.BAD] * 2
        assert [ended.message for ended in one.facts(ExecutionEnded)[1:]] == [
            "the machine broke",
            "the machine does not do that",
        ]
        await until(lambda: len(one.facts(SampleRead)) >= 2, "positions")
        assert one.facts(SampleRead)[0].values == (0.0, 0.0)
        assert one.driver.publish(SPEED, METADATA, message(0.254))
        assert await asyncio.to_thread(robot.wait_for, "speed") == "speed 0.25"


async def test_each_address_of_a_robot_is_tried(start_robot: StartRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = start_robot("--direct", "127.0.0.1:0")
    port = int(robot.wait_for("ready").split()[1])
    nobody, there = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (f"127.0.0.{last}", port)) for last in (2, 1)]

    def resolve(*_: object, **__: object) -> list[object]:
        return [nobody, there]

    monkeypatch.setattr("ua_bridges.tcp.link.socket.getaddrinfo", resolve)
    async with running(direct_fleet(f"robot.test:{port}")) as one:
        await until(lambda: one.facts(SampleRead), "a position")
        assert one.driver.status().connected


async def test_what_is_said_into_a_broken_connection_is_dropped_and_counted() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        async with running(direct_fleet(f"127.0.0.1:{listener.getsockname()[1]}")) as one:
            robot, _ = await asyncio.to_thread(listener.accept)
            await until(lambda: one.driver.status().connected, "the connection")
            robot.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            robot.close()  # with a reset, which the bridge has not seen yet
            assert not one.driver.publish(SPEED, METADATA, message(0.25))
            assert one.recorder.dropped(Drop.NOT_CONNECTED) == 1


async def test_a_robot_that_ends_each_connection_is_tried_more_and_more_rarely() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        async with running(direct_fleet(f"127.0.0.1:{listener.getsockname()[1]}")) as one:
            ending = asyncio.get_running_loop().time() + 1.2
            while asyncio.get_running_loop().time() < ending:
                with suppress(TimeoutError):
                    listener.settimeout(0.1)
                    (await asyncio.to_thread(listener.accept))[0].close()
            assert 2 <= len(one.facts(SourceFound)) <= 4  # after 0.1, 0.3 and 0.7 s


async def test_a_robot_that_goes_away_leaves_it_unknown_and_comes_back(start_robot: StartRobot) -> None:
    address = f"127.0.0.1:{free_tcp_port()}"
    robot = start_robot("--direct", address)
    async with running(direct_fleet(address)) as one:
        one.begin("weld", 5.0, ID)
        await until(lambda: one.facts(ExecutionProgressed), "the beginning")
        robot.end()
        await until(lambda: one.facts(ExecutionForgotten), "the loss")
        assert one.facts(SourceLost)
        start_robot("--direct", address)
        one.begin("weld", 0.0, OTHER)
        await until(lambda: one.facts(ExecutionEnded), "the end")
        assert one.facts(ExecutionEnded)[0][:2] == (OTHER, 0)
