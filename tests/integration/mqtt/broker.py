"""Real brokers, started by a test on a free port of loopback and ended by it."""

from __future__ import annotations

import signal
import socket
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from tests.system import clean_environment, free_tcp_port, nats_server

START_S = 20.0
CLUSTER_MQTT = "consumer_memory_storage: true"
"""As docs/brokers.md advises. What has to be kept of messages is kept on disks; consumers end with their connection."""


class Broker:
    """A process that listens at one port, and can be killed, frozen and started again."""

    def __init__(self, command: Sequence[str | Path], port: int, log: Path) -> None:
        self.port, self._command, self._log = port, command, log
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        """Of the process, while it runs."""
        assert self._process is not None
        return self._process.pid

    @property
    def log(self) -> str:
        """What it has written."""
        return self._log.read_text(errors="replace")

    def start(self) -> None:
        """Start it, and wait until it listens."""
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [str(part) for part in self._command], stdout=log, stderr=log, env=clean_environment()
            )
        deadline = time.monotonic() + START_S
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            assert self._process.poll() is None, self._log.read_text()
            assert time.monotonic() < deadline, self._log.read_text()
            time.sleep(0.02)

    def end(self, number: int = signal.SIGTERM) -> None:
        """End it; also where it stands still."""
        if self._process is not None:
            self._process.send_signal(number)
            self._process.send_signal(signal.SIGCONT)
            self._process.wait()
            self._process = None

    def freeze(self) -> None:
        """Have it stand still: connections stay, and nothing is read."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        """Have it go on after that."""
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)


def mosquitto(folder: Path, *lines: str, port: int | None = None) -> Broker:
    """A mosquitto that lets everybody in, unless `lines` of its configuration say otherwise."""
    port = port or free_tcp_port()
    folder.mkdir(exist_ok=True)
    configuration = folder / "mosquitto.conf"
    settings = ["user root", "set_tcp_nodelay true", "max_queued_messages 10000", f"listener {port} 127.0.0.1"]
    settings += lines or ("allow_anonymous true",)
    configuration.write_text("\n".join(settings) + "\n")
    return Broker(["mosquitto", "-c", configuration], port, folder / "mosquitto.log")


def nats(folder: Path) -> Broker:
    """A nats-server, whose MQTT is 3.1.1."""
    port = free_tcp_port()
    folder.mkdir(exist_ok=True)
    configuration = folder / "nats.conf"
    configuration.write_text(
        f'server_name: test\nlisten: "127.0.0.1:{free_tcp_port()}"\n'
        f'jetstream: {{store_dir: "{folder}/store"}}\nmqtt: {{listen: "127.0.0.1:{port}"}}\n'
    )
    return Broker([nats_server(), "-c", configuration], port, folder / "nats.log")


class Cluster:
    """Three nats-servers that are one broker: what one keeps, all keep."""

    def __init__(self, folder: Path) -> None:
        names = ("a", "b", "c")
        routes = {name: free_tcp_port() for name in names}
        self.nodes = {name: self._node(folder / name, name, routes) for name in names}

    @staticmethod
    def _node(folder: Path, name: str, routes: dict[str, int]) -> Broker:
        port = free_tcp_port()
        folder.mkdir(parents=True)
        configuration = folder / "nats.conf"
        others = ", ".join(f'"nats://127.0.0.1:{routes[other]}"' for other in routes if other != name)
        configuration.write_text(
            f'server_name: {name}\nlisten: "127.0.0.1:{free_tcp_port()}"\n'
            f'jetstream: {{store_dir: "{folder}/store"}}\n'
            f'cluster: {{name: hall, listen: "127.0.0.1:{routes[name]}", routes: [{others}]}}\n'
            f'mqtt: {{listen: "127.0.0.1:{port}", stream_replicas: 3, {CLUSTER_MQTT}}}\n'
        )
        return Broker([nats_server(), "-c", configuration], port, folder / "nats.log")

    @property
    def urls(self) -> list[str]:
        return [node.url for node in self.nodes.values()]

    def start(self) -> None:
        """Start all; a client is let in once they have found each other and chosen who leads."""
        for node in self.nodes.values():
            node.start()

    def end(self) -> None:
        for node in self.nodes.values():
            node.end()
