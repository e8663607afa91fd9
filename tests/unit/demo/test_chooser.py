"""The operator of the demonstration: asked until a choice is taken, with those who can take over by then."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from ua_demo.talkrobots.chooser import Chooser

from ua_fleet.client import NotDone


class Scenarios:
    """Refuses the first choice."""

    def __init__(self) -> None:
        self.chosen: list[str] = []

    async def confirm(self, decision_id: str, robot: str) -> None:
        self.chosen.append(robot)
        if len(self.chosen) == 1:
            raise NotDone(3, f"{robot} cannot take over: has a fault")


async def test_an_operator_whose_choice_is_refused_is_asked_again() -> None:
    asked: list[list[str]] = []
    said: list[str] = []

    async def ask(_decision_id: str, robots: Sequence[str]) -> str:
        asked.append(list(robots))
        if len(asked) == 1:
            chooser.choose("d", ["ur3"], scenarios, tasks)
        return robots[0]

    chooser = Chooser(ask, said.append)
    scenarios: Any = Scenarios()
    async with asyncio.timeout(60), asyncio.TaskGroup() as tasks:
        chooser.choose("d", [], scenarios, tasks)
        chooser.choose("d", ["pioneer_1", "ur3"], scenarios, tasks)
    assert asked == [["pioneer_1", "ur3"], ["ur3"]]
    assert scenarios.chosen == ["pioneer_1", "ur3"]
    assert [line.strip() for line in said] == ["not done: pioneer_1 cannot take over: has a fault"]
