"""The running testbed with its robots disturbed, watched and commanded from outside."""

from __future__ import annotations

import asyncio
import json
import os
import platform
import tempfile
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from ua_demo.testbed.plan import OPERATOR, TESTBEDS

from tests.testbed.bed import LOGS, Bed, CannotStart, say, versions
from tests.testbed.clients import foreign_client, modbus_client, trust
from tests.testbed.commands import Commands
from tests.testbed.disturb import Deed, Kind
from tests.testbed.engine import ROOT, CommandFailed, Compose
from tests.testbed.healing import Healing, Row, settle
from tests.testbed.isolation import check_hardening, check_isolation, check_yard
from tests.testbed.runs import RunRow, problems_of, run_lines, through_kills
from tests.testbed.scenes import SCENES, Scene
from tests.testbed.table import failures, into_page, lines, write_json
from tests.testbed.watching import Login, Watcher, addresses_of
from ua_fleet.client import ClientIdentity
from ua_fleet.config.load import load
from ua_fleet.errors import UaFleetError

__all__ = ["disturbances", "first_looks", "first_looks_at_the_yard", "meant"]

PAGE: Final = ROOT / "docs" / "testbed.md"
_RUNS: Final = "runs"
"""In ONLY: the kills within runs."""
_COMPLETE_S: Final = 60.0
_LAST_ENDS_S: Final = 130.0
"""A skill ends by itself after 120 s: by then an end has been told, or it is lost."""


def first_looks(bed: Bed, compose: Compose) -> list[str]:
    """Clients from the host, and what no robot may reach; what is not as it should be."""
    found = [*foreign_client(bed, compose), *modbus_client(bed.modbus_port)]
    say("clients from this machine: " + ("; ".join(found) or "refused, trusted, let in; the Modbus server counts"))
    containers = compose.containers()
    ways = check_isolation(bed, containers)
    say("isolation: " + ("; ".join(ways) or "no robot reaches the server by any way, and each bridge does"))
    weak = check_hardening(containers)
    say("containers: " + ("; ".join(weak) or "no root, nothing to write to, no capability, no secret in them"))
    return [*found, *ways, *weak]


def first_looks_at_the_yard(bed: Bed, compose: Compose) -> list[str]:
    """What reaches the server from the yard, and whom the broker lets in; what is not as it should be."""
    containers = compose.containers()
    ways = check_yard(bed, containers)
    say("yard: " + ("; ".join(ways) or "nothing reaches the server but by the broker, and that lets in whom it knows"))
    weak = check_hardening(containers)
    say("containers: " + ("; ".join(weak) or "no root, nothing to write to, no capability, no secret in them"))
    return [*ways, *weak]


def meant(only: str) -> dict[str, list[tuple[Kind, Deed]]]:
    """By profile all disturbances, or those of some services or of a profile; `service:killed` is one of these.

    Raises CannotStart where there is none of that name.
    """
    words = only.split() or [""]
    found = {
        scene.profile: [
            (kind, deed)
            for kind in scene.kinds
            for deed in kind.deeds
            if any(_is_meant(word, scene, kind, deed) for word in words)
        ]
        for scene in SCENES
    }
    if not any(found.values()) and _RUNS not in words:
        names = ", ".join(kind.service for scene in SCENES for kind in scene.kinds)
        raise CannotStart(f"ONLY={only}: there is no such disturbance; services: {names}; e.g. server:killed")
    return found


def _is_meant(word: str, scene: Scene, kind: Kind, deed: Deed) -> bool:
    service, _, how = word.partition(":")
    return service in ("", kind.service, scene.profile) and deed.value.startswith(how)


def with_runs(scene: Scene, only: str) -> bool:
    """Whether the kills within runs are wanted."""
    return bool(scene.cases) and (not only or _RUNS in only.split())


async def disturbances(bed: Bed, compose: Compose, scene: Scene, only: str) -> list[str]:
    """Disturb containers of each kind, and write the table; what is not as it should be."""
    with tempfile.TemporaryDirectory() as folder:
        rows, runs = await _disturb_all(bed, compose, scene, only, Path(folder))
    about = {
        "Run of": datetime.now(UTC).date().isoformat(),
        **await asyncio.to_thread(versions, bed),
        "kernel": platform.release().split("-")[0],
        "cores": str(os.cpu_count()),
    }
    table = [*lines(rows, about), *(["", *run_lines(runs)] if runs else [])]
    print("\n".join(table), flush=True)
    write_json(LOGS / f"{scene.profile}.json", rows, about)
    if not only and PAGE.exists():
        PAGE.write_text(into_page(PAGE.read_text(encoding="utf-8"), scene.profile, table), encoding="utf-8")
        say(f"the table stands in {PAGE.relative_to(ROOT)}")
    return [*failures(rows), *(problem for row in runs for problem in problems_of(row))]


async def _disturb_all(
    bed: Bed, compose: Compose, scene: Scene, only: str, folder: Path
) -> tuple[list[Row], list[RunRow]]:
    containers = compose.containers()
    written = containers[scene.server].execute("cat", "/var/lib/ua-fleet/fleet/fleet.yaml")
    (folder / "fleet.yaml").write_text(written, encoding="utf-8")
    config = load(folder / "fleet.yaml", TESTBEDS[scene.profile].environment(OPERATOR))
    identity = ClientIdentity(folder / "identity")
    await identity.ensure()
    trust(compose, identity.certificate.read_bytes(), scene.server)
    login = json.loads(containers[scene.conductor].execute("ua-fleet", "testbed", "login", scene.profile, "--json"))
    watcher = Watcher(
        Login(login["endpoint"], login["user"], login["password"], folder / "identity"),
        addresses_of(config),
    )
    commands = Commands(watcher, config, scene.asked)
    working = [asyncio.create_task(watcher.run()), asyncio.create_task(commands.run())]
    rows: list[Row] = []
    runs: list[RunRow] = []
    try:
        await _complete(watcher)
        healing = Healing(scene, watcher, commands, containers, bed.modbus_port)
        for kind, deed in meant(only)[scene.profile]:
            since = time.time()
            try:
                row = await healing.disturb(kind, deed)
            except (CommandFailed, UaFleetError) as error:
                row = Row(kind.name, kind.service, deed, None, None, [str(error)], since=since, until=time.time())
            rows.append(row)
            _tell(row)
            if row.healed_s is None:
                await asyncio.to_thread(compose.keep_logs, LOGS / f"{row.service}-{row.deed.replace(' ', '-')}")
                with suppress(TimeoutError):
                    async with asyncio.timeout(_COMPLETE_S):
                        await _complete(watcher)
        deadline = time.monotonic() + _LAST_ENDS_S
        while commands.open() and time.monotonic() < deadline:
            await asyncio.sleep(1.0)
        await asyncio.to_thread(settle, scene, rows, commands.all, containers)
        _write_commands(scene, commands)
        if with_runs(scene, only):
            runs = await through_kills(watcher, containers, scene.cases)
            for made in runs:
                say(f"{made.service} killed within a run: {made.state} after {made.took_s:.1f} s {made.reason}")
    finally:
        for task in working:
            task.cancel()
        await asyncio.wait(working)
    return rows, runs


async def _complete(watcher: Watcher) -> None:
    try:
        async with asyncio.timeout(_COMPLETE_S):
            while not watcher.seen.is_all_good():
                await asyncio.sleep(0.2)
    except TimeoutError:
        raise CannotStart(f"not all nodes are Good: {watcher.seen.bad}") from None


def _tell(row: Row) -> None:
    noticed = "nothing noticed" if row.noticed_s is None else f"noticed after {row.noticed_s:.1f} s"
    healed = f"NOT HEALED: {'; '.join(row.missing)}" if row.healed_s is None else f"healed in {row.healed_s:.1f} s"
    say("; ".join([f"{row.service} {row.deed}: {noticed}, {healed}", *row.meanwhile]))


def _write_commands(scene: Scene, commands: Commands) -> None:
    """All commands, for who wants to look into the table."""
    LOGS.mkdir(parents=True, exist_ok=True)
    written = [
        f"{each.asked_at:.3f} {each.robot}.{each.skill} {each.execution_id or '-'} {each.outcome} {each.message}"
        for each in commands.all
    ]
    (LOGS / f"{scene.profile}-commands.txt").write_text("\n".join(written) + "\n", encoding="utf-8")
