from __future__ import annotations

from typing import Any

from tests.testbed.commands import Commands
from tests.testbed.ledger import Command, Outcome
from tests.testbed.scenes import TALKROBOTS


async def test_robot_has_to_do_each_of_its_skills_after_a_disturbance() -> None:
    nothing: Any = None
    commands = Commands(nothing, nothing, TALKROBOTS.asked)
    commands.all = [
        Command("ridgeback", "fetch", 9.0, outcome=Outcome.DONE),
        Command("ridgeback", "go", 10.0, outcome=Outcome.REFUSED),
        Command("ridgeback", "load", 11.0, outcome=Outcome.DONE),
        Command("pioneer_1", "go", 11.0, outcome=Outcome.DONE),
    ]
    assert commands.not_done("ridgeback", 10.0) == ["fetch", "go"]
    commands.all += [Command("ridgeback", skill, 20.0, outcome=Outcome.DONE) for skill in ("fetch", "go")]
    assert commands.not_done("ridgeback", 10.0) == []
    assert commands.not_done("temperature_sensor", 10.0) == [], "it has none"
    assert commands.done_between("ridgeback", 9.0, 12.0) == 2
    assert commands.done_between("ridgeback", 20.0, 20.0) == 0
