"""The timer of the server's parts."""

from __future__ import annotations

from math import inf

from ua_fleet.monitoring import Mistakes
from ua_fleet.server.timetable import PAUSE_S, Timetable


def test_the_nearest_deadline_counts_and_all_get_their_turn() -> None:
    turns = list[str]()
    assert Timetable(Mistakes(), []).next_deadline(0.0) == inf
    timetable = Timetable(
        Mistakes(),
        [
            ("a", lambda _: turns.append("a"), lambda _: 7.0),
            ("b", lambda _: turns.append("b"), lambda now: now + 2.0),
            ("c", lambda _: turns.append("c"), lambda _: None),
        ],
    )
    assert timetable.next_deadline(1.0) == 3.0
    timetable.poll(1.0)
    assert turns == ["a", "b", "c"]


def test_a_part_that_fails_keeps_no_other_from_its_turn_and_does_not_wake_them_all_the_time() -> None:
    mistakes = Mistakes()
    turns = list[float]()

    def fail(_: float) -> None:
        raise KeyError("no")

    timetable = Timetable(mistakes, [("broken", fail, lambda _: 0.0), ("good", turns.append, lambda _: 50.0)])
    timetable.poll(10.0)
    assert turns == [10.0]
    assert mistakes.counts == {"broken": 1}
    assert timetable.next_deadline(10.0) == 10.0 + PAUSE_S
    timetable.poll(10.5)
    assert mistakes.counts == {"broken": 1}
    timetable.poll(10.0 + PAUSE_S)
    assert (turns, mistakes.counts) == ([10.0, 10.5, 11.0], {"broken": 2})


def test_a_deadline_that_cannot_be_told_costs_its_part_alone() -> None:
    mistakes = Mistakes()

    def unknown(_: float) -> float:
        raise ValueError("no")

    timetable = Timetable(mistakes, [("broken", lambda _: None, unknown), ("good", lambda _: None, lambda _: 20.0)])
    assert timetable.next_deadline(10.0) == 10.0 + PAUSE_S
    assert timetable.next_deadline(10.5) == 10.0 + PAUSE_S
    assert mistakes.counts == {"broken": 1}
