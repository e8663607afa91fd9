"""The PLCs of `modbus.py`, a process of their own: `python -m benchmarks._modbus PORT`.

One server on all of 127.0.0.0/8, so that each address is a device with a connection of its own. After each reading of
holding registers every word that was read has another value, so that nothing can be saved by silence.
"""

from __future__ import annotations

import asyncio
import sys

from ua_demo.simulators.modbus import Memory, make_server

from ua_fleet.registers import AddressSpan, Table


async def serve(port: int) -> None:
    memory = Memory(10_000)

    def change(span: AddressSpan) -> None:
        if span.table is Table.HOLDING:
            memory.put_cells(span, [(int(cell) + 1) & 0xFFFF for cell in memory.cells(span)])

    memory.on_read = change
    await make_server({1: memory}, host="0.0.0.0", port=port).serve_forever(background=True)
    print("ready", flush=True)
    await asyncio.to_thread(sys.stdin.read)


if __name__ == "__main__":
    asyncio.run(serve(int(sys.argv[1])))
