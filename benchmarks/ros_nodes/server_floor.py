# pyright: reportPrivateImportUsage=false
"""The least that a server can do: one double from a multicast group, written to one node of a stock asyncua server.

    server_floor.py URL GROUP PORT

stdin and stdout as `server_ours.py`.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import sys

from asyncua import Server, ua

from benchmarks.ros_nodes.ages import Ages, watch_node


async def main(url: str, group: str, port: int) -> None:
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    receiver.bind((group, port))
    membership = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    receiver.setblocking(False)
    server, ages = Server(), Ages()
    await server.init()
    server.set_endpoint(url)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    node = await server.nodes.objects.add_variable(ua.NodeId.from_string("ns=2;i=7"), "Level", 0.0)
    unpack, loop = struct.Struct("<d").unpack, asyncio.get_running_loop()

    async def carry() -> None:
        while True:
            await node.write_value(unpack(await loop.sock_recv(receiver, 2048))[0])

    async with server:
        watch_node(server, "ns=2;i=7", ages)
        running = asyncio.ensure_future(carry())
        print(f"ready {url}", flush=True)
        await ages.serve()
        running.cancel()
        await asyncio.wait([running])
    receiver.close()


asyncio.run(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
