"""A run whose scenario no longer fits ends with the reason, in the journal and for people; its robots are to stop."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
import structlog

from tests.unit.operation.runs.recorded_world import Machines, RecordedWorld
from tests.unit.operation.runs.world import CONFIG, World
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ConfigError
from ua_fleet.operation.runs.library import MOST_BYTES, Checked, ScenarioUnknown
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.operation.runs.restart import runs_of_journal, scenario_to_go_on
from ua_fleet.scenario import read_scenario
from ua_fleet.scenario.facts import Fact, RunCreated, RunEnded, RunOutcome
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.wire.actions import ActionMessage

TEXT = "version: 1\nname: shift\nsteps:\n  - {task: weld, skill: weld, robot: arm}\n"
CREATED = RunCreated(100.0, "r1", TEXT)


def checked(*problems: str) -> Checked:
    return Checked(read_scenario(TEXT.encode()).scenario, tuple(ConfigError(problem) for problem in problems))


@pytest.mark.parametrize("problems", [(), ("there is no robot arm", "and no other")])
def test_a_run_goes_on_or_ends_with_the_reason(tmp_path: Path, problems: Sequence[str]) -> None:
    asked: list[str] = []

    def check(text: str) -> Checked:
        asked.append(text)
        return checked(*problems)

    with RunJournal(tmp_path / "runs") as journal:
        journal.write([("r1", CREATED)])
        record = RunRecord.of("r1", [CREATED])
        scenario = scenario_to_go_on(record, journal.facts("r1"), check, journal, log=structlog.get_logger(), now=200.0)
        written: list[Fact] = journal.facts("r1")[1:]
    assert asked == [TEXT], "byte for byte"
    if not problems:
        assert scenario == checked().scenario
        assert (written, record.ended) == ([], None)
    else:
        reason = "it does not fit the fleet any more: there is no robot arm"
        assert scenario is None
        assert written == [RunEnded(200.0, RunOutcome.FAILED, reason)]
        assert record.ended == 200.0


STEPS = '"name": "shift", "steps": [{"task": "a", "skill": "grab", "robot": "left"}]}'
LONG = "version: 1\nname: shift\nsteps:\n  - {task: a, skill: grab, robot: left}\n#"


@pytest.mark.parametrize(
    "text",
    [
        f'\ufeff{{"version": 1, {STEPS}',
        f'--- {{"version": 1, {STEPS}',
        "version: 1\rname: shift\rsteps:\r  - {task: a, skill: grab, robot: left}\r",
        LONG.ljust(MOST_BYTES, "x"),
    ],
    ids=["byte order mark", "one line", "carriage returns", "as long as may be"],
)
def test_a_run_of_a_file_goes_on_whatever_its_text_looks_like(tmp_path: Path, text: str) -> None:
    (tmp_path / "shift.yaml").write_bytes(text.encode())
    world = World(tmp_path)
    run_id = world.start("shift")
    world.journal.close()
    again = World(tmp_path, robots=world.robots)
    assert (again.service.run_ids, again.ended()) == ([run_id], [])


def test_a_run_whose_text_cannot_be_read_costs_no_other_run(tmp_path: Path) -> None:
    def check(text: str) -> Checked:
        if "weld" in text:
            raise ScenarioUnknown("'shift' is no name of a scenario")
        return checked()

    other = RunCreated(100.0, "r2", TEXT.replace("weld", "turn"))
    with RunJournal(tmp_path / "runs") as journal:
        journal.write([("r1", CREATED), ("r2", other)])
        found = runs_of_journal(journal, check, log=structlog.get_logger(), now=200.0)
    assert found.going_on_ids == {"r2"}
    reason = "its scenario cannot be read (ScenarioUnknown): 'shift' is no name of a scenario"
    assert found.records[0].state.reason == reason


BOTH = """version: 1
name: both
steps:
  - {task: first, skill: grab, robot: left, arguments: {angle: 5}}
  - {task: second, skill: grab, robot: right, arguments: {angle: 5}}
"""


def without(robot: str, *entries: str) -> FleetConfig:
    """The fleet after somebody has taken entries of a robot out of it, or the robot."""
    raw = CONFIG.model_dump(mode="json", exclude_unset=True)
    for entry in entries:
        del raw["robots"][robot][entry]
    if not entries:
        del raw["robots"][robot]
    return FleetConfig.model_validate(raw)


class Away(Machines):
    """Its bridge is away: no request arrives."""

    def hear(self, message: ActionMessage) -> None: ...


@pytest.mark.parametrize(
    "changed", [without("right", "skills", "skill_status_id"), without("left")], ids=["other robot", "its robot"]
)
def test_a_robot_begins_nothing_of_a_run_that_has_ended(tmp_path: Path, changed: FleetConfig) -> None:
    before = RecordedWorld(tmp_path, Away())
    before.start(BOTH)
    before.close()
    world = RecordedWorld(tmp_path, config=changed)
    assert world.records[-1].state.outcome is RunOutcome.FAILED
    assert [message.timeout_hint_ms for message in world.asked()] == [0.0], "it is only asked what became of it"
    assert world.machines.told == {}
    world.respond(world.asked()[0])
    assert [halt for halt in world.file.runs.halts() if halt.robot in changed.robots] == [], "it never began"
    assert world.faults() == []
    world.close()


def test_a_robot_at_a_task_of_such_a_run_is_told_to_stop(tmp_path: Path) -> None:
    machines = Machines()
    before = RecordedWorld(tmp_path, machines)
    before.start(BOTH)
    before.respond(before.asked()[0])
    before.close()
    world = RecordedWorld(tmp_path, machines, config=without("right", "skills", "skill_status_id"))
    (execution_id,) = machines.told
    assert [halt.execution_id for halt in world.file.runs.halts()] == [execution_id.hex()]
    world.pass_time(100)
    assert "left.not_halted RAISED" in world.faults()
    world.close()
