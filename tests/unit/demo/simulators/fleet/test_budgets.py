"""What the messages of a fleet may cost, signed and encrypted; and that a very large one comes to its end.

Both modes stand in one file: their fleet is simulated once for all tests.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from ua_demo import equations
from ua_demo.equations import equation_12_sum
from ua_demo.simulators.fleet import Result, Settings, modes, report, simulate

from ua_fleet.config.reference import put_between
from ua_fleet.traffic import MessageKind

PAGE = Path(__file__).parents[5] / "docs" / "simulator.md"


@pytest.fixture(scope="module")
def both() -> tuple[Result, Result]:
    return modes.both_modes(Settings(50, 100))


@pytest.fixture(scope="module")
def fifty(both: tuple[Result, Result]) -> Result:
    return both[0]


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


def test_50_robots_carry_100_tasks_with_800_messages_and_140_kb(both: tuple[Result, Result]) -> None:
    _, carried = both
    assert carried.is_right, carried.reason
    assert equation_12_sum(carried.traffic.messages) <= 800
    assert equation_12_sum(carried.traffic.bytes) <= 140_000
    assert not carried.traffic.unreadable
    assert set(carried.drops) <= {"repeated"}


def test_each_exchange_has_two_messages(both: tuple[Result, Result]) -> None:
    counted = both[1].traffic.messages
    parts, first, handed_over, ends = 50, 1, 99, 49
    assert counted[MessageKind.TOKEN] == 2 * (parts + first + handed_over + ends)
    assert counted[MessageKind.REGISTRATION] == 50 * 3 + 2
    assert counted[MessageKind.STATUS] == 50 + 100 * 2
    assert not counted[MessageKind.REQUEST] + counted[MessageKind.RESPONSE], "a bridge asks its robot itself"


def test_who_watches_hears_two_messages_a_step_with_400_bytes(both: tuple[Result, Result]) -> None:
    traffic = both[1].traffic
    assert 0 < traffic.messages[MessageKind.RUN] <= 2 * 100
    assert traffic.bytes[MessageKind.RUN] <= 400 * 100
    assert not both[0].traffic.messages[MessageKind.RUN]


def test_tasks_take_as_long_as_orchestrated(both: tuple[Result, Result]) -> None:
    took = [result.ended_s - result.began_s for result in both]
    assert took[1] <= took[0]


def test_the_table_of_the_page_is_from_this_run(both: tuple[Result, Result], monkeypatch: pytest.MonkeyPatch) -> None:
    def known(_settings: Settings) -> tuple[Result, Result]:
        return both

    monkeypatch.setattr(modes, "both_modes", known)
    text = PAGE.read_text(encoding="utf-8")
    made = put_between(text, modes.BEGIN, modes.END, modes.markdown())
    assert text == made, "python -m ua_demo.simulators.fleet.modes docs/simulator.md"


def test_1000_robots_do_1000_tasks() -> None:
    result = simulate(Settings(1000, 1000, keep_alive_s=600))
    assert result.is_right, result.reason
    assert equation_12_sum(result.traffic.messages) == 1000 * (3 + 1) + 2 + 1000 * (4 + 2)
