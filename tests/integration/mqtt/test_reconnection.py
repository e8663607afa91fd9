"""A mosquitto that is started anew under many clients: each comes back after pauses of its own, and is heard."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from itertools import accumulate
from random import Random
from typing import Final

import pytest

from tests.integration.mqtt.broker import Broker
from tests.integration.mqtt.speaking import Speaking
from tests.unit.pubsub.security.securing import data
from tests.waiting import until
from ua_fleet.transport.mqtt.pauses import Pauses

pytestmark = pytest.mark.needs("mosquitto")

CLIENTS: Final = range(1, 13)
ATTEMPTS: Final = 3
"""That each makes in vain while the broker is away."""
CLIENT_ID_AT: Final = 2
EARLY_S: Final = 0.02
"""What the clocks of asyncio and of this test differ by at most."""

Attempts = dict[str, list[float]]
"""By ClientID, when it has sent a CONNECT."""


@asynccontextmanager
async def a_port_without_a_broker(port: int) -> AsyncGenerator[Attempts]:
    """Notes who comes to a port, and closes the connection."""
    attempts: Attempts = {}

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        begin = await reader.read(4096)
        for client in CLIENTS:
            name = f"test-{client}".encode()
            if len(name).to_bytes(CLIENT_ID_AT, "big") + name in begin:
                attempts.setdefault(name.decode(), []).append(asyncio.get_running_loop().time())
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", port)
    async with server:
        yield attempts


def pauses_of(client: int) -> list[float]:
    pauses = Pauses(Random(client))
    return [pauses.next_s() for _ in range(ATTEMPTS)]


async def test_clients_of_a_broker_that_is_started_anew_come_back_each_at_its_time(broker: Broker) -> None:
    async with AsyncExitStack() as stack:
        clients = {client: Speaking(broker.url, client, random=Random(client)) for client in CLIENTS}
        for each in clients.values():
            stack.push_async_callback(each.transport.close)
            await each.start()
        loop = asyncio.get_running_loop()
        began = loop.time()
        broker.end(9)  # all lose it in the same moment
        async with a_port_without_a_broker(broker.port) as attempts:
            await until(lambda: all(each.transport.stats.problem for each in clients.values()))
            await until(lambda: len(attempts) == len(CLIENTS) and min(map(len, attempts.values())) >= ATTEMPTS, "them")
        broker.start()
        await until(lambda: not any(each.transport.stats.problem for each in clients.values()), "all to be back")

        # Never earlier than its own pauses say. Later is the machine's affair.
        for client in CLIENTS:
            due = [began + after for after in accumulate(pauses_of(client))]
            seen = attempts[f"test-{client}"][:ATTEMPTS]
            assert all(at > earliest - EARLY_S for at, earliest in zip(seen, due, strict=True)), (client, seen, due)
        # Their pauses differ, so they come over a time, about that between the shortest and the longest of them.
        for number in range(ATTEMPTS):
            times = [seen[number] for seen in attempts.values()]
            sums = [sum(pauses_of(client)[: number + 1]) for client in CLIENTS]
            assert max(times) - min(times) > 0.5 * (max(sums) - min(sums))

        # What each says now arrives at all the others, once.
        for client, each in clients.items():
            each.transport.send(data(f"again {client}", client))
        for client, each in clients.items():
            wanted = {data(f"again {other}", other) for other in CLIENTS if other != client}
            await until(lambda: wanted <= set(each.heard), f"what the others say to {client}")  # noqa: B023 - now
            assert all(each.heard.count(datagram) == 1 for datagram in wanted)
