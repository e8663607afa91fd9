"""Where a demonstration runs: its folder, its ports, its password, and the interpreters that it starts."""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ua_demo.broker import BROKER_PORT
from ua_demo.console import why_no_console
from ua_demo.layout import Layout, check_same_fleet
from ua_demo.processes import free_tcp_port, udp_port_in_use
from ua_demo.ros_environment import ros2_environment
from ua_fleet.bridge.launch import child_environment, find_ros1_python

__all__ = ["ENGINEER", "KEY_LIFETIME_S", "OPC_UA_PORT", "USER", "Site", "choose_site"]

USER: Final = "operator"
ENGINEER: Final = "engineer"
"""With the same password: for who changes a scenario."""
OPC_UA_PORT: Final = 4840
KEY_LIFETIME_S: Final = 5
_DEFAULT_GROUP: Final = "224.0.2.14"


@dataclass(frozen=True, slots=True)
class Site:
    """See the module."""

    folder: Path
    server_port: int
    pubsub_urls: tuple[str, ...]
    """One, or those of the nodes of an MQTT broker."""
    password: str
    """Of the users USER and ENGINEER."""
    master_port: int
    ros1_python: Path | None
    """None where there is no ROS 1, or it is not wanted."""
    why_without_ros1: str
    secure: bool
    """Whether PubSub is signed and encrypted, with keys from the server's key service."""
    console_port: int | None = None
    """None where there is no web console."""
    broker_port: int | None = None
    """Of the MQTT broker that the demonstration starts; None where it starts none."""

    @property
    def endpoint(self) -> str:
        """URL of the OPC UA server."""
        return f"opc.tcp://127.0.0.1:{self.server_port}/ua_fleet"

    @property
    def console_url(self) -> str:
        """Where the web console is; empty where there is none."""
        return "" if self.console_port is None else f"http://127.0.0.1:{self.console_port}/"

    @property
    def config_file(self) -> Path:
        """The `fleet.yaml` of the run."""
        return self.folder / "fleet.yaml"

    def layout(self, name: str) -> Layout:
        """For the `fleet.yaml` of the demonstration of this name."""
        return Layout(
            written_by=f"demo {name}",
            server_port=self.server_port,
            pubsub_url=self.pubsub_urls[0],
            broker_nodes=self.pubsub_urls[1:],
            keys=f"{{lifetime_s: {KEY_LIFETIME_S}}}" if self.secure else None,
            master_uri=f"http://127.0.0.1:{self.master_port}",
        )

    def python(self, ros: int) -> str:
        """The interpreter for programs of ROS 1 or 2; the server's is that of ROS 2."""
        return str(self.ros1_python) if ros == 1 else sys.executable

    def write_config(self, text: str) -> None:
        """Write `fleet.yaml`; raises ConfigError where that of another fleet is in the folder."""
        check_same_fleet(self.config_file, text, "choose another --folder")
        self.config_file.write_text(text, encoding="utf-8")

    def environment(self, domain: int | None) -> dict[str, str]:
        """The environment of a program: in the ROS 2 domain `domain`, or with the ROS 1 master for None."""
        environment = child_environment(os.environ)
        log_folder = self.folder / "log" / "ros"
        log_folder.mkdir(parents=True, exist_ok=True)
        environment["ROS_LOG_DIR"] = str(log_folder)
        if domain is None:
            environment["ROS_MASTER_URI"] = f"http://127.0.0.1:{self.master_port}"
            environment["ROS_IP"] = environment["ROS_HOSTNAME"] = "127.0.0.1"
        else:
            environment |= ros2_environment(domain, "LOCALHOST")
        return environment


def choose_site(
    folder: Path,
    *,
    port: int,
    master_port: int,
    pubsub_urls: Sequence[str],
    without_ros1: bool,
    secure: bool,
    console_port: int | None,
    say: Callable[[str], None],
    with_broker: bool = False,
) -> Site:
    """Choose ports and a password, and say what differs from what a reader expects.

    Args:
        folder: an empty folder for this run.
        port: wanted TCP port of the OPC UA server; another is taken if it is in use.
        master_port: wanted TCP port of the ROS master, likewise.
        pubsub_urls: PubSub address; by default the registered one, or another group if its port is in use. Of a
            clustered broker those of its nodes.
        without_ros1: do without ROS 1 even if it is there.
        secure: sign and encrypt PubSub.
        console_port: wanted TCP port of the web console, likewise; None: no console.
        say: prints a line for people.
        with_broker: PubSub goes over an MQTT broker that is started for it.
    """
    broker_port = _free_port("the MQTT broker", BROKER_PORT, say) if with_broker else None
    if broker_port is not None:
        pubsub_urls = [f"mqtt://127.0.0.1:{broker_port}"]
    server_port = _free_port("the OPC UA server", port, say)
    if not pubsub_urls:
        pubsub_urls = [f"opc.udp://{_DEFAULT_GROUP}:{OPC_UA_PORT}"]
        if udp_port_in_use(OPC_UA_PORT):
            group = f"239.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}"
            pubsub_urls = [f"opc.udp://{group}:{OPC_UA_PORT}"]
            say(f"UDP port {OPC_UA_PORT} is in use; PubSub takes the group {group}")
    ros1_python = None if without_ros1 else find_ros1_python(os.environ)
    if ros1_python is not None:
        master_port = _free_port("the ROS master", master_port, say)
    why = "as asked" if without_ros1 else "since there is no .venv-ros1 (make setup says why)"
    if console_port is not None:
        if why_not := why_no_console():
            say(f"there is no web console: {why_not}")
            console_port = None
        else:
            console_port = _free_port("the web console", console_port, say)
    password = secrets.token_urlsafe(9)
    return Site(
        folder,
        server_port,
        tuple(pubsub_urls),
        password,
        master_port,
        ros1_python,
        why,
        secure,
        console_port,
        broker_port,
    )


def _free_port(who: str, wanted: int, say: Callable[[str], None]) -> int:
    port = free_tcp_port(wanted)
    if port != wanted:
        say(f"port {wanted} is in use; {who} takes {port}")
    return port
