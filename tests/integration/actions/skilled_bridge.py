"""A bridge to a machine with a skill, as a process: `skilled_bridge.py FLEET_JSON BRIDGE MACHINE_FOLDER`.

Prints `ready`, ends at SIGTERM.
"""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import sys
from pathlib import Path

import structlog

from tests.contract.skilled import Machine, SkilledDriver
from tests.contract.virtual import Bus
from tests.integration.security.fleets import fleet_of
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.config.security import file_keys_of
from ua_fleet.config.transports import open_transports
from ua_fleet.errors import UaFleetError


async def main(path: Path, name: str, machine: Path) -> int:
    config = fleet_of(json.loads(path.read_text()))
    space = config.bridges[name].space
    bus = Bus()
    bus.is_up = True
    running = asyncio.ensure_future(
        run_bridge(
            config,
            name,
            SkilledDriver(space, bus, Machine(machine)),
            open_transports(config, path.parent, space=space),
            state_dir=path.parent / config.state_dir_of(name),
            keys=file_keys_of(config, space, path.parent) if config.pubsub.is_secured else None,
            ready=lambda: print("ready", flush=True),
        )
    )
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
    try:
        await running
    except asyncio.CancelledError:
        return 0
    except UaFleetError as error:
        print(f"failed: {error}", flush=True)
    return 1


logging.basicConfig(stream=sys.stderr, level=logging.INFO)
structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
sys.exit(asyncio.run(main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))))
