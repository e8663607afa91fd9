"""A stock asyncua server with so many variables; prints a line when it serves: `_start_floor.py ROBOTS NODES`."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import asyncio
import gc
import sys

from asyncua.server.server import Server


async def main(robots: int, nodes: int) -> None:
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0/floor")
    group = server.nodes.objects
    for robot in range(robots):
        if robot % 100 == 0:
            group = await server.nodes.objects.add_folder(2, f"G{robot // 100:02d}")
        node = await group.add_object(2, f"R{robot:04d}")
        for index in range(nodes):
            await node.add_variable(2, f"value{index}", 0.0)
    async with server:
        print("ready", flush=True)
        await asyncio.Event().wait()


gc.disable()  # as `ua-fleet serve` does while it starts
asyncio.run(main(int(sys.argv[1]), int(sys.argv[2])))
