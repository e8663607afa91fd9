"""What it costs to begin a run grows with its tasks, and not faster: 2,000 side by side took 32 s in place of 1 s."""

from __future__ import annotations

from tests.counted_lines import counted_lines
from tests.unit.orchestrator.world import FLEET, settings
from ua_fleet.orchestrator import Orchestrator
from ua_fleet.scenario import Value, ValueUnknown, scenario_of


def _unknown(name: str) -> Value:
    raise ValueUnknown(name)


def _lines_of(tasks: int) -> int:
    """Lines of the program that run while tasks begin that any robot may do."""
    steps = "".join(f"  - {{task: t{number}, skill: go, capacity: mobile}}\n" for number in range(tasks))
    scenario = scenario_of(f"version: 1\nname: many\nsteps:\n- parallel:\n{steps}")
    orchestrator = Orchestrator(settings(), FLEET, _unknown, lambda run_id, fact: None)
    count = counted_lines(lambda: orchestrator.start("r1", scenario, {}, by="anna", now=0.0))
    assert len(orchestrator.runs["r1"].state.tasks) == tasks
    return count


def test_twice_as_many_tasks_side_by_side_take_twice_as_many_steps() -> None:
    _lines_of(2)  # what is done once
    assert _lines_of(80) < 2.3 * _lines_of(40)
