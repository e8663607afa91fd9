"""Clients of the benchmark `services` that watch values, and decode of their notifications the times alone.

All notifications are of a Double with a StatusCode and both times, so that each has the same number of bytes. They
answer `watch CLIENTS ITEMS MS` with the number of items, once; `count SECONDS` with the notifications that came
meanwhile; `age` with the 99th percentile of their ages then, in seconds, from the SourceTimestamp to their arrival.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import contextlib
import struct
import time
from collections.abc import Awaitable, Callable
from typing import Any

from asyncua import ua as standard
from asyncua.ua.ua_binary import struct_from_binary

from benchmarks._ingest import serve_lines

ua: Any = standard

CHANGES = b"\x01\x00" + (811).to_bytes(2, "little") + b"\x01"
"""TypeId of a DataChangeNotification with a body."""
HEAD = struct.Struct("<ii")
"""Its length, and the number of notifications."""
NOTIFICATION = 34
SOURCE_AT = 18
"""Where in a notification its SourceTimestamp is."""
EACH = 10
"""Of so many notifications the age of one is taken."""
EPOCH_TICKS = 116_444_736_000_000_000
REQUESTS = 3
"""Publish requests of a client that wait at the server."""


class Counted:
    """What has come to all clients."""

    def __init__(self) -> None:
        self.number = 0
        self.ages: list[int] = []

    def take(self, data: bytes) -> tuple[int, int]:
        """Count a PublishResponse; the subscription and sequence number to acknowledge, 0 for a keep-alive."""
        now = time.time_ns() // 100 + EPOCH_TICKS
        subscription, kept = HEAD.unpack_from(data, 28)
        sequence = int.from_bytes(data[37 + 4 * kept : 41 + 4 * kept], "little")
        at = data.find(CHANGES, 41 + 4 * kept)
        if at < 0:
            return subscription, 0
        _, count = HEAD.unpack_from(data, at + len(CHANGES))
        start = at + len(CHANGES) + HEAD.size + SOURCE_AT
        self.number += count
        for number in range(0, count, EACH):
            begin = start + number * NOTIFICATION
            self.ages.append(now - int.from_bytes(data[begin : begin + 8], "little"))
        return subscription, sequence


async def _send(client: Any, request: Any) -> bytes:
    return bytes(await client.uaclient.protocol.send_request(request, 600))


async def _subscribe(client: Any, items: int, interval_ms: float) -> None:
    request = ua.CreateSubscriptionRequest()
    request.Parameters = ua.CreateSubscriptionParameters(interval_ms, 10_000, 1_000, 0, True, 0)
    data = struct_from_binary(ua.CreateSubscriptionResponse, ua.utils.Buffer(await _send(client, request)))
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = data.Parameters.SubscriptionId
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    request.Parameters.ItemsToCreate = [
        ua.MonitoredItemCreateRequest(
            ua.ReadValueId(ua.NodeId(number, 2), ua.AttributeIds.Value),
            ua.MonitoringMode.Reporting,
            ua.MonitoringParameters(number, interval_ms, None, 1, True),
        )
        for number in range(1, items + 1)
    ]
    made = struct_from_binary(ua.CreateMonitoredItemsResponse, ua.utils.Buffer(await _send(client, request)))
    assert all(result.StatusCode.is_good() for result in made.Results)


async def _publish(client: Any, counted: Counted) -> None:
    """Keep one Publish request at the server, and acknowledge what came."""
    known: list[Any] = []
    while True:
        request = ua.PublishRequest()
        request.Parameters.SubscriptionAcknowledgements, known = known, []
        subscription, sequence = counted.take(await _send(client, request))
        if sequence:
            known.append(ua.SubscriptionAcknowledgement(subscription, sequence))


async def watchers(make: Callable[..., Awaitable[Any]]) -> None:
    """Serve the lines of the standard input with clients that `make` makes."""
    counted = Counted()
    tasks: list[asyncio.Task[None]] = []

    async def answer(line: str) -> str:
        what, *numbers = line.split()
        if what == "watch" and tasks:
            return "0"
        if what == "watch":
            clients, items, interval_ms = map(int, numbers)
            for _ in range(clients):
                client = await stack.enter_async_context(await make(named=True))
                await _subscribe(client, items, interval_ms)
                tasks.extend(asyncio.create_task(_publish(client, counted)) for _ in range(REQUESTS))
            return str(clients * items)
        if what == "count":
            counted.number, counted.ages = 0, []
            await asyncio.sleep(float(numbers[0]))
            return str(counted.number)
        ages = sorted(counted.ages)
        return str(ages[len(ages) * 99 // 100] * 1e-7)

    async with contextlib.AsyncExitStack() as stack:
        print("ready", flush=True)
        await serve_lines(answer)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
