"""A robot's own watch: it stops without speeds, and follows again only after a zero."""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import contextmanager
from queue import Queue

import pytest
from ua_bridges.robot import Driven

TIMEOUT_S = 0.05
PATIENCE_S = 60.0


@contextmanager
def driven(timeout_s: float = TIMEOUT_S) -> Generator[tuple[Driven, Queue[float]]]:
    driven_to: Queue[float] = Queue()
    watch = Driven(driven_to.put, lambda: 0.0, timeout_s)
    try:
        yield watch, driven_to
    finally:
        watch.close()
        assert not watch._thread.is_alive()  # pyright: ignore[reportPrivateUsage]


def test_it_is_stopped_when_speeds_cease_and_follows_after_a_zero() -> None:
    with driven() as (watch, driven_to):
        watch.take(0.3)
        assert (watch.is_stopped, watch.ignored, driven_to.empty()) == (True, 1, True)
        for speed in (0.0, 0.2, 0.3):
            watch.take(speed)
        assert [driven_to.get(timeout=PATIENCE_S) for _ in range(4)] == [0.0, 0.2, 0.3, 0.0]
        assert (watch.is_stopped, watch.stops) == (True, 1)
        watch.take(0.3)
        assert driven_to.empty()
        watch.take(0.0)
        watch.take(0.1)
        assert [driven_to.get(timeout=PATIENCE_S) for _ in range(3)] == [0.0, 0.1, 0.0]


def test_each_speed_gives_it_time_again() -> None:
    now = 0.0
    driven_to: list[float] = []
    watch = Driven(driven_to.append, lambda: 0.0, 100.0, clock=lambda: now)
    for _ in range(3):
        watch.take(0.0)
        now += 99.0
        watch.take(0.5)
    assert watch.stops == 0
    watch.close()
    assert driven_to == [0.0, 0.5] * 3 + [0.0]


def test_a_speed_that_comes_first_after_an_outage_is_not_followed() -> None:
    """The thread may look later than the speed comes, e.g. where the whole program stood."""
    now = 0.0
    driven_to: list[float] = []
    watch = Driven(driven_to.append, lambda: 0.0, 100.0, clock=lambda: now)
    watch.take(0.0)
    watch.take(0.5)
    now += 100.0
    watch.take(0.5)
    assert driven_to == [0.0, 0.5, 0.0]
    assert (watch.is_stopped, watch.stops, watch.ignored) == (True, 1, 1)
    watch.take(0.0)
    watch.take(0.2)
    assert driven_to[3:] == [0.0, 0.2]
    watch.close()


def test_nothing_is_followed_once_it_is_closed() -> None:
    with driven() as (watch, driven_to):
        watch.take(0.0)
        watch.close()
        assert [driven_to.get(timeout=PATIENCE_S) for _ in range(2)] == [0.0, 0.0]
        watch.take(0.0)
        watch.take(0.3)
        assert (watch.is_stopped, driven_to.empty()) == (True, True)


def test_a_function_that_fails_is_told_to_stop_the_next_time_too() -> None:
    stopped = threading.Semaphore(0)

    def drive(speed: float) -> None:
        if not speed:
            stopped.release()
            raise OSError("the motor is away")

    watch = Driven(drive, lambda: 0.0, TIMEOUT_S)
    for _ in range(2):
        with pytest.raises(OSError, match="the motor"):
            watch.take(0.0)
        watch.take(0.4)
        assert stopped.acquire(timeout=PATIENCE_S)
        assert stopped.acquire(timeout=PATIENCE_S)
    watch.close()


class Motor:
    """Takes speeds, but does not take the next zeros."""

    def __init__(self) -> None:
        self.speed, self.failures = 0.0, 0
        self.stopped = threading.Event()

    def drive(self, speed: float) -> None:
        if not speed and self.failures:
            self.failures -= 1
            raise OSError("the motor board did not take it")
        self.speed = speed
        if not speed:
            self.stopped.set()


def test_a_stop_that_fails_is_tried_until_it_went_through(caplog: pytest.LogCaptureFixture) -> None:
    motor = Motor()
    watch = Driven(motor.drive, lambda: 0.0, TIMEOUT_S)
    watch.take(0.0)
    motor.stopped.clear()
    motor.failures = 3
    watch.take(0.5)
    assert motor.stopped.wait(PATIENCE_S)
    watch.close()
    assert (motor.speed, watch.is_stopped, watch.stops, watch.failed_stops) == (0.0, True, 1, 3)
    told = [record.message for record in caplog.records]
    assert [text.split(",")[0] for text in told] == ["the robot could not be stopped", "the robot is stopped now"]


def test_it_counts_as_moving_and_follows_nothing_until_the_zero_went_through() -> None:
    now = 0.0
    motor = Motor()
    watch = Driven(motor.drive, lambda: 0.0, 100.0, clock=lambda: now)
    watch.take(0.0)
    watch.take(0.5)
    motor.failures = 2
    for _ in range(2):
        now += 100.0
        watch.take(0.4)
        assert (motor.speed, watch.is_stopped, watch.stops) == (0.5, False, 1)
    assert (watch.ignored, watch.failed_stops) == (2, 2)
    watch.take(0.0)
    watch.take(0.2)
    assert motor.speed == 0.2, "a zero that is heard stops it, too"
    watch.close()


@pytest.mark.parametrize(("failures", "speed", "told"), [(1, 0.0, "stopped now"), (9, 0.5, "before its program ends")])
def test_closing_stops_a_robot_whose_function_fails_at_first(
    failures: int, speed: float, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    motor = Motor()
    watch = Driven(motor.drive, lambda: 0.0, PATIENCE_S)
    watch.take(0.0)
    watch.take(0.5)
    motor.failures = failures
    watch.close()
    assert (motor.speed, watch.is_stopped) == (speed, not speed)
    assert told in caplog.text


def test_a_time_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="write that of robot_timeout_ms"):
        Driven(print, float, 0.0)
