"""A bridge of ROS 1 in another space than 1: `load_bridge.py FLEET_JSON BRIDGE SPACE`.

ROS 1 is one space, so there are no two bridges of it between which data could be carried. The load benchmark measures
both ends in one version of ROS; the space is changed behind the configuration's back.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from functools import partial
from pathlib import Path

from ua_fleet.bridge.registry import load_driver
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.config.load import load
from ua_fleet.transport.udp import UdpTransport


async def main(path: str, name: str, space: int) -> None:
    config = load(path, {}, allow_missing_ids=True)
    moved = config.bridges[name].model_copy(update={"space": space})
    config = config.model_copy(update={"bridges": {**config.bridges, name: moved}})
    pubsub = config.pubsub
    buffer_bytes = pubsub.receive_buffer_bytes
    transport = UdpTransport(pubsub.url, pubsub.interface, receive_buffer_bytes=buffer_bytes, hears_itself=False)
    running = asyncio.ensure_future(
        run_bridge(
            config,
            name,
            load_driver(config, name),
            transport,
            state_dir=Path(path).parent / name,
            ready=partial(print, "ready", flush=True),
        )
    )
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
    try:
        await running
    except asyncio.CancelledError:
        return


asyncio.run(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
