"""What the messages of a fleet may cost, signed and encrypted; and that a very large one comes to its end."""

from __future__ import annotations

import pytest
from ua_demo import equations
from ua_demo.equations import equation_12_sum
from ua_demo.simulators.fleet import Result, Settings, report, simulate

from ua_fleet.traffic import MessageKind


@pytest.fixture(scope="module")
def fifty() -> Result:
    return simulate(Settings(50, 100))


def test_50_robots_and_100_tasks_take_half_the_messages_of_equation_12(fifty: Result) -> None:
    assert fifty.is_right, fifty.reason
    assert equations.total(report.situation_of(fifty.settings)) == 1925
    assert equation_12_sum(fifty.traffic.messages) <= 960


def test_they_take_a_tenth_of_the_bytes_of_the_paper(fifty: Result) -> None:
    assert equation_12_sum(fifty.traffic.bytes) <= 140_000


def test_metadata_is_small(fifty: Result) -> None:
    assert 0 < fifty.traffic.bytes[MessageKind.METADATA] / 50 <= 5_100


def test_nothing_is_dropped_but_repeats(fifty: Result) -> None:
    assert set(fifty.drops) <= {"repeated"}
    assert not fifty.traffic.unreadable


def test_each_kind_is_there_as_often_as_it_has_to_be(fifty: Result) -> None:
    counted = fifty.traffic.messages
    assert counted[MessageKind.REGISTRATION] == 50 * 3 + 2  # who it is, that it works, its writers; the server
    assert counted[MessageKind.METADATA] == 50 * 3  # the bridge's status, SkillStatus, the skill
    assert counted[MessageKind.REQUEST] == counted[MessageKind.RESPONSE] == 100 * 2  # do it, done with it
    assert counted[MessageKind.STATUS] == 50 + 100 * 2  # nothing yet, begun, ended
    assert not counted[MessageKind.TOKEN] + counted[MessageKind.FAULT] + counted[MessageKind.SENSOR]


def test_tasks_take_three_seconds(fifty: Result) -> None:
    assert 300 <= fifty.ended_s - fifty.began_s <= 301


def test_1000_robots_do_1000_tasks() -> None:
    result = simulate(Settings(1000, 1000, keep_alive_s=600))
    assert result.is_right, result.reason
    assert equation_12_sum(result.traffic.messages) == 1000 * (3 + 1) + 2 + 1000 * (4 + 2)
