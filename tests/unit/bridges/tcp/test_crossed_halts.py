"""Halts that cross the end of their commands: what the robot answers to them ends no other command."""

from __future__ import annotations

import pytest

from tests.unit.bridges.tcp.test_direct import ID, NUMBERED, OTHER, Robot
from ua_fleet.bridge.driver import Dropped, ExecutionEnded, SampleRead
from ua_fleet.counters import Drop
from ua_fleet.errors import SkillRejected
from ua_fleet.values import StatusCode


@pytest.mark.parametrize("late", ["ERR nothing to stop\n", "STOPPED\n", "OK 0.1\n"])
def test_a_halt_that_crosses_the_end_of_its_command_ends_no_other(late: str) -> None:
    robot = Robot()
    robot.session.halt(robot.execute("move", 0.5, "left"), robot.now)
    robot.says(f"OK 0.5\n{late}COUNT 5\n")
    assert robot.facts(SampleRead) == [], "the connection is over"
    told = [event for event in robot.told if isinstance(event, Dropped)]
    assert [(drop.cause, drop.count, "connects anew" in drop.detail) for drop in told] == [
        (Drop.UNASKED, 1, True),
        (Drop.UNASKED, 2, False),
    ]
    following = robot.execute("move", 0.7, "left", execution_id=OTHER)
    robot.session.connected(robot.now)
    assert robot.sent.count(b'movej(0.7, "left")\n') == 1, "it waits for the new connection"
    robot.session.halt(following, robot.now)
    robot.says("STOPPED\n")
    assert [(ended.execution_id, ended.status) for ended in robot.facts(ExecutionEnded)] == [
        (ID, 0),
        (OTHER, StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT),
    ]
    assert len(robot.resets) == 1


def test_a_halt_that_crosses_an_end_with_a_number_costs_no_connection() -> None:
    robot = Robot(*NUMBERED)
    robot.session.halt(robot.execute("move", 0.5, "left"), robot.now)
    number = robot.sent[0].split(b", ")[2].rstrip(b")\n").decode()
    robot.says(f"OK {number} 0.5\n")
    robot.execute("move", 0.7, "left", execution_id=OTHER)
    robot.says(f"ERR {number} nothing to stop\nSTOPPED {number}\n")
    assert [ended.execution_id for ended in robot.facts(ExecutionEnded)] == [ID]
    assert robot.resets == []


def test_of_two_halts_one_answer_is_still_to_come() -> None:
    robot = Robot()
    execution = robot.execute("move", 0.5, "left")
    robot.session.halt(execution, robot.now)
    robot.session.halt(execution, robot.now)
    robot.says("STOPPED\n")
    assert len(robot.facts(ExecutionEnded)) == len(robot.resets) == 1


def test_a_line_that_is_also_the_commands_own_answer_leaves_that_to_the_halt_open() -> None:
    robot = Robot(('"STOPPED"', '"ERR stopped"'))
    robot.session.halt(robot.execute("move", 0.5, "left"), robot.now)
    robot.says("ERR stopped\n")
    assert len(robot.facts(ExecutionEnded)) == len(robot.resets) == 1


def test_a_halt_of_what_has_ended_does_not_stop_the_next_one() -> None:
    robot = Robot()
    execution = robot.execute("move", 0.5, "left")
    robot.says("OK 0.5\n")
    robot.execute("move", 0.7, "left", execution_id=OTHER)
    with pytest.raises(SkillRejected, match="not under way"):
        robot.session.halt(execution, robot.now)
    assert b"stopj()\n" not in robot.sent
