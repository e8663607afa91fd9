"""The product's server with one node, telling how old values are when the node gets them.

    server_ours.py FLEET_JSON NODE_ID

stdout: `ready URL`; stdin: a line, answered with a JSON list of the ages in microseconds since it was last asked.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import structlog

from benchmarks.ros_nodes.ages import Ages, watch_node
from ua_fleet.config.load import load
from ua_fleet.endpoint import hardened_server as hardened
from ua_fleet.server import app


async def main(path: Path, node_id: str) -> None:
    create, ages = hardened.create_server, Ages()
    servers: list[Any] = []

    async def remember(*args: Any, **named: Any) -> Any:
        servers.append(await create(*args, **named))
        return servers[0]

    def ready(url: str) -> None:
        watch_node(servers[0], node_id, ages)
        print(f"ready {url}", flush=True)

    setattr(app, "create_server", remember)  # noqa: B010 - the only way to the server's address space
    running = asyncio.ensure_future(app.run_server(load(path, {}), path.parent, ready=ready))
    await ages.serve()
    running.cancel()
    await asyncio.wait([running])


structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
asyncio.run(main(Path(sys.argv[1]), sys.argv[2]))
