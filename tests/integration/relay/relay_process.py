"""A relay as a process of its own: `relay_process.py FLEET_JSON RELAY`.

Prints `ready`, and at SIGTERM, as its last line, what it has done (`run_relay` logs that).
"""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from functools import partial
from pathlib import Path

import structlog

from tests.integration.security.fleets import fleet_of
from ua_fleet.cli.key_source import relay_key_source_of
from ua_fleet.config.transports import relay_transports
from ua_fleet.errors import UaFleetError
from ua_fleet.relay import run_relay


async def main(path: Path, name: str) -> int:
    config = fleet_of(json.loads(path.read_text()))
    transports = relay_transports(config, path.parent, name)
    state_dir = path.parent / config.state_dir_of(name)

    async def relayed() -> None:
        async with relay_key_source_of(config, name, path.parent, state_dir) as keys:
            ready = partial(print, "ready", flush=True)
            await run_relay(config, name, transports, state_dir=state_dir, keys=keys, ready=ready)

    running = asyncio.ensure_future(relayed())
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
    try:
        await running
    except asyncio.CancelledError:
        return 0
    except UaFleetError as error:
        print(f"failed: {error}", flush=True)
    return 1


structlog.configure(
    processors=[structlog.processors.JSONRenderer()], logger_factory=structlog.PrintLoggerFactory(sys.stdout)
)
sys.exit(asyncio.run(main(Path(sys.argv[1]), sys.argv[2])))
