"""What a simulation says is what a fleet would do, whatever was made easier for it."""

from __future__ import annotations

import functools
from dataclasses import replace

import pytest
from ua_demo.equations import EQUATION_12_KINDS
from ua_demo.simulators.fleet import Result, Settings, report, simulate
from ua_demo.simulators.fleet.fleet import SettingsInvalid

from ua_fleet.traffic import MessageKind

SMALL = Settings(robots=6, tasks=12, faults=2)


@functools.cache
def simulated(settings: Settings) -> Result:
    """Once for all tests that need the same."""
    return simulate(settings)


def test_who_gets_a_datagram_changes_no_message() -> None:
    routed, to_all = simulated(SMALL), simulate(replace(SMALL, all_hear_all=True))
    assert routed.traffic.messages_at == to_all.traffic.messages_at
    assert routed.traffic.bytes_at == to_all.traffic.bytes_at
    assert to_all.drops["repeated"] > routed.drops["repeated"]  # they were delivered, and dropped


def test_periods_change_nothing_of_equation_12() -> None:
    usual, slow = simulated(SMALL), simulate(replace(SMALL, keep_alive_s=60))
    for kind in EQUATION_12_KINDS:
        assert usual.traffic.messages[kind] == slow.traffic.messages[kind]
        assert usual.traffic.bytes[kind] == slow.traffic.bytes[kind]
    assert usual.traffic.messages[MessageKind.KEEP_ALIVE] > 5 * slow.traffic.messages[MessageKind.KEEP_ALIVE]


def test_the_same_seed_gives_the_same_report() -> None:
    one, same = report.as_json(simulated(SMALL)), report.as_json(simulate(SMALL))
    assert {**one, "wall_s": 0} == {**same, "wall_s": 0}


def test_another_seed_has_other_robots_fail() -> None:
    failed = {tuple(failure.robot for failure in simulated(replace(SMALL, seed=seed)).failures) for seed in range(4)}
    assert len(failed) > 1


@pytest.mark.parametrize("faults", range(6))
def test_whatever_fails_each_task_is_done_once(faults: int) -> None:
    result = simulated(replace(SMALL, faults=faults))
    assert result.is_right, result.reason
    assert len({failure.robot for failure in result.failures}) == len(result.failures) == faults
    assert result.traffic.messages[MessageKind.FAULT] == faults
    broken: set[str] = set()
    for failure in result.failures:
        broken.add(failure.robot)
        assert failure.replacement
        assert failure.replacement not in broken
        assert failure.task


def test_a_failure_costs_the_fault_and_the_request_to_another_robot() -> None:
    none, one = simulated(replace(SMALL, faults=0)), simulated(replace(SMALL, faults=1))
    more = one.traffic.messages - none.traffic.messages
    wanted = {MessageKind.FAULT: 1, MessageKind.REQUEST: 2, MessageKind.RESPONSE: 2, MessageKind.STATUS: 1}
    assert {kind: count for kind, count in more.items() if kind in EQUATION_12_KINDS} == wanted


def test_one_robot_does_all_by_itself() -> None:
    result = simulate(Settings(1, 9))
    assert result.is_right, result.reason


def test_robots_without_a_task_are_there_all_the_same() -> None:
    result = simulate(Settings(4, 2, faults=2))
    assert result.is_right, result.reason
    assert result.traffic.messages[MessageKind.REGISTRATION] == 4 * 3 + 2


def test_the_usual_period_stretches_with_the_fleet() -> None:
    assert Settings(100, 1).timing.keep_alive_s == 1.0
    large = Settings(1000, 1).timing
    assert (large.keep_alive_s, large.receive_timeout_s, large.repeat_interval_s) == (10.0, 30.0, 50.0)
    assert (large.announce_interval_s, large.status_interval_s) == (600.0, 100.0)
    assert Settings(1000, 1, keep_alive_s=1.0).timing.keep_alive_s == 1.0


@pytest.mark.parametrize(
    ("robots", "tasks", "faults", "keep_alive_s", "said"),
    [
        (0, 1, 0, None, "0 robots: give 1 to 10,000"),
        (10_001, 1, 0, None, "10,001 robots: give 1 to 10,000"),
        (1, 0, 0, None, "0 tasks: give 1 to 10,000"),
        (1, -3, 0, None, "-3 tasks: give 1 to 10,000"),
        (3, 9, 3, None, "3 faults: with 3 robots and 9 tasks give 0 to 2"),
        (9, 2, 3, None, "3 faults: with 9 robots and 2 tasks give 0 to 2"),
        (9, 2, -1, None, "-1 faults"),
        (9, 2, 0, 0.0, "a keep-alive period of 0 s: give 0.1 to 3600"),
        (9, 2, 0, float("nan"), "a keep-alive period of nan s"),
    ],
)
def test_what_cannot_be_simulated(robots: int, tasks: int, faults: int, keep_alive_s: float | None, said: str) -> None:
    with pytest.raises(SettingsInvalid, match=said) as raised:
        Settings(robots, tasks, faults, keep_alive_s=keep_alive_s)
    assert "\n" not in str(raised.value)
