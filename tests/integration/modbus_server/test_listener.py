"""The Modbus server against pymodbus's client: its functions, and its bounds."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pymodbus import ModbusException
from pymodbus.client import AsyncModbusTcpClient

from tests.waiting import until
from ua_fleet.config.modbus_schema import ModbusServerConfig
from ua_fleet.errors import ServerStartError
from ua_fleet.modbus import listener
from ua_fleet.modbus.image import Image
from ua_fleet.modbus.listener import ModbusListener
from ua_fleet.registers import AddressSpan, Cell, Register, RegisterType, Table

WORDS = [Register(Table.HOLDING, address, RegisterType.UINT16) for address in range(4)]
COILS = [Register(Table.COIL, address, RegisterType.BOOL) for address in range(4)]
SHOWN = [Register(Table.INPUT, 2, RegisterType.UINT16), Register(Table.DISCRETE, 1, RegisterType.BOOL)]


class Device:
    def __init__(self, image: Image, listener: ModbusListener, written: list[AddressSpan], port: int) -> None:
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
    config = ModbusServerConfig(port=tcp_port, writers=("127.0.0.0/16",), most_connections=2)
    image, written = Image(SHOWN, [*WORDS, *COILS]), list[AddressSpan]()
    async with ModbusListener(image, config, written.append) as listener:
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
    assert device.written[:2] == [AddressSpan(Table.HOLDING, 0, 1), AddressSpan(Table.HOLDING, 1, 2)]
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
    assert device.image.cells(AddressSpan(Table.HOLDING, 0, 4)) == [0, 0, 0, 0]


async def test_connections_are_bounded_and_come_free_again(device: Device) -> None:
    async with device.client() as one, device.client() as two:
        for client in (one, two):
            assert (await client.read_holding_registers(0, count=1)).registers == [0]
        async with device.client() as third:
            await until(lambda: not third.connected, "the end of the third")
        assert (one.connected, two.connected) == (True, True)
    assert device.listener.refused["connections"] == 1
    await asyncio.sleep(0.1)
    async with device.client() as again:
        assert (await again.read_holding_registers(0, count=1)).registers == [0]


async def test_connections_on_which_nothing_comes_keep_nobody_out(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "IDLE_S", 0.2)
    async with device.client() as silent, device.client() as asking, device.client() as _:
        await until(lambda: device.listener.refused["connections"] == 1, "the end of the third")
        await asyncio.sleep(0.3)
        assert (await asking.read_holding_registers(0, count=1)).registers == [0]
        async with device.client() as third:
            assert (await third.read_holding_registers(0, count=1)).registers == [0]
            await until(lambda: not silent.connected, "the end of the silent one")
            assert (await asking.read_holding_registers(0, count=1)).registers == [0]
        assert device.listener.refused["connections"] == 2


async def test_plcs_that_may_write_go_before_all_others(device: Device) -> None:
    readers = [await asyncio.open_connection("127.0.0.1", device.port, local_addr=("127.1.0.1", 0)) for _ in range(2)]
    async with device.client() as plc:
        assert not (await plc.write_register(0, 1)).isError()
        assert await asyncio.wait_for(readers[0][0].read(), 5) == b"", "the end of the reader that came first"
        reader, writer = await asyncio.open_connection("127.0.0.1", device.port, local_addr=("127.1.0.1", 0))
        assert await asyncio.wait_for(reader.read(), 5) == b"", "it keeps no PLC and no reader out"
        assert not (await plc.write_register(0, 2)).isError()
    for _, each in (*readers, (reader, writer)):
        each.close()
        await each.wait_closed()
    assert device.listener.refused["connections"] == 2


async def test_connections_are_asked_whether_they_are_still_there(device: Device) -> None:
    async with device.client():
        await until(lambda: device.listener.connections == 1, "the connection")
        lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()]
    (timer,) = [line[5] for line in lines if line[1].endswith(f":{device.port:04X}") and line[3] == "01"]
    assert timer.startswith("02:"), "2 is the timer of keep-alives"


def request(number: int, function: int, *words: int) -> bytes:
    body = struct.pack(f">BB{len(words)}H", 1, function, *words)
    return struct.pack(">HHH", number, 0, len(body)) + body


@pytest.mark.parametrize("count", [2, 30, 3000])
async def test_requests_that_come_at_once_are_each_done_once_in_their_order(device: Device, count: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", device.port)
    writer.write(b"".join(request(number, 6, number % 4, number) for number in range(count)))
    writer.write(request(count, 3, 0, 4))
    for number in range(count):
        answer = await asyncio.wait_for(reader.readexactly(12), 5)
        assert answer == request(number, 6, number % 4, number)
    assert (await asyncio.wait_for(reader.readexactly(17), 5))[:2] == struct.pack(">H", count)
    assert [span.address for span in device.written] == [number % 4 for number in range(count)]
    writer.close()
    await writer.wait_closed()


class Counting(Image):
    """Counts what is read."""

    count = 0

    def cells(self, span: AddressSpan) -> list[Cell]:
        self.count += 1
        return super().cells(span)


async def test_client_that_reads_no_answers_gets_no_more_until_it_does(
    tcp_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "_KEEP_ALIVE", ((socket.SOL_SOCKET, socket.SO_SNDBUF, 4096),))
    image = Counting([Register(Table.INPUT, 124, RegisterType.UINT16)], [])
    async with ModbusListener(image, ModbusServerConfig(port=tcp_port), lambda _: None):
        with socket.socket() as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.connect(("127.0.0.1", tcp_port))
            connection.setblocking(False)
            reader, writer = await asyncio.open_connection(sock=connection, limit=1024)
            writer.write(request(1, 4, 0, 125) * 2000)
            answered = -1
            while image.count != answered:
                answered = image.count
                await asyncio.sleep(0.3)
            assert 0 < answered < 1000
            for _ in range(2000):
                assert len(await asyncio.wait_for(reader.readexactly(259), 5)) == 259
            assert image.count == 2000
            writer.close()
            await writer.wait_closed()


async def test_function_23_writes_nothing_where_its_read_is_refused(device: Device) -> None:
    async with device.client() as client:
        both = await client.readwrite_registers(read_address=100, read_count=1, write_address=0, values=[9])
        assert both.exception_code == 2
        none = await client.readwrite_registers(read_address=0, read_count=1, write_address=100, values=[9])
        assert none.exception_code == 2
        assert (await client.read_holding_registers(0, count=1)).registers == [0]
    assert device.written == []
    assert device.listener.refused["address"] == 2


@pytest.mark.parametrize(
    ("asked", "answer", "cause"),
    [
        ((7,), (0x87, 1), "function"),
        ((8, 0, 0, 0, 7), (0x88, 1), "function"),
        ((17,), (0x91, 1), "function"),
        ((24, 0, 0), (0x98, 1), "function"),
        ((43, 14, 1, 0), (0xAB, 1), "function"),
        ((100, 1), (0xE4, 1), "function"),
        ((0x84, 1), (0x84, 1), "function"),
        ((4, 0, 0, 0, 0), (0x84, 3), "value"),
        ((3, 0, 0, 0xFF, 0xFF), (0x83, 3), "value"),
        ((3,), (0x83, 3), "value"),
        ((16, 0), (0x90, 3), "value"),
        ((16, 0, 0, 0, 2, 4, 1), (0x90, 3), "value"),
        ((15, 0, 0, 0, 8, 1), (0x8F, 3), "value"),
        ((23, 0, 0), (0x97, 3), "value"),
    ],
)
async def test_what_is_not_served_is_answered_with_its_function_and_counted(
    device: Device, asked: tuple[int, ...], answer: tuple[int, int], cause: str
) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", device.port)
    header = struct.pack(">HHH", 5, 0, 1 + len(asked))
    writer.write(header + bytes((9, *asked)))
    writer.write(header + bytes((1, *asked)))
    writer.write(request(6, 6, 0, 1))
    assert await asyncio.wait_for(reader.readexactly(9), 5) == struct.pack(">HHHB", 5, 0, 3, 1) + bytes(answer)
    assert await asyncio.wait_for(reader.readexactly(12), 5) == request(6, 6, 0, 1)
    assert device.listener.refused == {cause: 1, "unit": 1}, "another unit is not answered"
    writer.close()
    await writer.wait_closed()


async def test_what_is_no_modbus_ends_its_connection(device: Device) -> None:
    for number, rubbish in enumerate((b"GET / HTTP/1.1\r\n\r\n", struct.pack(">HHHBB", 1, 0, 1, 1, 3)), start=1):
        reader, writer = await asyncio.open_connection("127.0.0.1", device.port)
        writer.write(request(1, 6, 0, number) + rubbish)
        assert await asyncio.wait_for(reader.read(), 5) == request(1, 6, 0, number)
        assert device.listener.refused["frame"] == number
        assert device.listener.connections == 0
        writer.close()
        await writer.wait_closed()


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
        async with ModbusListener(device.image, config, device.written.append):
            pass
