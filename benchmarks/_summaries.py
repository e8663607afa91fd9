"""The processes of the benchmark `summaries`: a server, and a client that counts.

    python -m benchmarks._summaries server PORT with|without | client URL summaries|nodes|nothing

They are told what to do line by line on their standard input, and answer each line with one line.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import logging
import sys
import tempfile
import time
from pathlib import Path

import structlog

from benchmarks._ingest import Meter, client, serve_lines

ROBOTS = 1_000
VALUES = 10
GROUPS = ROBOTS // 100
PARTS = ("State", "LastUpdate", "HeldBy")
"""What a list has to watch of each robot where there are no summaries; of the quality it knows nothing then."""
TOLD = {"summaries": GROUPS, "nodes": ROBOTS, "nothing": 0}
"""Notifications of a second: LastUpdate is the only part that moves each second."""


async def server(port: int, has_summaries: bool) -> None:
    """State, coalescer, projection and summaries as the hub calls them, for one second after another."""
    from ua_fleet.config.nodes import fleet_model
    from ua_fleet.config.schema import FleetConfig
    from ua_fleet.counters import Counters
    from ua_fleet.endpoint.hardened_server import create_server
    from ua_fleet.fleet import Change, Coalescer, FleetState, ValueChanged
    from ua_fleet.monitoring.mistakes import Mistakes
    from ua_fleet.nodes.address_space import FleetNodes
    from ua_fleet.nodes.node_factory import NodeFactory
    from ua_fleet.nodes.nodeset import load_types
    from ua_fleet.nodes.projection import Projection
    from ua_fleet.nodes.summary_nodes import SummaryNodes
    from ua_fleet.operation.runs.activity import RobotActivities
    from ua_fleet.pubsub.events import DataReceived
    from ua_fleet.pubsub.metadata import make_field
    from ua_fleet.topics import Topic
    from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, ticks_from_unix_ns
    from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

    ids = range(1, ROBOTS * VALUES + 1)
    robots = {
        f"robot{robot:04d}": {
            "bridge": "side",
            "capacities": ["mobile", "grab"],
            "data": {f"value{n}": {"id": 1 + VALUES * robot + n, "type": "Double"} for n in range(VALUES)},
        }
        for robot in range(ROBOTS)
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
        made = await create_server(config.server, Path(folder), application_uri="urn:ua-fleet:benchmark")
        await load_types(made, "urn:ua-fleet:fleet", 2)
        model = fleet_model(config)
        nodes = FleetNodes(made.iserver.aspace, model)
        nodes.build()
        state, coalescer = FleetState(model, Counters()), Coalescer(config.server.analog_rate_hz)
        projection = Projection(nodes)
        wall = ticks_from_unix_ns(time.time_ns())
        parts = NodeFactory(made.iserver.aspace, nodes.ns)
        parts.values = nodes.values
        summaries = SummaryNodes(parts, state, RobotActivities(), projection.write, lambda: wall, Mistakes())
        if has_summaries:
            summaries.build()
        await made.start()
        metadata = DataSetMetaData("value", (make_field("data", BuiltinType.DOUBLE),), ConfigurationVersion(1, 1))
        topics = [Topic(2, 2, number) for number in ids]
        meter, double, now = Meter(), int(BuiltinType.DOUBLE), 0.0

        def take(changes: list[Change]) -> None:
            for change in changes:
                if isinstance(change, ValueChanged) and (ready := coalescer.offer(change, now)) is not None:
                    projection.write(ready)

        async def answer(line: str) -> str:
            nonlocal now, wall
            if line == "cpu":
                return meter.answer()
            value, now, wall = float(line), now + 1.5, wall + TICKS_PER_SECOND
            events = [
                DataReceived(
                    topic, DataSetMessage(topic.id, types=(double,), values=(value,), timestamp=wall), metadata
                )
                for topic in topics
            ]
            meter.started = time.process_time()
            for event in events:
                projection.begin_turn()
                take(state.apply(event, wall))
            take(state.tick(wall))
            while has_summaries and (due := summaries.next_deadline(now)) is not None and due <= now:
                summaries.poll(now)
            while projection.waiting:
                projection.poll(now)
                await asyncio.sleep(0)
            return meter.answer()

        print("ready", flush=True)
        await serve_lines(answer)
        await made.stop()


def watched(what: str) -> list[str]:
    """The nodes that a client watches."""
    return {
        "summaries": [f"ns=2;s=Fleet.Summaries.{number + 1}" for number in range(GROUPS)],
        "nodes": [f"ns=2;s=Robots.robot{robot:04d}.{part}" for robot in range(ROBOTS) for part in PARTS],
        "nothing": [],
    }[what]


def main() -> None:
    logging.disable(logging.WARNING)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    role, first, second = sys.argv[1:]
    asyncio.run(client(first, watched(second)) if role == "client" else server(int(first), second == "with"))


if __name__ == "__main__":
    main()
