from __future__ import annotations

from ua_fleet.endpoint.gateway_logins import (
    UNKNOWN_AT_ONCE,
    UNKNOWN_PER_S,
    Attempt,
    GatewayLogins,
    LoginOutcome,
)
from ua_fleet.endpoint.throttle import FREE_FAILURES, FREE_FAILURES_OF_ADDRESS, MAX_SOURCES


def user(name: str, gateway: str = "console") -> Attempt:
    return Attempt(gateway, name, is_known=True)


def made_up(number: int, gateway: str = "console") -> Attempt:
    return Attempt(gateway, f"nobody{number}", is_known=False)


def test_a_name_that_is_guessed_at_is_locked_and_no_other() -> None:
    logins = GatewayLogins()
    for _ in range(FREE_FAILURES_OF_ADDRESS * 10):
        logins.failure(user("anna"), 0.0)
    assert logins.locked_for(user("anna"), 0.0) > 0
    assert logins.locked_for(user("bert"), 0.0) == 0
    assert logins.locked_for(user("anna", "board"), 0.0) == 0, "another gateway"
    assert logins.outcomes == {("console", LoginOutcome.LOCKED_OUT): 1}


def test_all_users_of_a_gateway_may_fail_together() -> None:
    logins = GatewayLogins()
    for number in range(FREE_FAILURES_OF_ADDRESS * 2):
        logins.failure(user(f"user{number}"), 0.0)
    assert logins.locked_for(user("another"), 0.0) == 0


def test_who_logs_in_is_forgiven() -> None:
    logins = GatewayLogins()
    for _ in range(FREE_FAILURES - 1):
        logins.failure(user("anna"), 0.0)
    logins.success(user("anna"))
    logins.failure(user("anna"), 0.0)
    assert logins.locked_for(user("anna"), 0.0) == 0


def test_names_that_no_user_has_are_checked_within_a_budget() -> None:
    logins = GatewayLogins()
    checked = [logins.may_check(made_up(number), 0.0) for number in range(1_000)]
    assert checked == [True] * UNKNOWN_AT_ONCE + [False] * (1_000 - UNKNOWN_AT_ONCE)
    assert logins.is_flooded("console", 0.0)
    assert logins.may_check(user("anna"), 0.0)
    assert not logins.is_flooded("board", 0.0)
    later = 1 / UNKNOWN_PER_S
    assert [logins.may_check(made_up(number), later) for number in range(2)] == [True, False]
    assert not logins.is_flooded("console", 10 * later)


def test_made_up_names_make_nobody_forget_the_failures_of_a_user() -> None:
    logins = GatewayLogins()
    for _ in range(FREE_FAILURES + 6):
        logins.failure(user("anna"), 0.0)
    for number in range(MAX_SOURCES * 2):
        logins.failure(made_up(number), 1.0)
    assert logins.locked_for(user("anna"), 1.0) > 0


def test_made_up_names_are_locked_as_users_are() -> None:
    """Or a lock would tell which names there are."""
    logins = GatewayLogins()
    for _ in range(FREE_FAILURES):
        logins.failure(user("anna"), 0.0)
        logins.failure(made_up(1), 0.0)
    assert logins.locked_for(user("anna"), 0.5) == logins.locked_for(made_up(1), 0.5) > 0


def test_made_up_names_take_no_place_from_users() -> None:
    assert user("anna").lane.name != made_up(1).lane.name != made_up(1, "board").lane.name
