"""Configuration of a bridge to plugged-in sensors and actuators in `fleet.yaml`.

The bridge names devices and how they are recognised; the data and the skills of its robots say how each is read or
driven:

    line         a line that a device on a serial port says, by itself or when it is asked
    attribute    a file of a device below /sys, as those of hwmon
    signal       a D-Bus signal `trbots.<sensor>` (TalkRoBots 3.2.2)
    url          where the stream of a camera is found
    plugged      whether the device is there
    command      a line that is written to a serial port
    call         a D-Bus method
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Annotated, ClassVar, Final, Literal

from pydantic import BaseModel, Field, field_validator, model_validator

from ua_fleet.config.base import Model, Name
from ua_fleet.config.schema import DataMapping, RobotConfig, VendorBridgeConfig
from ua_fleet.config.shapes import all_of, at_least_one, exactly_one, given, implies, none_of
from ua_fleet.document import KeyPath

__all__ = [
    "MESSAGE",
    "Call",
    "Device",
    "Match",
    "PluggedBridgeConfig",
    "PluggedSink",
    "PluggedSkill",
    "PluggedSource",
    "SerialSettings",
]

Line = Annotated[str, Field(min_length=1, max_length=4096)]
UsbId = Annotated[str, Field(pattern=r"^[0-9a-fA-F]{4}$", examples=["2341"])]
BusName = Annotated[
    str,
    Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)+$", max_length=255, examples=["trbots.gas"]),
]
Member = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=255)]
ObjectPath = Annotated[str, Field(pattern=r"^/([A-Za-z0-9_]+(/[A-Za-z0-9_]+)*)?$", examples=["/trbots/lamp"])]
MESSAGE: Final = "message"
"""A pattern of failure may hold `{message}`: what the device says of it."""


class Match(
    Model,
    frozen=True,
    json_schema_extra=at_least_one("vendor", "product", "serial", "node", "properties", "attributes", empty=({}, "")),
):
    """What udev says of a device. All that is given has to fit; of several devices that fit, the first is taken."""

    subsystem: str = "tty"
    """Kind of device: `tty`, `hwmon`, `video4linux`, `input`, ..."""
    vendor: UsbId | None = None
    """USB vendor id, e.g. `2341`."""
    product: UsbId | None = None
    """USB product id, e.g. `0043`."""
    serial: str | None = None
    """Serial number, which tells two devices of one kind apart."""
    node: str | None = None
    """The device's file, with `*` for any characters: `/dev/ttyAMA0`, `/dev/ttyUSB*`."""
    properties: dict[str, str] = {}
    """Properties that udev's rules gave to the device, e.g. `ID_PATH`."""
    attributes: dict[str, str] = {}
    """Attributes of the device itself below /sys, e.g. `name: coretemp`."""

    @model_validator(mode="after")
    def _check(self) -> Match:
        if not (self.vendor or self.product or self.serial or self.node or self.properties or self.attributes):
            raise ValueError(f"would take any device of {self.subsystem}; say which, e.g. by `vendor` and `product`")
        return self


class SerialSettings(Model, frozen=True):
    """How a serial port is set."""

    baud: int = Field(default=115_200, ge=50, le=4_000_000)
    """Bits per second."""
    parity: Literal["none", "even", "odd"] = "none"
    """Parity bit."""
    stop_bits: Literal[1, 2] = 1
    """Stop bits."""
    terminator: Annotated[str, Field(min_length=1, max_length=4, pattern=r"^[\x00-\x7f]+$")] = "\n"
    """Ends each line that the device says."""
    encoding: Literal["ascii", "latin-1", "utf-8"] = "utf-8"
    """Of lines and commands."""


class Device(Model, frozen=True, json_schema_extra=exactly_one("match", "path")):
    """One device that may be plugged in."""

    match: Match | None = None
    """How udev recognises it."""
    path: str | None = None
    """In place of `match`, where udev does not see it (in a container): it is there while this file is."""
    port: SerialSettings = SerialSettings()
    """For a device on a serial port: how it is set."""

    @model_validator(mode="after")
    def _check(self) -> Device:
        if (self.match is None) == (self.path is None):
            raise ValueError("give either `match`, what udev knows it by, or `path`, a file that is there with it")
        return self


class PluggedSource(
    DataMapping,
    frozen=True,
    json_schema_extra=all_of(
        exactly_one("line", "attribute", "signal", "url", "plugged"),
        implies(given("signal"), none_of("device")),
        implies(none_of("signal"), given("device")),
        implies(given("ask"), given("line")),
    ),
):
    """`source` of data: exactly one of `line`, `attribute`, `signal`, `url` and `plugged`."""

    device: Name | None = None
    """The device, by its name in the bridge's `devices`. Only `signal` needs none."""
    line: Line | None = None
    """A line that the device says, e.g. `T={value}`; the names are those of the fields, `value` for a single one."""
    ask: Line | None = None
    """With `line`: command that has the device say it, with its end of line. Left out: it says it by itself."""
    attribute: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_./-]*$", max_length=255)] | None = None
    """File below the device's folder in /sys with the value, e.g. `temp1_input`."""
    scale: float = 1.0
    """With `attribute`: the value is what stands there, times this, ..."""
    offset: float = 0.0
    """... plus this."""
    signal: BusName | None = None
    """Interface of a D-Bus signal, e.g. `trbots.gas`. Its arguments are the fields, in their order."""
    member: Member = "Value"
    """With `signal`: the signal's name."""
    sender: BusName | None = None
    """With `signal`: well-known name that the sensor's program owns while it lives; `signal` if left out. Signals of
    others are not taken."""
    url: Annotated[str, Field(pattern=r"^[a-z][a-z0-9+.-]*://\S+$", max_length=2048)] | None = None
    """Where the camera's stream is found: the value of a String, while the device is there."""
    plugged: Literal[True] | None = None
    """The value is true while the device is there. For a Boolean."""
    when: Literal["wanted", "always"] = "wanted"
    """`wanted`: read while an OPC UA client subscribes or a run of a scenario needs it, and not otherwise. `always`:
    as long as the device is there."""
    period_s: float = Field(default=1.0, ge=0.01, le=3600)
    """With `ask` and `attribute`: read so often."""
    silent_after_s: float | None = Field(default=None, ge=0.1)
    """Read without an answer for so long, the source is lost until it says something. Left out: three periods, at
    least 2 s, where it is asked; otherwise it may be silent."""
    max_rate_hz: float = Field(default=100.0, gt=0, le=10_000)
    """Values that are handed on in a second at most; the latest wins, and the last one always arrives."""

    @model_validator(mode="after")
    def _one(self) -> PluggedSource:
        ways = [name for name in ("line", "attribute", "signal", "url", "plugged") if getattr(self, name) is not None]
        if len(ways) != 1:
            raise ValueError("give exactly one of line, attribute, signal, url and plugged")
        if ways != ["signal"] and self.device is None:
            raise ValueError(f"device: `{ways[0]}` needs the name of one of the bridge's devices")
        if ways == ["signal"] and self.device is not None:
            raise ValueError("device: a D-Bus signal is there while its sender is; remove it")
        if self.ask is not None and self.line is None:
            raise ValueError("ask: belongs to `line`")
        if self.attribute is not None and ".." in self.attribute.split("/"):
            raise ValueError("attribute: leads out of the device's folder")
        return self


class Call(Model, frozen=True):
    """A D-Bus method. Its arguments are those of the skill, or the fields of the data, in their order."""

    name: BusName
    """Well-known name of the program that has it, e.g. `trbots.lamp`."""
    path: ObjectPath = "/"
    """Path of the object."""
    interface: BusName | None = None
    """Interface of the method; `name` if left out."""
    member: Member
    """Name of the method."""


_DRIVE: Final = all_of(
    exactly_one("command", "call"),
    implies(given("command"), given("device")),
    implies(given("device"), given("command")),
)
"""As `_check_drive` has it."""


class PluggedSink(DataMapping, frozen=True, json_schema_extra=_DRIVE):
    """`sink` of data: exactly one of `command` and `call`."""

    device: Name | None = None
    """With `command`: the device."""
    command: Line | None = None
    """Line that is written to the device's port, e.g. `LED {value}\\n`. Nothing is added: write the end of line too."""
    call: Call | None = None
    """A D-Bus method."""

    @model_validator(mode="after")
    def _one(self) -> PluggedSink:
        _check_drive(self.device, self.command, self.call)
        return self


class PluggedSkill(
    Model,
    frozen=True,
    json_schema_extra=all_of(
        {"if": given("read"), "then": none_of("device", "command", "call"), "else": _DRIVE},
        *(implies(given(key), given("command")) for key in ("done", "failed", "halt", "halted")),
        implies(given("failed"), given("done")),
        implies(given("halted"), given("done")),
        implies(given("halted"), given("halt")),
    ),
):
    """`via` of a skill: exactly one of `read`, `command` and `call`."""

    read: Name | None = None
    """Read this data of the robot now, whoever subscribes; the results are its fields."""
    device: Name | None = None
    """With `command`: the device."""
    command: Line | None = None
    """Line that is written to the device's port, e.g. `BEEP {ms}\\n`. Nothing is added: write the end of line too."""
    done: Line | None = None
    """With `command`: what the device says when it is done. Left out: it is done when it is sent."""
    failed: Line | None = None
    """With `done`: what the device says when it has failed, e.g. `ERR {message}`."""
    halt: Line | None = None
    """With `command`: command that stops the device. Left out: it cannot be stopped."""
    halted: Line | None = None
    """With `halt` and `done`: what the device says when it stands after `halt`, e.g. `STOPPED`. `done` and `failed`
    tell it too; where it says none of these within 5 s, nobody knows whether it stands: Unknown."""
    call: Call | None = None
    """A D-Bus method; the skill is done when it returns, with what it returns."""

    @model_validator(mode="after")
    def _one(self) -> PluggedSkill:
        if self.read is None:
            _check_drive(self.device, self.command, self.call)
        elif self.device is not None or self.command is not None or self.call is not None:
            raise ValueError("read: goes with nothing else; the data says what is read")
        for name in ("done", "failed", "halt", "halted"):
            if getattr(self, name) is not None and self.command is None:
                raise ValueError(f"{name}: belongs to `command`")
        if self.failed is not None and self.done is None:
            raise ValueError("failed: without `done` the device is not listened to; add `done`, or remove it")
        if self.halted is not None and (self.done is None or self.halt is None):
            raise ValueError("halted: it answers `halt`, of what has `done`; add both, or remove it")
        return self


def _check_drive(device: str | None, command: str | None, call: Call | None) -> None:
    if (command is None) == (call is None):
        raise ValueError("give either `command`, a line for a serial port, or `call`, a D-Bus method")
    if (command is None) != (device is None):
        raise ValueError("device: belongs to `command`, which needs it")


class PluggedBridgeConfig(VendorBridgeConfig, frozen=True):
    """A bridge to what is plugged into a computer. `space` is one of the vendor spaces, 256 to 65535."""

    kind: Literal["plugged"]
    """Always `plugged`."""
    devices: dict[Name, Device] = {}
    """The devices that may be plugged in, by name. Two that fit the same device: the first one gets it."""
    bus: str = Field(default="system", json_schema_extra={"pattern": r"^(system|session|(unix|tcp):\w+=\S+)$"})
    """D-Bus for `signal` and `call`: `system`, `session`, or an address such as `unix:path=/run/my/bus`."""

    skill_mapping: ClassVar[type[BaseModel] | None] = PluggedSkill
    source_mapping: ClassVar[type[DataMapping] | None] = PluggedSource
    sink_mapping: ClassVar[type[DataMapping] | None] = PluggedSink

    @field_validator("bus")
    @classmethod
    def _bus(cls, bus: str) -> str:
        if bus not in ("system", "session") and not re.match(r"^(unix|tcp):\w+=\S+$", bus):
            raise ValueError("write `system`, `session`, or an address such as `unix:path=/run/my/bus`")
        return bus

    def reads_on_demand(self, robots: Iterable[RobotConfig]) -> bool:
        """See BridgeConfig."""
        sources = [data.source for robot in robots for data in robot.data.values()]
        return any(isinstance(source, PluggedSource) and source.when == "wanted" for source in sources)

    def problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """See BridgeConfig: devices that are not there, templates, types and results that do not fit."""
        from ua_bridges.plugged.checks import problems_of  # which needs these models

        return problems_of(self, name, robots)
