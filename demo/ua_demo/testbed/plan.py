"""Which processes each testbed has, and where they find each other: by the names of services in `compose.yaml`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, cast, get_args

from ua_demo.brokered import setting as brokered
from ua_demo.console import CONSOLE, settings_text
from ua_demo.layout import Layout
from ua_demo.pal import setting as pal
from ua_demo.ros_environment import ros2_environment
from ua_demo.talkrobots import setting as talkrobots
from ua_demo.talkrobots.course import TASKS
from ua_demo.talkrobots.setting import ACTORS, Kind, Mode
from ua_fleet.errors import ConfigError

__all__ = [
    "BROKER",
    "BROKER_PORT",
    "CONSOLE_PORT",
    "CONSOLE_SETTINGS",
    "EVENTS",
    "FLEET",
    "IDENTITY",
    "LIMIT_S",
    "MODBUS",
    "OPERATOR",
    "PASSWORD",
    "SERVER",
    "TESTBEDS",
    "TRAFFIC",
    "Options",
    "Testbed",
]

FLEET, SERVER, OPERATOR, MODBUS, BROKER = "fleet", "server", "operator", "modbus", "broker"
EVENTS, TRAFFIC = "events", "traffic"
"""Folders of volumes, beside one for each bridge. Robots see events alone; server and bridges write traffic."""
PASSWORD = "password"  # noqa: S105 - the name of a file
"""In the operator's folder."""
CONSOLE_SETTINGS = "console.yaml"
"""In the fleet's folder."""
IDENTITY = "ua-fleet/client"
"""In the operator's folder: where every `ua-fleet` command finds its certificate if XDG_STATE_HOME is that folder."""

CONSOLE_PORT: Final = 8080
BROKER_PORT: Final = 8883
_OPC_UA_PORT: Final = 4840
_MONITORING_PORT: Final = 9464
_KEY_LIFETIME_S: Final = 600
_ROSMASTER: Final = "http://rosmaster:11311"
_PORTS: Final = {"drone": "4841", "conveyor": "1502", "temperature_sensor": "/tmp/thermometer"}  # noqa: S108
"""Where what does not speak ROS is found on its host. /tmp is the container's own, and empty at its start."""
_TWO_HALLS: Final = {"belt": brokered.BELT_PORT, "quadcopter": brokered.QUADCOPTER_PORT}
_DOMAINS: Final = {"pioneer_1": 2, "pioneer_2": 3}
_MOBILE_DOMAIN: Final = 2
_FIRST_VENDOR_SPACE: Final = 300
LIMIT_S: Final = 60.0
"""So long an operator may think, who may not be there at all."""
_SPEED: Final = re.compile(r"\d{1,2}(\.\d+)?")
_NETWORK: Final = re.compile(r"\d{1,3}(\.\d{1,3}){2}")


@dataclass(frozen=True, slots=True)
class Options:
    """What a user chooses by the environment of `docker compose`."""

    speed: float = 1.0
    """Speed relative to the paper."""
    mode: Mode = "operator"
    """Who chooses a replacement."""
    published_host: str = "127.0.0.1"
    """Address of the host at which the server's port is published."""
    published_port: int = _OPC_UA_PORT
    network: str = "10.214.84"
    """First three bytes of the addresses of all containers."""
    console_port: int = CONSOLE_PORT
    """Port of loopback of the host at which the web console is published."""
    is_carried: bool = False
    """Whether bridges carry the run of the nine tasks."""

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Options:
        """Read the environment; raises ConfigError for what it cannot be."""
        usual = cls()

        def given(name: str, otherwise: object) -> str:
            return environment.get(f"UA_FLEET_{name}") or str(otherwise)

        speed, mode = given("SPEED", usual.speed), given("RESILIENCE", usual.mode)
        port, network = given("PORT", usual.published_port), given("NET", usual.network)
        if not (_SPEED.fullmatch(speed) and 0.1 <= float(speed) <= 20):
            raise _wrong("SPEED", speed, "a number from 0.1 to 20")
        if mode not in get_args(Mode):
            raise _wrong("RESILIENCE", mode, f"one of {', '.join(get_args(Mode))}")
        console_port = given("CONSOLE_PORT", usual.console_port)
        for name, number in (("PORT", port), ("CONSOLE_PORT", console_port)):
            if not (number.isdecimal() and 0 < int(number) < 65536):
                raise _wrong(name, number, "a TCP port")
        if not _NETWORK.fullmatch(network):
            raise _wrong("NET", network, "the first three numbers of a network's addresses, e.g. 10.214.84")
        host, run = given("PUBLISH", usual.published_host), given("MODE", "orchestrated")
        if run not in ("orchestrated", "carried"):
            raise _wrong("MODE", run, "orchestrated or carried")
        if run == "carried" and mode != "automatic":
            raise _wrong("RESILIENCE", mode, "automatic where UA_FLEET_MODE is carried")
        return cls(
            float(speed), cast("Mode", mode), host, int(port), network, int(console_port), is_carried=run == "carried"
        )


def _wrong(name: str, value: str, wanted: str) -> ConfigError:
    return ConfigError(f"{value!r} cannot be", file="environment", key=f"UA_FLEET_{name}", suggestion=f"give {wanted}")


@dataclass(frozen=True, slots=True)
class Testbed:
    """One of TESTBEDS."""

    name: str
    fleet: str
    """What fleet.yaml calls the fleet."""
    bridges: tuple[str, ...]
    robots: tuple[str, ...]
    """What `testbed robot` becomes."""
    ros1_address: int
    """Last byte of the address that its ROS 1 bridge has in the network of ROS 1; 0 where there is none."""
    server: str
    """The server's service."""
    conductor: str
    """The conductor's service."""
    has_modbus: bool = False
    has_broker: bool = False
    """Whether a part of it is reached by an MQTT broker alone, so that keys come from files."""
    scenario: str = ""
    """What its conductor runs; empty where robots begin by themselves."""
    tasks: int = 0
    """Of the scenario."""

    @property
    def console(self) -> str:
        """The web console's service."""
        return self.server.replace("server", CONSOLE)

    @property
    def volumes(self) -> tuple[str, ...]:
        """The folders that its processes keep something in."""
        return (
            FLEET,
            SERVER,
            *self.bridges,
            OPERATOR,
            CONSOLE,
            EVENTS,
            TRAFFIC,
            *([MODBUS] if self.has_modbus else []),
            *([BROKER] if self.has_broker else []),
        )

    def environment(self, process: str) -> dict[str, str]:
        """What the environment of a process, which is named by its folder, has for `fleet.yaml`."""
        return {brokered.PROCESS_VARIABLE: process} if self.has_broker else {}

    def files(self, options: Options) -> dict[str, str]:
        """What stands in the folder of the fleet, by path."""
        layout, console = self._layout(options), {CONSOLE_SETTINGS: self._console_text()}
        if self.name == "pal":
            return {"fleet.yaml": pal.fleet_text(layout, arm_space=1, mobile_space=_MOBILE_DOMAIN), **console}
        if self.has_broker:
            text = brokered.fleet_text(layout, f"mqtts://{BROKER}:{BROKER_PORT}", speed=options.speed)
            return {"fleet.yaml": text, f"scenarios/{self.scenario}.yaml": brokered.scenario_text(), **console}
        text = talkrobots.fleet_text(
            layout,
            _spaces(),
            {actor.name: actor.name for actor in ACTORS},
            _PORTS,
            speed=options.speed,
            mode=options.mode,
            limit_s=LIMIT_S,
            is_carried=options.is_carried,
        )
        return {"fleet.yaml": text, f"scenarios/{self.scenario}.yaml": talkrobots.scenario_text(), **console}

    def _console_text(self) -> str:
        """Of `console.yaml`: published on loopback of the host alone, so browsers need no TLS."""
        return settings_text(
            self.fleet,
            f"opc.tcp://server:{_OPC_UA_PORT}/ua_fleet",
            f"0.0.0.0:{CONSOLE_PORT}",
            f"../{CONSOLE}",
            allowed_hosts=["127.0.0.1", "localhost"],
            plain_http=True,
            monitoring_port=_MONITORING_PORT,
        )

    def _layout(self, options: Options) -> Layout:
        return Layout(
            written_by=f"testbed prepare {self.name}",
            server_port=_OPC_UA_PORT,
            pubsub_url=f"opc.udp://224.0.2.14:{_OPC_UA_PORT}",
            keys=f'{{lifetime_s: {_KEY_LIFETIME_S}, endpoint: "opc.tcp://server:{_OPC_UA_PORT}/ua_fleet"}}',
            master_uri=_ROSMASTER,
            ros1_host_ip=f"{options.network}.{self.ros1_address}",
            ros2_discovery="subnet",
            trusts_all_clients=False,
            server_host="0.0.0.0",
            server_state=f"../{SERVER}",
            bridges_state="..",
            modbus_state=f"../{MODBUS}",
            interface=f"{options.network}.0/26",
            monitoring_port=_MONITORING_PORT,
            modbus_host="0.0.0.0",
            modbus_writers=f"{options.network}.192/27, 127.0.0.1",
        )

    def robot(self, name: str, options: Options) -> tuple[list[str], dict[str, str]]:
        """What simulates a robot: arguments of a Python interpreter, and what is added to its environment."""
        if self.name == "pal":
            arguments = pal.robot_arguments(name, arm_space=1, mobile_space=_MOBILE_DOMAIN, speed=options.speed)
            return arguments, {} if name in pal.IN_ARM_SPACE else ros2_environment(_MOBILE_DOMAIN, "SUBNET")
        everywhere = "0.0.0.0"
        if self.has_broker:
            place = str(_TWO_HALLS[name])
            return brokered.ACTORS[name].arguments(space=0, host=everywhere, place=place, speed=options.speed), {}
        actor = next(actor for actor in ACTORS if actor.name == name)
        space = _spaces()[name]
        arguments = actor.arguments(space=space, host=everywhere, place=_PORTS.get(name, ""), speed=options.speed)
        return arguments, ros2_environment(space, "SUBNET") if actor.kind is Kind.ROS2 else {}


def _spaces() -> dict[str, int]:
    vendors = [actor.name for actor in ACTORS if not actor.kind.is_ros]
    return {"ridgeback": 1, **_DOMAINS, **{name: _FIRST_VENDOR_SPACE + at for at, name in enumerate(vendors)}}


TESTBEDS: Final = {
    "pal": Testbed("pal", "AssemblyLine", ("arm_side", "mobile_side"), pal.ROBOTS, 71, "server-pal", "line"),
    "talkrobots": Testbed(
        "talkrobots",
        "TalkRoBots",
        tuple(actor.bridge for actor in ACTORS),
        tuple(actor.name for actor in ACTORS),
        70,
        "server",
        "tasks",
        has_modbus=True,
        scenario=talkrobots.SCENARIO,
        tasks=TASKS,
    ),
    "brokered": Testbed(
        "brokered",
        "TwoHalls",
        ("hall_side", "yard_side"),
        tuple(brokered.ACTORS),
        0,
        "server-brokered",
        "flights",
        has_broker=True,
        scenario=brokered.SCENARIO,
        tasks=brokered.TASKS,
    ),
}
