"""A Modbus driver on its own, with a recorder in place of the bridge, and a device whose answers a test decides."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from ua_bridges.modbus.driver import ModbusDriver, create_driver

from tests.contract.harness import Recorder
from ua_fleet.bridge import SampleRead
from ua_fleet.config.load import load_content
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, Variant, status_name

Start = Callable[..., Awaitable["Bench"]]


class Bench:
    """A started driver and what it tells."""

    def __init__(self, driver: ModbusDriver, recorder: Recorder) -> None:
        self.driver, self.recorder = driver, recorder

    def values(self, id: int) -> tuple[Any, ...] | None:
        """The last values of a source; a Bad field is the name of its status."""
        samples = self.recorder.samples(Topic(300, 2, id))
        return None if not samples else tuple([shown(value) for value in samples[-1].values])

    def all_values(self, id: int) -> list[tuple[Any, ...]]:
        """All of them."""
        events = self.recorder.of(Topic(300, 2, id))
        return [tuple([shown(value) for value in event.values]) for event in events if isinstance(event, SampleRead)]


def shown(value: Any) -> Any:
    """A value, or the name of the status of a Bad field."""
    return status_name(value.value) if isinstance(value, Variant) and value.type == BuiltinType.STATUS_CODE else value


@pytest.fixture
async def start(tmp_path: Path) -> AsyncIterator[Start]:
    """Starts a driver: `await start(devices, data, **bridge)`; its robot is named `machine`."""
    benches: list[Bench] = []

    async def begin(devices: dict[str, Any], data: dict[str, Any], **more: Any) -> Bench:
        fleet = {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {
                "plc": {"kind": "modbus", "space": 300, "status_id": 1, "poll_s": 0.02, "devices": devices, **more}
            },
            "robots": {"machine": {"bridge": "plc", "data": data}},
        }
        driver, recorder = (
            create_driver(load_content(yaml.safe_dump(fleet, sort_keys=False).encode(), "F", {}), "plc"),
            Recorder(),
        )
        driver.remember_in(tmp_path)
        await driver.start(recorder)
        benches.append(Bench(driver, recorder))
        return benches[-1]

    yield begin
    for bench in benches:
        await bench.driver.stop()


Behave = Callable[[bytes, int, int], bytes | None]
"""Makes the answer's PDU from the request's, its address and its count; None says nothing."""


def words(pdu: bytes, address: int, count: int) -> bytes:
    """The right answer: each word is its address."""
    return struct.pack(f">BB{count}H", pdu[0], 2 * count, *range(address, address + count))


class Device:
    """A Modbus/TCP server whose answers a test decides; framed by hand."""

    def __init__(self) -> None:
        self.behave: Behave = words
        self.requests: list[tuple[int, int, int]] = []
        self.server: asyncio.Server | None = None
        self.raw: Callable[[bytes], list[bytes]] = lambda answer: [answer]
        """What is sent in place of a whole answer, piece by piece."""
        self._writers: set[asyncio.StreamWriter] = set()
        self.port = 0

    async def listen(self) -> None:
        self.server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = int(self.server.sockets[0].getsockname()[1])

    async def hang_up(self) -> None:
        assert self.server is not None
        self.server.close()
        for writer in list(self._writers):
            writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        try:
            while True:
                header = await reader.readexactly(7)
                number, _, length, unit = struct.unpack(">HHHB", header)
                pdu = await reader.readexactly(length - 1)
                function, address, count = struct.unpack(">BHH", pdu[:5])
                self.requests.append((function, address, count))
                answer = self.behave(pdu, address, count)
                if answer is None:
                    continue
                for piece in self.raw(struct.pack(">HHHB", number, 0, len(answer) + 1, unit) + answer):
                    writer.write(piece)
                    await asyncio.sleep(0.005)
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            self._writers.discard(writer)
            writer.close()


@pytest.fixture
async def device() -> AsyncIterator[Device]:
    made = Device()
    await made.listen()
    yield made
    await made.hang_up()


def of(device: Device, **more: Any) -> dict[str, Any]:
    options = {"timeout_s": 0.15, "retries": 0, "retry_s": [0.05, 0.1], "most_gap": 0}
    return {"host": "127.0.0.1", "port": device.port, **options, **more}


def holding(device: str, number: int, address: int = 1) -> dict[str, Any]:
    """A register of a device as data."""
    at = {"table": "holding", "address": address}
    return {"id": number, "type": "UInt16", "source": {"device": device, "at": at}}


def silent_at(*addresses: int) -> Behave:
    return lambda pdu, address, count: None if address in addresses else words(pdu, address, count)
