"""One bridge as a process of its own: `run_bridge.py FLEET_JSON BRIDGE`. Prints `ready`, ends at SIGTERM."""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
from functools import partial
from pathlib import Path

import structlog

from ua_fleet.bridge.registry import load_driver
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.cli.key_source import key_source_of
from ua_fleet.config.load import load
from ua_fleet.config.teleoperation import setpoint_heads
from ua_fleet.config.transports import open_transport
from ua_fleet.errors import UaFleetError


async def main(path: str, name: str) -> int:
    config = load(path, {}, allow_missing_ids=True)
    space = config.bridges[name].space
    transport = open_transport(
        config, Path(path).parent, space=space, hears_itself=False, urgent_heads=setpoint_heads(config, space)
    )
    state_dir = Path(path).parent / config.state_dir_of(name)

    async def bridged() -> None:
        async with key_source_of(config, name, Path(path).parent, state_dir) as keys:
            driver, ready = load_driver(config, name), partial(print, "ready", flush=True)
            await run_bridge(config, name, driver, transport, state_dir=state_dir, keys=keys, ready=ready)

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
sys.exit(asyncio.run(main(sys.argv[1], sys.argv[2])))
