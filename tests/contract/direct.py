"""A robot that takes commands in its own language: the simulated one, whose answers do not say what they answer."""

from __future__ import annotations

import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from ua_bridges.tcp.config import DirectLink, TcpBridgeConfig

from tests import system
from tests.contract.harness import FAULT_ID, WORK
from tests.contract.tcp import SPACE, SkilledTcpSpace
from ua_fleet.config.schema import FleetConfig

NEEDS: tuple[str, ...] = ()
WARNINGS: tuple[str, ...] = ()

WAY: Final[dict[str, Any]] = {
    "command": "WORK {work} {seconds}\n",
    "done": "DONE {done} {seconds}",
    "failed": "ERROR {message}",
    "halt": "STOP\n",
    "halted": "STOPPED",
}


class SkilledDirectSpace(SkilledTcpSpace):
    """See SkilledSpace."""

    remembers = False

    def _configuration(self, port: int) -> FleetConfig:
        link = DirectLink(connect=f"127.0.0.1:{port}")
        skills = {"work": {**WORK, "via": {"direct": WAY}}}
        return FleetConfig.model_validate(
            {
                "version": 1,
                "pubsub": {"security": "none"},
                "bridges": {"cell": TcpBridgeConfig(kind="tcp", space=SPACE, direct=link)},
                "robots": {
                    "machine": {"bridge": "cell", "skill_status_id": 1902, "fault_id": FAULT_ID, "skills": skills}
                },
            }
        )


@asynccontextmanager
async def open_skilled_space(folder: Path, processes: system.Processes) -> AsyncGenerator[SkilledDirectSpace]:
    """A robot that is up."""
    memory = folder / "memory"
    robot = processes.start(
        *(sys.executable, "-u", "-m", "ua_demo.simulators.tcp", "--direct", "127.0.0.1:0", "--memory", memory),
        env=system.clean_environment(PYTHONPATH="demo"),
    )
    port = int(robot.wait_for("ready").split()[1])
    yield SkilledDirectSpace(port, memory, robot)
