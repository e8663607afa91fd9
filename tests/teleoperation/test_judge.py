"""The judge of the runs: what it lets pass, and each way in which a record can be wrong."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final

import pytest

from tests.teleoperation.judge import Blocked, Entry, Facts, Frozen, Grant, Rules, Verdict, Waited, Wish, judge

RULES: Final = Rules(deadman_s=0.3, period_s=0.02, robot_timeout_s=0.5, stop_s=0.4, rise_s=0.05, slack_s=0.1)
FULL: Final = 0.5
LAST: Final = 2.0
"""The last wish is sent then, and its echo was published just then."""
LATEST: Final = LAST + RULES.deadman_s + RULES.period_s + RULES.slack_s


def every(period_s: float, since: float, until: float) -> Iterable[float]:
    count = round((until - since) / period_s)
    return [since + number * period_s for number in range(count)]


def wishes(lease: int = 1, speed: float = FULL, since: float = 1.0, until: float = LAST) -> list[Wish]:
    return [Wish(at, at, lease, speed) for at in [*every(0.05, since, until), until]]


def hump(since: float, falls: float, speed: float = FULL, *, fall_s: float = 0.3) -> list[Entry]:
    """Zero, up within 0.2 s, held until it falls, and down to zero."""
    rising = [Entry(at, speed * (at - since) / 0.2) for at in every(0.02, since, since + 0.2)]
    held = [Entry(at, speed) for at in every(0.02, since + 0.2, falls)]
    falling = [
        Entry(at, speed * (1 - (at - falls + 0.02) / (fall_s + 0.02))) for at in every(0.02, falls, falls + fall_s)
    ]
    return [*rising, *held, *falling, Entry(falls + fall_s, 0.0)]


def verdict(entries: list[Entry], **facts: Any) -> Verdict:
    given = Facts(entries, entries[-1].at + 1.0, [Grant(1, 0.8, 0.9)], wishes())
    return judge(replace(given, **facts), RULES)


def test_a_robot_that_stops_in_time_has_no_problem() -> None:
    found = verdict(hump(1.05, LAST + RULES.deadman_s))
    assert found.problems == []
    (stop,) = found.stops
    assert stop.lease == 1
    assert stop.unexplained_s == pytest.approx(0.0)
    assert stop.took_s == pytest.approx(0.3)


def test_one_that_stops_early_has_none_either() -> None:
    assert verdict(hump(1.05, 1.5)).problems == []


def test_a_stop_may_begin_just_in_time_and_not_later() -> None:
    assert verdict(hump(1.05, LATEST - 0.005)).problems == []
    found = verdict(hump(1.05, LATEST + 0.025)).problems
    assert "nobody wishes a speed of 0.5" in found[0]
    assert "a stop from 0.5 begins too late" in found[-1]


def test_a_robot_that_says_nothing_more_still_moves() -> None:
    entries = [entry for entry in hump(1.05, 9.0) if entry.at < 2.0]
    assert verdict(entries, until=5.0).problems == ["5.000: it still moves with 0.5 at the end"]
    # Its last word was legal, and the next one comes much too late.
    (problem,) = verdict([*entries, Entry(4.0, 0.0)]).problems
    assert problem.startswith("4.000: a stop from 0.5 begins too late; the newest wish is 0.5 under lease 1, sent 2.0")


def test_a_stop_that_takes_too_long_is_one() -> None:
    assert verdict(hump(1.05, 2.2, fall_s=0.54)).problems == []
    (problem,) = verdict(hump(1.05, 2.2, fall_s=0.7)).problems
    assert "a stop takes 0.700 s, at most 0.560 s are legal" in problem


def test_a_speed_that_rises_may_go_on_rising_while_its_slope_is_let_go() -> None:
    rising = [Entry(at, (at - LATEST + 0.2) / 2) for at in every(0.01, LATEST - 0.19, LATEST + 0.02)]
    highest = rising[-1].speed
    falling = [Entry(LATEST + 0.02 + at, highest * (1 - at / 0.2)) for at in every(0.02, 0.02, 0.2)]
    facts = {"wishes": wishes(until=LAST)}
    assert verdict([*rising, *falling, Entry(LATEST + 0.3, 0.0)], **facts).problems == []
    held = [Entry(at, highest) for at in every(0.01, LATEST - 0.19, LATEST + 0.02)]
    assert verdict([*held, *falling, Entry(LATEST + 0.3, 0.0)], **facts).problems


def test_what_moves_again_without_a_new_lease_is_a_problem() -> None:
    late = wishes(since=3.0, until=3.5)
    entries = [*hump(1.05, 2.2), *hump(3.05, 3.6)]
    problems = verdict(entries, wishes=[*wishes(), *late]).problems
    assert "nobody wishes a speed of" in problems[0]
    again = [Wish(*wish[:2], 2, wish.speed) for wish in late]
    granted = [Grant(1, 0.8, 0.9), Grant(2, 2.8, 2.9)]
    assert verdict(entries, wishes=[*wishes(), *again], grants=granted).problems == []


def test_what_rises_before_a_stop_was_over_is_a_problem() -> None:
    falling = [entry for entry in hump(1.05, 1.6) if entry.at < 1.75]
    again = [Entry(at, FULL) for at in every(0.02, 1.76, 2.2)]
    assert "while it is stopped" in verdict([*falling, *again, Entry(2.22, 0.0)]).problems[0]


def test_a_robot_that_waited_for_a_core_may_not_have_taken_the_zero_between_two_who_drive() -> None:
    falling = [entry for entry in hump(1.05, 1.6) if entry.at < 1.9]
    entries = [*falling, *hump(1.95, LAST + RULES.deadman_s, -FULL)[1:]]
    facts = {
        "grants": [Grant(1, 0.8, 0.9), Grant(2, 1.5, 1.6)],
        "wishes": [*wishes(until=1.6), *wishes(2, -FULL, since=1.7)],
    }
    assert "without standing between" in verdict(entries, **facts).problems[0]
    for waited_s, problems in ((0.0, 2), (0.01, 2), (0.03, 0)):
        waited = [Waited(1.0, {"1": 0.0}), Waited(1.9, {"1": 0.0}), Waited(1.98, {"1": waited_s})]
        assert len(verdict(entries, takes_last=waited, **facts).problems) == problems


def test_a_stale_echo_is_an_old_wish_however_late_it_is_sent() -> None:
    stale = [Wish(at, LAST, 1, FULL) for at in every(0.05, LAST, LAST + 2)]
    assert verdict(hump(1.05, LAST + RULES.deadman_s), wishes=[*wishes(), *stale]).problems == []
    assert verdict(hump(1.05, LATEST + 0.1), wishes=[*wishes(), *stale]).problems


@pytest.mark.parametrize("is_lost", [True, False])
def test_what_was_sent_into_a_link_that_is_cut_explains_nothing(is_lost: bool) -> None:
    on = wishes(until=4.0)
    blocked = [Blocked(LAST + 0.001, 3.9, is_lost)]
    assert verdict(hump(1.05, LATEST - 0.01), wishes=on, blocked=blocked).problems == []
    assert verdict(hump(1.05, LATEST + 0.1), wishes=on, blocked=blocked).problems
    assert verdict(hump(1.05, LATEST + 0.1), wishes=on).problems == []


def test_a_link_of_one_operator_is_not_that_of_another() -> None:
    grants = [Grant(1, 0.8, 0.9), Grant(2, 2.0, 2.1)]
    both = [*wishes(until=4.0), *wishes(2, -0.2, since=2.1, until=3.0)]
    record = [*hump(1.05, 2.1), *hump(2.5, 3.1, -0.2)]
    assert verdict(record, wishes=both, grants=grants, blocked=[Blocked(1.9, 3.5, False, 1)]).problems == []
    assert verdict(record, wishes=both, grants=grants, blocked=[Blocked(1.9, 3.5, False)]).problems


def test_what_waited_explains_a_motion_only_when_it_comes_and_while_it_is_fresh() -> None:
    blocked = [Blocked(1.9, 2.2, False)]
    on = wishes(until=4.0)
    assert verdict(hump(1.05, 3.0), wishes=on, blocked=blocked).problems == [], "a short while, ridden out"
    found = verdict(hump(1.05, 3.0), wishes=on, blocked=[Blocked(1.9, 2.6, False)]).problems
    assert "nobody wishes" in found[0]


def test_a_bridge_that_stands_leaves_the_robot_to_its_own_watch() -> None:
    before = [entry for entry in hump(1.05, 9.0) if entry.at < LAST]
    frozen = [Frozen(LAST, 5.0)]
    assert verdict([*before, Entry(LAST + 0.55, 0.0)], frozen=frozen).problems == []
    assert verdict([*before, Entry(LAST + 0.65, 0.0)], frozen=frozen).problems
    assert verdict([*before, Entry(LAST + 0.55, 0.0)]).problems, "it did not stand"
    queued = [*before, Entry(LAST + 0.55, 0.0), Entry(5.02, FULL), Entry(5.3, 0.0)]
    assert verdict(queued, frozen=frozen, wishes=wishes(until=6.0)).problems


def test_a_bridge_that_stands_in_the_middle_of_a_stop_draws_it_out_by_that() -> None:
    falling = [entry for entry in hump(1.05, 2.2) if entry.at < 2.3]
    late = [*falling, *[entry._replace(at=entry.at + 0.4) for entry in hump(1.05, 2.2) if entry.at >= 2.3]]
    assert verdict(late, frozen=[Frozen(2.3, 2.7)]).problems == []
    assert verdict(late).problems
    too_late = [*falling, Entry(3.3, 0.0)]
    assert verdict(too_late, frozen=[Frozen(2.3, 3.4)]).problems


def test_a_lease_that_was_taken_over_explains_nothing_more() -> None:
    grants = [Grant(1, 0.8, 0.9), Grant(2, 2.0, 2.1)]
    both = [*wishes(until=4.0), *wishes(2, -0.2, since=2.1, until=3.0)]
    good = [*hump(1.05, 2.1), *hump(2.5, 3.1, -0.2)]
    assert verdict(good, wishes=both, grants=grants).problems == []
    late = [*hump(1.05, 2.5), *hump(2.9, 3.1, -0.2)]
    assert "nobody wishes a speed of 0.5" in verdict(late, wishes=both, grants=grants).problems[0]
    mixed = [*hump(1.05, 2.1), *hump(2.5, 2.8, -0.2), *hump(3.2, 3.6)]
    assert "nobody wishes a speed of" in verdict(mixed, wishes=both, grants=grants).problems[0]
    flipped = [*[entry for entry in hump(1.05, 2.1) if entry.at < 2.2], *hump(2.3, 3.1, -0.2)[5:]]
    assert "two command" in verdict(flipped, wishes=both, grants=grants).problems[0]


def test_a_speed_beyond_what_is_wished_is_nobodys() -> None:
    grants = [Grant(1, 0.8, 0.9), Grant(2, 2.8, 2.9)]
    slow = [*wishes(), *wishes(2, 0.2, since=2.9, until=3.9)]
    assert verdict([*hump(1.05, 2.2), *hump(3.0, 4.0, 0.2)], wishes=slow, grants=grants).problems == []
    assert verdict([*hump(1.05, 2.2), *hump(3.0, 4.0, 0.3)], wishes=slow, grants=grants).problems


def test_a_record_without_a_wish_is_a_problem() -> None:
    assert "nobody has wished anything yet" in verdict(hump(1.05, 2.0), wishes=[]).problems[0]


def test_what_a_machine_did_not_run_is_late_by_that_and_no_more() -> None:
    late_s = 0.2
    record = hump(1.05, LATEST + late_s - 0.01)
    deadline = LAST + RULES.deadman_s
    assert "nobody wishes a speed" in verdict(record).problems[0]

    def waiting(*totals: tuple[float, dict[str, float]]) -> list[list[Waited]]:
        return [[Waited(at, total_s) for at, total_s in totals]]

    first = (deadline - 0.02, {"1": 3.0, "2": 7.0})
    # One thread waited for a core until it stopped the robot, or the one process and then the other.
    assert verdict(record, waited=waiting(first, (record[-1].at, {"1": 3.0 + late_s, "2": 7.0}))).problems == []
    halves = waiting(first, (record[-1].at, {"1": 3.0 + late_s / 2, "2": 7.0}))
    assert verdict(record, waited=halves * 2).problems == []
    assert verdict(record, waited=halves).problems
    # Not what two threads waited at the same time, what was waited before, and what a thread waited that is new.
    both = (record[-1].at, {"1": 3.0 + late_s / 2, "2": 7.0 + late_s / 2})
    assert verdict(record, waited=waiting(first, both)).problems
    before = waiting((1.0, {"1": 0.0}), (deadline - 0.02, {"1": 9.0}), (record[-1].at, {"1": 9.0}))
    assert verdict(record, waited=before).problems
    assert verdict(record, waited=waiting(first, (record[-1].at, {"3": 9.0}))).problems
    assert verdict(record, waited=waiting((record[-1].at, {"1": 9.0}))).problems
    # However long it waited, it does not go on for longer than that.
    long = hump(1.05, LATEST + 2 * late_s)
    assert verdict(long, waited=waiting(first, (long[-1].at, {"1": 3.0 + late_s, "2": 7.0}))).problems
