"""The server of a simulated PLC: pymodbus over TCP, TLS or a serial line, on the memory of `memory.py`."""

from __future__ import annotations

import ssl
from collections.abc import Mapping
from typing import Protocol

from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.exceptions import NoSuchIdException
from pymodbus.server import ModbusSerialServer, ModbusTcpServer, ModbusTlsServer
from pymodbus.simulator import DataType, SimData, SimDevice

from ua_demo.simulators.modbus.memory import Memory
from ua_fleet.registers import TABLE_OF_FUNCTION, AddressSpan, Cell

__all__ = ["PlcServer", "make_server"]


class PlcServer(Protocol):
    """What is used of a server."""

    async def serve_forever(self, *, background: bool = False) -> None:
        """Listen."""
        ...

    async def shutdown(self) -> None:
        """Hang up on all."""
        ...


class _Memories:
    """What pymodbus asks for data: see its SimCore."""

    def __init__(self, units: Mapping[int, Memory]) -> None:
        self._units = units

    def device_ids(self) -> list[int]:
        """The units that there are."""
        return list(self._units)

    async def async_getValues(  # noqa: N802 - the name is pymodbus's
        self, device_id: int, func_code: int, address: int, count: int = 1
    ) -> list[Cell] | ExcCodes:
        """What lies at the addresses."""
        memory, span = self._units.get(device_id), AddressSpan(TABLE_OF_FUNCTION[func_code], address, count)
        if memory is None:
            raise NoSuchIdException
        if not memory.has(span):
            return ExcCodes.ILLEGAL_ADDRESS
        cells = memory.cells(span)
        memory.on_read(span)
        return cells

    async def async_setValues(  # noqa: N802 - the name is pymodbus's
        self, device_id: int, func_code: int, address: int, values: list[int] | list[bool]
    ) -> ExcCodes | None:
        """Lay values at the addresses."""
        memory, span = self._units.get(device_id), AddressSpan(TABLE_OF_FUNCTION[func_code], address, len(values))
        if memory is None:
            raise NoSuchIdException
        if not memory.has(span):
            return ExcCodes.ILLEGAL_ADDRESS
        memory.put_cells(span, values)
        memory.on_write(span)
        return None


def make_server(
    units: Mapping[int, Memory],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    tls: ssl.SSLContext | None = None,
    tty: str | None = None,
    parity: str = "even",
) -> PlcServer:
    """A server that does not listen yet. In a running event loop.

    Args:
        units: the memory of each unit.
        host: address to listen on.
        port: TCP port.
        tls: for Modbus/TCP Security.
        tty: a serial line instead, with RTU.
        parity: of the serial line: even, odd or none; a pseudo terminal has none.
    """
    nothing = SimDevice(0, [SimData(0, values=0, datatype=DataType.REGISTERS)])
    server: ModbusTcpServer | ModbusSerialServer
    if tty is not None:
        server = ModbusSerialServer(
            nothing,
            port=tty,
            framer=FramerType.RTU,
            parity=parity[0].upper(),
            baudrate=19_200,
            ignore_missing_devices=True,
        )
    elif tls is not None:
        server = ModbusTlsServer(nothing, framer=FramerType.SOCKET, address=(host, port), sslctx=tls)
    else:
        server = ModbusTcpServer(nothing, address=(host, port))
    server.context = _Memories(units)  # type: ignore[assignment]  # it uses these three methods alone
    return server
