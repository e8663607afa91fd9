"""The fleet as a Modbus device, in `fleet.yaml`: what a PLC reads, writes and commands."""

from __future__ import annotations

import ipaddress
from typing import Annotated, Final

from pydantic import AfterValidator, Field, model_validator

from ua_fleet.config.base import Model, Name, Port
from ua_fleet.config.register_schema import Address, RegisterConfig
from ua_fleet.config.shapes import all_of, exactly_one, given, implies, none_of
from ua_fleet.registers import ByteOrder

__all__ = ["MOST_ROBOTS", "CommandConfig", "ModbusServerConfig"]

MOST_ROBOTS: Final = 32
"""Robots that have a number: the faults' words have a bit for each."""


def _network(text: str) -> str:
    try:
        ipaddress.ip_network(text)
    except ValueError as error:
        raise ValueError(f"{text} is no address and no network like 10.0.0.0/24") from error
    return text


Network = Annotated[str, AfterValidator(_network)]
NodePath = Annotated[str, Field(pattern=r"^[A-Za-z][\w-]*\.[A-Za-z][\w-]*(\.[A-Za-z][\w.]*)?$", examples=["arm.speed"])]
ArgumentName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")]


class CommandConfig(
    Model,
    frozen=True,
    json_schema_extra=all_of(
        exactly_one("skill", "scenario"),
        implies(given("skill"), given("robot")),
        implies(given("scenario"), none_of("robot", "results", empty=({},))),
    ),
):
    """One thing that a PLC may start: a skill of a robot, or a scenario."""

    code: int = Field(ge=1, le=65_535)
    """What the PLC writes to start it."""
    robot: Name | None = None
    """With `skill`: the robot."""
    skill: Name | None = None
    """The robot's skill."""
    scenario: str | None = None
    """Name of a scenario of the server's folder."""
    arguments: dict[ArgumentName, RegisterConfig] = {}
    """Where each argument (or parameter of the scenario) is taken from: holding registers or coils."""
    results: dict[ArgumentName, RegisterConfig] = {}
    """Where each result is shown: input registers or discrete inputs."""

    @model_validator(mode="after")
    def _check(self) -> CommandConfig:
        if (self.skill is None) is (self.scenario is None) or (self.skill is None) is not (self.robot is None):
            raise ValueError("give either `robot` and `skill`, or `scenario`")
        if self.scenario is not None and self.results:
            raise ValueError("results: a scenario has none")
        return self


class ModbusServerConfig(Model, frozen=True):
    """The fleet as a Modbus/TCP device: `ua-fleet modbus serve`, see docs/plc.md."""

    host: str = "127.0.0.1"
    """Address to listen on. Modbus/TCP neither encrypts nor asks who is there: choose one of the machines' network."""
    port: int = Field(default=502, ge=0, le=65535)
    """TCP port."""
    unit: int = Field(default=1, ge=0, le=255)
    """Unit identifier; others are not answered. 255 is asked for by some PLCs."""
    order: ByteOrder = ByteOrder.ABCD
    """How the bytes of the value 0xAABBCCDD lie in two words."""
    writers: tuple[Network, ...] = ()
    """Addresses, or networks, of the PLCs that may write; all others may read. Empty: nobody."""
    most_connections: int = Field(default=16, ge=1, le=1000)
    """Connections at once. One more is closed, or takes the place of the one that is silent longest, where that is so
    for 10 s; a PLC of `writers` takes the place of any other client at once."""
    control: Address = 0
    """First of the holding registers with which a PLC commands; see docs/plc.md."""
    status: Address = 0
    """First of the input registers in which it is answered."""
    quality: Address = 0
    """First of the discrete inputs that say which of `values` are Good."""
    robots: tuple[Name, ...] = Field(default=(), max_length=MOST_ROBOTS)
    """Robots that have a number, from 1 in this order: those that may fail, and those that may take over."""
    values: dict[NodePath, RegisterConfig] = {}
    """What can be read: `<robot>.<data>`, or `<robot>.<data>.<field>`, in input registers or discrete inputs."""
    sets: dict[NodePath, RegisterConfig] = {}
    """What can be written: data of `origin: server`, in holding registers or coils."""
    commands: dict[Name, CommandConfig] = {}
    """What can be started."""
    state_dir: str = "state/modbus"
    """Folder for what has to be remembered over a restart, and the certificate; relative to `fleet.yaml`."""
    monitoring_port: Port | None = None
    """The gateway's port in place of `monitoring.port`."""
