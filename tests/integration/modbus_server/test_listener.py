"""The Modbus server against pymodbus's client: its functions, and its bounds."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymodbus import ModbusException
from pymodbus.client import AsyncModbusTcpClient

from tests.contract.harness import until
from ua_fleet.config.modbus_schema import ModbusServerConfig
from ua_fleet.errors import ServerStartError
from ua_fleet.modbus.image import Image
from ua_fleet.modbus.listener import Listener
from ua_fleet.registers import Register, RegisterType, Span, Table

WORDS = [Register(Table.HOLDING, address, RegisterType.UINT16) for address in range(4)]
COILS = [Register(Table.COIL, address, RegisterType.BOOL) for address in range(4)]
SHOWN = [Register(Table.INPUT, 2, RegisterType.UINT16), Register(Table.DISCRETE, 1, RegisterType.BOOL)]


class Device:
    def __init__(self, image: Image, listener: Listener, written: list[Span], port: int) -> None:
        self.image, self.listener, self.written, self.port = image, listener, written, port

    @asynccontextmanager
    async def client(self) -> AsyncGenerator[AsyncModbusTcpClient]:
        client = AsyncModbusTcpClient("127.0.0.1", port=self.port, timeout=0.5, retries=0, reconnect_delay=0)
        assert await client.connect()
        try:
            yield client
        finally:
            client.close()


@pytest.fixture
async def device(tcp_port: int) -> AsyncGenerator[Device]:
    config = ModbusServerConfig(port=tcp_port, writers=("127.0.0.0/8",), most_connections=2)
    image, written = Image(SHOWN, [*WORDS, *COILS]), list[Span]()
    async with Listener(image, config, written.append) as listener:
        yield Device(image, listener, written, tcp_port)


async def test_every_function_that_the_page_names(device: Device) -> None:
    device.image.put(SHOWN[0], 77)
    device.image.put(SHOWN[1], True)
    async with device.client() as client:
        assert (await client.read_input_registers(0, count=3)).registers == [0, 0, 77]
        assert (await client.read_discrete_inputs(0, count=2)).bits[:2] == [False, True]
        assert not (await client.write_register(0, 1)).isError()
        assert not (await client.write_registers(1, [2, 3])).isError()
        assert (await client.read_holding_registers(0, count=4)).registers == [1, 2, 3, 0]
        assert not (await client.write_coil(0, True)).isError()
        assert not (await client.write_coils(1, [False, True])).isError()
        assert (await client.read_coils(0, count=3)).bits[:3] == [True, False, True]
        assert not (await client.mask_write_register(address=1, and_mask=0xFFF0, or_mask=0x000C)).isError()
        both = await client.readwrite_registers(read_address=0, read_count=2, write_address=3, values=[9])
        assert both.registers == [1, 0x000C]
        assert (await client.read_holding_registers(3, count=1)).registers == [9]
    assert device.written[:2] == [Span(Table.HOLDING, 0, 1), Span(Table.HOLDING, 1, 2)]
    assert not device.listener.refused


async def test_what_is_refused_is_counted(device: Device) -> None:
    async with device.client() as client:
        assert (await client.read_holding_registers(0, count=5)).exception_code == 2
        assert (await client.write_registers(3, [1, 2])).exception_code == 2
        with pytest.raises(ModbusException):
            await client.read_holding_registers(0, count=1, device_id=7)
        assert (await client.read_holding_registers(0, count=1)).registers == [0]
    assert device.listener.refused["address"] == 2
    assert device.listener.refused["unit"] == 1
    assert device.image.cells(Span(Table.HOLDING, 0, 4)) == [0, 0, 0, 0]


async def test_connections_are_bounded_and_come_free_again(device: Device) -> None:
    async with device.client() as one, device.client() as two:
        for client in (one, two):
            assert (await client.read_holding_registers(0, count=1)).registers == [0]
        async with device.client() as third:
            await until(lambda: not third.connected, "the end of the third")
    assert device.listener.refused["connections"] == 1
    await asyncio.sleep(0.1)
    async with device.client() as again:
        assert (await again.read_holding_registers(0, count=1)).registers == [0]


@pytest.mark.parametrize(
    "rubbish",
    [
        b"\x00",
        b"\xff" * 300,
        b"\x00\x01\x00\x00\xff\xff\x01\x03",
        b"\x00\x01\x00\x00\x00\x02\x01\x63",
        b"GET / HTTP/1.1\r\n\r\n",
    ],
    ids=["short", "long", "a length that is never met", "unknown function", "http"],
)
async def test_rubbish_harms_nobody_else(device: Device, rubbish: bytes) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", device.port)
    writer.write(rubbish)
    await writer.drain()
    async with device.client() as client:
        assert (await client.read_holding_registers(0, count=1)).registers == [0]
    writer.close()
    await writer.wait_closed()
    assert reader is not None


async def test_request_in_pieces_is_one_request(device: Device) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", device.port)
    request = struct.pack(">HHHBBHH", 5, 0, 6, 1, 3, 0, 2)
    for begin in range(0, len(request), 3):
        writer.write(request[begin : begin + 3])
        await writer.drain()
        await asyncio.sleep(0.01)
    answer: Any = await asyncio.wait_for(reader.readexactly(13), 5)
    assert answer == struct.pack(">HHHBBBHH", 5, 0, 7, 1, 3, 4, 0, 0)
    writer.close()
    await writer.wait_closed()


async def test_port_in_use_is_said_with_what_to_do(device: Device) -> None:
    config = ModbusServerConfig(port=device.port)
    with pytest.raises(ServerStartError, match=r"choose another modbus\.port"):
        async with Listener(device.image, config, device.written.append):
            pass
