"""From the end of a step to the call of the robot in the next bridge: carried, orchestrated, and a bare UDP echo.

A server and two bridges as processes of their own, whose robots take 50 ms for each task: measured is from the moment
in which a robot is done to the call of the other one. The same processes run the same tasks in both modes, in turn. The
journals are on the disk, as in production. The echo has as many bytes as a token and its answer.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import Any, Final

from benchmarks._ros import Node, median_and_p99
from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, at_most, shown
from tests import system
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore

USER, PASSWORD = "operator", "benchmark-1"
SKILL: Final = "work"
SCENARIO_NAME: Final = "to_and_fro"
TASKS: Final = 20
TASK_S: Final = 0.05
TOKEN_BYTES, ANSWER_BYTES = 147, 100
"""As `simulate --carried` counts them, without message security."""
ECHOES: Final = 100
REFERENCE: Final = "bare UDP echo"
MODES: Final = ("orchestrated", "carried")
GOAL: Final = 1.2


def fleet_of() -> dict[str, Any]:
    names = range(2)
    return {
        "version": 1,
        "server": {"port": system.free_tcp_port(), "trust_all_clients": True},
        "pubsub": {"security": "none", "url": system.free_multicast_url(), "interface": "lo"},
        "bridges": {
            f"cell_{n}": {"kind": "virtual", "space": 300 + n, "status_id": 900 + n, "requestors": [0, 300, 301]}
            for n in names
        },
        "robots": {
            f"robot_{n}": {
                "bridge": f"cell_{n}",
                "skill_status_id": 910 + n,
                "skills": {SKILL: {"id": 920 + n, "timeout_s": 10, "limits": {"requests_at_once": 50}}},
            }
            for n in names
        },
    }


class Fleet:
    """All processes."""

    def __init__(self, stack: contextlib.ExitStack) -> None:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=system.ROOT)))
        raw = fleet_of()
        fleet = folder / "fleet.json"
        fleet.write_text(json.dumps(raw))
        config = FleetConfig.model_validate(raw)
        users = UserStore(folder / config.server.state_dir / USERS_FILE)
        users.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        users.add(USER, PASSWORD, Role.OPERATOR, replace_existing=False)
        scenarios = folder / config.scenarios.folder
        scenarios.mkdir()
        tasks = [f"  - {{task: t{n}, skill: {SKILL}, robot: robot_{n % 2}}}" for n in range(TASKS)]
        text = "\n".join(["version: 1", f"name: {SCENARIO_NAME}", "steps:", *tasks, ""])
        (scenarios / f"{SCENARIO_NAME}.yaml").write_text(text)

        def start(module: str, *arguments: object) -> Node:
            command = [sys.executable, "-m", f"benchmarks.{module}", *map(str, arguments)]
            node = Node(*command, env=os.environ | {"PYTHONPATH": ".:bridges"})
            stack.callback(node.end)
            return node

        self._bridges = [start("_hand_over", "bridge", fleet, name) for name in config.bridges]
        url = start("_hand_over", "server", fleet).ready.removeprefix("ready ")
        self._client = start("_hand_over", "client", fleet, url)
        self._port = int(start("_actions", "echo", ANSWER_BYTES).ready.removeprefix("ready"))
        for mode in MODES:
            self.run(mode)  # everybody knows everybody then

    def run(self, mode: str) -> list[float]:
        """Microseconds from the end of each task to the call for the next one."""
        self._taken()
        self._client.tell(mode)
        state, reason = json.loads(self._client.read())
        called, done = self._taken()
        if (state, len(called)) != ("done", TASKS):
            raise Failed(f"a run that is {mode} is {state} ({reason}), and robots were called {len(called)} times")
        return [(later - earlier) * 1e6 for earlier, later in zip(done, called[1:], strict=False)]

    def _taken(self) -> tuple[list[float], list[float]]:
        called: list[float] = []
        done: list[float] = []
        for bridge in self._bridges:
            bridge.tell("taken")
            of_bridge = json.loads(bridge.read())
            called += of_bridge[0]
            done += of_bridge[1]
        return sorted(called), sorted(done)

    def echo(self) -> list[float]:
        """Microseconds of round trips."""
        self._client.tell(f"echo {ECHOES} {TOKEN_BYTES} {self._port}")
        times: list[float] = json.loads(self._client.read())
        return times


@contextlib.contextmanager
def running() -> Generator[Fleet]:
    with contextlib.ExitStack() as stack:
        yield Fleet(stack)


def figures(rounds: int) -> list[Figure]:
    took: dict[str, list[float]] = {mode: [] for mode in MODES}
    echoed: list[float] = []
    with running() as fleet:
        for _ in range(max(rounds, FEWEST_ROUNDS)):
            echoed += fleet.echo()
            for mode in MODES:
                took[mode] += fleet.run(mode)
    echo_p50, echo_p99 = median_and_p99(echoed)
    rows: list[Figure] = []
    for mode in MODES:
        p50, p99 = median_and_p99(took[mode])
        rows.append(shown(f"hand-over, {mode}, p50", p50, "us", reference=REFERENCE, reference_value=echo_p50))
        rows.append(shown(f"hand-over, {mode}, p99", p99, "us", reference=REFERENCE, reference_value=echo_p99))
    (orchestrated, _), (carried, _) = (median_and_p99(took[mode]) for mode in MODES)
    rows.append(
        at_most(
            "hand-over, carried, p50, beside",
            carried,
            "us",
            reference="orchestrated",
            reference_value=orchestrated,
            goal=GOAL,
        )
    )
    return rows
