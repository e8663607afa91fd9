"""The processes of the benchmark `history`: a whole server, robots that send values, and clients.

    python -m benchmarks._history server FLEET | robots URL | watcher URL | reader URL FOLDER

They are told what to do line by line on their standard input, and answer each line with one number.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import logging
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import structlog
from asyncua import ua as standard

from benchmarks._ingest import serve_lines

ua: Any = standard
"""Its types are no help to those who fill in its structures."""
ROBOTS, FIELDS, RATE_HZ = 50, 10, 10
"""5,000 values a second: no more than an analog value is shown with."""
SPACE, FIRST = 2, 1_001
USER, PASSWORD = "operator", "benchmark-1234"
BEGIN = datetime(2026, 3, 1, tzinfo=UTC)
SECONDS = 86_400
"""Values of one node that are read: one for each second of a day."""
READ_NODE = f"{FIRST}.f0"
PAGE = 2_000


def robots_config() -> dict[str, Any]:
    """The fleet's robots: one DataSet each."""
    return {
        f"r{number}": {
            "bridge": "side",
            "data": {
                "joints": {
                    "id": FIRST + number,
                    "fields": {f"f{field}": {"type": "Double"} for field in range(FIELDS)},
                }
            },
        }
        for number in range(ROBOTS)
    }


async def server(fleet: Path) -> None:
    """A whole server; `cpu` is answered with the CPU seconds of its process."""
    from ua_fleet.config.load import load
    from ua_fleet.server.app import run_server

    async def answer(line: str) -> str:
        return str(time.process_time())

    loop = asyncio.get_running_loop()
    ready: asyncio.Future[str] = loop.create_future()
    task = asyncio.create_task(
        run_server(load(str(fleet), {}, allow_missing_ids=True), fleet.parent, ready=ready.set_result)
    )
    waited: list[asyncio.Future[Any]] = [task, ready]
    await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
    if task.done():
        task.result()
    print("ready", flush=True)
    await serve_lines(answer)
    task.cancel()
    await asyncio.wait([task])


async def robots(url: str) -> None:
    """Sends values for so many seconds as the line says; answers how many it has sent."""
    from tests.integration.peer import Peer
    from ua_fleet.pubsub.metadata import make_field
    from ua_fleet.topics import Topic
    from ua_fleet.values import BuiltinType

    topics = [Topic(SPACE, 2, FIRST + number) for number in range(ROBOTS)]
    async with Peer.at(url, SPACE) as peer:
        fields = tuple(make_field(f"f{field}", BuiltinType.DOUBLE) for field in range(FIELDS))
        for topic in topics:
            peer.announce(topic, fields)
        count = 0

        async def answer(line: str) -> str:
            nonlocal count
            peer.datagrams.clear()
            peer.events.clear()
            before, pause = count, 1 / (ROBOTS * RATE_HZ)
            due = time.monotonic()
            end = due + float(line)
            while due < end:
                for topic in topics:
                    count += FIELDS
                    peer.publish(topic, *[count * 0.001 + field for field in range(FIELDS)])
                    due += pause
                    if (left := due - time.monotonic()) > 0.001:
                        await asyncio.sleep(left)
            return str(count - before)

        print("ready", flush=True)
        await serve_lines(answer)


async def watcher(url: str) -> None:
    """Watches all values. `age` is answered with the 99th percentile, in ms, of how old they were since the last."""
    from asyncua.client.client import Client

    ages: list[float] = []

    class Handler:
        def datachange_notification(self, node: Any, val: Any, data: Any) -> None:
            source = data.monitored_item.Value.SourceTimestamp
            if source is not None:
                ages.append((datetime.now(UTC) - source.replace(tzinfo=UTC)).total_seconds() * 1e3)

    async with Client(url, timeout=60, watchdog_intervall=600) as client:
        subscription: Any = await client.create_subscription(50, Handler(), queue_maxsize=100_000)
        nodes = [
            client.get_node(f"ns=2;s={FIRST + number}.f{field}") for number in range(ROBOTS) for field in range(FIELDS)
        ]
        await subscription.subscribe_data_change(nodes, queuesize=1, sampling_interval=0)

        async def answer(line: str) -> str:
            found = sorted(ages)
            ages.clear()
            return str(found[len(found) * 99 // 100]) if found else "-1"

        print("ready", flush=True)
        await serve_lines(answer)


class Reading:
    """Reads the history of one node, and decodes nothing but where a page goes on."""

    def __init__(self, client: Any) -> None:
        self._client = client

    async def answer(self, line: str) -> str:
        """`raw`, `average`: seconds until the last byte. `others N`: of N Reads of one value the slowest, in ms."""
        what, _, number = line.partition(" ")
        began = time.perf_counter()
        if what == "raw":
            await self._all(ua.ReadRawModifiedDetails(False, BEGIN, BEGIN + timedelta(seconds=SECONDS), PAGE, False))
        elif what == "average":
            function = ua.NodeId(ua.ObjectIds.AggregateFunction_Average)
            said = ua.AggregateConfiguration(UseServerCapabilitiesDefaults=True)
            day = BEGIN + timedelta(seconds=SECONDS)
            await self._all(ua.ReadProcessedDetails(BEGIN, day, 1e3 * SECONDS / 96, [function], said))
        else:
            return str(await self._others(float(number)))
        return str(time.perf_counter() - began)

    async def _all(self, details: Any) -> None:
        point: bytes | None = None
        size = 0
        while True:
            request = ua.HistoryReadRequest()
            request.Parameters.HistoryReadDetails = details
            request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Source
            request.Parameters.ReleaseContinuationPoints = False
            node = ua.NodeId(READ_NODE, 2)
            request.Parameters.NodesToRead = [ua.HistoryReadValueId(node, ContinuationPoint=point)]
            answer = await self._client.uaclient.protocol.send_request(request, 60)
            data = answer.read(len(answer))
            status, point = _result(data)
            assert not status, hex(status)
            size += len(data)
            if point is None:
                break
        expected = SECONDS * 18 if isinstance(details, ua.ReadRawModifiedDetails) else 96 * 18
        assert expected <= size <= expected + 50_000, (size, data[:60].hex())

    async def _others(self, seconds: float) -> float:
        request: Any = ua.ReadRequest()
        request.Parameters.NodesToRead = [ua.ReadValueId(ua.NodeId(READ_NODE, 2), ua.AttributeIds.Value)]
        slowest, end = 0.0, time.perf_counter() + seconds
        while (began := time.perf_counter()) < end:
            await self._client.uaclient.protocol.send_request(request, 60)
            slowest = max(slowest, time.perf_counter() - began)
            await asyncio.sleep(0.005)
        return slowest * 1e3


def _result(data: bytes) -> tuple[int, bytes | None]:
    """StatusCode and continuation point of the only result. `data` is a HistoryReadResponse from its TypeId on."""
    at = 4 + 8 + 4 + 4 + 1 + 4 + 3
    count, status = (int.from_bytes(data[at + skip : at + skip + 4], "little") for skip in (0, 4))
    assert count == 1, count
    length = int.from_bytes(data[at + 8 : at + 12], "little", signed=True)
    return status, data[at + 12 : at + 12 + length] if length > 0 else None


async def reader(url: str, folder: Path) -> None:
    """A client that reads history over an encrypted connection."""
    from asyncua.client.client import Client

    from ua_fleet.endpoint.certificates import ensure_application_certificate

    files = ensure_application_certificate(folder, "urn:ua-fleet:client", ["127.0.0.1"])
    client: Any = Client(url, timeout=60, watchdog_intervall=600)
    client.application_uri = "urn:ua-fleet:client"
    await client.set_security_string(f"Basic256Sha256,SignAndEncrypt,{files.certificate},{files.private_key}")
    client.set_user(USER)
    client.set_password(PASSWORD)
    async with client:
        print("ready", flush=True)
        await serve_lines(Reading(client).answer)


def main() -> None:
    logging.disable(logging.WARNING)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    role, *arguments = sys.argv[1:]
    roles: dict[str, Callable[[], Any]] = {
        "server": lambda: server(Path(arguments[0])),
        "robots": lambda: robots(arguments[0]),
        "watcher": lambda: watcher(arguments[0]),
        "reader": lambda: reader(arguments[0], Path(arguments[1])),
    }
    asyncio.run(roles[role]())


if __name__ == "__main__":
    main()
