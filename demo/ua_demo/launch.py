"""Starts what each demonstration has: server with user, web console, ROS master, bridges, and robots' programs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Final

from ua_demo.broker import BROKER, find_broker
from ua_demo.broker import settings_text as broker_settings
from ua_demo.console import CONSOLE, introduce_console, settings_text
from ua_demo.processes import Processes
from ua_demo.site import ENGINEER, USER, Site
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.config.load import load
from ua_fleet.endpoint.users import Role, UserStore
from ua_fleet.server.mutual_trust import introduce_bridge

__all__ = ["START_TIMEOUT_S", "Launch"]

START_TIMEOUT_S: Final = 60.0


class Launch:
    """See the module."""

    def __init__(self, site: Site, processes: Processes, cli_options: Sequence[str] = ()) -> None:
        """Prepare to start.

        Args:
            site: where.
            processes: keeps what was started, and ends it.
            cli_options: further options of `ua-fleet serve` and `ua-fleet bridge`.
        """
        self._site, self._processes, self._cli_options = site, processes, cli_options

    async def prepare(self) -> None:
        """Make the users, the console's certificate, and those of bridges where they need them."""
        site = self._site
        state = site.folder / "state"
        state.mkdir(mode=0o700, exist_ok=True)
        store = UserStore(state / "users.yaml")
        for user, role in ((USER, Role.OPERATOR), (ENGINEER, Role.ENGINEER)):
            await asyncio.to_thread(store.add, user, site.password, role, replace_existing=True)
        if site.console_port is not None:
            await introduce_console(state, site.folder / CONSOLE)
        if site.secure:
            config = load(site.config_file)
            for bridge in config.bridges:
                await introduce_bridge(config, site.folder, bridge)

    async def master(self) -> None:
        """Start the ROS master, and wait until it listens: rospy nodes do not wait for it."""
        port = self._site.master_port
        command = ["/usr/bin/env", "rosmaster", "--core", "-p", str(port), "-w", "3"]
        await self._processes.start("rosmaster", command, self._site.environment(None))
        await self._processes.listening("rosmaster", port, START_TIMEOUT_S)

    async def broker(self) -> None:
        """Start the MQTT broker, where the demonstration has one, and wait until it listens."""
        site = self._site
        if site.broker_port is None:
            return
        settings = site.folder / "mosquitto.conf"
        settings.write_text(broker_settings(site.broker_port), encoding="utf-8")
        await self._processes.start(BROKER, [find_broker(), "-c", settings], site.environment(None))
        await self._processes.listening(BROKER, site.broker_port, START_TIMEOUT_S)

    async def server(self, *options: str) -> None:
        """Start the server."""
        await self._cli("server", 2, "serve", *options)

    async def console(self) -> None:
        """Start the web console, where there is one, and wait until it answers. It needs no server for that."""
        site = self._site
        if site.console_port is None:
            return
        listen, settings = f"127.0.0.1:{site.console_port}", site.folder / "console.yaml"
        fleet = load(site.config_file).fleet.name
        text = settings_text(fleet, site.endpoint, listen, str(site.folder / CONSOLE))
        settings.write_text(text, encoding="utf-8")
        command = [site.python(2), "-m", "ua_fleet.cli", "console", "--config", str(settings)]
        await self._processes.start(CONSOLE, command, site.environment(None))
        await self.ready(CONSOLE)

    async def bridge(self, name: str, ros: int, *options: str) -> None:
        """Start a bridge, in the interpreter for ROS 1 or 2."""
        await self._cli(name, ros, "bridge", name, *options)

    async def ready(self, *names: str) -> None:
        """Wait until the server and bridges say that they work."""
        for name in names:
            await self._processes.line_with(name, "ready", START_TIMEOUT_S)

    async def robot(
        self,
        name: str,
        arguments: Sequence[str],
        domain: int | None,
        on_line: Callable[[str], None],
    ) -> None:
        """Start a robot's program with its arguments, in a ROS 2 domain, or with the ROS 1 master for None."""
        command = [self._site.python(1 if domain is None else 2), *arguments]
        await self._processes.start(name, command, self._site.environment(domain), on_line)

    def connect(self) -> AbstractAsyncContextManager[FleetClient]:
        """An OPC UA client of the user."""
        site, identity = self._site, ClientIdentity(self._site.folder / "client")
        return FleetClient.connect(site.endpoint, user=USER, password=site.password, identity=identity, timeout_s=30)

    async def _cli(self, name: str, ros: int, *arguments: str) -> None:
        site = self._site
        command = [site.python(ros), "-m", "ua_fleet.cli", *arguments, "--config", str(site.config_file)]
        await self._processes.start(name, [*command, *self._cli_options], site.environment(None))
