# pymodbus's server handler is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportMissingParameterType=false
"""The Modbus server: pymodbus on an image, with its bounds. Who may write is decided by the client's address."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import socket
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Final, Self

from pymodbus.constants import ExcCodes
from pymodbus.exceptions import NoSuchIdException
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadWriteMultipleRegistersRequest
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from ua_fleet.config.modbus_schema import ModbusServerConfig
from ua_fleet.errors import ServerStartError
from ua_fleet.modbus.image import Image
from ua_fleet.registers import TABLE_OF_FUNCTION, AddressSpan, Cell

__all__ = ["ModbusListener"]

# What a PLC does wrong is counted here; it would be said once for each request.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

IDLE_S: Final = 10.0
"""A connection on which nothing came for so long is closed where there is no room for another one."""
_HEADER: Final = 6
"""Bytes up to the length."""
_LONGEST: Final = 260
"""Bytes of the longest request, with its header (MODBUS Messaging on TCP/IP 1.0b, 4.3.2)."""
_KEEP_ALIVE: Final = (
    (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 2),
    (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3),
    (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 5000),
)
"""A client whose cable is out is gone within five seconds."""


class _Tables:
    """What pymodbus asks for data, and what it is refused."""

    def __init__(self, image: Image, config: ModbusServerConfig, written: Callable[[AddressSpan], None]) -> None:
        self._image, self._unit, self._written = image, config.unit, written
        self._networks = [ipaddress.ip_network(network) for network in config.writers]
        self.refused: Counter[str] = Counter()
        self.peer = ""
        """Address of the client whose request is answered now: nothing else runs until it is."""

    def device_ids(self) -> list[int]:
        """The one unit."""
        return [self._unit]

    async def async_getValues(  # noqa: N802 - the name is pymodbus's
        self, device_id: int, func_code: int, address: int, count: int = 1
    ) -> list[Cell] | ExcCodes:
        """What a client reads."""
        span = self._span(device_id, func_code, address, count)
        if not self._image.has(span):
            self.refused["address"] += 1
            return ExcCodes.ILLEGAL_ADDRESS
        return self._image.cells(span)

    async def async_setValues(  # noqa: N802 - the name is pymodbus's
        self, device_id: int, func_code: int, address: int, values: Sequence[Cell]
    ) -> ExcCodes | None:
        """What a client writes."""
        span = self._span(device_id, func_code, address, len(values))
        if not self.may_write(self.peer):
            self.refused["writer"] += 1
            return ExcCodes.ILLEGAL_FUNCTION
        if not self._image.can_write(span):
            self.refused["address"] += 1
            return ExcCodes.ILLEGAL_ADDRESS
        self._image.put_cells(span, values)
        self._written(span)
        return None

    def _span(self, unit: int, function: int, address: int, count: int) -> AddressSpan:
        if unit != self._unit or function not in TABLE_OF_FUNCTION:
            self.refused["unit"] += 1
            raise NoSuchIdException
        return AddressSpan(TABLE_OF_FUNCTION[function], address, count)

    def may_write(self, peer: str) -> bool:
        """Whether a client at this address may write."""
        try:
            address = ipaddress.ip_address(peer)
        except ValueError:
            return False
        return any(address in network for network in self._networks)


class _ReadWrite(ReadWriteMultipleRegistersRequest):
    """Function 23, which writes nothing where what it reads is refused."""

    async def datastore_update(self, context: Any, device_id: int) -> ModbusPDU:
        """See ModbusPDU."""
        if 1 <= self.read_count <= self.MAX_READ_COUNT:
            read = await context.async_getValues(device_id, self.function_code, self.read_address, self.read_count)
            if isinstance(read, ExcCodes):
                return ExceptionResponse(self.function_code, read)
        return await super().datastore_update(context, device_id)


class _Handler(ServerRequestHandler):
    """One connection. Its requests are answered one after the other, also where several come at once.

    pymodbus forgets with each answer, and with each request, what else had come; so it is given one request at a time.
    """

    def __init__(self, owner: _Server, tables: _Tables) -> None:
        super().__init__(owner, None, None, None)  # type: ignore[no-untyped-call]
        self._tables = tables
        self._peer = ""
        self._unread = bytearray()
        self._is_answering = self._is_full = False
        self.heard = 0.0
        """When something was received last, or it was connected; by the loop's clock."""

    @property
    def may_write(self) -> bool:
        """Whether it is a PLC that may write."""
        return self._tables.may_write(self._peer)

    def callback_connected(self) -> None:
        """Too many connections are closed at once."""
        super().callback_connected()
        self._peer = str((self.transport.get_extra_info("peername") or ("",))[0])
        self.heard = self.loop.time()
        for level, option, value in _KEEP_ALIVE:
            self.transport.get_extra_info("socket").setsockopt(level, option, value)
        if not self.server.admit(self):
            self.close()

    def callback_disconnected(self, exc: Exception | None) -> None:
        """The client is gone."""
        self.server.leave(self)
        super().callback_disconnected(exc)

    def data_received(self, data: bytes) -> None:
        """Take what has come."""
        self.heard = self.loop.time()
        self._unread += data
        self._go_on()

    def pause_writing(self) -> None:
        """The client does not read its answers: it gets no more until it does."""
        self._is_full = True

    def resume_writing(self) -> None:
        """It reads them again."""
        self._is_full = False
        self._go_on()

    async def handle_request(self) -> None:
        """Answer a request; whose it is decides whether it may write."""
        self._tables.peer = self._peer
        try:
            await super().handle_request()  # type: ignore[no-untyped-call]
        finally:
            self._is_answering = False
            self._go_on()

    def _go_on(self) -> None:
        """Have pymodbus answer the next request, where one is there and none is being answered."""
        while self.transport and not self._is_answering and not self._is_full and (request := self._request()):
            if self._is_served(request):
                self.callback_data(request)
                self._is_answering = self.last_pdu is not None
        if isinstance(self.transport, asyncio.ReadTransport):  # it is None after the end
            (self.transport.pause_reading if len(self._unread) > _LONGEST else self.transport.resume_reading)()

    def _is_served(self, request: bytes) -> bool:
        """Whether it is a request to this unit that pymodbus can read; another one is answered here, or not at all.

        pymodbus has more functions than this device, some of them for every unit, and answers what it cannot read as
        a function 0 (MODBUS Application Protocol 1.1b3, 7, says which exception it is).
        """
        number, unit, function = int.from_bytes(request[:2], "big"), request[_HEADER], request[_HEADER + 1]
        if unit not in self._tables.device_ids():
            self._tables.refused["unit"] += 1
            return False
        if function not in TABLE_OF_FUNCTION:
            self._tables.refused["function"] += 1
            code = ExcCodes.ILLEGAL_FUNCTION
        elif self.framer.decoder.decode(request[_HEADER + 1 :]) is None:
            code = ExcCodes.ILLEGAL_VALUE
        else:
            return True
        self.server_send(ExceptionResponse(function, code, device_id=unit, transaction=number), None)
        return False

    def server_send(self, pdu: ModbusPDU, addr: tuple[Any, ...] | None) -> None:
        """Send an answer; pymodbus finds some of the wrong numbers of values itself."""
        if isinstance(pdu, ExceptionResponse) and pdu.exception_code == ExcCodes.ILLEGAL_VALUE:
            self._tables.refused["value"] += 1
        super().server_send(pdu, addr)  # type: ignore[no-untyped-call]

    def _request(self) -> bytes:
        """The next whole request, taken away; empty where there is none yet.

        What is no header of MODBUS (MODBUS Messaging on TCP/IP 1.0b, 3.1.3) tells not where the next one begins.
        """
        if len(self._unread) < _HEADER:
            return b""
        protocol, length = int.from_bytes(self._unread[2:4]), int.from_bytes(self._unread[4:6])
        if protocol != 0 or not 2 <= length <= _LONGEST - _HEADER:
            self._tables.refused["frame"] += 1
            self.server.leave(self)
            self.close()
            return b""
        request = bytes(self._unread[: _HEADER + length])
        if len(request) < _HEADER + length:
            return b""
        del self._unread[: len(request)]
        return request


class _Server(ModbusTcpServer):
    """A server whose connections know who is at their other end."""

    def __init__(self, config: ModbusServerConfig, tables: _Tables) -> None:
        nothing = SimDevice(0, [SimData(0, values=0, datatype=DataType.REGISTERS)])
        address = config.host, config.port
        super().__init__(nothing, address=address, ignore_missing_devices=True, custom_pdu=[_ReadWrite])
        self.context = tables  # type: ignore[assignment]  # it uses these three methods alone
        self._tables, self._most = tables, config.most_connections
        self._there: set[_Handler] = set()

    def callback_new_connection(self) -> ServerRequestHandler:
        """See ModbusBaseServer."""
        return _Handler(self, self._tables)

    def admit(self, handler: _Handler) -> bool:
        """Whether there is room for one more; the longest idle one makes it, where it is idle or keeps a PLC out."""
        if len(self._there) >= self._most:
            self._tables.refused["connections"] += 1
            idle_since = self.loop.time() - IDLE_S
            giving = [
                each for each in self._there if each.heard < idle_since or (handler.may_write and not each.may_write)
            ]
            if not giving:
                return False
            longest = min(giving, key=lambda each: each.heard)
            self.leave(longest)
            longest.close()
        self._there.add(handler)
        return True

    def leave(self, handler: _Handler) -> None:
        """A connection has ended."""
        self._there.discard(handler)

    @property
    def connections(self) -> int:
        """Clients that are there."""
        return len(self._there)


class ModbusListener:
    """The server while the context lasts."""

    def __init__(self, image: Image, config: ModbusServerConfig, written: Callable[[AddressSpan], None]) -> None:
        """`written` is told each span that a client has written."""
        self._config, self._tables = config, _Tables(image, config, written)
        self._server: _Server | None = None

    @property
    def refused(self) -> Counter[str]:
        """Requests that were refused, by cause: writer, address, value, function, unit, frame; and connections."""
        return self._tables.refused

    @property
    def connections(self) -> int:
        """Clients that are connected."""
        return 0 if self._server is None else self._server.connections

    async def __aenter__(self) -> Self:
        self._server = _Server(self._config, self._tables)
        try:
            await self._server.serve_forever(background=True)
        except RuntimeError as error:
            place = f"{self._config.host}:{self._config.port}"
            remedy = "choose another modbus.port, or give the process the right to use this one"
            raise ServerStartError(f"Modbus cannot listen on {place}; {remedy}") from error
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._server is not None:
            await self._server.shutdown()  # type: ignore[no-untyped-call]
