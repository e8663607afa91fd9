"""What tests of carried runs share: a scenario of three bridges, and what is asked of a run."""

from __future__ import annotations

import asyncio
import signal
from typing import Any, Final

from asyncua.client.client import Client

from tests.integration.scenarios.conftest import Plant, call, texts, value
from tests.integration.server_model.harness import until
from tests.system import Child

__all__ = ["THREE", "leave_out", "mutual", "reason_of", "run_carried", "told_by"]

THREE: Final = """
  - {task: first, skill: work, robot: left, arguments: {work: one}}
  - {task: second, skill: work, robot: middle, arguments: {work: two}}
  - {task: third, skill: work, robot: right, arguments: {work: "=second.done"}}
"""


def mutual(plant: Plant) -> None:
    """Let all bridges send each other Actions."""

    def change(raw: dict[str, Any]) -> None:
        for bridge in raw["bridges"].values():
            bridge["requestors"] = [0, 300, 301, 302]

    plant.declare(change)


async def run_carried(client: Client, name: str) -> str:
    called = await call(client, "Scenarios", "RunCarried", name, texts(), texts())
    assert called.status == 0, called.message
    run_id: str = called.outputs[0]
    return run_id


async def reason_of(client: Client, run_id: str) -> str:
    return str(await value(client, f"Scenarios.Runs.{run_id}.Reason"))


async def leave_out(client: Client, run_id: str, robot: str, bridge: Child, heir: str) -> None:
    """Kill a bridge, and have another one go on for it."""
    bridge.process.send_signal(signal.SIGKILL)
    await asyncio.to_thread(bridge.process.wait)
    await until(lambda: reason_of(client, run_id), lambda said: f"adopt {run_id} {robot}_cell" in said, timeout_s=60)
    called = await call(client, "Scenarios", "Adopt", run_id, f"{robot}_cell", True, texts())
    assert (called.status, called.outputs) == (0, [heir]), called.message


async def told_by(plant: Plant) -> list[tuple[str, str]]:
    return plant.told()
