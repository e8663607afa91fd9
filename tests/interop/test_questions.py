"""Foreign clients answer the question of a run, what became of a task, after the server was started anew."""

from __future__ import annotations

import json
import signal
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.contract.skilled import ENDLESS_WORK
from tests.integration.scenarios.conftest import ROBOTS, Plant, all_heard, run, run_is, value
from tests.integration.server_model.harness import OPERATOR, Running, until
from tests.interop.test_node_opcua import run_client
from tests.interop.test_o6_alarms import run_o6
from tests.system import Processes

FOLDER = Path(__file__).parent
Answer = Callable[[Running, Path, str], Awaitable[dict[str, Any]]]


async def asked(plant: Plant, client: Client) -> str:
    """A run whose robot cannot tell, after its bridge was killed, whether it did its task; the run's id."""
    plant.machines["left"].forget()
    bridges = {robot: plant.bridge(robot) for robot in ROBOTS}
    await all_heard(client)
    run_id = await run(client, "one")

    async def told() -> Any:
        return plant.told()

    await until(told, lambda found: found == [("left", ENDLESS_WORK)])
    bridges["left"].end(signal.SIGKILL)
    plant.bridge("left")
    await until_asked(client, run_id)
    return run_id


async def until_asked(client: Client, run_id: str) -> None:
    async def states() -> Any:
        return await value(client, f"Scenarios.Runs.{run_id}.States")

    await until(states, lambda found: "asked" in found)


async def by_node_opcua(running: Running, folder: Path, run_id: str) -> dict[str, Any]:
    arguments = (*OPERATOR, folder / "pki", "dialog", "done")
    code, output, errors = await run_client(running.url, *arguments, script=FOLDER / "alarms.cjs")
    assert code == 0, errors
    report: dict[str, Any] = json.loads(output.splitlines()[-1])
    assert report["open"]["id"] == f"ns=2;s=Dialogs.question.{run_id}.0"
    assert report["closed"]["LastResponse"] == 0
    return {**report, "options": report["open"]["ResponseOptionSet"], "prompt": report["open"]["Prompt"]}


async def by_o6(running: Running, folder: Path, run_id: str) -> dict[str, Any]:
    dialog = f"ns=2;s=Dialogs.question.{run_id}.0"
    report: dict[str, Any] = json.loads(
        await run_o6(FOLDER / "o6_dialog.py", running.url, folder, OPERATOR, dialog, "done")
    )
    assert report["active"] is True
    return report


@pytest.mark.parametrize(
    "answer",
    [
        pytest.param(by_node_opcua, marks=pytest.mark.needs("node")),
        pytest.param(by_o6, marks=pytest.mark.needs("o6")),
    ],
)
async def test_a_foreign_client_answers_a_question_after_a_restart(
    answer: Answer, udp_url: str, tcp_port: int, tmp_path: Path, processes: Processes
) -> None:
    plant = Plant(tmp_path, udp_url, tcp_port, processes, "operator")
    task = f"task: first, skill: work, robot: left, on_unknown: ask, arguments: {{work: {ENDLESS_WORK}}}"
    plant.scenario("one", f"  - {{{task}}}\n")
    async with plant.server() as running, running.client() as client:
        run_id = await asked(plant, client)
    async with plant.server() as running, running.client() as client:
        await until_asked(client, run_id)
        report = await answer(running, tmp_path, run_id)
        assert report["options"] == ["done", "retry", "fail", "replace"]
        assert report["prompt"].startswith("first: ")
        said = [report[each].upper().replace("_", "").removeprefix("BAD") for each in ("wrong", "answered", "late")]
        assert said == ["DIALOGRESPONSEINVALID", "GOOD", "DIALOGNOTACTIVE"]
        assert await run_is(client, run_id, "done", "failed") == "done"
    assert plant.told() == [("left", ENDLESS_WORK)]
