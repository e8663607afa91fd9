"""A clustered broker of which a node is killed: who was connected there goes on at another one."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.mqtt.broker import Cluster
from tests.integration.mqtt.speaking import Speaking
from tests.unit.pubsub.security.securing import data
from tests.waiting import until

pytestmark = pytest.mark.needs("nats")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    made = Cluster(tmp_path / "cluster")
    made.start()
    yield made
    made.end()


async def test_who_loses_a_node_goes_on_at_the_next_one_and_nothing_is_lost(cluster: Cluster) -> None:
    a, b, c = cluster.urls
    speaker = Speaking(a, 1, more_urls=[b, c])
    listener = Speaking(b, 2, more_urls=[c])
    try:
        await speaker.start()
        await listener.start()
        said: list[bytes] = []
        for number in range(1, 41):
            message = data(f"value {number}", number)
            said.append(message)
            speaker.transport.send(message)
            if number == 15:
                # What has not come to it yet gives way to the newest of its writer.
                await until(lambda: said[-1] in listener.heard, "what its node had")
                cluster.nodes["a"].end(signal.SIGKILL)
            await asyncio.sleep(0.05)
        await until(lambda: said[-1] in listener.heard, "the last value", 60)
        assert not speaker.transport.stats.problem
        assert listener.heard[-1] == said[-1]
        assert [each for each in listener.heard if each in said[:15]] == said[:15]
    finally:
        await speaker.transport.close()
        await listener.transport.close()


async def test_no_connection_has_the_nodes_choose_who_leads_its_subscriptions(cluster: Cluster) -> None:
    a, b, c = cluster.urls
    speaker, listener = Speaking(a, 1, more_urls=[b]), Speaking(b, 2, more_urls=[c])
    try:
        await speaker.start()
        await listener.start()
        message = data("value", 1)
        speaker.transport.send(message)
        await until(lambda: message in listener.heard, "the value", 30)
        logs = [node.log for node in cluster.nodes.values()]
        assert any("new stream leader" in log for log in logs), "they are told of at all"
        assert not [line for log in logs for line in log.splitlines() if "new consumer leader" in line]
    finally:
        await speaker.transport.close()
        await listener.transport.close()
