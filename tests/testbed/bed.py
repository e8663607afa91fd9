"""A project of its own for one run: images, free addresses and ports, up and down."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, Final

from tests.testbed import checks
from tests.testbed.engine import ROOT, CommandFailed, Compose, Container, docker, run

__all__ = ["LOGS", "Bed", "CannotStart", "Missing", "make_bed", "say"]

PROJECT: Final = "ua-fleet-testbed-check"
LOGS: Final = ROOT / "build" / "testbed"
_NETWORKS: Final = tuple(f"10.214.{number}" for number in range(85, 125))
_BUILD_S: Final = 1800.0
_UP_S: Final = 300.0
_LOOK_S: Final = 0.5


class Missing(Exception):
    """This machine lacks something; one line for each."""


class CannotStart(Exception):
    """The testbed did not come up, or not to its end."""


def say(text: str) -> None:
    """Tell people what goes on."""
    print(f"testbed: {text}", flush=True)


class Bed:
    """The testbed of one run; its options are those of `compose.yaml`."""

    def __init__(self, command: tuple[str, ...], options: dict[str, str]) -> None:
        """Made by `make_bed`."""
        self.command, self.options = command, options

    def compose(self, profile: str, **options: str) -> Compose:
        """Compose for a profile, with options beside the run's own."""
        return Compose(self.command, PROJECT, profile, {**self.options, **options})

    @property
    def port(self) -> int:
        """Of the OPC UA server on this machine."""
        return int(self.options["UA_FLEET_PORT"])

    @property
    def modbus_port(self) -> int:
        """Of the Modbus server on this machine."""
        return int(self.options["UA_FLEET_MODBUS_PORT"])

    def build(self) -> None:
        """Build all images, as a user does."""
        begun = time.monotonic()
        self.compose("talkrobots,brokered")("build", timeout_s=_BUILD_S)
        say(f"images built in {time.monotonic() - begun:.0f} s")

    @contextmanager
    def up(self, profile: str, *, keep: bool = False, **options: str) -> Generator[Compose]:
        """A profile that is up while the context lasts; its containers' logs are kept where something fails."""
        compose = self.compose(profile, **options)
        compose.down()
        try:
            begun = time.monotonic()
            compose("up", "--detach", "--no-build", timeout_s=_UP_S)
            say(f"{profile}: {len(compose.containers())} containers started in {time.monotonic() - begun:.0f} s")
            yield compose
        except BaseException:
            with contextlib.suppress(CommandFailed):
                compose.keep_logs(LOGS / profile)
                say(f"{profile}: what all containers have said stands in {LOGS / profile}")
            raise
        finally:
            if keep:
                say(f"{profile} stays up: {' '.join(compose.command)} -p {PROJECT} --profile {profile} ...")
            else:
                compose.down()

    def result(self, compose: Compose, conductor: str, timeout_s: float) -> dict[str, Any]:
        """What the conductor writes at the end of the demonstration; raises CannotStart where that does not come."""
        deadline = time.monotonic() + timeout_s
        container: Container | None = None
        while time.monotonic() < deadline:
            with contextlib.suppress(CommandFailed, ValueError):
                container = container or compose.container(conductor)
                read: dict[str, Any] = json.loads(container.execute("cat", "/var/lib/ua-fleet/operator/result.json"))
                return read
            time.sleep(_LOOK_S)
        last = container.logs().splitlines()[-3:] if container is not None else []
        raise CannotStart(f"{conductor} has written no result within {timeout_s:g} s: {' / '.join(last)}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def make_bed() -> Bed:
    """Check this machine, make the base image where that is possible, and choose what is free; raises Missing."""
    given = os.environ.get("COMPOSE", "")
    ports = (
        ("UA_FLEET_PORT", _free_port()),
        ("UA_FLEET_MODBUS_PORT", _free_port()),
        ("UA_FLEET_CONSOLE_PORT", _free_port()),
    )
    needs = _on_free_network(ports, given)
    _ensure_base(needs)
    command, _ = checks.compose_command(given, checks.ask)
    options = {
        "UA_FLEET_NET": needs.network,
        "UA_FLEET_TAG": "check",
        "UA_FLEET_BASE": needs.base,
        **{name: str(port) for name, port in ports},
        **{name: os.environ[name] for name in ("PIP_INDEX_URL", "NPM_CONFIG_REGISTRY") if os.environ.get(name)},
    }
    return Bed(command, options)


def _on_free_network(ports: tuple[tuple[str, int], ...], compose: str) -> checks.Needs:
    found: list[str] = []
    for network in _NETWORKS:
        needs = checks.Needs(PROJECT, network, ports=ports)
        found = checks.problems(needs, compose, checks.ask)
        if not found:
            return needs
        if not any("UA_FLEET_NET" in problem for problem in found):
            break
    raise Missing("\n".join(found))


def _ensure_base(needs: checks.Needs) -> None:
    problem = checks.base_problem(needs, checks.ask)
    if problem is None:
        return
    script = ROOT / "scripts" / "testbed-base"
    if os.geteuid() != 0 or not script.exists():
        raise Missing(problem)
    say(f"making the base image {needs.base}: it cannot be pulled")
    try:
        run(str(script), timeout_s=_BUILD_S)
    except CommandFailed as error:
        raise Missing(f"{problem}; here it failed: {str(error).splitlines()[-1]}") from error


def versions(bed: Bed) -> dict[str, str]:
    """Of the engine and Compose."""
    said = checks.ask([*bed.command, "version", "--short"])
    return {
        "Docker": docker("version", "--format", "{{.Server.Version}}").strip(),
        " ".join(bed.command): said.output if said is not None else "?",
    }
