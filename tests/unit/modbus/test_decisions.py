"""Faults, the ranking of who takes over, and a PLC's choice: told once, whatever is repeated or lost."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.client import DecisionInfo, FaultInfo
from ua_fleet.config.modbus_schema import ModbusServerConfig
from ua_fleet.modbus.decisions import DecisionDesk, PlcAnswer
from ua_fleet.modbus.image import Image
from ua_fleet.modbus.memory import CommandMemory
from ua_fleet.modbus.words import CONTROL, STATUS, DecisionOutcome, control, status
from ua_fleet.registers import AddressSpan, Table

OPEN = DecisionInfo(
    "d1", "open", "step", "arm", "silent", "", "", ("cart", "drone"), (0.6, 0.4), ("arm",), ("it failed",), 0.0
)


class Decisions:
    def __init__(self, folder: Path) -> None:
        self.memory = CommandMemory(folder / "commands.db")
        self.image = Image([status(word.name, 0) for word in STATUS], [control(word.name, 0) for word in CONTROL])
        config = ModbusServerConfig(robots=("arm", "cart", "drone"))
        self.desk = DecisionDesk(self.image, self.memory, config)

    def choose(self, number: int, robot: int) -> None:
        self.image.put(control("chosen", 0), robot)
        self.image.put(control("decision", 0), number)
        self.desk.written(AddressSpan(Table.HOLDING, 2, 1))

    def chosen(self, number: int, robot: int) -> PlcAnswer:
        """A choice that the server is told now."""
        self.choose(number, robot)
        choice = self.desk.take()
        assert choice is not None
        return choice

    def words(self, *names: str) -> tuple[Any, ...]:
        return tuple(self.image.get(status(name, 0)) for name in names)


@pytest.fixture
def decisions(tmp_path: Path) -> Decisions:
    return Decisions(tmp_path)


def test_ranking_is_shown_with_the_numbers_of_the_robots(decisions: Decisions) -> None:
    fault = FaultInfo("f", "arm", "silent", "not heard", active=True, acknowledged=False)
    old = dataclasses.replace(fault, robot="drone", active=False)
    decisions.desk.show([dataclasses.replace(OPEN, decision_id="d0", state="made"), OPEN], [fault, old])
    assert decisions.words("decision", "failed", "candidates") == (1, 1, 2)
    assert decisions.words("candidate_1", "candidate_2", "candidate_3") == (2, 3, 0)
    assert decisions.words("score_1", "score_2") == (0.6, 0.4)
    assert decisions.words("faults_1", "faults_17") == (0b001, 0)
    decisions.desk.show([], [])
    assert decisions.words("decision", "failed", "candidates", "candidate_1", "faults_1") == (0, 0, 0, 0, 0)


def test_choice_is_told_once_and_repeated_ones_are_not(decisions: Decisions) -> None:
    decisions.desk.show([OPEN], [])
    choice = decisions.chosen(1, 3)
    assert (choice.decision_id, choice.robot) == ("d1", "drone")
    assert decisions.desk.take() is None
    decisions.desk.answered(choice, DecisionOutcome.TAKEN)
    assert decisions.words("decided", "outcome") == (1, DecisionOutcome.TAKEN)
    decisions.choose(1, 3)
    assert decisions.desk.take() is None


@pytest.mark.parametrize(("number", "robot"), [(2, 3), (1, 0), (1, 9)])
def test_choice_of_nothing_is_refused(decisions: Decisions, number: int, robot: int) -> None:
    decisions.desk.show([OPEN], [])
    decisions.choose(number, robot)
    assert decisions.desk.take() is None
    assert decisions.words("decided", "outcome") == (number, DecisionOutcome.REFUSED)


def test_refused_choice_may_be_made_again(decisions: Decisions) -> None:
    decisions.desk.show([OPEN], [])
    choice = decisions.chosen(1, 2)
    decisions.desk.answered(choice, DecisionOutcome.REFUSED)
    again = decisions.chosen(1, 3)
    assert again.robot == "drone"


def test_the_second_decision_of_a_step_can_be_answered_as_the_first(decisions: Decisions) -> None:
    """The replacement has failed as well: the decision is open again, under its name and number."""
    decisions.desk.show([OPEN], [])
    choice = decisions.chosen(1, 2)
    decisions.desk.answered(choice, DecisionOutcome.TAKEN)
    decisions.desk.show([OPEN], [])
    assert decisions.words("decided", "outcome") == (1, DecisionOutcome.TAKEN), (
        "the server shows it as open a little longer"
    )
    decisions.desk.show([], [])
    decisions.choose(1, 2)
    assert decisions.words("decided", "outcome") == (1, DecisionOutcome.TAKEN)
    decisions.desk.show([OPEN], [])
    assert decisions.words("decision", "decided", "outcome") == (1, 0, DecisionOutcome.NONE)
    again = decisions.chosen(1, 3)
    assert again.robot == "drone"


def test_choice_that_is_written_in_each_cycle_is_told_once(decisions: Decisions) -> None:
    decisions.desk.show([OPEN], [])
    choice = decisions.chosen(1, 3)
    decisions.choose(1, 3)
    assert decisions.desk.take() is None, "the server has not answered yet"
    decisions.desk.answered(choice, DecisionOutcome.TAKEN)
    decisions.choose(1, 3)
    assert decisions.desk.take() is None
    assert decisions.words("decided", "outcome") == (1, DecisionOutcome.TAKEN)


def test_choice_that_is_wrong_does_not_have_the_one_that_is_told_repeated(decisions: Decisions) -> None:
    decisions.desk.show([OPEN], [])
    choice = decisions.chosen(1, 3)
    decisions.choose(9, 3)
    assert decisions.words("decided", "outcome") == (9, DecisionOutcome.REFUSED)
    decisions.choose(1, 3)
    decisions.desk.answered(choice, DecisionOutcome.TAKEN)
    assert decisions.desk.take() is None
    assert decisions.words("decided", "outcome") == (1, DecisionOutcome.TAKEN)


def unknown(decisions: Decisions) -> None:
    decisions.desk.show([OPEN], [])
    choice = decisions.chosen(1, 3)
    decisions.desk.answered(choice, DecisionOutcome.UNKNOWN)
    decisions.choose(1, 3)
    decisions.desk.refuse()
    assert decisions.words("decided", "outcome") == (1, DecisionOutcome.UNKNOWN), (
        "nothing is known before the next look"
    )


@pytest.mark.parametrize("is_early", [True, False], ids=["before the next look", "after it"])
def test_choice_with_an_unknown_end_is_made_again_where_the_decision_is_still_open(
    decisions: Decisions, is_early: bool
) -> None:
    unknown(decisions)
    if is_early:
        decisions.choose(1, 3)
    decisions.desk.show([OPEN], [])
    assert decisions.words("decision", "decided", "outcome") == (1, 1, DecisionOutcome.UNKNOWN)
    if not is_early:
        decisions.choose(1, 3)
    again = decisions.desk.take()
    assert again is not None
    decisions.desk.answered(again, DecisionOutcome.TAKEN)
    assert decisions.words("decided", "outcome") == (1, DecisionOutcome.TAKEN)


def test_choice_with_an_unknown_end_is_not_refused_once_the_decision_is_made(decisions: Decisions) -> None:
    unknown(decisions)
    decisions.choose(1, 3)
    decisions.desk.show([dataclasses.replace(OPEN, state="made")], [])
    assert decisions.desk.take() is None
    decisions.choose(1, 3)
    assert decisions.desk.take() is None
    assert decisions.words("decision", "decided", "outcome") == (0, 1, DecisionOutcome.UNKNOWN)
    decisions.desk.show([OPEN], [])
    assert decisions.words("decision", "decided", "outcome") == (1, 0, DecisionOutcome.NONE)


def test_decisions_keep_their_numbers(decisions: Decisions) -> None:
    numbers = [decisions.memory.decision_number(name) for name in ("a", "b", "a", "c")]
    assert numbers == [1, 2, 1, 3]
