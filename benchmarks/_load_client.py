# pyright: reportPrivateUsage=false
"""The requestor of the benchmark `ros_load`: `python -m benchmarks._load_client FLEET SPACE SKILL STATUS`.

It answers a line `N PAUSE_S` on its standard input with `[[accepted, ended], ...]`, in milliseconds from each of N
requests. It reads no values but SkillStatus: a server's time for images is not what is measured.
"""

from __future__ import annotations

import asyncio
import json
import secrets
import sys
import tempfile
import time
from pathlib import Path

from benchmarks._actions import quiet_logs
from tests.integration.actions.requesting import requesting
from ua_fleet.config.load import load
from ua_fleet.pubsub.events import DataReceived, SubscriberEvent
from ua_fleet.skill.executions import OPEN, ExecutionState
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.topics import Topic
from ua_fleet.transport.base import Address

MOST_BYTES = 2000
"""Of a datagram that is looked at: an Action, an announcement, or a SkillStatus."""
TIMEOUT_S = 60.0


async def client(fleet: str, space: int, skill: int, status: int) -> None:
    config = load(fleet, {}, allow_missing_ids=True)
    with tempfile.TemporaryDirectory() as folder:
        async with requesting(config, Path(folder), journal=MemoryJournal()) as requestor:
            receive, take = requestor.receive, requestor._take
            ends: dict[bytes, float] = {}
            ended = asyncio.Event()

            def receive_small(datagram: bytes, sender: Address) -> None:
                if len(datagram) <= MOST_BYTES:
                    receive(datagram, sender)

            def note(events: list[SubscriberEvent]) -> None:
                for event in events:
                    if isinstance(event, DataReceived) and event.topic == Topic(space, 2, status):
                        ids, _, states, *_ = event.message.values
                        for execution_id, state in zip(ids, states, strict=True):
                            if ExecutionState(state) not in OPEN:
                                ends.setdefault(execution_id, time.perf_counter())
                                ended.set()
                take(events)

            requestor.receive = receive_small  # type: ignore[method-assign]  # large ones would take its time
            requestor._take = note  # type: ignore[method-assign]
            await requestor.invoke(Topic(space, 2, skill), (0.5,), TIMEOUT_S)
            print("ready", flush=True)
            reader = asyncio.StreamReader()
            await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
            while line := (await reader.readline()).decode().split():
                times: list[tuple[float, float]] = []
                for _ in range(int(line[0])):
                    await asyncio.sleep(float(line[1]))
                    execution_id, began = secrets.token_bytes(16), time.perf_counter()
                    outcome = await requestor.invoke(Topic(space, 2, skill), (0.5,), TIMEOUT_S, execution_id)
                    accepted = time.perf_counter()
                    assert outcome.kind == "accepted", outcome
                    async with asyncio.timeout(TIMEOUT_S):
                        while execution_id not in ends:
                            ended.clear()
                            await ended.wait()
                    times.append((round((accepted - began) * 1e3, 3), round((ends[execution_id] - began) * 1e3, 3)))
                print(json.dumps(times), flush=True)


if __name__ == "__main__":
    quiet_logs()
    asyncio.run(client(sys.argv[1], *map(int, sys.argv[2:])))
