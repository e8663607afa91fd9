"""One bridge as a process of its own: `run_bridge.py FLEET_JSON BRIDGE`. Prints `ready`, ends at SIGTERM."""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import sys
from functools import partial
from pathlib import Path

import structlog
from ua_bridges.ros1.config import Ros1BridgeConfig
from ua_bridges.ros2.config import Ros2BridgeConfig

from ua_fleet.bridge.registry import load_driver
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.cli.key_source import key_source_of
from ua_fleet.config.schema import BridgeConfig, FleetConfig
from ua_fleet.errors import UaFleetError
from ua_fleet.transport.udp import UdpTransport

MODELS: dict[str, type[BridgeConfig]] = {"ros1": Ros1BridgeConfig, "ros2": Ros2BridgeConfig}


async def main(path: str, name: str) -> int:
    raw = json.loads(Path(path).read_text())
    raw["bridges"] = {key: MODELS[value["kind"]].model_validate(value) for key, value in raw["bridges"].items()}
    config = FleetConfig.model_validate(raw)
    pubsub = config.pubsub
    transport = UdpTransport(
        pubsub.url, pubsub.interface, ttl=pubsub.ttl, receive_buffer_bytes=pubsub.receive_buffer_bytes
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
