"""Who holds which robot by a server, as its bridges and its sessions say."""

from __future__ import annotations

import pytest

from ua_fleet.errors import LeaseRefused
from ua_fleet.operation.leases import MOST_REMEMBERED, OVERTAKING_S, HeldLease, HeldLeases
from ua_fleet.teleoperation import State, Status
from ua_fleet.values import StatusCode


def lease(number: int, session: str = "s1", *, holder: str = "anna", counter: int = 100, at: float = 0.0) -> HeldLease:
    return HeldLease("rover", number, session, holder, (0,), counter, at)


def status(number: int, counter: int, last_end: str = "", holder: str = "") -> Status:
    return Status(counter, State.IDLE, number, holder, 0, last_end, (), (0, 0, 0, 0))


def refusal(leases: HeldLeases, number: int, session: str = "s1") -> tuple[int, str]:
    with pytest.raises(LeaseRefused) as refused:
        leases.check("rover", number, session)
    return refused.value.ua_status, str(refused.value)


def test_a_lease_is_its_sessions_alone() -> None:
    leases = HeldLeases()
    assert refusal(leases, 7) == (StatusCode.BAD_INVALID_STATE, "this session has no lease 7 of rover")
    leases.granted(held := lease(7))
    assert leases.check("rover", 7, "s1") is held
    assert refusal(leases, 7, "s2") == (StatusCode.BAD_USER_ACCESS_DENIED, "lease 7 of rover is another session's")
    assert refusal(leases, 6)[0] == StatusCode.BAD_INVALID_STATE
    leases.end("rover", "released")
    assert refusal(leases, 7) == (StatusCode.BAD_INVALID_STATE, "lease 7 of rover is over (anna: released)")
    assert refusal(leases, 7, "s2") == (StatusCode.BAD_INVALID_STATE, "this session has no lease 7 of rover")


def test_the_bridges_word_ends_it() -> None:
    leases = HeldLeases()
    leases.granted(lease(7))
    assert leases.heard("rover", status(7, 101), 0.1) is None
    ended = leases.heard("rover", status(0, 150, "anna: no setpoint was fresh"), 3.0)
    assert ended is not None
    assert (ended.why, ended.ua_status) == ("anna: no setpoint was fresh", StatusCode.BAD_INVALID_STATE)
    assert leases.get("rover") is None
    assert leases.heard("rover", status(0, 151), 3.1) is None


def test_a_status_of_before_the_grant_says_nothing_of_it() -> None:
    leases = HeldLeases()
    leases.granted(lease(7, at=10.0))
    assert leases.heard("rover", status(0, 100, "otto: released"), 10.1) is None
    assert leases.heard("rover", status(3, 99, holder="otto"), 10.1) is None
    assert leases.heard("rover", status(0, 101, "anna: the bridge"), 10.1) is not None


def test_a_bridge_that_was_started_anew_counts_from_the_beginning() -> None:
    leases = HeldLeases()
    leases.granted(lease(7, at=10.0))
    ended = leases.heard("rover", status(0, 0), 10.0 + OVERTAKING_S)
    assert ended is not None
    assert ended.why == "anna: the bridge was started anew"


def test_the_counter_runs_over() -> None:
    held = lease(7, counter=0xFFFF_FFFE)
    assert not held.is_older(1)
    assert held.is_older(0xFFFF_FFFE)
    assert held.is_older(0xFFFF_FFF0)


@pytest.mark.parametrize("by_status", [True, False])
def test_who_is_overruled_is_told_by_whom(by_status: bool) -> None:
    leases = HeldLeases()
    leases.granted(lease(7))
    if by_status:  # of another server, or before the answer to Acquire
        ended = leases.heard("rover", status(8, 150, "anna: taken over by otto", "otto"), 3.0)
    else:
        ended = leases.granted(lease(8, "s2", holder="otto"))
    assert ended is not None
    assert refusal(leases, 7) == (
        StatusCode.BAD_RESOURCE_UNAVAILABLE,
        "lease 7 of rover is over (anna: taken over by otto)",
    )


def test_the_same_session_acquires_again() -> None:
    leases = HeldLeases()
    leases.granted(lease(7))
    ended = leases.granted(lease(8))
    assert ended is not None
    assert (ended.why, ended.ua_status) == ("anna: acquired again by the same session", StatusCode.BAD_INVALID_STATE)
    assert [each.number for each in leases] == [8]


def test_what_is_remembered_is_bounded() -> None:
    leases = HeldLeases()
    for number in range(1, MOST_REMEMBERED + 3):
        leases.granted(lease(number))
        leases.end("rover", "released")
    assert "is over" not in refusal(leases, 2)[1]
    assert "is over" in refusal(leases, 3)[1]


def test_setpoints_are_sent_in_the_order_of_the_bridge_and_no_more_values_than_axes() -> None:
    held = HeldLease("carrier", 7, "s1", "anna", (1, 0), 100, 0.0)
    assert held.ordered((0.1, 0.2)) == (0.2, 0.1)
    for values in ((), (0.1,), (0.1,) * 200_000):
        assert held.ordered(values) == ()
