"""`ua-fleet up`: the server, all bridges and all relays of a fleet in one terminal, for trying."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import sys
from asyncio.subprocess import Process
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

import typer

from ua_fleet.cli.endings import EXIT_FAILED, NotFound, extra_needed
from ua_fleet.cli.log_lines import readable
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, load_config
from ua_fleet.cli.output import message
from ua_fleet.cli.process import run
from ua_fleet.cli.screen import ColorWhen, has_colours
from ua_fleet.printing import config_option, harmless

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig

__all__ = ["EXAMPLES", "up"]

EXAMPLES = ("ua-fleet up", "ua-fleet up floor -c hall2.yaml")

_Result = TypeVar("_Result")

_ROS1: Final = "ros1"
"""The kind of bridge that has an interpreter of its own (docs/install.md)."""
_READY: Final = "ready: "
_COLORS: Final = (36, 33, 32, 35, 34, 96, 93, 92, 95, 94)
"""SGR codes of the processes' names."""


def up(
    bridges: Annotated[
        list[str] | None, typer.Argument(help="Only these bridges and relays; without names, all of the file.")
    ] = None,
    config: Config = DEFAULT_CONFIG,
) -> None:
    """Run the server, all bridges and all relays of a fleet in this terminal until Ctrl-C, for trying.

    Each is a process of its own, as with `ua-fleet serve`, `ua-fleet bridge` and `ua-fleet pubsub relay`, and its lines
    begin with its name. If one cannot run here, or ends, a line gives the reason, and the others go on. A bridge or
    relay that needs a certificate to get its keys, and has none yet, gets one that the server trusts. For permanent
    operation, run each as a service.
    """
    fleet = load_config(config)
    known = (*fleet.bridges, *fleet.relays)
    wanted = tuple(dict.fromkeys(bridges or known))
    if unknown := [name for name in wanted if name not in known]:
        there = ", ".join(known) or "none"
        raise NotFound(f"{config}: there is no bridge or relay {unknown[0]!r}; there are: {there}")
    run(_up(fleet, config, config.resolve().parent, wanted))


async def _up(fleet: FleetConfig, config: Path, folder: Path, wanted: Sequence[str]) -> None:
    await _introduce(fleet, folder, wanted)
    shown = _Shown(["server", *wanted])

    def told(ended: _Running) -> None:
        reason = f": {ended.last}" if ended.last else ""
        message(
            f"{_kind_of(fleet, ended.name)} {ended.name} {ended.how}{reason}; the others go on; to start it again, in "
            f"another terminal: ua-fleet {' '.join(_command_of(fleet, ended.name))}{config_option()}"
        )

    server = _Running("server", shown)
    running: list[_Running] = []
    try:
        await server.start([sys.executable, "-m", "ua_fleet.cli", "serve", "--config", str(config)])
        if (endpoint := await shown.while_read(server.ready())) is None:
            raise typer.Exit(server.code or EXIT_FAILED)
        _tell_how_to_log_in(fleet, folder, endpoint)
        for name in wanted:
            python = sys.executable if name in fleet.relays else _python_of(fleet.bridges[name].kind)
            if python is None:
                message(
                    f"bridge {name} is not started: it needs rospy, and no interpreter with it was found; run: "
                    "make setup, or name one with UA_FLEET_ROS1_PYTHON (docs/install.md)"
                )
                continue
            bridge = _Running(name, shown, told)
            running.append(bridge)
            await bridge.start([python, "-m", "ua_fleet.cli", *_command_of(fleet, name), "--config", str(config)])
        await shown.while_read(server.ended())
        message(f"the server {server.how}, and the bridges with it")
        raise typer.Exit(server.code or EXIT_FAILED)
    finally:
        await asyncio.gather(*(bridge.end() for bridge in running))
        await server.end()


async def _introduce(fleet: FleetConfig, folder: Path, wanted: Sequence[str]) -> None:
    """Give the bridges certificates by which the server knows them, where they need one and have none."""
    if not fleet.is_secured or not fleet.pubsub.keys.from_server:
        return
    with extra_needed("the server", "server"):
        from ua_fleet.client import ClientIdentity
        from ua_fleet.client.shared_certificate import why_not_its_own
        from ua_fleet.server.mutual_trust import introduce_bridge

    for name in wanted:
        if not ClientIdentity.of_bridge(folder / fleet.state_dir_of(name), fleet.fleet.name, name).certificate.exists():
            await introduce_bridge(fleet, folder, name)
            message(f"{_kind_of(fleet, name)} {name} has a certificate now, and the server knows it")
        elif problem := why_not_its_own(fleet, folder, name):
            message(f"{_kind_of(fleet, name)} {name} will get no keys: {problem}")


def _kind_of(fleet: FleetConfig, name: str) -> str:
    return "relay" if name in fleet.relays else "bridge"


def _command_of(fleet: FleetConfig, name: str) -> list[str]:
    """What runs a bridge or a relay."""
    return ["pubsub", "relay", name] if name in fleet.relays else ["bridge", name]


def _python_of(kind: str) -> str | None:
    """The interpreter for a kind of bridge; None where there is none."""
    from ua_fleet.bridge.launch import find_ros1_python

    if kind != _ROS1 or importlib.util.find_spec("rospy") is not None:
        return sys.executable
    found = find_ros1_python(os.environ)
    return str(found) if found is not None else None


def _tell_how_to_log_in(fleet: FleetConfig, folder: Path, endpoint: str) -> None:
    from ua_fleet.endpoint.users import USERS_FILE, UserStore

    users = UserStore(folder / fleet.server.state_dir / USERS_FILE).list()
    message(f"endpoint: {endpoint}  (UaExpert: Basic256Sha256, Sign & Encrypt)")
    if users:
        names = ", ".join(f"{user.name} ({user.role.value})" for user in users)
        message(f"users: {names}; in another terminal: ua-fleet login {endpoint} --user {users[0].name}")
    elif fleet.server.allow_anonymous:
        message(f"in another terminal: ua-fleet browse -e {endpoint}")
    else:
        message(
            f"no user exists yet; in another terminal: ua-fleet user add NAME --role operator{config_option()}, "
            f"and then: ua-fleet login {endpoint} --user NAME"
        )


class _Shown:
    """Prints the lines of processes, each with the name of its process before it."""

    def __init__(self, names: Sequence[str]) -> None:
        self._width = max(map(len, names))
        colours = has_colours(ColorWhen.AUTO)
        self._colors = {name: _COLORS[at % len(_COLORS)] for at, name in enumerate(names)} if colours else {}
        self._gone: asyncio.Future[OSError] = asyncio.get_running_loop().create_future()
        """Done with the reason when nobody reads stdout any more."""

    def line(self, name: str, text: str) -> None:
        """Print one, where somebody still reads them."""
        if self._gone.done():
            return
        before = f"{harmless(name):<{self._width}} |"
        if name in self._colors:
            before = f"\x1b[{self._colors[name]}m{before}\x1b[0m"
        try:
            sys.stdout.write(f"{before} {harmless(text)}\n".replace(" \n", "\n"))
            sys.stdout.flush()
        except OSError as error:
            self._gone.set_result(error)

    async def while_read(self, work: Coroutine[None, None, _Result]) -> _Result:
        """Wait for something as long as somebody reads the lines; raises the OSError of writing them."""
        task = asyncio.ensure_future(work)
        try:
            both: tuple[asyncio.Future[Any], ...] = task, self._gone
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            if self._gone.done():
                raise self._gone.result()
            return task.result()
        finally:
            task.cancel()


class _Running:
    """One process, whose lines are shown as they come."""

    def __init__(self, name: str, shown: _Shown, on_end: Callable[[_Running], None] | None = None) -> None:
        """Prepare to start it; `on_end` is told when it ends by itself."""
        self.name = name
        self.last = ""
        """The last line that it wrote."""
        self._shown, self._on_end = shown, on_end
        self._process: Process | None = None
        self._reader: asyncio.Task[None] | None = None
        self._endpoint: asyncio.Future[str | None] = asyncio.get_running_loop().create_future()

    @property
    def code(self) -> int | None:
        """With what it ended."""
        return self._process.returncode if self._process is not None else None

    @property
    def how(self) -> str:
        """How it ended, for people."""
        from ua_fleet.bridge.children import how_it_ended

        return how_it_ended(self.code or 0)

    async def start(self, args: Sequence[str]) -> None:
        """Start it."""
        from ua_fleet.bridge.children import start_child
        from ua_fleet.bridge.launch import child_environment

        self._process = await start_child(args, child_environment(os.environ))
        self._reader = asyncio.create_task(self._read(self._process), name=f"output of {self.name}")

    async def _read(self, process: Process) -> None:
        assert process.stdout is not None
        while True:
            try:
                raw = await process.stdout.readline()
            except ValueError:
                self._shown.line(self.name, "(a line that is too long)")
                continue
            if not raw:
                break
            for line in readable(raw.decode(errors="replace").rstrip("\n")):
                self.last = line or self.last
                self._shown.line(self.name, line)
                if line.startswith(_READY) and not self._endpoint.done():
                    self._endpoint.set_result(line.removeprefix(_READY))
        await process.wait()
        if not self._endpoint.done():
            self._endpoint.set_result(None)
        if self._on_end is not None:
            self._on_end(self)

    async def ready(self) -> str | None:
        """What it says when it is ready; None where it has ended."""
        return await self._endpoint

    async def ended(self) -> None:
        """Wait until it has ended, and all that it wrote is shown."""
        assert self._reader is not None
        await asyncio.shield(self._reader)

    async def end(self) -> None:
        """End it, where it was started."""
        from ua_fleet.bridge.children import end_child

        self._on_end = None
        if self._process is not None and self._reader is not None:
            await end_child(self._process)
            await self._reader
