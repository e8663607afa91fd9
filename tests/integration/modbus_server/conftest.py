"""A plant whose fleet is a Modbus device too, and mbpoll, which knows nothing of it."""

from __future__ import annotations

import asyncio
import re
import subprocess
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import pytest

from tests.contract.skilled import Machine
from tests.integration.scenarios.conftest import Plant
from tests.integration.server_model.harness import OPERATOR, Running
from tests.system import Processes, free_tcp_port
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.config.modbus_schema import ModbusServerConfig
from ua_fleet.config.schema import FleetConfig
from ua_fleet.modbus.gateway import Gateway
from ua_fleet.modbus.listener import ModbusListener
from ua_fleet.modbus.memory import CommandMemory
from ua_fleet.modbus.words import STATUS, CommandState

WORK, SHIFT = 1, 2
TEXT_AT: Final = 20
SECONDS_AT: Final = 40
TABLES: Final = {"coil": "0", "discrete": "1", "input": "3", "holding": "4"}
WORDS: Final = {word.name: word.offset for word in STATUS}


def modbus(**more: Any) -> dict[str, Any]:
    """The section of the configuration."""
    return {
        "writers": ["127.0.0.1"],
        "robots": ["left", "middle", "right"],
        "quality": 0,
        "values": {"left.go_on": {"table": "input", "address": 100, "type": "int32"}},
        "sets": {"left.go_on": {"table": "holding", "address": 60, "type": "int32"}},
        "commands": {
            "work": {
                "code": WORK,
                "robot": "left",
                "skill": "work",
                "arguments": {
                    "work": {"table": "holding", "address": TEXT_AT, "length": 8},
                    "seconds": {"table": "holding", "address": SECONDS_AT, "type": "uint16", "scale": 0.1},
                },
                "results": {
                    "done": {"table": "input", "address": 110, "length": 8},
                    "seconds": {"table": "input", "address": 118, "type": "float32"},
                },
            },
            "shift": {"code": SHIFT, "scenario": "shift"},
        },
        **more,
    }


class Panel:
    """A PLC: mbpoll, one process for each request."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._number = 0

    async def read(self, table: str, address: int, count: int = 1) -> list[int]:
        """Words or bits; raises AssertionError where they are refused."""
        run = await self._run("-c", str(count), "-t", TABLES[table], "-r", str(address), "127.0.0.1")
        assert run.returncode == 0, run.stdout + run.stderr
        found = re.findall(r"^\[(\d+)\]:\s+(-?\d+)", run.stdout, re.MULTILINE)
        assert [int(at) for at, _ in found] == list(range(address, address + count)), run.stdout
        return [int(value) & 0xFFFF for _, value in found]

    async def write(self, address: int, *values: int, table: str = "holding") -> bool:
        """Whether it was taken."""
        texts = [str(value) for value in values]
        run = await self._run("-t", TABLES[table], "-r", str(address), "127.0.0.1", *texts)
        return run.returncode == 0

    async def word(self, name: str) -> int:
        """One of the status words."""
        return (await self.read("input", WORDS[name]))[0]

    async def command(self, code: int, number: int | None = None) -> int:
        """Command something, as a PLC does: the number last. The number."""
        self._number = number if number is not None else self._number + 1
        assert await self.write(1, code)
        assert await self.write(0, self._number)
        return self._number

    async def ask_for_work(self, text: str, tenths: int) -> int:
        """Have `left` work."""
        content = text.encode().ljust(16, b"\0")
        assert await self.write(TEXT_AT, *(int.from_bytes(content[at : at + 2], "big") for at in range(0, 16, 2)))
        assert await self.write(SECONDS_AT, tenths)
        return await self.command(WORK)

    async def ended(self, number: int, timeout_s: float = 60) -> CommandState:
        """Wait for the end of a command."""
        state = await self.until(
            lambda words: words[0] == number and CommandState(words[1]).is_over, "answer", 2, timeout_s
        )
        return CommandState(state[1])

    async def until(
        self, condition: Callable[[list[int]], bool], name: str, count: int = 1, timeout_s: float = 60
    ) -> list[int]:
        """Read status words until they are as wanted."""
        async with asyncio.timeout(timeout_s):
            while not condition(words := await self.read("input", WORDS[name], count)):
                await asyncio.sleep(0.05)
        return words

    async def _run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        command = ["mbpoll", "-m", "tcp", "-p", str(self._port), "-a", "1", "-0", "-1", "-q", "-o", "10", *arguments]
        return await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, check=False)


class ModbusPlant(Plant):
    """A plant with the section `modbus`."""

    def __init__(self, folder: Path, url: str, port: int, processes: Processes, mode: str) -> None:
        super().__init__(folder, url, port, processes, mode)
        self.port = free_tcp_port()

    def fleet(self, **more: Any) -> FleetConfig:
        """The configuration of the Modbus device."""
        section = ModbusServerConfig.model_validate(modbus(port=self.port, **more))
        return self.config.model_copy(update={"modbus": section})

    @asynccontextmanager
    async def device(self, running: Running, **more: Any) -> AsyncGenerator[Panel]:
        """The Modbus device while the context lasts."""
        fleet = self.fleet(**more)
        assert fleet.modbus is not None
        memory = CommandMemory(self.folder / "commands.db")

        def connect() -> Any:
            identity = ClientIdentity(self.folder / "plc_identity")
            return FleetClient.connect(running.url, user=OPERATOR[0], password=OPERATOR[1], identity=identity)

        gateway = Gateway(fleet, memory)
        try:
            async with ModbusListener(gateway.image, fleet.modbus, gateway.written):
                work = asyncio.create_task(gateway.run(connect))
                panel = Panel(self.port)
                try:
                    yield panel
                finally:
                    work.cancel()
                    await asyncio.gather(work, return_exceptions=True)
        finally:
            memory.close()

    def left(self) -> Machine:
        """The machine that the PLC commands."""
        return self.machines["left"]


@pytest.fixture
def plant(
    request: pytest.FixtureRequest, tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes
) -> ModbusPlant:
    """A fleet; an operator decides."""
    return ModbusPlant(tmp_path, udp_url, tcp_port, processes, getattr(request, "param", "operator"))
