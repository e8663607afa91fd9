"""Requests to devices by pymodbus: on a line, which is a TCP connection, with TLS or not, or a serial line.

pymodbus takes any answer for the one to its request: whether function and length are those that were asked for is
checked here. TLS keeps the header of Modbus/TCP inside (MODBUS/TCP Security 36, 5.1), which pymodbus's own TLS client
leaves out.
"""

from __future__ import annotations

import asyncio
import logging
import ssl
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Final

from pymodbus import FramerType, ModbusException
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.client.base import ModbusBaseClient
from pymodbus.pdu import ModbusPDU
from pymodbus.transport import CommParams, CommType

from ua_bridges.modbus.config import DeviceConfig, TlsConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import BridgeUnavailable
from ua_fleet.registers import AddressSpan, Cell, Table
from ua_fleet.values import StatusCode

__all__ = ["MOST_BYTES", "Line", "NoAnswer", "RequestFailed"]

# What it says of each attempt is said here once, by its effect.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

MOST_BYTES: Final = 1 << 16
"""From one request to the next; an answer has 260. Who sends more is not read on."""
ILLEGAL_FUNCTION: Final = 1
ILLEGAL_ADDRESS: Final = 2
_EXCEPTIONS: Final = {
    ILLEGAL_FUNCTION: (StatusCode.BAD_NOT_SUPPORTED, "has no such function"),
    ILLEGAL_ADDRESS: (StatusCode.BAD_CONFIGURATION_ERROR, "has no such address"),
    3: (StatusCode.BAD_OUT_OF_RANGE, "does not take this value or length"),
    4: (StatusCode.BAD_DEVICE_FAILURE, "has failed"),
    5: (StatusCode.BAD_RESOURCE_UNAVAILABLE, "needs longer"),
    6: (StatusCode.BAD_RESOURCE_UNAVAILABLE, "is busy"),
    8: (StatusCode.BAD_SENSOR_FAILURE, "has a memory error"),
    10: (StatusCode.BAD_NO_COMMUNICATION, "is not reached by its gateway"),
    11: (StatusCode.BAD_NO_COMMUNICATION, "does not answer its gateway"),
}
"""Exception codes (MODBUS Application Protocol 1.1b3, 7)."""


class RequestFailed(Exception):
    """A request that brought nothing: why, as a StatusCode and in a line, and what to count it as."""

    def __init__(self, status: int, cause: Drop, reason: str, code: int = 0) -> None:
        self.status, self.cause, self.reason = status, cause, reason
        self.code = code
        """Of a Modbus exception; 0 where the device said none."""
        super().__init__(reason)


class NoAnswer(RequestFailed):
    """Nothing came in time."""

    def __init__(self, reason: str) -> None:
        super().__init__(StatusCode.BAD_TIMEOUT, Drop.NO_ANSWER, reason)


class _TlsClient(AsyncModbusTcpClient):
    def __init__(self, host: str, port: int, context: ssl.SSLContext, timeout_s: float) -> None:
        self.comm_params = CommParams(
            comm_type=CommType.TLS,
            host=host,
            port=port,
            sslctx=context,
            comm_name="modbus",
            reconnect_delay=0.0,
            timeout_connect=timeout_s,
        )
        super().__init__(host, framer=FramerType.SOCKET, port=port, retries=0)


def _tls_context(tls: TlsConfig, folder: Path) -> ssl.SSLContext:
    """Raises BridgeUnavailable where a file is missing or no certificate."""
    try:
        context = ssl.create_default_context(ssl.Purpose.SERVER_AUTH, cafile=str(folder / tls.ca))
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        if tls.certificate is not None and tls.key is not None:
            context.load_cert_chain(folder / tls.certificate, folder / tls.key)
    except (OSError, ValueError) as error:
        raise BridgeUnavailable(f"tls: {error}; the files are looked for in {folder}") from error
    return context


class Line:
    """What one or several devices are reached by. All of it runs in one event loop."""

    def __init__(self, config: DeviceConfig, folder: Path, timeout_s: float) -> None:
        """Make a line that is not connected.

        Args:
            config: any of the devices on it.
            folder: where the files of TLS are.
            timeout_s: so long an answer is waited for.

        Raises:
            BridgeUnavailable: a file of TLS cannot be used.
        """
        self._config, self.timeout_s = config, timeout_s
        self._context = _tls_context(config.tls, folder) if config.tls is not None else None
        self._client: ModbusBaseClient | None = None
        self._connecting = asyncio.Lock()
        self._why = ""
        self._received = 0
        """Bytes since the last request."""
        self._offence = ""
        self.devices = 0
        """How many share it."""

    @property
    def connected(self) -> bool:
        """Whether requests can be sent."""
        return self._client is not None and self._client.connected

    async def connect(self) -> str:
        """Connect unless it is; why that did not work, or the empty text."""
        async with self._connecting:
            if self.connected:
                return ""
            self.close()
            self._client, self._why = self._make(), "there was no answer in time"
            self._note_errors(self._client)
            self._count_bytes(self._client)
            return "" if await self._client.connect() else self._why

    def close(self) -> None:
        """Hang up."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def take_offence(self) -> str:
        """What came since this was asked last and is no answer; empty where nothing did."""
        offence, self._offence = self._offence, ""
        return offence

    async def read(self, unit: int, span: AddressSpan) -> Sequence[Cell]:
        """The cells of a span; raises RequestFailed."""
        client = self._connected()
        functions: dict[Table, Callable[..., Awaitable[ModbusPDU]]] = {
            Table.COIL: client.read_coils,
            Table.DISCRETE: client.read_discrete_inputs,
            Table.HOLDING: client.read_holding_registers,
            Table.INPUT: client.read_input_registers,
        }
        answer = await self._ask(functions[span.table](span.address, count=span.count, device_id=unit), span)
        cells: Sequence[Cell] = answer.bits if span.table.is_bits else answer.registers
        # Bits come in whole bytes.
        if len(cells) != (-(-span.count // 8) * 8 if span.table.is_bits else span.count):
            raise self._malformed(f"{len(cells)} addresses for {span.count}", span)
        if span.table is not _TABLES.get(answer.function_code):
            raise self._malformed(f"function {answer.function_code}", span)
        return cells[: span.count]

    async def write(self, unit: int, span: AddressSpan, cells: Sequence[Cell]) -> None:
        """Write a span; raises RequestFailed. After NoAnswer the device may have it or not."""
        client = self._connected()
        if span.table is Table.COIL:
            bits = [bool(cell) for cell in cells]
            if len(bits) == 1:
                function, request = 5, client.write_coil(span.address, bits[0], device_id=unit)
            else:
                function, request = 15, client.write_coils(span.address, bits, device_id=unit)
        else:
            words = [int(cell) for cell in cells]
            if len(words) == 1:
                function, request = 6, client.write_register(span.address, words[0], device_id=unit)
            else:
                function, request = 16, client.write_registers(span.address, words, device_id=unit)
        self._check_written(await self._ask(request, span), function, span)

    async def write_bits(self, unit: int, address: int, mask: int, word: int) -> None:
        """Set the bits of `mask` in a holding register to those in `word`, in one request (function 22).

        Reading and writing back instead could undo what the device's program does between the two.
        """
        span = AddressSpan(Table.HOLDING, address, 1)
        request = self._connected().mask_write_register(
            address=address, and_mask=0xFFFF & ~mask, or_mask=word & mask, device_id=unit
        )
        self._check_written(await self._ask(request, span), 22, span)

    def _make(self) -> ModbusBaseClient:
        config, serial = self._config, self._config.serial
        if serial is not None:
            return AsyncModbusSerialClient(
                serial.tty,
                framer=FramerType.RTU,
                baudrate=serial.baudrate,
                parity=serial.parity[0].upper(),
                stopbits=serial.stop_bits,
                bytesize=8,
                reconnect_delay=0.0,
                timeout=self.timeout_s,
                retries=0,
            )
        assert config.host is not None
        if self._context is not None:
            return _TlsClient(config.host, config.tcp_port, self._context, self.timeout_s)
        return AsyncModbusTcpClient(
            config.host, port=config.tcp_port, reconnect_delay=0.0, timeout=self.timeout_s, retries=0
        )

    def _note_errors(self, client: ModbusBaseClient) -> None:
        """The library says that it could not connect, but not why."""
        create = client.ctx.call_create

        async def noting() -> object:
            try:
                return await create()
            except OSError as error:
                self._why = " ".join(str(error.strerror or error).split())
                raise

        client.ctx.call_create = noting

    def _count_bytes(self, client: ModbusBaseClient) -> None:
        """The library reads on for ever, and does not say what it could not decode."""
        take: Callable[[bytes], None] = client.ctx.data_received

        def received(data: bytes) -> None:
            self._received += len(data)
            if self._received > MOST_BYTES:
                self._offence = f"it sent more than {MOST_BYTES} bytes where an answer has 260"
                client.close()
                return
            try:
                take(data)
            except Exception as error:
                self._offence = f"an answer that cannot be decoded ({' '.join(str(error).split())[:120]})"
                raise

        client.ctx.data_received = received  # type: ignore[method-assign]

    def _connected(self) -> ModbusBaseClient:
        if self._client is None or not self._client.connected:
            raise NoAnswer("the connection is lost")
        return self._client

    async def _ask(self, request: Awaitable[ModbusPDU], span: AddressSpan) -> ModbusPDU:
        self._received, self._offence = 0, ""
        try:
            answer = await request
        except ModbusException as error:
            if self._config.serial is not None:
                # What is late would be taken for the answer to the next request, which nothing tells apart.
                await asyncio.sleep(self.timeout_s)
            raise NoAnswer(f"no answer to {span.text} within {self.timeout_s:g} s") from error
        if answer.isError():
            status, said = _EXCEPTIONS.get(answer.exception_code, (StatusCode.BAD_COMMUNICATION_ERROR, "refuses"))
            reason = f"the device {said}: {span.text} (exception {answer.exception_code})"
            raise RequestFailed(status, Drop.REJECTED, reason, answer.exception_code)
        return answer

    def _check_written(self, answer: ModbusPDU, function: int, span: AddressSpan) -> None:
        """Each answer to a write repeats its function and address (MODBUS Application Protocol 1.1b3, 6)."""
        if answer.function_code != function:
            raise self._malformed(f"function {answer.function_code}", span)
        if answer.address != span.address:
            raise self._malformed(f"address {answer.address}", span)

    def _malformed(self, what: str, span: AddressSpan) -> RequestFailed:
        return RequestFailed(
            StatusCode.BAD_COMMUNICATION_ERROR, Drop.MALFORMED, f"the device answers {what} when asked for {span.text}"
        )


_TABLES: Final = {1: Table.COIL, 2: Table.DISCRETE, 3: Table.HOLDING, 4: Table.INPUT}
"""Which table a function reads."""
