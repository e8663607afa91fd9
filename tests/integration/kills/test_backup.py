"""A backup while a server and its bridges are at work, secured, and their work going on from it after a restore."""

from __future__ import annotations

import asyncio
import json
import tarfile
from pathlib import Path
from typing import Any

import pytest

from tests.integration.kills.conftest import SECURED, SERVER, crew_of, ended, stop
from tests.integration.scenarios.conftest import ROBOTS, Plant, all_heard, run, value
from tests.system import clean_environment, cli
from tests.system import run as run_command

FLEET = "folders.json"
STEPS = """
  - repeat:
        - {task: on_left, skill: work, robot: left, arguments: {work: left, seconds: 0.1}, retries: 3}
        - {task: on_right, skill: work, robot: right, arguments: {work: right, seconds: 0.1}, retries: 3}
    while: left.go_on > 0
"""


async def state(plant: Plant, command: str, file: Path, *options: str) -> tuple[int, str]:
    """Run `ua-fleet state`; how it ends, and what it says."""
    environment = clean_environment(UA_FLEET_CONFIG=str(plant.folder / FLEET))
    arguments = cli("state", command, file, *options)
    done = await asyncio.to_thread(run_command, *arguments, env=environment)
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout + done.stderr


def with_state(raw: dict[str, Any]) -> None:
    for robot in ROBOTS:
        raw["bridges"][f"{robot}_cell"]["state_dir"] = robot


def write_fleet(plant: Plant) -> None:
    """The same folders for the command line, which does not know the kind of bridge that the tests have."""
    bridges = {
        f"{robot}_cell": {"kind": "ros2", "space": 10 + number, "status_id": 900 + number, "state_dir": robot}
        for number, robot in enumerate(ROBOTS)
    }
    fleet = {"version": 1, "fleet": {"name": plant.config.fleet.name}, "pubsub": SECURED, "bridges": bridges}
    (plant.folder / FLEET).write_text(json.dumps(fleet))


@pytest.mark.timeout(300)
@pytest.mark.parametrize("works", [SECURED], indirect=True)
async def test_work_goes_on_from_a_backup_that_was_made_while_it_went_on(works: Plant, tmp_path: Path) -> None:
    works.declare(with_state)
    write_fleet(works)
    await works.prepare()
    works.scenario("busy", STEPS)
    file = tmp_path / "busy.tar"
    crew = crew_of(works, 17)
    await crew.begin(SERVER, *ROBOTS)
    async with works.client() as client:
        await all_heard(client)
        run_id = await run(client, "busy")
        while len(works.told()) < 4:
            await asyncio.sleep(0.05)
        code, said = await state(works, "backup", file)
        assert code == 0, said
        with tarfile.open(file) as archive:
            databases = {name for name in archive.getnames() if name.endswith(".db")}
        assert databases == {"server/server.db", *[f"bridge-{robot}_cell/executions.db" for robot in ROBOTS]}
        before = len(works.told())
        while len(works.told()) < before + 4:
            await asyncio.sleep(0.05)
    code, said = await state(works, "restore", file, "--despite-open-work")
    assert (code, "runs" in said) == (1, True), said
    crew.end()
    code, said = await state(works, "check", file)
    assert code == 0, said
    code, said = await state(works, "restore", file)
    assert (code, "1 runs and" in said) == (2, True), said
    code, said = await state(works, "restore", file, "--despite-open-work")
    assert code == 0, said
    assert "keys of message security are made anew" in said
    crew = crew_of(works, 17)
    await crew.begin(SERVER, *ROBOTS)
    before = len(works.told())
    async with works.client() as client:
        await all_heard(client)
        while len(works.told()) < before + 2:
            assert await value(client, f"Scenarios.Runs.{run_id}.State") != "failed"
            await asyncio.sleep(0.05)
        await stop(client)
        assert await ended(client, run_id) == "done", await value(client, f"Scenarios.Runs.{run_id}.Reason")
    crew.end()
