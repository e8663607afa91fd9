"""A robot that speaks over TCP, with a program of its own that takes one field after the other."""

from __future__ import annotations

import json
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

from ua_bridges.tcp.config import Framing, InterpreterLink, TcpBridgeConfig
from ua_bridges.tcp.driver import create_driver

from tests import system
from tests.contract.harness import WORK
from ua_fleet.bridge import Driver
from ua_fleet.config.schema import FleetConfig

NEEDS: tuple[str, ...] = ()
WARNINGS: tuple[str, ...] = ()

SPACE = 300


class SkilledTcpSpace:
    """See SkilledSpace."""

    def __init__(self, port: int, memory: Path) -> None:
        self._memory = memory
        link = InterpreterLink(connect=f"127.0.0.1:{port}", framing=Framing.ACKNOWLEDGED)
        self._config = FleetConfig.model_validate(
            {
                "version": 1,
                "pubsub": {"security": "none"},
                "bridges": {"cell": TcpBridgeConfig(kind="tcp", space=SPACE, interpreter=link)},
                "robots": {"machine": {"bridge": "cell", "skill_status_id": 1902, "skills": {"work": WORK}}},
            }
        )

    def make_driver(self) -> Driver:
        """See SkilledSpace."""
        return create_driver(self._config, "cell")

    def told(self) -> list[str]:
        """See SkilledSpace."""
        if not self._memory.exists():
            return []
        return [json.loads(line)[2][0] for line in self._memory.read_text().splitlines()]


@asynccontextmanager
async def open_skilled_space(folder: Path, processes: system.Processes) -> AsyncGenerator[SkilledTcpSpace]:
    """A robot whose program acknowledges each field, and remembers what it was told."""
    memory = folder / "memory"
    robot = processes.start(
        *(sys.executable, "-u", "-m", "ua_bridges.tcp.simulator", "--listen", "127.0.0.1:0"),
        *("--framing", "acknowledged", "--memory", memory),
        env=system.clean_environment(PYTHONPATH="bridges"),
    )
    port = int(robot.wait_for("ready").split()[1])
    yield SkilledTcpSpace(port, memory)
