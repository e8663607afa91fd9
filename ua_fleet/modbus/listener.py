# pymodbus's server handler is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportMissingParameterType=false
"""The Modbus server: pymodbus on an image, with its bounds. Who may write is decided by the client's address."""

from __future__ import annotations

import ipaddress
import logging
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final, Self

from pymodbus.constants import ExcCodes
from pymodbus.exceptions import NoSuchIdException
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from ua_fleet.config.modbus_schema import ModbusServerConfig
from ua_fleet.errors import ServerStartError
from ua_fleet.modbus.image import Image
from ua_fleet.registers import Cell, Span, Table

__all__ = ["Listener"]

# What a PLC does wrong is counted here; it would be said once for each request.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

_TABLES: Final = {
    1: Table.COIL,
    2: Table.DISCRETE,
    3: Table.HOLDING,
    4: Table.INPUT,
    5: Table.COIL,
    6: Table.HOLDING,
    15: Table.COIL,
    16: Table.HOLDING,
    22: Table.HOLDING,
    23: Table.HOLDING,
}
"""Which table each function is about (MODBUS Application Protocol 1.1b3, 6)."""


class _Tables:
    """What pymodbus asks for data, and what it is refused."""

    def __init__(self, image: Image, config: ModbusServerConfig, written: Callable[[Span], None]) -> None:
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
        if not self._image.can_read(span):
            self.refused["address"] += 1
            return ExcCodes.ILLEGAL_ADDRESS
        return self._image.cells(span)

    async def async_setValues(  # noqa: N802 - the name is pymodbus's
        self, device_id: int, func_code: int, address: int, values: Sequence[Cell]
    ) -> ExcCodes | None:
        """What a client writes."""
        span = self._span(device_id, func_code, address, len(values))
        if not self._may_write():
            self.refused["writer"] += 1
            return ExcCodes.ILLEGAL_FUNCTION
        if not self._image.can_write(span):
            self.refused["address"] += 1
            return ExcCodes.ILLEGAL_ADDRESS
        self._image.put_cells(span, values)
        self._written(span)
        return None

    def _span(self, unit: int, function: int, address: int, count: int) -> Span:
        if unit != self._unit or function not in _TABLES:
            self.refused["unit"] += 1
            raise NoSuchIdException
        return Span(_TABLES[function], address, count)

    def _may_write(self) -> bool:
        try:
            peer = ipaddress.ip_address(self.peer)
        except ValueError:
            return False
        return any(peer in network for network in self._networks)


class _Handler(ServerRequestHandler):
    """One connection."""

    def __init__(self, owner: _Server, tables: _Tables) -> None:
        super().__init__(owner, None, None, None)  # type: ignore[no-untyped-call]
        self._tables = tables

    def callback_connected(self) -> None:
        """Too many connections are closed at once."""
        super().callback_connected()
        if not self.server.admit(self):
            self.close()

    def callback_disconnected(self, exc: Exception | None) -> None:
        """The client is gone."""
        self.server.leave(self)
        super().callback_disconnected(exc)

    async def handle_request(self) -> None:
        """Answer a request; whose it is decides whether it may write."""
        name = self.transport.get_extra_info("peername") if self.transport else None
        self._tables.peer = str(name[0]) if name else ""
        await super().handle_request()  # type: ignore[no-untyped-call]


class _Server(ModbusTcpServer):
    """A server whose connections know who is at their other end."""

    def __init__(self, config: ModbusServerConfig, tables: _Tables) -> None:
        nothing = SimDevice(0, [SimData(0, values=0, datatype=DataType.REGISTERS)])
        super().__init__(nothing, address=(config.host, config.port), ignore_missing_devices=True)
        self.context = tables  # type: ignore[assignment]  # it uses these three methods alone
        self._tables, self._most = tables, config.most_connections
        self._there: set[_Handler] = set()

    def callback_new_connection(self) -> ServerRequestHandler:
        """See ModbusBaseServer."""
        return _Handler(self, self._tables)

    def admit(self, handler: _Handler) -> bool:
        """Whether there is room for one more."""
        if len(self._there) >= self._most:
            self._tables.refused["connections"] += 1
            return False
        self._there.add(handler)
        return True

    def leave(self, handler: _Handler) -> None:
        """A connection has ended."""
        self._there.discard(handler)

    @property
    def connections(self) -> int:
        """Clients that are there."""
        return len(self._there)


class Listener:
    """The server while the context lasts."""

    def __init__(self, image: Image, config: ModbusServerConfig, written: Callable[[Span], None]) -> None:
        """`written` is told each span that a client has written."""
        self._config, self._tables = config, _Tables(image, config, written)
        self._server: _Server | None = None

    @property
    def refused(self) -> Counter[str]:
        """Requests that were refused, by cause: writer, address, unit, connections."""
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
