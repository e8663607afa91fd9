"""Who hears values over MQTT, in a process of its own: our server, or the bare client library.

    python -m benchmarks._mqtt_subject ours FLEET_JSON | bare URL

Prints `ready`. Each line on the standard input is answered with what was heard since the last one, as JSON; `numbers`
with the values themselves since they were asked for last, and how often one was kept with another status.
"""

from __future__ import annotations

import asyncio
import json
import resource
import struct
import sys
import time
from array import array
from pathlib import Path
from typing import Any

import structlog

QUEUE = "+"
"""The filter of a bare client: that of the queues of data in `TopicTree`."""


class Heard:
    """What was heard since it was asked last."""

    def __init__(self) -> None:
        self.holds = 0
        """How often a value waited for its turn to be written."""
        self._numbers, self._statuses = array("d"), 0
        self._clear()

    def _clear(self) -> None:
        self._cpu_s = time.process_time()
        self._count, self._disordered, self._last_at = 0, 0, 0.0
        self._ages: list[float] = []
        self._last: dict[Any, float] = {}

    def value(self, key: Any, value: float) -> None:
        """A source has a value: how many there were before it, or the monotonic clock when it was sent."""
        self._last_at = time.monotonic()
        self._count += 1
        self._numbers.append(value)
        if self._last.get(key, -1.0) >= value:
            self._disordered += 1
        self._last[key] = value
        if len(self._ages) < 10_000:
            self._ages.append(self._last_at - value)

    def status(self) -> None:
        """A source keeps its value, with a status that is not Good."""
        self._statuses += 1

    def message(self) -> None:
        """A message has come, whatever is in it."""
        self._last_at = time.monotonic()
        self._count += 1

    def take(self) -> str:
        """Tell it, and begin again."""
        told = {
            "count": self._count,
            "disordered": self._disordered,
            "last_at": self._last_at,
            "cpu_s": time.process_time() - self._cpu_s,
            "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            "ages": self._ages,
        }
        self._clear()
        return json.dumps(told)

    async def serve(self) -> None:
        """Answer each line, until there are no more."""
        while line := (await asyncio.to_thread(sys.stdin.readline)).strip():
            if line == "look":
                print(json.dumps({"count": self._count}), flush=True)
            elif line == "numbers":
                print(json.dumps([self._numbers.tolist(), self._statuses]), flush=True)
                self._numbers, self._statuses = array("d"), 0
            else:
                print(self.take(), flush=True)


async def ours(path: Path, content: str) -> None:
    """The product's server; a value counts once it was written to its node."""
    from ua_fleet.cli.process import collection_paused
    from ua_fleet.config.schema import FleetConfig
    from ua_fleet.fleet.changes import ValueChanged
    from ua_fleet.nodes.projection import Projection
    from ua_fleet.server import app

    heard, write, hold = Heard(), Projection.write, Projection._hold  # pyright: ignore[reportPrivateUsage]

    def noted(projection: Projection, change: Any, *, ahead: bool = False) -> None:
        holds = heard.holds
        write(projection, change, ahead=ahead)
        if type(change.value) is not float or heard.holds != holds:  # one that waits comes here again in its turn
            return
        if change.status:
            heard.status()
        else:
            heard.value(change.key, change.value)

    def held(projection: Projection, change: ValueChanged) -> None:
        hold(projection, change)
        heard.holds += 1

    # A monitored item of each node would cost more than the write.
    setattr(Projection, "write", noted)  # noqa: B010
    setattr(Projection, "_hold", held)  # noqa: B010
    config = FleetConfig.model_validate_json(content)
    with collection_paused() as settled:

        def ready(_url: str) -> None:
            settled()
            print("ready", flush=True)

        running = asyncio.ensure_future(app.run_server(config, path.parent, ready=ready))
        await heard.serve()
    running.cancel()
    await asyncio.wait([running])


async def bare(url: str) -> None:
    """The library of `transport.mqtt` alone: what comes is acknowledged and counted."""
    import mqttium
    from mqttium.api import AsyncClient

    from ua_fleet.transport.mqtt.address import parse_broker_url

    address, heard = parse_broker_url(url), Heard()
    client = AsyncClient("bare", protocol=mqttium.MQTTProtocolVersion.MQTTv5, message_delivery="callback")

    def on_message(message: Any) -> None:
        if len(message.payload) == 8:
            heard.value(message.topic, struct.unpack("<d", message.payload)[0])
        else:
            heard.message()

    client.on_message = on_message
    await client.connect(address.host, address.port)
    await client.subscribe(QUEUE, qos=1)
    print("ready", flush=True)
    await heard.serve()
    await client.disconnect()


def main() -> None:
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    role, argument = sys.argv[1:]
    asyncio.run(bare(argument) if role == "bare" else ours(Path(argument), Path(argument).read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
