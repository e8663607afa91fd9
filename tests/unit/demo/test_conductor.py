"""The operator of the demonstration: asked until a choice is taken, with those who can take over by then."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.unit.demo.test_talkrobots_setting import made
from ua_fleet.client import NotDone
from ua_fleet.demo.talkrobots.conductor import Conductor


class Scenarios:
    """Refuses the first choice."""

    def __init__(self) -> None:
        self.chosen: list[str] = []

    async def confirm(self, decision_id: str, robot: str) -> None:
        self.chosen.append(robot)
        if len(self.chosen) == 1:
            raise NotDone(3, f"{robot} cannot take over: has a fault")


async def test_an_operator_whose_choice_is_refused_is_asked_again(tmp_path: Path) -> None:
    asked: list[list[str]] = []
    said: list[str] = []

    async def ask(_decision_id: str, robots: Sequence[str]) -> str:
        asked.append(list(robots))
        if len(asked) == 1:
            conductor._ask_for("d", ["ur3"], scenarios, tasks)
        return robots[0]

    callbacks: dict[str, Any] = {"traffic": list, "check": list, "started": list, "finished": list}
    _, config = made(tmp_path, ros1=False)
    conductor = Conductor(
        config, speed=1.0, mode="operator", say=said.append, ask=ask, runs=False, patience_s=1.0, **callbacks
    )
    scenarios: Any = Scenarios()
    async with asyncio.timeout(5), asyncio.TaskGroup() as tasks:
        conductor._ask_for("d", [], scenarios, tasks)
        conductor._ask_for("d", ["pioneer_1", "ur3"], scenarios, tasks)
    assert asked == [["pioneer_1", "ur3"], ["ur3"]]
    assert scenarios.chosen == ["pioneer_1", "ur3"]
    assert [line.strip() for line in said] == ["not done: pioneer_1 cannot take over: has a fault"]
