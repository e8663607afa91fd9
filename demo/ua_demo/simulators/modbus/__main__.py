"""A simulated PLC as a process.

    python -m ua_demo.simulators.modbus --port 5020 --program conveyor
    python -m ua_demo.simulators.modbus --tty /dev/pts/3 --parity none --unit 1 --unit 2

It prints `ready` when it listens, and `told: ...` for each work that its program begins. Each line on its input is a
command as JSON, and is answered with `{"done": true}`:

    {"do": "put", "table": "holding", "address": 7, "type": "float64", "values": [1.5, 2.0]}    side by side
    {"do": "cells", "table": "holding", "address": 7, "count": 2}            answers {"done": true, "cells": [..]}
    {"do": "listen"}  {"do": "hang up"}                                      be there, or not
    {"do": "run"}  {"do": "stop"}                                            the program
    {"do": "run", "having_read": 1}                the same; it had read that request before it stood still
    {"do": "clear"}                                                          all memory, as when the power was off

It ends with the end of its input, or with a signal; with --stay it does not look at its input.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import signal
import ssl
import sys
import time
from typing import Any, Final

from ua_demo.simulators.modbus.memory import Memory
from ua_demo.simulators.modbus.program import Conveyor, HandshakeLayout, HandshakeProgram, Task, Work
from ua_demo.simulators.modbus.server import PlcServer, make_server
from ua_fleet.registers import AddressSpan, Register, RegisterType, Table

CYCLE_S: Final = 0.01
BASE: Final = 100
"""Base address of the program's handshake."""
WORK_COMMAND, CONVEYOR_COMMAND = 0, 1


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


class Plc:
    """The process."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Make a PLC that does not listen."""
        self._options = options
        self._units = {unit: Memory(options.size) for unit in options.unit or [1]}
        self._memory = next(iter(self._units.values()))
        self._server: PlcServer | None = None
        self._runs = True
        self._program = self._make_program()
        self._read = asyncio.Event()
        self._memory.on_read = self._on_read
        self._memory.on_write = self._on_write
        self._awaited: AddressSpan | None = None

    def _make_program(self) -> HandshakeProgram:
        def told(what: str) -> None:
            _say(f"told: {what}")

        tasks: dict[int, Task] = {WORK_COMMAND: Work(BASE, told)}
        if self._options.program == "conveyor":
            tasks[CONVEYOR_COMMAND] = Conveyor(BASE, told)
        return HandshakeProgram(self._memory, HandshakeLayout(BASE), tasks)

    def _on_read(self, span: AddressSpan) -> None:
        if self._awaited is not None and self._awaited.overlaps(span):
            self._read.set()

    def _on_write(self, span: AddressSpan) -> None:
        if self._options.tell_writes:
            _say(json.dumps({"written": [span.table, span.address, self._memory.cells(span)]}))

    async def listen(self) -> None:
        """Be there."""
        if self._server is not None:
            return
        tls = None
        if self._options.certificate is not None:
            tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            tls.load_cert_chain(self._options.certificate, self._options.key)
        options = self._options
        self._server = make_server(
            self._units, host=options.host, port=options.port, tls=tls, tty=options.tty, parity=options.parity
        )
        await self._server.serve_forever(background=True)

    async def hang_up(self) -> None:
        """Be gone, as when a cable is pulled at this end."""
        if self._server is not None:
            await self._server.shutdown()
            self._server = None

    async def run_program(self) -> None:
        """The cyclic task."""
        while True:
            if self._runs:
                self._program.cycle(time.monotonic())
            await asyncio.sleep(CYCLE_S)

    def _begin(self, number: int) -> None:
        """Have the program begin a request that was taken back, before anybody can take it back again."""
        self._memory.put(HandshakeLayout(BASE).request, number)
        self._program.cycle(time.monotonic())

    async def obey(self, line: str) -> None:
        """Do a command, and answer."""
        command: dict[str, Any] = json.loads(line)
        answer: dict[str, Any] = {"done": True}
        match command["do"]:
            case "put":
                await self._put(command)
            case "cells":
                span = AddressSpan(Table(command["table"]), command["address"], command["count"])
                answer["cells"] = self._units[command.get("unit", next(iter(self._units)))].cells(span)
            case "listen":
                await self.listen()
            case "hang up":
                await self.hang_up()
            case "run" | "stop" as do:
                self._runs = do == "run"
                if number := command.get("having_read"):
                    self._begin(number)
            case "clear":
                for table in Table:
                    empty = AddressSpan(table, 0, self._memory.size)
                    self._memory.put_cells(empty, [False if table.is_bits else 0] * self._memory.size)
                self._program = self._make_program()
            case unknown:
                answer = {"error": f"unknown command {unknown}"}
        _say(json.dumps(answer))

    async def _put(self, command: dict[str, Any]) -> None:
        kind, address = RegisterType(command.get("type", "bool")), int(command["address"])
        memory = self._units[command.get("unit", next(iter(self._units)))]
        last: AddressSpan | None = None
        for value in command["values"]:
            register = Register(Table(command["table"]), address, kind, command.get("bit"), command.get("length", 0))
            memory.put(register, value)
            last, address = register.span, register.span.end
        if command.get("until_read_s"):
            self._awaited = last
            self._read.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._read.wait(), command["until_read_s"])
            self._awaited = None


async def _serve(options: argparse.Namespace) -> None:
    plc, loop = Plc(options), asyncio.get_running_loop()
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    if not options.absent:
        await plc.listen()
    tasks = [asyncio.create_task(plc.run_program())]

    async def obey_all() -> None:
        lines = asyncio.StreamReader()
        transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
        with contextlib.closing(transport):
            while line := await lines.readline():
                await plc.obey(line.decode())
        ended.set()

    if not options.stay:
        tasks.append(asyncio.create_task(obey_all()))
    _say("ready")
    _say(json.dumps({"done": True}))
    await ended.wait()
    for task in tasks:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
    await plc.hang_up()


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(prog="python -m ua_demo.simulators.modbus", description="A simulated PLC.")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on")
    parser.add_argument("--port", type=int, default=502, help="TCP port")
    parser.add_argument("--tty", help="a serial line instead of TCP")
    parser.add_argument("--parity", choices=("none", "even", "odd"), default="even", help="of the serial line")
    parser.add_argument("--unit", type=int, action="append", help="a unit identifier; may be repeated")
    parser.add_argument("--size", type=int, default=10_000, help="addresses of each table")
    parser.add_argument("--certificate", help="file for TLS")
    parser.add_argument("--key", help="file for TLS")
    parser.add_argument("--program", choices=("work", "conveyor"), default="work", help="what its program can do")
    parser.add_argument("--absent", action="store_true", help="do not listen until told to")
    parser.add_argument("--tell-writes", action="store_true", help="print what is written")
    parser.add_argument("--stay", action="store_true", help="take no commands, and end with a signal alone")
    asyncio.run(_serve(parser.parse_args()))


if __name__ == "__main__":
    main()
