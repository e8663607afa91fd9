from __future__ import annotations

from ua_fleet.endpoint.throttle import (
    FREE_FAILURES,
    FREE_FAILURES_OF_ADDRESS,
    LONGEST_LOCK_S,
    MAX_SOURCES,
    LoginThrottle,
)


def test_lock_grows_and_ends() -> None:
    throttle = LoginThrottle()
    for _ in range(FREE_FAILURES - 1):
        throttle.failure("a", "alice", 0.0)
    assert throttle.locked_for("a", "alice", 0.0) == 0
    throttle.failure("a", "alice", 0.0)
    assert throttle.locked_for("a", "alice", 0.5) == 0.5
    assert throttle.locked_for("a", "alice", 1.0) == 0
    throttle.failure("a", "alice", 1.0)
    assert throttle.locked_for("a", "alice", 1.0) == 2.0
    for _ in range(20):
        throttle.failure("a", "alice", 1.0)
    assert throttle.locked_for("a", "alice", 1.0) == LONGEST_LOCK_S


def test_others_are_not_locked_out() -> None:
    throttle = LoginThrottle()
    for _ in range(FREE_FAILURES):
        throttle.failure("a", "alice", 0.0)
    assert throttle.locked_for("a", "bob", 0.0) == 0
    assert throttle.locked_for("b", "alice", 0.0) == 0


def test_one_address_cannot_try_all_users() -> None:
    throttle = LoginThrottle()
    for number in range(FREE_FAILURES_OF_ADDRESS):
        throttle.failure("a", f"user{number}", 0.0)
    assert throttle.locked_for("a", "another", 0.0) > 0
    assert throttle.locked_for("b", "another", 0.0) == 0


def test_success_forgets_the_users_failures() -> None:
    throttle = LoginThrottle()
    for _ in range(FREE_FAILURES - 1):
        throttle.failure("a", "alice", 0.0)
    throttle.success("a", "alice")
    throttle.failure("a", "alice", 0.0)
    assert throttle.locked_for("a", "alice", 0.0) == 0


def test_failures_are_forgotten_in_time() -> None:
    throttle = LoginThrottle()
    for _ in range(FREE_FAILURES - 1):
        throttle.failure("a", "alice", 0.0)
    throttle.failure("a", "alice", 10_000.0)
    assert throttle.locked_for("a", "alice", 10_000.0) == 0


def test_memory_is_bounded() -> None:
    throttle = LoginThrottle()
    for number in range(MAX_SOURCES * 2):
        throttle.failure(f"address {number}", "alice", 0.0)
    assert len(throttle._sources) <= MAX_SOURCES  # pyright: ignore[reportPrivateUsage]
