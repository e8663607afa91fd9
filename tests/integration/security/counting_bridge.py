"""A bridge as a process of its own whose space is this process: `counting_bridge.py FLEET_JSON BRIDGE`.

Its source says 0, 1, 2, ... and goes on, after a restart, where the time has brought it; each value that other spaces
say is printed as `heard <topic> <value>`. Keys come from where the fleet says. Prints `ready`; ends at SIGTERM.
"""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import sys
import time
from functools import partial
from pathlib import Path

import structlog

from tests.integration.security.fleets import fleet_of
from ua_fleet.bridge import Driver, DriverStatus, Inlet, SampleRead, SourceFound, run_bridge
from ua_fleet.cli.key_source import key_source_of
from ua_fleet.config.transports import open_transports
from ua_fleet.errors import UaFleetError
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

FIELDS = (make_field("data", BuiltinType.INT64, properties={"RosType": "std_msgs/Int64"}),)
PERIOD_S = 0.01
FIRST_SPACE = 300
"""The source of this space has the id 1, that of the next one 2, and so on."""


class CountingDriver(Driver):
    """A space with one source."""

    def __init__(self, space: int) -> None:
        self._topic = Topic(space, 2, space - FIRST_SPACE + 1)
        self._counting: asyncio.Task[None] | None = None

    async def start(self, inlet: Inlet) -> None:
        inlet.put(SourceFound(self._topic, "counter", FIELDS))
        self._counting = asyncio.ensure_future(self._count(inlet))

    async def _count(self, inlet: Inlet) -> None:
        number = round(time.time() / PERIOD_S)
        while True:
            inlet.put(SampleRead(self._topic, (number,), time.time_ns()))
            number += 1
            await asyncio.sleep(number * PERIOD_S - time.time())

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        del metadata
        print(f"heard {topic.name} {message.values[0]}", flush=True)
        return True

    def status(self) -> DriverStatus:
        return DriverStatus(True, "counting")

    async def stop(self) -> None:
        if self._counting is not None:
            self._counting.cancel()
            await asyncio.wait([self._counting])
            self._counting = None


async def main(path: Path, name: str) -> int:
    config = fleet_of(json.loads(path.read_text()))
    transports = open_transports(config, path.parent, space=config.bridges[name].space)
    state_dir = path.parent / config.state_dir_of(name)

    async def bridged() -> None:
        async with key_source_of(config, name, path.parent, state_dir) as keys:
            driver = CountingDriver(config.bridges[name].space)
            ready = partial(print, "ready", flush=True)
            await run_bridge(config, name, driver, transports, state_dir=state_dir, keys=keys, ready=ready)

    running = asyncio.ensure_future(bridged())
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
    try:
        await running
    except asyncio.CancelledError:
        print("stopped", flush=True)
        return 0
    except UaFleetError as error:
        print(f"failed: {error}", flush=True)
    return 1


logging.basicConfig(stream=sys.stderr, level=logging.INFO)
structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
sys.exit(asyncio.run(main(Path(sys.argv[1]), sys.argv[2])))
