"""The server as a process that may be killed: `server_process.py FLEET_JSON`. Prints its URL."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import sys
from pathlib import Path

import structlog

from ua_fleet.config.schema import FleetConfig
from ua_fleet.server.app import run_server


async def main(path: Path) -> None:
    config = FleetConfig.model_validate_json(path.read_text())
    running = asyncio.ensure_future(run_server(config, path.parent, ready=lambda url: print(url, flush=True)))
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await running


logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
asyncio.run(main(Path(sys.argv[1])))
