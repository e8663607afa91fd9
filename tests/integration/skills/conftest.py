"""A whole server, and a bridge to a machine with skills as a process, over real UDP."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import pytest

from tests.contract.skilled import QUICK, STATUS, WORK, Machine
from tests.integration.server_model.harness import Running, serving
from tests.system import Child, Processes
from ua_fleet.config.schema import FleetConfig

PROGRAM: Final = Path(__file__).parents[1] / "actions" / "skilled_bridge.py"
SPACE: Final = 300
_ARGUMENTS: Final = {
    "work": {"type": "String", "default": "weld", "description": "What to do."},
    "seconds": {"type": "Double", "unit": "s", "range": [0, 10], "description": "How long it takes."},
}
_RESULTS: Final = {"done": {"type": "String"}, "seconds": {"type": "Double", "unit": "s"}}


class Hall:
    """The folder of a fleet with one machine."""

    def __init__(self, folder: Path, url: str, port: int, processes: Processes, **pubsub: Any) -> None:
        self.folder, self._processes = folder, processes
        self.machine = Machine(folder / "machine")
        raw: dict[str, Any] = {
            "version": 1,
            "server": {"port": port, "trust_all_clients": True},
            "pubsub": {"security": "none", "url": url, "keep_alive_s": 0.2, "receive_timeout_s": 0.8, **pubsub},
            "bridges": {"cell": {"kind": "virtual", "space": SPACE, "status_id": 900}},
            "robots": {
                "machine": {
                    "bridge": "cell",
                    "capacities": ["weld"],
                    "skill_status_id": STATUS,
                    "skills": {
                        "work": {
                            "id": WORK,
                            "description": "Works for some time.",
                            "needs": ["weld"],
                            "arguments": _ARGUMENTS,
                            "results": _RESULTS,
                            "timeout_s": 20,
                            "limits": {"requests_at_once": 2},
                        },
                        "quick": {
                            "id": QUICK,
                            "arguments": _ARGUMENTS,
                            "results": _RESULTS,
                            "timeout_s": 5,
                            "immediate": True,
                            "limits": {"least_interval_s": 30},
                        },
                    },
                }
            },
        }
        (folder / "fleet.json").write_text(json.dumps(raw))
        self.config = FleetConfig.model_validate(raw)

    def bridge(self) -> Child:
        """Start the bridge, and wait until it works."""
        child = self._processes.fork(PROGRAM, self.folder / "fleet.json", "cell", self.folder / "machine")
        child.wait_for("ready")
        return child

    @asynccontextmanager
    async def server(self) -> AsyncGenerator[Running]:
        """The server, while the context lasts."""
        async with serving(self.folder, self.config) as running:
            yield running


@pytest.fixture
def hall(tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> Hall:
    return Hall(tmp_path, udp_url, tcp_port, processes)
