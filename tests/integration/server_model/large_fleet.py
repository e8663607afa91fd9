"""A fleet of three namespaces and spaces: browsed, read and watched in each. `large_fleet.py ROBOTS` runs a large one.

ROBOTS is for each namespace, 30 values each.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import sys
import tempfile
import time
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import Any

from tests.integration.peer import Peer
from tests.integration.server_model.harness import SPACE, serving, ua
from tests.system import free_multicast_url, free_tcp_port
from tests.waiting import until
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.fleet.model import GROUP_SIZE
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

VALUES = 30
SPACES = {2: SPACE, 4: SPACE + 1, 5: SPACE + 2}
"""By namespace."""
FIELD = (make_field("data", BuiltinType.DOUBLE),)
TIMING = PubSubTiming(60.0, 180.0, 600.0)
"""150,000 sources that say each second that they live would be that many messages a second."""
START_S = 300
"""5,000 robots on a busy machine."""
BURST = 200
"""DataSets that are sent at once; then the others have to have heard them, or some of them would be lost."""


def fleet(robots: int, url: str, port: int) -> FleetConfig:
    """So many robots in each namespace."""
    raw: dict[str, Any] = {
        "version": 1,
        "fleet": {"namespaces": ["urn:hall-2", "urn:hall-3"]},
        "server": {"port": port, "trust_all_clients": True},
        "pubsub": {
            "security": "none",
            "url": url,
            "keep_alive_s": TIMING.keep_alive_s,
            "receive_timeout_s": TIMING.receive_timeout_s,
            "repeat_interval_s": TIMING.repeat_interval_s,
        },
        "bridges": {
            f"bridge{ns}": {"kind": "ros2", "space": space, "status_id": 65530 + ns} for ns, space in SPACES.items()
        },
        "robots": {
            f"R{ns}-{robot}": {
                "bridge": f"bridge{ns}",
                "namespace": ns,
                "data": {f"v{index}": {"id": 1 + robot * VALUES + index, "type": "Double"} for index in range(VALUES)},
            }
            for ns in SPACES
            for robot in range(robots)
        },
    }
    return load_content(json.dumps(raw).encode(), "fleet.json", {})


async def carried(robots: int, url: str, port: int, folder: Path) -> dict[str, float]:
    """Serve such a fleet, and see each value of each namespace at a client; how long each part took, in seconds."""
    took: dict[str, float] = {}
    started = time.perf_counter()

    def lap(what: str) -> None:
        nonlocal started
        took[what], started = time.perf_counter() - started, time.perf_counter()

    config = fleet(robots, url, port)
    lap("loaded")
    async with AsyncExitStack() as stack:
        running = await stack.enter_async_context(serving(folder, config, start_s=START_S))
        peers = {
            space: await stack.enter_async_context(Peer.at(url, space)) for space in SPACES.values() if space != SPACE
        }
        peers[SPACE] = running.peer
        client = await stack.enter_async_context(running.client())
        lap("serving")
        groups = await client.get_node("ns=2;s=Fleet.Robots").get_children()
        assert len(groups) == math.ceil(len(SPACES) * robots / GROUP_SIZE)
        found = [child for group in groups for child in await group.get_children()]
        assert len({str(node.nodeid) for node in found}) == len(SPACES) * robots
        for ns in SPACES:
            data = await client.get_node(f"ns=2;s=Robots.R{ns}-{robots - 1}.Data").get_children()
            assert [node.nodeid.NamespaceIndex for node in data] == [ns] * VALUES
        lap("browsed")
        await _published(peers, robots)
        lap("published")
        await _read(peers, client, robots)
        lap("read")
    return took


async def _published(peers: dict[int, Peer], robots: int) -> None:
    for ns, space in SPACES.items():
        hearer = next(peer for other, peer in peers.items() if other != space)
        for number in range(1, robots * VALUES + 1):
            topic = Topic(space, ns, number)
            peers[space].announce(topic, FIELD)
            peers[space].publish(topic, float(ns * 100_000 + number))
            if number % BURST == 0:
                with contextlib.suppress(AssertionError):  # it was lost: `_read` has it sent again
                    await until(partial(_has_heard, hearer, topic), timeout_s=2)


def _has_heard(peer: Peer, topic: Topic) -> bool:
    return any(isinstance(event, DataReceived) and event.topic == topic for event in peer.events[-4 * BURST :])


async def _read(peers: dict[int, Peer], client: Any, robots: int) -> None:
    """All values are there, and one of each namespace is watched while it changes."""
    for ns, space in SPACES.items():
        nodes = [client.get_node(ua.NodeId(number, ns)) for number in range(1, robots * VALUES + 1)]
        wanted = [float(ns * 100_000 + number) for number in range(1, robots * VALUES + 1)]
        for at in range(0, len(nodes), 1000):
            part = nodes[at : at + 1000]

            async def values(part: list[Any] = part) -> list[Any]:
                read = await client.read_attributes(part, ua.AttributeIds.Value)
                return [one.Value.Value if one.StatusCode.is_good() else None for one in read]

            async with asyncio.timeout(START_S):
                while (found := await values()) != (right := wanted[at : at + 1000]):
                    for place, one in enumerate(right):
                        if found[place] != one:
                            topic = Topic(space, ns, at + place + 1)
                            peers[space].announce(topic, FIELD)
                            peers[space].publish(topic, one)
                    await asyncio.sleep(1)
    seen: dict[str, float] = {}

    class Watcher:
        def datachange_notification(self, node: Any, value: Any, _data: Any) -> None:
            seen[node.nodeid.to_string()] = value

    subscription = await client.create_subscription(50, Watcher())
    last = [f"ns={ns};i={robots * VALUES}" for ns in SPACES]
    await subscription.subscribe_data_change([client.get_node(name) for name in last])
    await until(lambda: set(seen) == set(last), "the first values of the monitored items")
    for ns, space in SPACES.items():
        peers[space].publish(Topic(space, ns, robots * VALUES), -float(ns))
    await until(lambda: seen == {name: -float(ns) for name, ns in zip(last, SPACES, strict=True)}, "the changes")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        print(asyncio.run(carried(int(sys.argv[1]), free_multicast_url(), free_tcp_port(), Path(place))))
