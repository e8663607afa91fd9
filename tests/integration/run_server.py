"""A fleet's server as a process of its own: `run_server.py FLEET_JSON`. Prints its URL, ends at SIGTERM."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import sys
from pathlib import Path

import structlog

from ua_fleet.config.load import load
from ua_fleet.server.app import run_server


async def main(path: Path) -> None:
    running = asyncio.ensure_future(run_server(load(path, {}), path.parent, ready=lambda url: print(url, flush=True)))
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await running


logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
asyncio.run(main(Path(sys.argv[1])))
