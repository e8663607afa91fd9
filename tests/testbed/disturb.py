"""What is done to containers: killed, paused, cut from their networks, stopped, or robbed of what they have kept."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from tests.testbed.engine import CommandFailed, Container, docker

__all__ = ["ABSENCE_S", "ALWAYS", "Deed", "Kind", "disturbance"]

ABSENCE_S: Final = 10.0
"""How long a container is paused, or cut off."""

# `docker kill` counts as a manual stop, after which the engine starts nothing: the process is killed from inside.
_KILL: Final = "import os, signal; os.kill(-1, signal.SIGKILL)"
# One that finds nothing there would prove nothing.
_FORGET: Final = """
import pathlib, sys
kept = list(pathlib.Path(sys.argv[1]).iterdir())
for file in kept:
    file.unlink()
sys.exit(not kept)
"""
_STARTS_WITHIN_S: Final = 30.0


class Deed(StrEnum):
    """What is done."""

    KILL = "killed"
    PAUSE = "paused"
    CUT = "cut off"
    STOP = "stopped"
    FORGET = "robbed of its state"


ALWAYS: Final = (Deed.KILL, Deed.PAUSE, Deed.CUT)
"""What is done to every kind."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of container, and the one of it that is disturbed."""

    name: str
    service: str
    robots: tuple[str, ...] = ()
    """Whose skills have to work again."""
    also: tuple[str, ...] = ()
    """Other services whose health check has to pass."""
    deeds: tuple[Deed, ...] = ALWAYS
    silenced: tuple[str, ...] = ()
    """Robots of which no value may be Good at the end of an absence."""
    spared: tuple[str, ...] = ()
    """Robots whose values stay Good, and which are asked and work on meanwhile."""
    state: str = ""
    """Folder of what it keeps, for Deed.FORGET."""


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


class Stopped:
    """It is asked to end, and started again by hand."""

    def __init__(self, container: Container, forgotten: str = "") -> None:
        """Of which container; what is in the folder `forgotten` is removed meanwhile."""
        self._container, self._forgotten = container, forgotten

    def begin(self) -> None:
        """Stop it."""
        docker("stop", "--time", "10", self._container.id)
        if self._forgotten:
            image = str(self._container.inspect()["Image"])
            where = ("run", "--rm", "--network", "none", "--volumes-from", self._container.id)
            docker(*where, image, "python3", "-c", _FORGET, self._forgotten)

    def end(self) -> None:
        """Start it."""
        docker("start", self._container.id)


def disturbance(deed: Deed, container: Container, state: str = "") -> Killed | Paused | Cut | Stopped:
    """A deed that can be begun and ended; `state` is the folder of what the container keeps."""
    match deed:
        case Deed.KILL:
            return Killed(container)
        case Deed.PAUSE:
            return Paused(container)
        case Deed.CUT:
            return Cut(container)
        case Deed.STOP:
            return Stopped(container)
        case Deed.FORGET:
            return Stopped(container, state)
