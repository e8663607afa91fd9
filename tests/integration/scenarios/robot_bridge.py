"""A bridge to one machine of a fleet, as a process: `robot_bridge.py FLEET_JSON ROBOT MACHINE_FOLDER`.

Prints `ready`, ends at SIGTERM.
"""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
from functools import partial
from pathlib import Path

import structlog

from tests.contract.skilled import Machine
from tests.contract.virtual import Bus
from tests.integration.scenarios.machines import RobotDriver, tell_values
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.carrier import carrier_of
from ua_fleet.cli.key_source import key_source_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.transports import open_transport


async def main(path: Path, robot: str, machine: Path) -> int:
    config = FleetConfig.model_validate_json(path.read_text())
    name = config.robots[robot].bridge
    bus = Bus()
    bus.is_up = True
    state_dir = path.parent / config.state_dir_of(name)

    async def bridged() -> None:
        async with key_source_of(config, name, path.parent, state_dir) as keys:
            controller = Machine(machine)
            driver = RobotDriver(config, robot, bus, controller)
            space = config.bridges[name].space
            transport = open_transport(config, path.parent, space=space)
            ready = partial(print, "ready", flush=True)
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(tell_values(config, robot, bus, controller))
                await run_bridge(
                    config,
                    name,
                    driver,
                    transport,
                    state_dir=state_dir,
                    keys=keys,
                    ready=ready,
                    carry=carrier_of(config, name, state_dir),
                )

    running = asyncio.ensure_future(bridged())
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
    try:
        await running
    except asyncio.CancelledError:
        return 0
    return 1


logging.basicConfig(stream=sys.stderr, level=logging.INFO)
structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
sys.exit(asyncio.run(main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))))
