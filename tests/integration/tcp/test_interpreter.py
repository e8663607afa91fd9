"""The driver and the program on a robot, over real sockets."""

from __future__ import annotations

import asyncio
import logging
import socket
import time
from pathlib import Path

import pytest

from tests.integration.tcp.conftest import StartRobot, interpreter_fleet, running
from tests.system import free_tcp_port
from tests.waiting import until
from ua_fleet.bridge.driver import (
    Dropped,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionProgressed,
    SampleRead,
    SourceFound,
    SourceLost,
)
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotOffline
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

ID, OTHER = bytes(range(16)), bytes(range(16, 32))
SPEED = Topic(0, 2, 11)
METADATA = DataSetMetaData("speed", (make_field("data", BuiltinType.DOUBLE),), ConfigurationVersion(1, 1))


def message(value: float) -> DataSetMessage:
    return DataSetMessage(
        SPEED.id, types=(11,), values=(value,), timestamp=ticks_from_unix_ns(time.time_ns()), status=0
    )


@pytest.mark.parametrize("framing", ["terminator", "length", "acknowledged"])
async def test_each_framing_carries_skills_and_data(framing: str, start_robot: StartRobot) -> None:
    robot = start_robot("--listen", "127.0.0.1:0", "--framing", framing)
    port = robot.wait_for("ready").split()[1]
    async with running(interpreter_fleet(f'connect: "127.0.0.1:{port}", framing: {framing}')) as one:
        one.begin("weld", 0.2, ID)
        await until(lambda: one.facts(ExecutionEnded), "the end")
        assert one.facts(ExecutionEnded) == [ExecutionEnded(ID, 0, ("weld", 0.2))]
        await until(lambda: one.facts(SampleRead), "the position")
        assert one.facts(SampleRead)[0].values == (0.0, 0.0)
        assert one.driver.publish(SPEED, METADATA, message(0.25))
        assert await asyncio.to_thread(robot.wait_for, "information speed") == "information speed 0.25"
        assert one.facts(Dropped) == []
        assert one.driver.status().connected


async def test_the_robots_program_may_connect_and_nobody_else(start_robot: StartRobot) -> None:
    port = free_tcp_port()
    async with running(interpreter_fleet(f'listen: "127.0.0.1:{port}", peer: 127.0.0.1')) as one:
        assert "start it" in one.driver.status().detail
        start_robot("--connect", f"127.0.0.1:{port}")
        one.begin("weld", 0.0, ID)
        await until(lambda: one.facts(ExecutionEnded), "the end")
    async with running(interpreter_fleet(f'listen: "127.0.0.1:{port}", peer: 127.0.0.9')) as one:
        await asyncio.sleep(0.5)
        assert not one.driver.status().connected
        assert one.facts(SourceFound) == []


@pytest.mark.parametrize("remembers", [True, False])
async def test_a_program_that_was_ended_is_asked_when_it_is_back(
    remembers: bool, start_robot: StartRobot, tmp_path: Path
) -> None:
    options = ("--memory", tmp_path / "memory") if remembers else ()
    port = free_tcp_port()
    robot = start_robot("--listen", f"127.0.0.1:{port}", *options)
    async with running(interpreter_fleet(f'connect: "127.0.0.1:{port}"')) as one:
        one.begin("weld", 1.0, ID)
        await until(lambda: one.facts(ExecutionProgressed), "the beginning")
        robot.end()
        await until(lambda: one.facts(SourceLost), "the loss")
        assert "lost" in one.driver.status().detail or "no connection" in one.driver.status().detail
        start_robot("--listen", f"127.0.0.1:{port}", *options)
        if remembers:
            await until(lambda: one.facts(ExecutionEnded), "the end")
            assert one.facts(ExecutionEnded) == [ExecutionEnded(ID, 0, ("weld", 1.0))]
        else:
            await until(lambda: one.facts(ExecutionForgotten), "the end")
        if remembers:
            assert len((tmp_path / "memory").read_text().splitlines()) == 1


async def test_a_robot_that_is_not_there_is_told_to_who_asks() -> None:
    async with running(interpreter_fleet(f'connect: "127.0.0.1:{free_tcp_port()}"')) as one:
        one.begin("weld", 0.0, ID)
        await until(lambda: one.facts(ExecutionEnded), "the end")
        assert one.facts(ExecutionEnded)[0].status == StatusCode.BAD_NO_COMMUNICATION
        with pytest.raises(RobotOffline, match="start it"):
            one.begin("weld", 0.0, OTHER)
        assert "see that the robot is on and listens there" in one.driver.status().detail
        assert not one.driver.publish(SPEED, METADATA, message(0.25))


async def test_a_program_that_sends_rubbish_or_half_messages_is_left_and_met_again() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(10)
        port = listener.getsockname()[1]
        link = f'connect: "127.0.0.1:{port}", answer_timeout_s: 0.3'
        async with running(interpreter_fleet(link)) as one:
            for said in (b"hello robot\n", b"status\ndone\n", b"x" * 10_000, b"\x00" * 500):
                robot, _ = await asyncio.to_thread(listener.accept)
                robot.sendall(said)
                robot.settimeout(10)
                assert await asyncio.to_thread(robot.recv, 10) == b""
                robot.close()
            robot, _ = await asyncio.to_thread(listener.accept)
            with robot:
                robot.sendall(b"information\nposition\n0\n2\n1\n2\n")
                await until(lambda: one.facts(SampleRead), "the position")
            assert sum(event.cause is Drop.MALFORMED for event in one.facts(Dropped)) == 4
            assert len(one.facts(SourceFound)) == 5


async def test_an_answer_is_of_now_or_empty() -> None:
    oven, question = Topic(301, 2, 90), b"request\noven.temperature\n5\n0\n"
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(10)
        link = f'connect: "127.0.0.1:{listener.getsockname()[1]}"'
        async with running(interpreter_fleet(link)) as one:
            robot, _ = await asyncio.to_thread(listener.accept)
            with robot:

                async def answer() -> bytes:
                    robot.sendall(question)
                    return await asyncio.to_thread(robot.recv, 1000)

                assert await answer() == b"information\noven.temperature\n5\n0\n"
                assert one.driver.publish(oven, METADATA, message(181.5))
                assert await answer() == b"information\noven.temperature\n5\n1\n181.5\n"
                one.driver.stale(oven, True)
                assert await answer() == b"information\noven.temperature\n5\n0\n"
                one.driver.stale(oven, False)
                assert await answer() == b"information\noven.temperature\n5\n1\n181.5\n"


async def test_a_robot_that_floods_is_read_and_others_go_on() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        async with running(interpreter_fleet(f'connect: "127.0.0.1:{port}"')) as one:
            robot, _ = await asyncio.to_thread(listener.accept)
            with robot:
                flood = b"information\nposition\n0\n2\n1\n2\n" * 20_000
                sending = asyncio.create_task(asyncio.to_thread(robot.sendall, flood))
                longest = 0.0  # by the CPU time of this thread: what others of the machine take is not the driver's
                while len(one.facts(SampleRead)) < 20_000:
                    began = time.thread_time()
                    await asyncio.sleep(0.01)
                    longest = max(longest, time.thread_time() - began)
                await sending
            assert longest < 2.0


async def test_a_robot_that_does_not_read_is_left() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        async with running(interpreter_fleet(f'connect: "127.0.0.1:{port}"')) as one:
            robot, _ = await asyncio.to_thread(listener.accept)
            with robot:
                await until(lambda: one.driver.status().connected, "the connection")
                sent = 0
                while one.driver.status().connected:
                    one.driver.publish(SPEED, METADATA, message(0.25))
                    sent += 1
                    if sent % 1000 == 0:
                        await asyncio.sleep(0)
                    assert sent < 1_000_000
                assert one.facts(SourceLost)


async def test_each_change_of_the_connection_is_logged_once(
    start_robot: StartRobot, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, "ua_bridges.tcp.link")
    port = free_tcp_port()
    async with running(interpreter_fleet(f'connect: "127.0.0.1:{port}"')) as one:
        await asyncio.sleep(1.5)  # it tries several times
        robot = start_robot("--listen", f"127.0.0.1:{port}")
        await until(lambda: one.driver.status().connected, "the connection")
        robot.end()
        await until(lambda: "no connection" in one.driver.status().detail, "the loss")
    lines = [record.getMessage() for record in caplog.records]
    assert [line.removeprefix("cell (interpreter): ").split(" ")[0] for line in lines] == [
        "no",
        "connected",
        "the",
        "no",
    ], lines
    assert all("\n" not in line for line in lines)


async def test_stop_leaves_nothing_behind(start_robot: StartRobot) -> None:
    port = free_tcp_port()
    async with running(interpreter_fleet(f'listen: "127.0.0.1:{port}", peer: 127.0.0.1')) as one:
        start_robot("--connect", f"127.0.0.1:{port}")
        await until(lambda: one.driver.status().connected, "the connection")
    await one.driver.stop()
    assert not one.driver.status().connected
    with socket.create_server(("127.0.0.1", port)):
        pass
