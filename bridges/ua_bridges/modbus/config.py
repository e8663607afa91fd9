"""Configuration of a Modbus bridge in `fleet.yaml`, and of the registers of the robots behind it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, ClassVar, Final, Literal

from pydantic import BaseModel, Field, field_validator, model_validator

from ua_fleet.config.base import Model, Name
from ua_fleet.config.register_schema import Address, RegisterConfig
from ua_fleet.config.schema import DataMapping, RobotConfig, VendorBridgeConfig
from ua_fleet.config.shapes import all_of, exactly_one, given, implies, none_of
from ua_fleet.document import KeyPath
from ua_fleet.registers import ByteOrder, DeviceLimits, Table

__all__ = [
    "DeviceConfig",
    "HandshakeSkill",
    "ModbusBridgeConfig",
    "PollConfig",
    "RegisterMapping",
    "RegisterSink",
    "RegisterSource",
    "SerialConfig",
    "TlsConfig",
]

_PORT: Final = 502
_TLS_PORT: Final = 802
"""The registered ports of Modbus over TCP and over TLS."""

Range = Annotated[tuple[Address, Address], Field(examples=["[0, 99]"])]
FieldName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.]{0,127}$")]


class SerialConfig(Model, frozen=True):
    """A serial line with Modbus RTU. Devices with the same `tty` share it."""

    tty: Annotated[str, Field(min_length=1, examples=["/dev/ttyUSB0"])]
    """The line's device file; a name under /dev/serial/by-id does not change."""
    baudrate: int = Field(default=19_200, ge=300, le=4_000_000)
    """Bits a second."""
    parity: Literal["none", "even", "odd"] = "even"
    """Parity bit; `even` is the standard's default."""
    stop_bits: Literal[1, 2] = 1
    """Stop bits; the standard wants 2 without parity."""


class TlsConfig(
    Model,
    frozen=True,
    json_schema_extra=all_of(implies(given("certificate"), given("key")), implies(given("key"), given("certificate"))),
):
    """Modbus/TCP Security: the device is known by its certificate. Files are relative to the bridge's `state_dir`."""

    ca: str
    """File with the certificate that the device's must be signed by, or with the device's own (PEM)."""
    certificate: str | None = None
    """File with this bridge's certificate, where the device wants to know it (PEM)."""
    key: str | None = None
    """File with its private key (PEM)."""
    server_name: str | None = None
    """Name in the device's certificate; left out: `host`."""

    @model_validator(mode="after")
    def _check(self) -> TlsConfig:
        if (self.certificate is None) is not (self.key is None):
            raise ValueError("certificate and key belong together")
        return self


class DeviceConfig(
    Model,
    frozen=True,
    json_schema_extra=all_of(exactly_one("host", "serial"), implies(given("serial"), none_of("port", "tls"))),
):
    """One device: a PLC, or one of several on a serial line or behind a gateway."""

    host: str | None = None
    """Address of a device that is reached by TCP; devices with the same host and port share the connection, and have
    the same `tls`."""
    port: int | None = Field(default=None, ge=1, le=65535)
    """TCP port; 502 if left out, 802 with `tls`."""
    tls: TlsConfig | None = None
    """Encrypted and authenticated, where the device can."""
    serial: SerialConfig | None = None
    """A serial line instead of `host`."""
    unit: int = Field(default=1, ge=0, le=255)
    """Unit identifier (slave address): 1 to 247 on a serial line; many devices with TCP take any."""
    order: ByteOrder = ByteOrder.ABCD
    """How the bytes of the value 0xAABBCCDD lie in two words."""
    timeout_s: float = Field(default=1.0, gt=0, le=60)
    """So long an answer is waited for."""
    retries: int = Field(default=1, ge=0, le=10)
    """A request without an answer is sent so many times more."""
    retry_s: tuple[float, float] = (0.5, 30.0)
    """A device that does not answer is asked again after the first, and after more and more up to the second."""
    read_words: int = Field(default=125, ge=1, le=125)
    """Most words that one request may read."""
    read_bits: int = Field(default=2000, ge=1, le=2000)
    """Most coils or discrete inputs that one request may read."""
    write_words: int = Field(default=123, ge=1, le=123)
    """Most words that one request may write."""
    write_bits: int = Field(default=1968, ge=1, le=1968)
    """Most coils that one request may write."""
    most_gap: int = Field(default=16, ge=0, le=2000)
    """Between values that are asked for so many addresses are read along, where the tables below say that they
    exist."""
    coils: tuple[Range, ...] | None = None
    """First and last addresses of the coils that there are; left out: not known."""
    discrete_inputs: tuple[Range, ...] | None = None
    """The same of discrete inputs."""
    holding_registers: tuple[Range, ...] | None = None
    """The same of holding registers."""
    input_registers: tuple[Range, ...] | None = None
    """The same of input registers."""

    @model_validator(mode="after")
    def _check(self) -> DeviceConfig:
        if (self.host is None) is (self.serial is None):
            raise ValueError("give either `host` (TCP) or `serial`")
        if self.serial is not None and (self.port is not None or self.tls is not None):
            raise ValueError("port and tls belong to `host`")
        if self.serial is not None and not 1 <= self.unit <= 247:
            raise ValueError("unit: on a serial line 1 to 247")
        if not 0 < self.retry_s[0] <= self.retry_s[1]:
            raise ValueError("retry_s: the first must be above 0, and at most the second")
        for name in ("coils", "discrete_inputs", "holding_registers", "input_registers"):
            for first, last in getattr(self, name) or ():
                if first > last:
                    raise ValueError(f"{name}: [{first}, {last}] has its end before its beginning")
        return self

    @property
    def limits(self) -> DeviceLimits:
        """What it takes in one request, and which addresses it has."""
        tables = (
            (Table.COIL, self.coils),
            (Table.DISCRETE, self.discrete_inputs),
            (Table.HOLDING, self.holding_registers),
            (Table.INPUT, self.input_registers),
        )
        return DeviceLimits(
            self.read_words,
            self.read_bits,
            self.write_words,
            self.write_bits,
            self.most_gap,
            {table: ranges for table, ranges in tables if ranges is not None},
        )

    @property
    def tcp_port(self) -> int:
        """The port, given or not."""
        return self.port or (_TLS_PORT if self.tls is not None else _PORT)

    @property
    def line(self) -> str:
        """The connection or serial line that it shares with others: `10.0.0.7:502`, `/dev/ttyUSB0`."""
        return self.serial.tty if self.serial is not None else f"{self.host}:{self.tcp_port}"

    @property
    def where(self) -> str:
        """For people: `10.0.0.7:502, unit 1`."""
        return f"{self.line}, unit {self.unit}"


class PollConfig(Model, frozen=True):
    """Values that are read together, again and again."""

    period_s: float = Field(ge=0.005, le=86_400)
    """From one reading to the next."""


class RegisterMapping(DataMapping, frozen=True, json_schema_extra=exactly_one("at", "registers", empty=({},))):
    """Registers of a data source: `at` for `type`, or `registers` for `fields`."""

    device: Name | None = None
    """The device of the bridge; left out where there is only one."""
    at: RegisterConfig | None = None
    """Where the value lies."""
    registers: dict[FieldName, RegisterConfig] = {}
    """Where each field lies."""

    @model_validator(mode="after")
    def _check(self) -> RegisterMapping:
        if (self.at is None) is (not self.registers):
            raise ValueError("give either `at` (with `type`) or `registers` (with `fields`)")
        return self

    def by_field(self) -> Mapping[str, RegisterConfig]:
        """By the field's name; the empty name for the single one."""
        return self.registers if self.at is None else {"": self.at}


class RegisterSource(RegisterMapping, frozen=True):
    """`source`: what the data is read from."""

    poll: Name | None = None
    """The poll group; left out: each `poll_s` of the bridge."""


class RegisterSink(RegisterMapping, frozen=True):
    """`sink`: what the data is written to."""

    read_back: bool = False
    """Read what was written, and count and tell it where the device has something else."""
    rewrite: bool = False
    """Write the last value again when the device was away. Otherwise it keeps what it has until the next one."""


class HandshakeSkill(
    Model,
    frozen=True,
    json_schema_extra=all_of(implies(given("command"), given("code")), implies(given("code"), given("command"))),
):
    """`via` of a skill: a handshake with the device's program, see docs/plc.md.

    The bridge writes the arguments and then a new number to `request`; the program repeats that number in `accepted`
    when it begins, and sets `done` or `error` when it has ended.
    """

    device: Name | None = None
    """The device of the bridge; left out where there is only one."""
    request: RegisterConfig
    """Holding register (uint16) for the number of the execution. Skills with the same one are done one at a time."""
    accepted: RegisterConfig
    """Register (uint16) in which the program repeats the number that it has begun."""
    busy: RegisterConfig
    """True while the program is at it."""
    done: RegisterConfig
    """True when it is done."""
    error: RegisterConfig
    """True when it has failed."""
    error_text: RegisterConfig | None = None
    """Text for people (string): why it failed."""
    error_code: RegisterConfig | None = None
    """Number that says why it failed."""
    progress: RegisterConfig | None = None
    """How far it is: 0 to 1, scaled if need be."""
    halt: RegisterConfig | None = None
    """Holding register (uint16): the number of the execution that is to stop. Left out: it cannot be stopped."""
    command: RegisterConfig | None = None
    """Holding register (an integer) for `code`, where one handshake serves several skills."""
    code: int | None = None
    """What is written to `command`."""
    arguments: dict[FieldName, RegisterConfig] = {}
    """Where each argument is written to."""
    results: dict[FieldName, RegisterConfig] = {}
    """Where each result is read from."""
    poll_s: float = Field(default=0.1, ge=0.005, le=60)
    """How often the program is asked while it is at it."""
    accept_s: float = Field(default=5.0, gt=0, le=3600)
    """A request that is not begun within this time is taken back."""
    cycle_s: float | None = Field(default=None, gt=0, le=3600)
    """The longest time from the program's reading of `request` to its writing of `accepted`.

    What was taken back and is not begun for so long counts as never begun, and another robot may do it. Left out:
    nobody knows what the program has read, and the execution is Unknown.
    """

    @model_validator(mode="after")
    def _check(self) -> HandshakeSkill:
        if (self.command is None) is not (self.code is None):
            raise ValueError("command and code belong together")
        return self


class ModbusBridgeConfig(VendorBridgeConfig, frozen=True):
    """A bridge to Modbus devices, which together are one space."""

    kind: Literal["modbus"]
    """Always `modbus`."""
    devices: dict[Name, DeviceConfig] = Field(json_schema_extra={"minProperties": 1})
    """The devices by name."""
    poll_s: float = Field(default=1.0, ge=0.005, le=86_400)
    """How often values of no poll group are read."""
    polls: dict[Name, PollConfig] = {}
    """Poll groups by name."""
    mirrors: dict[Annotated[str, Field(pattern=r"^[A-Za-z][\w-]*\.[A-Za-z][\w-]*$")], RegisterSink] = {}
    """Data of other bridges' robots, `<robot>.<data>`, that is written to registers of these devices."""

    skill_mapping: ClassVar[type[BaseModel] | None] = HandshakeSkill
    """Model of `via` in the skills of its robots."""
    source_mapping: ClassVar[type[DataMapping] | None] = RegisterSource
    sink_mapping: ClassVar[type[DataMapping] | None] = RegisterSink

    @field_validator("devices")
    @classmethod
    def _some_device(cls, devices: dict[str, DeviceConfig]) -> dict[str, DeviceConfig]:
        if not devices:
            raise ValueError("name at least one device")
        lines: dict[str, tuple[str, SerialConfig | TlsConfig | None]] = {}
        places: dict[str, str] = {}
        for name, device in devices.items():
            if (other := places.setdefault(device.where, name)) != name:
                raise ValueError(f"{name} and {other} are one device, {device.where}")
            key, settings = ("tls", device.tls) if device.serial is None else ("serial", device.serial)
            other, known = lines.setdefault(device.line, (name, settings))
            if settings != known:
                where = device.line
                raise ValueError(
                    f"{name} and {other} share {where}, and say different things of it; give both the same `{key}`"
                )
        return devices

    def device_of(self, name: str | None) -> str | None:
        """The device that a `device:` names; None where it leads nowhere."""
        if name is None:
            return next(iter(self.devices)) if len(self.devices) == 1 else None
        return name if name in self.devices else None

    def fleet_problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """See BridgeConfig: registers outside of their device, overlaps, types that do not fit."""
        from ua_bridges.modbus.checks import fleet_problems

        return fleet_problems(self, name, robots)
