"""ROS 1 publisher to a node's value in the server, and to an OPC UA client's notification, beside a floor.

Ours: rospy node, ROS 1 bridge, PubSub, server, and a stock asyncua client with a subscription. The floor: the same
robot, a bridge of a few lines, eight bytes over multicast, `write_value` in a stock asyncua server, the same client.
The values are shown, without a goal: most of a notification's time is the publishing interval.
"""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Generator
from pathlib import Path

from benchmarks._ros import NODES, RUNNER, Node, median_and_p99, ros1_environment, running_master, running_node
from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, Unavailable, shown
from tests import system

OURS, FLOOR = "ua_1_2_7", "floor"
NODE_ID = "ns=2;i=7"
REFERENCE = "stock asyncua, a bridge of a few lines"
RATE_HZ = 100.0
WARM_UP, MEASURED = 150, 300


class Way:
    """One of the two ways from the robot to the client."""

    def __init__(self, topic: str, publisher: Node, server: Node, client: Node) -> None:
        self._topic, self._publisher, self._observers = topic, publisher, (server, client)

    def _ages(self, count: int) -> list[list[float]]:
        self._publisher.tell(f"{self._topic} {RATE_HZ} {count}")
        self._publisher.expect("done")
        time.sleep(0.5)  # for the last ones
        for observer in self._observers:
            observer.tell("ages")
        return [observer.ages() for observer in self._observers]

    def wait_until_linked(self) -> None:
        deadline = time.monotonic() + 20
        while not all(self._ages(20)):
            if time.monotonic() > deadline:
                raise Failed(f"nothing arrives on {self._topic}")

    def measure(self) -> tuple[float, ...]:
        """Median and 99th percentile at the node, and at the client."""
        self._ages(WARM_UP)
        return tuple(figure for ages in self._ages(MEASURED) for figure in median_and_p99(ages))


@contextlib.contextmanager
def ways() -> Generator[tuple[Way, Way]]:
    """The floor's way and ours, at work."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        ros1, env = ros1_environment(folder), dict(os.environ)
        stack.enter_context(running_master(ros1))
        fleet = folder / "fleet.json"
        fleet.write_text(json.dumps(_fleet(ros1["ROS_MASTER_URI"])))

        def start(*args: str | Path, env: dict[str, str] = env) -> Node:
            return stack.enter_context(running_node(*args, env=env))

        def module(name: str, *args: str | Path) -> Node:
            return start(sys.executable, "-m", f"benchmarks.ros_nodes.{name}", *args)

        group, port = system.free_multicast_url().removeprefix("opc.udp://").split(":")
        floor_url = f"opc.tcp://127.0.0.1:{system.free_tcp_port()}/floor"
        publisher = start(system.ROS1_PYTHON, NODES / "publisher_ros1.py", OURS, FLOOR, env=ros1)
        start(system.ROS1_PYTHON, NODES / "floor_ros1.py", FLOOR, group, port, env=ros1)
        start(system.ROS1_PYTHON, RUNNER, fleet, "ros1", env=ros1)
        servers = module("server_floor", floor_url, group, port), module("server_ours", fleet, NODE_ID)
        clients = [module("client", server.ready.split()[1], NODE_ID) for server in servers]
        floor, ours = (
            Way(topic, publisher, server, client)
            for topic, server, client in zip((FLOOR, OURS), servers, clients, strict=True)
        )
        floor.wait_until_linked()
        ours.wait_until_linked()
        yield floor, ours


def _fleet(master_uri: str) -> dict[str, object]:
    return {
        "version": 1,
        "pubsub": {"security": "none", "url": system.free_multicast_url()},
        "server": {
            "port": system.free_tcp_port(),
            "allow_none_security": True,
            "allow_anonymous": True,
            "analog_rate_hz": 10_000,  # else nine of ten values would wait for their turn
        },
        "bridges": {"ros1": {"kind": "ros1", "space": 1, "master_uri": master_uri, "status_id": 900}},
        "robots": {"arm": {"bridge": "ros1", "data": {"Level": {"id": 7, "type": "Double"}}}},
    }


def figures(rounds: int) -> list[Figure]:
    if reason := system.missing("ros1"):
        raise Unavailable(reason)
    with ways() as (floor, ours):
        measured = [(floor.measure(), ours.measure()) for _ in range(max(rounds, FEWEST_ROUNDS))]
    names = [f"ROS 1 to the {place}, {part}" for place in ("node's value", "client") for part in ("p50", "p99")]
    return [
        shown(
            name,
            statistics.median(mine[column] for _, mine in measured),
            "us",
            reference=REFERENCE,
            reference_value=statistics.median(least[column] for least, _ in measured),
        )
        for column, name in enumerate(names)
    ]
