"""A hostile or broken ROS 1 node costs itself. Each is made of sockets; an honest neighbour publishes all the time."""

from __future__ import annotations

import asyncio
import socket
import struct
import xmlrpc.client
from collections.abc import AsyncIterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

import pytest

from tests import system
from tests.attacks.bridges import MOST_GROWTH_BYTES, OLDEST_S, age_s, goes_on, goes_on_a_while, limit_memory, threads
from tests.attacks.ros1_publisher import (
    FLOAT,
    HostilePublisher,
    Serve,
    endless,
    header,
    made_of,
    message,
    say,
    silent,
)
from tests.integration.ros1.ros1_graph import Peer, Ros1Graph
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

pytestmark = pytest.mark.needs("ros1")

HONEST = Topic(1, 2, 7)
ATTACKED = Topic(1, 2, 66)
FOREIGN = Topic(2, 2, 5)
NUMBER_FIELDS = (make_field("data", BuiltinType.DOUBLE, properties={"RosType": "std_msgs/Float64"}),)

EMPTY_ELEMENTS = "A[] all\n" + "=" * 80 + "\nMSG: acme_msgs/A\n"
NESTED = (
    "A[999999] all\n" + "=" * 80 + "\nMSG: acme_msgs/A\nB[999999] more\n" + "=" * 80 + "\nMSG: acme_msgs/B\nint8 x\n"
)
SMALL = "A[] all\n" + "=" * 80 + "\nMSG: acme_msgs/A\nint8 x\n"
NUMBER = message(struct.pack("<d", 1.5))
MOST = struct.pack("<I", 0xFFFFFFFF)
BLOCK = b"x" * (1 << 20)


@pytest.fixture
def graph(processes: system.Processes, tmp_path: Path, udp_url: str) -> Ros1Graph:
    return Ros1Graph(processes, tmp_path, udp_url)


@pytest.fixture
async def peer(udp_url: str) -> AsyncIterator[Peer]:
    async with Peer.at(udp_url, space=2) as started:
        yield started


async def honest(graph: Ros1Graph, peer: Peer) -> system.Child:
    """A bridge with an honest neighbour; the bridge."""
    graph.master()
    bridge = graph.bridge()
    limit_memory(bridge)
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    await peer.until(lambda: peer.good(HONEST))
    return bridge


def without(*names: str) -> bytes:
    return header({name: value for name, value in FLOAT.items() if name not in names})


PUT_ASIDE: dict[str, Serve] = {
    "no_type": say(without("type"), NUMBER),
    "no_md5sum": say(without("md5sum"), NUMBER),
    "no_header": say(struct.pack("<I", 0), NUMBER),
    "lengths_of_a_header_that_do_not_fit": say(struct.pack("<II", 8, 900) + b"type"),
    "endless_header": endless(MOST, again=BLOCK),
    "endless_message": endless(header(), MOST, again=BLOCK),
    "silent_link": silent,
    "more_elements_than_anybody_sends": endless(
        made_of(SMALL), again=message(struct.pack("<I", 30 << 20) + b"\1" * (30 << 20))
    ),
    "rubbish": endless(header(), again=message(b"rubbish")),
}
NOT_READ: dict[str, Serve] = {
    "empty_elements": say(made_of(EMPTY_ELEMENTS), message(MOST)),
    "nested_fixed_arrays": say(made_of(NESTED), message(b"")),
    "not_text": say(header({**FLOAT, "type": "std_msgs/\x1b[2J"}), NUMBER),
}


@pytest.mark.parametrize("kind", PUT_ASIDE)
async def test_a_publisher_that_misbehaves_is_put_aside_and_nobody_else_pays(
    graph: Ros1Graph, peer: Peer, kind: str
) -> None:
    bridge = await honest(graph, peer)
    with HostilePublisher(graph.uri, "/ua_1_2_66", PUT_ASIDE[kind]) as hostile:
        await peer.until(lambda: peer.bridge("Drops.misbehaved"))
        await goes_on(peer, HONEST, bridge, 3.0)
        await peer.until(lambda: "/ua_1_2_66 of http" in peer.bridge("Detail"))
        assert hostile.links <= 5  # at once, and after pauses of 1, 2, 4 s
    bridge.wait_for("source is put aside")


@pytest.mark.parametrize("kind", NOT_READ)
async def test_a_type_that_asks_for_too_much_is_not_read(graph: Ros1Graph, peer: Peer, kind: str) -> None:
    bridge = await honest(graph, peer)
    with HostilePublisher(graph.uri, "/ua_1_2_66", NOT_READ[kind]):
        await peer.until(lambda: peer.bridge("Drops.type_missing"))
        await goes_on(peer, HONEST, bridge, 2.0)
    assert not any("\x1b" in line for line in bridge.lines)


async def test_a_publisher_that_has_been_mended_is_read_again(graph: Ros1Graph, peer: Peer) -> None:
    bridge = await honest(graph, peer)
    with HostilePublisher(graph.uri, "/ua_1_2_66", say(without("type"))) as publisher:
        await peer.until(lambda: peer.bridge("Drops.misbehaved"))
        publisher.serve = endless(header(), again=NUMBER, pause_s=0.05)
        await peer.until(lambda: peer.good(ATTACKED) and age_s(peer, ATTACKED) < OLDEST_S)
        await goes_on(peer, HONEST, bridge, 1.0)
        assert peer.good(ATTACKED)[-1] == (1.5,)


async def test_a_silent_publisher_of_a_wrong_type_keeps_nobody_out(graph: Ros1Graph, peer: Peer) -> None:
    await honest(graph, peer)
    wrong = header({**FLOAT, "type": "std_msgs/String", "md5sum": "992ce8a1687cec8c8bd883ec73ca41d1"})
    with HostilePublisher(graph.uri, "/ua_1_2_66", say(wrong)) as hostile:
        await peer.until(lambda: hostile.links == 1)
        graph.talker("/ua_1_2_66", "std_msgs/Float64", "{data: COUNT}", "--name", "right")
        await peer.until(lambda: "it says nothing, and its type is std_msgs/String" in peer.bridge("Detail"))
        count = len(peer.good(ATTACKED))
        await peer.until(lambda: len(peer.good(ATTACKED)) > count)
        assert all(isinstance(value, float) for (value,) in peer.good(ATTACKED))


async def test_a_publisher_that_floods_costs_itself(graph: Ros1Graph, peer: Peer) -> None:
    bridge = await honest(graph, peer)
    with HostilePublisher(graph.uri, "/ua_1_2_66", endless(header(), again=NUMBER * 4096)):
        await peer.until(lambda: peer.good(ATTACKED))
        course = await goes_on(peer, HONEST, bridge, 6.0)
        assert course.oldest_s < OLDEST_S
        assert course.grown_bytes < MOST_GROWTH_BYTES
        assert set(peer.good(ATTACKED)) == {(1.5,)}


async def test_a_publisher_that_changes_its_type_at_each_link_costs_itself(graph: Ros1Graph, peer: Peer) -> None:
    bridge = await honest(graph, peer)
    numbers = count()

    def serve(link: socket.socket) -> None:
        link.sendall(made_of(f"int8 x{next(numbers)}\n", md5sum=f"{next(numbers):032}") + message(b"\1"))

    with HostilePublisher(graph.uri, "/ua_1_2_66", serve) as hostile:
        for _ in range(40):
            hostile.call_master("registerPublisher", "/ua_1_2_66", "std_msgs/Float64", hostile.uri)
            await goes_on_a_while(peer, HONEST, bridge, 0.2)
        await peer.until(lambda: peer.bridge("Drops.misbehaved"))
        await peer.until(lambda: "changed the type of its topic" in peer.bridge("Detail"))
        assert (await goes_on(peer, HONEST, bridge, 0.5)).oldest_s < OLDEST_S


async def test_silent_connections_to_its_ports_keep_nobody_out(graph: Ros1Graph, peer: Peer) -> None:
    """The one accepts subscribers, the other the calls of other nodes."""
    bridge = await honest(graph, peer)
    peer.announce(FOREIGN, NUMBER_FIELDS)
    peer.publish(FOREIGN, 1.0)
    await peer.until(lambda: "/ua_2_2_5" in graph.state()[0])
    api = graph.uri_of("/ua_bridge")
    with xmlrpc.client.ServerProxy(api) as node:
        _, _, (_, host, port) = cast("Any", node.requestTopic("/test", "/ua_2_2_5", [["TCPROS"]]))
    parts = urlsplit(api)
    with ExitStack() as links:
        for address in ((host, port), (parts.hostname, parts.port)):
            for _ in range(200):
                links.enter_context(socket.create_connection(address))
        dripping = links.enter_context(socket.create_connection((host, port)))
        dripping.sendall(b"\xff")
        listener = graph.listener("/ua_2_2_5", "std_msgs/Float64")
        await graph.linked(listener, "/ua_2_2_5")
        peer.publish(FOREIGN, 2.0)
        await asyncio.to_thread(listener.wait_for, "data: 2.0")
        await goes_on(peer, HONEST, bridge, 1.0)
        dripping.settimeout(15)
        assert dripping.recv(1) == b""  # who says nothing is not kept


async def test_orders_of_strangers_are_not_done(graph: Ros1Graph, peer: Peer) -> None:
    bridge = await honest(graph, peer)
    with xmlrpc.client.ServerProxy(graph.uri_of("/ua_bridge")) as node:
        for _ in range(3):
            node.shutdown("/master", "new node registered with same name")
        node.publisherUpdate("/master", "/ua_1_2_7", [])
        node.publisherUpdate("/master", "/ua_1_2_7", ["http://127.0.0.1:1/"])
        await peer.until(lambda: peer.bridge("Drops.misbehaved"))
        await goes_on(peer, HONEST, bridge, 2.0)
        assert peer.bridge("Connected") is True
        with pytest.raises((xmlrpc.client.Error, OSError)):
            node.publisherUpdate("/master", "/x" * (2 << 20), [])
    await asyncio.to_thread(bridge.wait_for, "the ROS master asked the bridge to shut down")
    graph.talker("/ua_1_2_8", "std_msgs/Float64", "{data: COUNT}", "--name", "new")
    await peer.until(lambda: peer.good(Topic(1, 2, 8)))


async def test_topics_that_come_and_go_leave_nothing_behind(graph: Ros1Graph, peer: Peer) -> None:
    bridge = await honest(graph, peer)
    with HostilePublisher(graph.uri, "/ua_1_2_66", endless(header(), again=NUMBER, pause_s=0.1)) as hostile:

        def come_and_go() -> None:
            for number in range(1000, 1400):
                hostile.call_master("registerPublisher", f"/ua_1_2_{number}", "std_msgs/Float64", hostile.uri)
                hostile.call_master("unregisterPublisher", f"/ua_1_2_{number}", hostile.uri)

        # In a thread: a loop that does not run hears nothing, and takes the honest value for an old one.
        coming = asyncio.ensure_future(asyncio.to_thread(come_and_go))
        while not coming.done():
            await goes_on_a_while(peer, HONEST, bridge, 0.2)
        await coming
        assert (await goes_on(peer, HONEST, bridge, 3.0)).oldest_s < OLDEST_S
    await peer.until(lambda: threads(bridge) < 40)
