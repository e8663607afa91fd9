"""A bridge to a machine with a skill, as a process over real UDP, and what its requestor needs."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.contract.skilled import QUICK, WORK, Machine
from tests.integration.actions.requesting import Requesting, requesting
from tests.integration.security.fleets import fleet_of
from tests.system import Child, Processes
from ua_fleet.config.security import all_groups
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.topics import Topic
from ua_fleet.wire.security import SecurityPolicy

PROGRAM = Path(__file__).parent / "skilled_bridge.py"
SPACE = 300
ACTION, QUICK_ACTION = Topic(SPACE, 2, WORK), Topic(SPACE, 2, QUICK)
TIMEOUT_S = 5.0


class Cell:
    """A machine, its bridge, and the folder of their fleet."""

    def __init__(self, folder: Path, url: str, processes: Processes, security: str, **pubsub: Any) -> None:
        self.folder, self._processes = folder, processes
        self.machine = Machine(folder / "machine")
        raw: dict[str, Any] = {
            "version": 1,
            "pubsub": {
                "security": security,
                "url": url,
                "keep_alive_s": 0.3,
                "receive_timeout_s": 1.0,
                "keys": {"source": "files"},
                **pubsub,
            },
            "bridges": {
                "cell": {"kind": "virtual", "space": SPACE, "status_id": 900},
                "other": {"kind": "virtual", "space": SPACE + 1, "status_id": 901},
            },
        }
        self.change(raw)
        (folder / "fleet.json").write_text(json.dumps(raw))
        self.config = fleet_of(raw)
        keys = KeyFolder(folder / "keys")
        for group_id in all_groups(self.config):
            keys.write(KeyFile.new(group_id, SecurityPolicy.AES256_CTR, 3600.0, time.time()))

    def change(self, raw: dict[str, Any]) -> None:
        """Change what is written; for cells that differ from this one."""

    def bridge(self) -> Child:
        """Start the bridge, and wait until it works."""
        child = self._processes.fork(PROGRAM, self.folder / "fleet.json", "cell", self.folder / "machine")
        child.wait_for("ready")
        return child

    @asynccontextmanager
    async def requestor(self, **options: Any) -> AsyncGenerator[Requesting]:
        """A requestor in the test's process; its journal stays when it ends."""
        folder = self.folder / f"requestor{options.get('space', 0)}"
        folder.mkdir(exist_ok=True)
        async with requesting(self.config, folder, **options) as requestor:
            yield requestor

    def told(self) -> list[str]:
        """The jobs that the machine was told to do, in their order, by the name of the work."""
        return [job.work for job in self.machine.told()]


@pytest.fixture(params=["none", "sign_and_encrypt"])
def cell(request: pytest.FixtureRequest, tmp_path: Path, udp_url: str, processes: Processes) -> Cell:
    """With and without message security."""
    return Cell(tmp_path, udp_url, processes, request.param)


@pytest.fixture
def secured_cell(tmp_path: Path, udp_url: str, processes: Processes) -> Cell:
    return Cell(tmp_path, udp_url, processes, "sign_and_encrypt")


async def work(requestor: Requesting, *values: Any, action: Topic = ACTION, **options: Any) -> RequestOutcome:
    """Ask the machine for something."""
    timeout_s = options.pop("timeout_s", TIMEOUT_S)
    return await requestor.invoke(action, values, timeout_s, **options)
