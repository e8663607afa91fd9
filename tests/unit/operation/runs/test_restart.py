"""A run whose scenario no longer fits ends with the reason, in the journal and for people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
import structlog

from ua_fleet.errors import ConfigError
from ua_fleet.operation.runs.library import Checked
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.operation.runs.restart import scenario_to_go_on
from ua_fleet.scenario import read_scenario
from ua_fleet.scenario.facts import Fact, RunCreated, RunEnded, RunOutcome
from ua_fleet.storage.run_journal import RunJournal

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
    assert asked == [f"{TEXT}\n"]
    if not problems:
        assert scenario == checked().scenario
        assert (written, record.ended) == ([], None)
    else:
        reason = "it does not fit the fleet any more: there is no robot arm"
        assert scenario is None
        assert written == [RunEnded(200.0, RunOutcome.FAILED, reason)]
        assert record.ended == 200.0
