"""What the testbed needs of a machine: each that is missing in one line, with the remedy.

    python3 -m tests.testbed.checks        (make testbed-check)

Nothing but the standard library, and nothing of this project, is imported: who starts the testbed by hand has no
environment for Python. Options are those of `compose.yaml`, in the shell or in `.env`.
"""

from __future__ import annotations

import ipaddress
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

__all__ = ["Needs", "compose_command", "engine_problem", "is_port_free", "overlapping", "problems", "read_options"]

ROOT: Final = Path(__file__).resolve().parents[2]
OLDEST_PLUGIN: Final = (2, 0, 0)
OLDEST_ALONE: Final = (1, 29, 2)
ROOM_BYTES: Final = 4 * 1024**3
"""For building all images; they take less than half of that in the end."""
BASE: Final = "debian:bookworm-slim"
_PATIENCE_S: Final = 30.0


@dataclass(frozen=True, slots=True)
class Said:
    """How a program ended, and what it said."""

    code: int
    output: str
    errors: str


Ask = Callable[[Sequence[str]], Said | None]
"""Runs a program; None where there is none of that name."""


def ask(command: Sequence[str]) -> Said | None:
    """See Ask."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_PATIENCE_S, check=False
        )
    except FileNotFoundError:
        return None
    except subprocess.TimeoutExpired:
        return Said(-1, "", f"no answer within {_PATIENCE_S:g} s")
    return Said(done.returncode, done.stdout.strip(), done.stderr.strip())


@dataclass(frozen=True, slots=True)
class Needs:
    """What a testbed takes of the machine; see the options of `compose.yaml`."""

    project: str
    network: str = "10.214.84"
    host: str = "127.0.0.1"
    ports: tuple[tuple[str, int], ...] = (
        ("UA_FLEET_PORT", 4840),
        ("UA_FLEET_MODBUS_PORT", 1502),
        ("UA_FLEET_CONSOLE_PORT", 8080),
    )
    """Each with the option that says which."""
    base: str = BASE


def engine_problem(said: Said | None) -> str | None:
    """What is wrong with the engine, by what `docker version --format {{.Server.Version}}` said."""
    if said is None:
        return "docker is not installed; as root: apt-get install docker.io"
    if said.code == 0:
        return None
    if "permission denied" in said.errors.lower():
        return (
            "this user may not use the Docker engine; as root: usermod -aG docker "
            f"{os.environ.get('USER', 'NAME')}, then log in again"
        )
    if "Cannot connect" in said.errors or "Is the docker daemon running" in said.errors:
        return "the Docker engine does not run; as root: systemctl start docker"
    return f"the Docker engine does not answer ({_last_line(said)}); look with: docker info"


def _last_line(said: Said) -> str:
    lines = (said.errors or said.output).splitlines()
    return lines[-1] if lines else f"exit code {said.code}"


def version_of(text: str) -> tuple[int, ...] | None:
    """The first three numbers of a version such as `v2.26.1-4`."""
    found = re.match(r"v?(\d+)\.(\d+)(?:\.(\d+))?", text.strip())
    return None if found is None else tuple(int(number or 0) for number in found.groups())


def compose_command(given: str, ask: Ask) -> tuple[tuple[str, ...], str | None]:
    """Which Compose to use: the plugin before `docker-compose`. What is wrong where there is none.

    Args:
        given: as the user wants it, e.g. `docker-compose`; empty: whichever there is.
        ask: runs programs.
    """
    kinds = [tuple(given.split())] if given else [("docker", "compose"), ("docker-compose",)]
    old = ""
    for command in kinds:
        said = ask([*command, "version", "--short"])
        version = version_of(said.output) if said is not None and said.code == 0 else None
        if version is None:
            continue
        is_plugin = command[-1] == "compose"
        oldest = OLDEST_PLUGIN if is_plugin or version >= OLDEST_PLUGIN else OLDEST_ALONE
        if version >= oldest:
            return command, None
        old = old or f"{' '.join(command)} is {'.'.join(map(str, version))}, and {'.'.join(map(str, oldest))} is needed"
    remedy = "as root: apt-get install docker-compose (1.29.2 or later), or install the plugin docker-compose-plugin"
    problem = old or f"{given or 'docker compose'} is not installed"
    return kinds[0], f"{problem}; {remedy}"


def is_port_free(host: str, port: int) -> bool:
    """Whether somebody can listen there."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True


def overlapping(network: str, others: Iterable[tuple[str, str]]) -> list[str]:
    """The names of those networks that share addresses with a testbed's.

    Args:
        network: the first three numbers of its addresses.
        others: name and subnet of each.
    """
    ours = ipaddress.ip_network(f"{network}.0/24")
    found: list[str] = []
    for name, subnet in others:
        try:
            other = ipaddress.ip_network(subnet, strict=False)
        except ValueError:
            continue
        if other.prefixlen and other.version == ours.version and ours.overlaps(other):
            found.append(name)
    return found


def routed(table: str) -> list[tuple[str, str]]:
    """Interface and subnet of each route of `/proc/net/route`."""
    found: list[tuple[str, str]] = []
    for line in table.splitlines()[1:]:
        fields = line.split()
        if len(fields) < 8:
            continue
        address, mask = (ipaddress.ip_address(int(fields[at], 16).to_bytes(4, "little")) for at in (1, 7))
        found.append((fields[0], f"{address}/{mask}"))
    return found


def _subnet_problem(needs: Needs, ask: Ask) -> str | None:
    listed = ask(["docker", "network", "ls", "--quiet"])
    ids = listed.output.split() if listed is not None and listed.code == 0 else []
    form = (
        '{{.Name}} {{index .Labels "com.docker.compose.project"}}'
        "{{range .IPAM.Config}} {{.Subnet}}{{end}} {{slice .Id 0 12}}"
    )
    shown = ask(["docker", "network", "inspect", "--format", form, *ids]) if ids else None
    networks: list[tuple[str, str]] = []
    own: set[str] = set()
    for line in (shown.output if shown is not None else "").splitlines():
        name, *words = line.split()
        if words[:1] == [needs.project]:
            own.add(f"br-{words[-1]}")
            continue
        networks += [(f"the Docker network {name}", word) for word in words if "/" in word]
    known = {subnet for _, subnet in networks}
    try:
        table = Path("/proc/net/route").read_text(encoding="ascii")
    except OSError:
        table = ""
    bridges = re.compile(r"br-[0-9a-f]{12}|docker\d+")
    networks += [
        (f"interface {interface}", subnet)
        for interface, subnet in routed(table)
        if subnet not in known and interface not in own and not bridges.fullmatch(interface)
    ]
    taken = overlapping(needs.network, networks)
    if not taken:
        return None
    return (
        f"the addresses {needs.network}.0/24 are those of {taken[0]}; "
        "set UA_FLEET_NET to the first three numbers of free ones, e.g. UA_FLEET_NET=10.215.16"
    )


def _port_problems(needs: Needs, ask: Ask) -> list[str]:
    held = ask(
        ["docker", "ps", "--filter", f"label=com.docker.compose.project={needs.project}", "--format", "{{.Ports}}"]
    )
    ours = held.output if held is not None and held.code == 0 else ""
    return [
        f"port {port} of {needs.host} is in use (who: ss -ltnp 'sport = :{port}'); end that, or set {option}"
        for option, port in needs.ports
        if f":{port}->" not in ours and not is_port_free(needs.host, port)
    ]


def _room_problem(ask: Ask) -> str | None:
    said = ask(["docker", "info", "--format", "{{.DockerRootDir}}"])
    folder = Path(said.output if said is not None and said.code == 0 and said.output else "/var/lib/docker")
    while not folder.exists():
        folder = folder.parent
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return None  # an engine on another machine
    if free >= ROOM_BYTES:
        return None
    return (
        f"{free / 1024**3:.1f} GB are free in {folder}, and building takes {ROOM_BYTES / 1024**3:.0f}; make room: "
        "docker builder prune, docker image prune"
    )


def base_problem(needs: Needs, ask: Ask) -> str | None:
    """Why the base image can neither be used nor pulled; pulls it where that is possible."""
    there = ask(["docker", "image", "inspect", "--format", "{{.Id}}", needs.base])
    if there is not None and there.code == 0:
        return None
    pulled = ask(["docker", "pull", "--quiet", needs.base])
    if pulled is not None and pulled.code == 0:
        return None
    why = _last_line(pulled) if pulled is not None else "no docker"
    return f"the image {needs.base} is not here and cannot be pulled ({why}); as root, make it: scripts/testbed-base"


def problems(needs: Needs, compose: str, ask: Ask) -> list[str]:
    """All that is missing, but for the base image; nothing else is asked where there is no engine."""
    engine = engine_problem(ask(["docker", "version", "--format", "{{.Server.Version}}"]))
    if engine is not None:
        return [engine]
    found = [compose_command(compose, ask)[1], _subnet_problem(needs, ask), _room_problem(ask)]
    return [problem for problem in (*found, *_port_problems(needs, ask)) if problem is not None]


def read_options(environment: Mapping[str, str], file: str) -> dict[str, str]:
    """The options of `compose.yaml`: those of the shell before those of a file `.env`, which is given as text."""
    read: dict[str, str] = {}
    for line in file.splitlines():
        name, is_option, value = line.partition("=")
        if is_option and not line.lstrip().startswith("#"):
            read[name.strip()] = value.strip().strip("\"'")
    return {**read, **{name: value for name, value in environment.items() if value}}


def _needs(options: Mapping[str, str]) -> Needs:
    usual = Needs(options.get("COMPOSE_PROJECT_NAME") or re.sub(r"[^a-z0-9_-]", "", ROOT.name.lower()))
    ports: list[tuple[str, int]] = []
    for option, otherwise in usual.ports:
        given = options.get(option, str(otherwise))
        if not (given.isdecimal() and 0 < int(given) < 65536):
            raise SystemExit(f"{option} is {given!r}; give a TCP port")
        ports.append((option, int(given)))
    network = options.get("UA_FLEET_NET", usual.network)
    try:
        ipaddress.ip_network(f"{network}.0/24")
    except ValueError:
        raise SystemExit(f"UA_FLEET_NET is {network!r}; give three numbers, e.g. 10.214.84") from None
    host = options.get("UA_FLEET_PUBLISH", usual.host)
    return Needs(usual.project, network, host, tuple(ports), options.get("UA_FLEET_BASE", BASE))


def main() -> int:
    """Check this machine for who starts the testbed by hand."""
    file = ROOT / ".env"
    options = read_options(os.environ, file.read_text(encoding="utf-8") if file.exists() else "")
    needs = _needs(options)
    found = problems(needs, options.get("COMPOSE", ""), ask)
    if not found and (problem := base_problem(needs, ask)):
        found.append(problem)
    for problem in found:
        print(f"testbed: {problem}", file=sys.stderr)
    if not found:
        command, _ = compose_command(options.get("COMPOSE", ""), ask)
        print(f"this machine can run the testbed: {' '.join(command)} --profile talkrobots up")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
