"""Own robots behind bridges that are processes, and a server with the fleet's defaults."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.integration.scenarios.conftest import Plant, value
from tests.system import Processes
from ua_fleet.config.schema import FleetConfig


class Works(Plant):
    """A plant with the timing that a fleet has by default."""

    def __init__(self, folder: Path, url: str, port: int, processes: Processes, mode: str) -> None:
        super().__init__(folder, url, port, processes, mode, {"keep_alive_s": 1.0, "receive_timeout_s": 3.0})
        self._change(resilience={"mode": mode})

    def configure(self, **resilience: float) -> None:
        """Other times of `resilience`, and bridges that are held to be silent soon; before anything is started."""
        self._change(resilience=resilience, pubsub={"keep_alive_s": 0.2, "receive_timeout_s": 0.8})

    def tell_values(self, robot: str) -> None:
        """Have a robot tell a value, by which it is heard; before anything is started."""
        declared: dict[str, Any] = json.loads((self.folder / "fleet.json").read_text())["robots"][robot]
        values = {**declared.get("data", {}), "load": {"id": 1400, "type": "Double"}}
        self._change(robots={robot: {**declared, "data": values}})

    def _change(self, **parts: dict[str, Any]) -> None:
        path = self.folder / "fleet.json"
        raw = json.loads(path.read_text())
        for name, part in parts.items():
            raw[name] = {**raw[name], **part}
        if "silence_s" not in parts.get("resilience", {"silence_s": None}):
            raw["resilience"] = {"mode": raw["resilience"]["mode"]}
        path.write_text(json.dumps(raw))
        self.config = FleetConfig.model_validate(raw)


async def reason_of(client: Client, run_id: str) -> str:
    """Why a run ended."""
    return str(await value(client, f"Scenarios.Runs.{run_id}.Reason"))


async def state_of(client: Client, run_id: str) -> list[str]:
    """The states of a run's tasks."""
    return list(await value(client, f"Scenarios.Runs.{run_id}.States") or ())


@pytest.fixture
def works(request: pytest.FixtureRequest, tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> Works:
    """A fleet; the mode of resilience may be given as the parameter."""
    return Works(tmp_path, udp_url, tcp_port, processes, getattr(request, "param", "automatic"))
