"""A command at the bridge of a TCP robot, until the robot has all its bytes, beside a bare socket.

The robot is another process and notes the time. The bare socket sends the same bytes, blocking, from this process; with
acknowledged fields it waits for each acknowledgement too. Goals: 0.5 ms for direct mode, 1.5 ms for five fields in
interpreter mode, and at most three times the bare socket. TalkRoBots has 1.8 ms and 10 ms, the latter by pauses between
fields.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import socket
import statistics
import sys
import time
from collections.abc import Generator

from ua_bridges.tcp.driver import TcpDriver
from ua_bridges.tcp.messages import number_of

from benchmarks._ros import Node
from benchmarks.harness import FEWEST_ROUNDS, Figure, at_most
from ua_fleet.bridge.driver import DriverEvent, Execution, ExecutionEnded
from ua_fleet.config.load import load_content

MEASURED = 200
GOAL_RATIO = 3.0
GOALS_S = {"direct": 0.5e-3, "terminator": 1.5e-3, "acknowledged": 1.5e-3}
FLEET = """\
version: 1
pubsub: {{security: none}}
bridges: {{cell: {{kind: tcp, space: 300, status_id: 1, {link}}}}}
robots:
  arm:
    bridge: cell
    skill_status_id: 2
    skills: {{move: {{id: 3, arguments: {{angle: {{type: Double}}}}, results: {{at: {{type: Int64}}}}{via}}}}}
"""


class Inlet:
    """Hands the end of the one execution over."""

    def __init__(self) -> None:
        self.ended: asyncio.Future[int] | None = None

    def put(self, event: DriverEvent) -> None:
        if isinstance(event, ExecutionEnded) and self.ended is not None and not self.ended.done():
            self.ended.set_result(int(event.values[0]))


def fleet(mode: str, port: int) -> str:
    if mode == "direct":
        via = ', via: {direct: {command: "movej({angle})\\n", done: "OK {at}"}}'
        return FLEET.format(link=f'direct: {{connect: "127.0.0.1:{port}"}}', via=via)
    return FLEET.format(link=f'interpreter: {{connect: "127.0.0.1:{port}", framing: {mode}}}', via="")


async def ours(mode: str, port: int) -> float:
    """The median time of our driver, s."""
    config = load_content(fleet(mode, port).encode(), "fleet.yaml", {})
    driver, inlet, times = TcpDriver(config, "cell"), Inlet(), list[float]()
    await driver.start(inlet)
    try:
        while not driver.status().connected:  # noqa: ASYNC110 -- a driver says it in its status
            await asyncio.sleep(0.01)
        topic = driver.skills()[0].topic
        for index in range(MEASURED + 20):
            inlet.ended = asyncio.get_running_loop().create_future()
            execution = Execution(secrets.token_bytes(16), topic, 1, (0.1 + index,), 10.0)
            began = time.monotonic_ns()
            driver.execute(execution)
            arrived = await inlet.ended
            if index >= 20:
                times.append((arrived - began) / 1e9)
    finally:
        await driver.stop()
    return statistics.median(times)


def bare(mode: str, port: int) -> float:
    """The median time of a bare socket, s."""
    times: list[float] = []
    with socket.create_connection(("127.0.0.1", port)) as robot:
        robot.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for index in range(MEASURED + 20):
            angle = b"%.1f" % (0.1 + index)
            fields = [b"command", b"move", b"%d" % number_of(secrets.token_bytes(16)), b"1", angle]
            began = time.monotonic_ns()
            if mode == "direct":
                robot.sendall(b"movej(" + angle + b")\n")
            elif mode == "terminator":
                robot.sendall(b"\n".join(fields) + b"\n")
            else:
                for field in fields[:-1]:
                    robot.sendall(field)
                    robot.recv(64)
                robot.sendall(fields[-1])
            answer = b""
            while not answer.endswith(b"\n") or (mode == "acknowledged" and answer == b"ack\n"):
                answer += robot.recv(256)
            arrived = int(answer.split()[-1])
            if index >= 20:
                times.append((arrived - began) / 1e9)
    return statistics.median(times)


@contextlib.contextmanager
def robots() -> Generator[dict[str, int]]:
    with contextlib.ExitStack() as stack:
        ports: dict[str, int] = {}
        for mode in GOALS_S:
            command = [sys.executable, "-m", "benchmarks._tcp", mode]
            node = Node(*command, env=os.environ | {"PYTHONPATH": ".:bridges"})
            stack.callback(node.end)
            ports[mode] = int(node.ready.removeprefix("ready"))
        yield ports


def figures(rounds: int) -> list[Figure]:
    rows: list[Figure] = []
    with robots() as ports:
        for mode, port in ports.items():
            again = range(max(rounds, FEWEST_ROUNDS))
            samples = [(asyncio.run(ours(mode, port)), bare(mode, port)) for _ in again]
            our_s, bare_s = (statistics.median(column) for column in zip(*samples, strict=True))
            name = "direct" if mode == "direct" else f"interpreter, five fields, {mode}"
            goal = min(GOAL_RATIO, GOALS_S[mode] / bare_s)
            rows.append(
                at_most(
                    f"{name}: command to the robot, p50",
                    our_s * 1e3,
                    "ms",
                    reference="bare socket",
                    reference_value=bare_s * 1e3,
                    goal=round(goal, 2),
                )
            )
    return rows
