"""Secured bridges as processes, key files that they share, and who listens to them."""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.integration.peer import Peer
from tests.integration.security.fleets import fleet_of
from tests.system import Child, Processes, clean_environment, free_tcp_port
from ua_fleet.config.security import all_groups
from ua_fleet.keys.files import FileKeySource
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.topics import Topic
from ua_fleet.wire.security import SecurityPolicy

PROGRAM = Path(__file__).parent / "counting_bridge.py"
ONE, TWO = 300, 301
COUNTER_ONE, COUNTER_TWO = Topic(ONE, 2, 1), Topic(TWO, 2, 2)
STATUS_ONE, STATUS_TWO = Topic(ONE, 2, 900), Topic(TWO, 2, 901)
POLICY = SecurityPolicy.AES256_CTR


class Site:
    """Two bridges `one` and `two`, and the folder of their fleet."""

    def __init__(self, folder: Path, url: str, processes: Processes) -> None:
        self.folder, self.url, self._processes = folder, url, processes
        self.port = free_tcp_port()
        self.keys = KeyFolder(folder / "keys")
        self.write_fleet()
        for group_id in all_groups(self.config):
            self.keys.write(KeyFile.new(group_id, POLICY, 3600.0, time.time()))

    def write_fleet(self, name: str = "fleet.json", **pubsub: Any) -> Path:
        """Write the fleet, with changes to `pubsub`, and take it for the one from now on."""
        raw: dict[str, Any] = {
            "version": 1,
            "pubsub": {
                "security": "sign_and_encrypt",
                "url": self.url,
                "keep_alive_s": 0.3,
                "receive_timeout_s": 1.0,
                "keys": {"source": "files"},
                **pubsub,
            },
            "bridges": {
                "one": {"kind": "counting", "space": ONE, "status_id": STATUS_ONE.id},
                "two": {"kind": "counting", "space": TWO, "status_id": STATUS_TWO.id},
            },
            "robots": {
                "first": {"bridge": "one", "data": {"counter": {"id": COUNTER_ONE.id, "type": "Int64"}}},
                "second": {"bridge": "two", "data": {"counter": {"id": COUNTER_TWO.id, "type": "Int64"}}},
            },
            "server": {"port": self.port, "trust_all_clients": True, "unknown_sources": "create"},
        }
        self.change(raw)
        path = self.folder / name
        path.write_text(json.dumps(raw))
        self.config = fleet_of(raw)
        return path

    def change(self, raw: dict[str, Any]) -> None:
        """Change what is written; for sites that differ from this one."""

    def bridge(
        self, name: str, *, fleet: str = "fleet.json", wait: bool = True, python: str | Path = sys.executable
    ) -> Child:
        """Start a bridge; with `wait` it is ready when this returns."""
        if python == sys.executable:
            child = self._processes.fork(PROGRAM, self.folder / fleet, name)
        else:
            environment = clean_environment(PYTHONUNBUFFERED="1", PYTHONPATH=".")
            child = self._processes.start(python, PROGRAM, self.folder / fleet, name, env=environment)
        if wait:
            child.wait_for("ready")
        return child

    def rotate(self, group_id: str, delay_s: float) -> None:
        """What `ua-fleet keys rotate` does."""
        self.keys.write(self.keys.read(group_id).rotated(time.time(), delay_s, 1))

    @asynccontextmanager
    async def peer(self, space: int = 0) -> AsyncGenerator[Peer]:
        """Who reads everything with the keys of a space."""
        async with Peer.secured(self.config, space, self.folder, FileKeySource(self.keys.path, POLICY)) as peer:
            yield peer


@pytest.fixture
def secured(tmp_path: Path, udp_url: str, processes: Processes) -> Site:
    return Site(tmp_path, udp_url, processes)


def heard(child: Child, topic: Topic) -> list[int]:
    """The numbers of a topic that a bridge has published into its space so far."""
    start = f"heard {topic.name} "
    return [int(line.removeprefix(start)) for line in child.lines if line.startswith(start)]


def holes(numbers: list[int]) -> list[tuple[int, int]]:
    """Where numbers do not follow each other."""
    return [(a, b) for a, b in itertools.pairwise(numbers) if b != a + 1]
