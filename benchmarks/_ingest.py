"""The processes of the benchmark `ingest`: a server of ours, a stock asyncua server, and a client that counts.

    python -m benchmarks._ingest ours PORT | stock PORT | client URL MONITORED

They are told what to do line by line on their standard input, and answer each line with one line.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import logging
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

import structlog

NODES = 10_000
PUBLISHING_MS = 100
MOST_WAITING = 10 * NODES
"""Notifications that a client takes before it has counted them."""

TURN = 64
"""Messages after which others get their turn, as in `transport.udp`; with the stock server it is 250 writes."""

Serve = Callable[[str], Awaitable[str]]


async def serve_lines(answer: Serve) -> None:
    """Answer each line of the standard input until it ends."""
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := (await reader.readline()).decode().strip():
        print(await answer(line), flush=True)


class Meter:
    """CPU time of this process since the last `start`."""

    def __init__(self) -> None:
        self.started = 0.0

    def answer(self) -> str:
        return str(time.process_time() - self.started)


async def ours(port: int) -> None:
    """Core, projection and the notifications of our server; a message in, a node and its watchers out."""
    from benchmarks.address_space import NODES as PER_ROBOT
    from ua_fleet.config.nodes import fleet_model
    from ua_fleet.config.schema import FleetConfig
    from ua_fleet.endpoint.hardened_server import create_server
    from ua_fleet.monitoring import Mistakes
    from ua_fleet.nodes.address_space import FleetNodes
    from ua_fleet.nodes.nodeset import load_types
    from ua_fleet.nodes.projection import Projection
    from ua_fleet.pubsub.events import DataReceived
    from ua_fleet.pubsub.metadata import make_field
    from ua_fleet.server.attached import Parts
    from ua_fleet.server.core import ServerCore
    from ua_fleet.server.ground import PubSubEnds, make_ground
    from ua_fleet.server.hub import wall_ticks
    from ua_fleet.skill.journal import MemoryJournal
    from ua_fleet.topics import Topic, loop_verdict
    from ua_fleet.transport.memory import MemoryNetwork
    from ua_fleet.values import BuiltinType, ticks_from_unix_ns
    from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

    ids = range(1, NODES + 1)
    robots = {
        f"R{first}": {
            "bridge": "side",
            "data": {f"value{number}": {"id": number, "type": "Double"} for number in ids[first : first + PER_ROBOT]},
        }
        for first in range(0, NODES, PER_ROBOT)
    }
    config = FleetConfig.model_validate(
        {
            "version": 1,
            "server": {"port": port, "allow_none_security": True, "allow_anonymous": True},
            "pubsub": {"security": "none"},
            "bridges": {"side": {"kind": "ros2", "space": 2}},
            "robots": robots,
        }
    )
    with tempfile.TemporaryDirectory() as folder:
        server = await create_server(config.server, Path(folder), application_uri="urn:ua-fleet:benchmark")
        await load_types(server, "urn:ua-fleet:fleet", 2)
        model = fleet_model(config)
        nodes = FleetNodes(server.iserver.aspace, model)
        nodes.build()
        clock = asyncio.get_running_loop().time
        ground = make_ground(
            config,
            model,
            PubSubEnds(config, Path(folder), MemoryNetwork(0).endpoint(), clock),
            MemoryJournal(),
            Mistakes(),
            rule=loop_verdict,
            told=lambda _execution_id, _outcome: None,
            sooner=lambda: None,
            clock=clock,
            wall_ticks=wall_ticks,
        )
        projection = Projection(nodes)
        core = ServerCore(ground, Parts(nodes=projection), analog_rate_hz=config.server.analog_rate_hz)
        await server.start()
        metadata = DataSetMetaData("value", (make_field("data", BuiltinType.DOUBLE),), ConfigurationVersion(1, 1))
        topics = [Topic(2, 2, number) for number in ids]
        meter, double = Meter(), int(BuiltinType.DOUBLE)

        async def answer(line: str) -> str:
            if line == "cpu":
                return meter.answer()
            value, wall = float(line), ticks_from_unix_ns(time.time_ns())
            events = [
                DataReceived(
                    topic, DataSetMessage(topic.id, types=(double,), values=(value,), timestamp=wall), metadata
                )
                for topic in topics
            ]
            now = clock()
            meter.started = time.process_time()
            for number, event in enumerate(events):
                projection.begin_turn()
                core.hear([event], now=now, wall=wall)
                if number % TURN == TURN - 1:
                    await asyncio.sleep(0)
            return meter.answer()

        print("ready", flush=True)
        await serve_lines(answer)
        await server.stop()


async def stock(port: int) -> None:
    """Asyncua as it comes: `write_value` for each node."""
    from asyncua import ua
    from asyncua.server.server import Server

    server: Any = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/ua_fleet")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    await server.register_namespace("urn:ua-fleet:fleet")
    nodes: list[Any] = []
    folder = server.nodes.objects
    for number in range(1, NODES + 1):
        if number % 100 == 1:
            folder = await server.nodes.objects.add_folder(f"ns=2;s=G{number // 100}", f"2:G{number // 100}")
        nodes.append(await folder.add_variable(f"ns=2;i={number}", f"2:value{number}", 0.0))
    await server.start()
    meter = Meter()

    async def answer(line: str) -> str:
        if line == "cpu":
            return meter.answer()
        value = float(line)
        meter.started = time.process_time()
        for number, node in enumerate(nodes):
            await node.write_value(value)
            if number % 250 == 249:
                await asyncio.sleep(0)
        return meter.answer()

    print("ready", flush=True)
    await serve_lines(answer)
    await server.stop()


async def client(url: str, watched: Sequence[str]) -> None:
    """Counts notifications of these nodes; `N` is answered when N of them have come since the last answer."""
    from asyncua.client.client import Client

    count = 0

    class Handler:
        def datachange_notification(self, node: Any, val: Any, data: Any) -> None:
            nonlocal count
            count += 1

    async with Client(url, timeout=60, watchdog_intervall=60) as connected:
        subscription: Any = await connected.create_subscription(PUBLISHING_MS, Handler(), queue_maxsize=MOST_WAITING)
        nodes = [connected.get_node(one) for one in watched]
        for first in range(0, len(nodes), 1_000):
            await subscription.subscribe_data_change(nodes[first : first + 1_000], queuesize=1)

        async def answer(line: str) -> str:
            nonlocal count
            wanted, deadline = int(line), time.monotonic() + 60
            while count < wanted:
                if time.monotonic() > deadline:
                    return f"only {count}"
                await asyncio.sleep(0.02)
            taken, count = count, 0
            return str(taken)

        print("ready", flush=True)
        await serve_lines(answer)


def main() -> None:
    logging.disable(logging.WARNING)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    role, *arguments = sys.argv[1:]
    if role == "client":
        url, monitored = arguments
        asyncio.run(client(url, [f"ns=2;i={number + 1}" for number in range(int(monitored))]))
    else:
        asyncio.run({"ours": ours, "stock": stock}[role](int(arguments[0])))


if __name__ == "__main__":
    main()
