"""Requests of logged-in users with wrong bytes in them: each gets an answer, and none gets further than that."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_security.harness import Client, Identities, bad, binary, door, ua
from tests.integration.server_security.test_limits import create_subscription, requests
from tests.integration.server_security.test_subscriptions import attacks

pytestmark = pytest.mark.asyncio(loop_scope="module")

COUNT = 400


def mutated(rng: random.Random, body: bytearray, start: int) -> bytes:
    """The bytes of a request with a few of its parameters' bytes changed, inserted, taken out or made huge."""
    for _ in range(rng.randint(1, 4)):
        if len(body) <= start:
            break
        at = rng.randrange(start, len(body))
        kind = rng.random()
        if kind < 0.5:
            body[at] = rng.randrange(256)
        elif kind < 0.7:
            del body[at : at + rng.randint(1, 8)]
        elif kind < 0.9:
            body[at:at] = rng.randbytes(rng.randint(1, 8))
        else:
            body[at : at + 4] = b"\xff\xff\xff\x7f"
    return bytes(body)


async def exchange(client: Client, request: Any, rng: random.Random) -> str:
    """Send a mutated request; the StatusCode that comes back, or nothing where none is due yet."""
    protocol = client.uaclient.protocol
    protocol._setup_request_header(request.RequestHeader, 1)
    head = 4 + len(binary.struct_to_binary(request.RequestHeader))
    body = mutated(rng, bytearray(binary.struct_to_binary(request)), head)
    protocol._request_id += 1
    answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
    protocol._callbackmap[protocol._request_id] = answer
    protocol.transport.write(protocol._connection.message_to_binary(body, request_id=protocol._request_id))
    try:
        data = await asyncio.wait_for(answer, 0.5)
    except TimeoutError:
        return ""
    binary.nodeid_from_binary(data)
    return str(binary.struct_from_binary(ua.ResponseHeader, data).ServiceResult.name)


async def test_every_mutated_request_gets_an_answer(tmp_path: Path, identities: Identities) -> None:
    rng = random.Random(11)
    async with door(tmp_path, identities) as hardened, hardened.connected("eva") as client:
        subscription = (await create_subscription(client)).SubscriptionId
        seen: set[str] = set()
        for _ in range(COUNT):
            built = [request for request, _ in requests(hardened.nodes, 2, subscription).values()]
            built += [parts[0] for parts in attacks(subscription, 1, hardened.nodes.value).values()]
            built += [ua.GetEndpointsRequest(), ua.FindServersRequest(), ua.CreateSubscriptionRequest()]
            seen.add(await exchange(client, rng.choice(built), rng))
        assert "BadInternalError" not in seen
        assert "BadDecodingError" in seen
        assert await bad(client.get_node(hardened.nodes.plain).read_value()) == "Good"
