"""What is done to containers: killed, paused, or cut from their networks."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from tests.testbed.engine import CommandFailed, Container, docker

__all__ = ["ABSENCE_S", "CONDUCTOR", "GATEWAY", "KINDS", "Deed", "Kind", "disturbance"]

ABSENCE_S: Final = 10.0
"""How long a container is paused, or cut off."""

# `docker kill` counts as a manual stop, after which the engine starts nothing: the process is killed from inside.
_KILL: Final = "import os, signal; os.kill(-1, signal.SIGKILL)"
_STARTS_WITHIN_S: Final = 30.0


class Deed(StrEnum):
    """What is done."""

    KILL = "killed"
    PAUSE = "paused"
    CUT = "cut off"


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of container, and the one of it that is disturbed."""

    name: str
    service: str
    robots: tuple[str, ...] = ()
    """Whose skills have to work again."""
    also: tuple[str, ...] = ()
    """Other services whose health check has to pass."""


GATEWAY: Final = "plc-gateway"
"""Modbus clients on this machine have to reach it again."""
CONDUCTOR: Final = "tasks"
"""It has to be connected to the server again."""
ALL_ROBOTS: Final = ("ridgeback", "ur3", "pioneer_1", "pioneer_2", "drone", "conveyor", "temperature_sensor")

KINDS: Final = (
    Kind("OPC UA server", "server", ALL_ROBOTS, (GATEWAY, CONDUCTOR)),
    Kind("ROS master", "rosmaster", ("ridgeback",), ("ridgeback-bridge",)),
    Kind("ROS 1 bridge", "ridgeback-bridge", ("ridgeback",)),
    Kind("ROS 2 bridge", "pioneer-1-bridge", ("pioneer_1",)),
    Kind("UR bridge", "ur3-bridge", ("ur3",)),
    Kind("Modbus bridge", "conveyor-bridge", ("conveyor",)),
    Kind("TCP bridge", "drone-bridge", ("drone",)),
    Kind("bridge of a plugged-in device", "temperature-sensor-bridge", ("temperature_sensor",)),
    Kind("Modbus server", GATEWAY),
    Kind("web console", "console"),
    Kind("conductor", CONDUCTOR),
    Kind("ROS 1 robot", "ridgeback", ("ridgeback",), ("ridgeback-bridge",)),
    Kind("ROS 2 robot", "pioneer-1", ("pioneer_1",), ("pioneer-1-bridge",)),
    Kind("UR controller", "ur3", ("ur3",), ("ur3-bridge",)),
    Kind("PLC", "conveyor", ("conveyor",), ("conveyor-bridge",)),
    Kind("TCP robot", "drone", ("drone",), ("drone-bridge",)),
)


class Killed:
    """All processes of a container get SIGKILL; the engine starts it again."""

    def __init__(self, container: Container) -> None:
        """Of which container."""
        self._container = container
        self._before = str(container.inspect()["State"]["StartedAt"])

    def begin(self) -> None:
        """Kill."""
        try:
            self._container.python(_KILL)
        except CommandFailed as error:
            if "exit code 137" not in str(error):  # it may be killed with the rest
                raise

    def end(self) -> None:
        """Wait until the engine has started it again; raises CommandFailed where it does not."""
        deadline = time.monotonic() + _STARTS_WITHIN_S
        while time.monotonic() < deadline:
            state = self._container.inspect()["State"]
            if state["Running"] and state["StartedAt"] != self._before:
                return
            time.sleep(0.1)
        raise CommandFailed(f"{self._container.service} was killed, and the engine has not started it again")


class Paused:
    """The processes stand, as on a machine that has hung; its network is there."""

    def __init__(self, container: Container) -> None:
        """Of which container."""
        self._container = container

    def begin(self) -> None:
        """Freeze it."""
        docker("pause", self._container.id)

    def end(self) -> None:
        """Let it go on."""
        docker("unpause", self._container.id)


class Cut:
    """Its network interfaces are taken away, and given back with the same addresses and names."""

    def __init__(self, container: Container) -> None:
        """Of which container."""
        self._container = container
        found = container.inspect()
        self._id = str(found["Id"])
        self._networks: Mapping[str, Mapping[str, Any]] = found["NetworkSettings"]["Networks"]

    def begin(self) -> None:
        """Take them away."""
        for network in self._networks:
            docker("network", "disconnect", network, self._id)

    def end(self) -> None:
        """Give them back."""
        for network, joined in self._networks.items():
            names: Sequence[str] = joined["Aliases"] or ()
            aliases = [word for name in names if not self._id.startswith(name) for word in ("--alias", name)]
            address = joined["IPAMConfig"]["IPv4Address"]
            docker("network", "connect", "--ip", address, *aliases, network, self._id)


def disturbance(deed: Deed, container: Container) -> Killed | Paused | Cut:
    """A deed that can be begun and ended."""
    match deed:
        case Deed.KILL:
            return Killed(container)
        case Deed.PAUSE:
            return Paused(container)
        case Deed.CUT:
            return Cut(container)
