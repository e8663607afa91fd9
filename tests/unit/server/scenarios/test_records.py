"""Runs as people see them."""

from __future__ import annotations

import json

from ua_fleet.scenario.facts import (
    Fact,
    Replaced,
    ReplacementWanted,
    RunCreated,
    TaskAssigned,
    decode_fact,
    encode_fact,
)
from ua_fleet.server.scenarios.records import RunRecord

CREATED = RunCreated(1.0, "r", "version: 1\nname: s\nsteps:\n  - {task: fetch, robot: ned, skill: go}\n")


def rows_of(*facts: Fact) -> list[tuple[str, str, str, str, str]]:
    record = RunRecord.of("r", [CREATED, *facts])
    return [(row.task, row.robot, row.skill, row.state, row.message) for row in record.rows()]


def test_a_task_that_has_got_no_robot_is_shown_with_its_name_and_why() -> None:
    wanted = ReplacementWanted(2.0, "0", "ned", "ned is stuck", "fetch", "go")
    assert decode_fact(encode_fact(wanted)) == wanted
    assert rows_of(wanted) == [("fetch", "ned", "go", "replacing", "ned is stuck")]
    begun = TaskAssigned(3.0, "0", "fetch", 1, "ur3", "e", "go")
    assert rows_of(wanted, Replaced(2.5, "0", "ned", "ur3", "anna"), begun) == [
        ("fetch", "ur3", "go", "assigned", "ned is stuck")
    ]


def test_a_journal_of_an_earlier_version_is_read() -> None:
    wanted = json.loads(encode_fact(ReplacementWanted(2.0, "0", "ned", "ned is stuck", "fetch", "go")))
    del wanted["task"], wanted["skill"]
    (row,) = rows_of(decode_fact(json.dumps(wanted)))
    assert row == ("", "ned", "", "replacing", "ned is stuck")
