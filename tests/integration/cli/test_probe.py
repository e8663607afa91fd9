"""`ua-fleet pubsub probe` asks the server that `ua-fleet serve` runs, over real UDP."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from tests.integration.cli.conftest import Site
from tests.system import free_multicast_url
from ua_fleet.counters import Counters
from ua_fleet.pubsub import ProbeReceived, Publisher, PubSubTiming, Subscriber, make_field
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ActionTarget

SERVER = "0"


def probe(site: Site, *arguments: str) -> list[dict[str, Any]]:
    ended = site.run("pubsub", "probe", *arguments, "--json", user=None)
    assert ended.code == 0, ended.stderr
    return ended.objects


def test_applications(site: Site) -> None:
    heard = {found["announcement_type"]: found for found in probe(site)}
    assert set(heard) == {5}
    ended = site.run("pubsub", "probe", user=None)
    heading, row = ended.stdout.splitlines()
    assert heading.split()[:4] == ["publisher", "application", "type", "state"]
    assert "Hall server" in row
    assert "operational" in row
    assert "urn:ua-fleet:Hall:server" in row


def test_metadata_and_writers(site: Site) -> None:
    metadata = probe(site, "--kind", "metadata", SERVER)
    assert {found["metadata"]["name"] for found in metadata} == {"goal", "name", "steps"}
    ids = {found["data_set_writer_id"] for found in metadata}
    writers = probe(site, "--kind", "writers", SERVER)
    assert {writer for found in writers for writer in found["data_set_writer_ids"]} == ids
    ended = site.run("pubsub", "probe", "--kind", "metadata", user=None)
    assert "goal double" in ended.stdout, "whom to ask is found"
    [group] = probe(site, "--kind", "groups", SERVER)
    assert (group["writer_group"]["writer_group_id"], group["writer_group"]["data_set_writers"]) == (2, [])


def test_connections_and_endpoints(site: Site) -> None:
    [found] = probe(site, "--kind", "connections", SERVER)
    [connection] = found["connections"]
    assert connection["address"]["url"] == site.url
    assert len(connection["writer_groups"][0]["data_set_writers"]) == 3
    [found] = probe(site, "--kind", "endpoints", SERVER)
    assert {endpoint["endpoint_url"] for endpoint in found["endpoints"]} == {site.endpoint}
    ended = site.run("pubsub", "probe", "--kind", "endpoints", SERVER, user=None)
    assert "sign and encrypt  Basic256Sha256" in ended.stdout


def test_nobody_answers(site: Site) -> None:
    ended = site.run("pubsub", "probe", "--kind", "actions", "9", "--timeout", "0.6", user=None)
    assert (ended.code, ended.stdout) == (5, "")
    assert "publisher 9 did not answer with actions within 0.6 s" in ended.stderr
    assert "others are heard" in ended.stderr
    elsewhere = site.run("pubsub", "probe", "--url", free_multicast_url(), "--timeout", "0.6", user=None)
    assert elsewhere.code == 5
    assert "`ua-fleet pubsub listen --timeout 10` shows what is heard" in elsewhere.stderr
    assert site.run("pubsub", "probe", "70000", user=None).code == 2


async def test_actions_of_a_bridge(site: Site) -> None:
    """A Responder on the same connection: what a bridge that has skills announces."""
    loop = asyncio.get_running_loop()
    transport = UdpTransport(site.url, "lo")
    publisher = Publisher(7, PubSubTiming(), Counters(), Codec())
    subscriber = Subscriber(7, PubSubTiming(), Counters(), Codec())

    def receive(datagram: bytes, _sender: object) -> None:
        for event in subscriber.receive(datagram, loop.time()):
            if isinstance(event, ProbeReceived):
                for answer in publisher.answer(event.probe, loop.time()):
                    transport.send(answer)

    await transport.start(receive)
    try:
        publisher.announce_action(
            Topic(7, 2, 5),
            "move",
            (ActionTarget(1, "arm\x1b[31m"),),
            (make_field("x", BuiltinType.DOUBLE),),
            (make_field("accepted", BuiltinType.BOOLEAN),),
            now=loop.time(),
            wall_ticks=1,
        )
        await asyncio.sleep(0.6)  # what is announced at once is not said again within half a second
        ended = await asyncio.to_thread(site.run, "pubsub", "probe", "--kind", "actions", "7", user=None)
        as_json = await asyncio.to_thread(site.run, "pubsub", "probe", "--kind", "actions", "7", "--json", user=None)
    finally:
        await transport.close()
    assert ended.code == 0, ended.stderr
    assert "1 arm\\x1b[31m" in ended.stdout, "nothing of a peer reaches the terminal unescaped"
    assert "x double" in ended.stdout
    assert {json.loads(line)["announcement_type"] for line in as_json.stdout.splitlines()} == {6, 7}
