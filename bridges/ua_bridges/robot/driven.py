"""A robot's own watch over the speeds that somebody sends it: none for too long, and it stops.

It is the last one: it works where the bridge is dead, stopped, or cut off. A stopped robot follows again once it has
heard a zero, which is how the bridge begins each time: so what comes after an outage does not set it in motion at once.
It is no safety function; the robot's own emergency stop stays what it is.
"""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final

__all__ = ["Driven", "DrivenByTopics"]

_TRIES_AT_END: Final = 3
"""So many zeros are tried by `close`: nobody does after it."""

_log = logging.getLogger(__name__)


class Driven:
    """Hands speeds on to a function, and a zero when none comes in time. A daemon thread looks after the time."""

    def __init__(
        self,
        drive: Callable[[Any], None],
        zero: Callable[[], Any],
        timeout_s: float,
        *,
        is_zero: Callable[[Any], bool] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin stopped.

        Args:
            drive: moves the robot; called by one thread at a time, and must return at once.
            zero: makes the message that stops it.
            timeout_s: `robot_timeout_ms` of `fleet.yaml`, in seconds.
            is_zero: whether a message is a zero; by default whether it equals that of `zero`.
            clock: monotonic seconds.
        """
        if not timeout_s > 0:
            raise ValueError(f"timeout_s: {timeout_s:g} is no time; write that of robot_timeout_ms in fleet.yaml")
        self._drive, self._zero, self._timeout_s, self._clock = drive, zero, timeout_s, clock
        self._is_zero = is_zero or self._equals_zero
        self._changed = threading.Condition()
        self._stop_at: float | None = None
        """When it is stopped unless a speed comes before, or the next try where a zero was not taken; None while it
        stands."""
        self._is_followed = False
        """Whether a zero was heard since it was last stopped, so that speeds are followed."""
        self._is_closed = False
        self.stops = 0
        """How often no speed came in time."""
        self.failed_stops = 0
        """How often `drive` did not take the zero that was to stop it."""
        self.ignored = 0
        """Speeds that came before a zero was heard, or after `close`."""
        self._thread = threading.Thread(target=self._look, name="driven", daemon=True)
        self._thread.start()

    @property
    def is_stopped(self) -> bool:
        """Whether it stands and waits for a zero. Not while `drive` does not take the zero that is to stop it."""
        return self._stop_at is None

    def take(self, message: Any) -> None:
        """Take a speed; none is followed after `close`."""
        with self._changed:
            self._look_at_time()  # the thread may not have had its turn yet
            if self._is_closed or not (self._is_followed or self._is_zero(message)):
                self.ignored += 1
                return
            self._is_followed, self._stop_at = True, self._clock() + self._timeout_s
            self._changed.notify()
            self._drive(message)

    def close(self) -> None:
        """Stop the robot if it moves, and the thread. Where `drive` fails at each try, the log says so."""
        with self._changed:
            self._is_closed = True
            for _ in range(_TRIES_AT_END):
                self._stop()
            if not self.is_stopped:
                _log.error("the robot could not be stopped before its program ends; stop it by its own means")
            self._changed.notify()
        self._thread.join()

    def _equals_zero(self, message: Any) -> bool:
        return bool(message == self._zero())

    def _look(self) -> None:
        with self._changed:
            while not self._is_closed:
                self._changed.wait(self._look_at_time())

    def _look_at_time(self) -> float | None:
        """Stop where the time is over; the seconds that are left, None while it stands."""
        if self._stop_at is None:
            return None
        left_s = self._stop_at - self._clock()
        if left_s > 0:
            return left_s
        if self._is_followed:
            self.stops += 1
        self._stop()
        return None if self.is_stopped else self._timeout_s

    def _stop(self) -> None:
        """Have it stopped. It counts as moving until `drive` has taken the zero, and that is tried again."""
        if self._stop_at is None:
            return
        is_first, self._is_followed = self._is_followed, False
        try:
            self._drive(self._zero())
        except Exception:  # noqa: BLE001 - whatever the robot's programmer has not foreseen, it is tried again
            self.failed_stops += 1
            self._stop_at = self._clock() + self._timeout_s
            if is_first:  # once an outage: the tries go on as often as every 20 ms
                _log.exception("the robot could not be stopped, which is tried again; see why its function fails")
        else:
            self._stop_at = None
            if not is_first:
                _log.warning("the robot is stopped now, which it could not be before")


class DrivenByTopics(ABC):
    """A robot that is driven by what comes on topics of its middleware."""

    def driven(
        self, topic: str, kind: type[Any], *, timeout_s: float, is_zero: Callable[[Any], bool] | None = None
    ) -> Callable[[Callable[[Any], None]], Driven]:
        """Have a function move the robot as somebody drives it by hand, and stop it when nothing comes in time.

        Args:
            topic: of the data that takes the setpoints in `fleet.yaml`, e.g. `/cmd_vel`.
            kind: its type, e.g. `geometry_msgs.msg.Twist`; an empty one has to stop the robot.
            timeout_s: `robot_timeout_ms` there, in seconds.
            is_zero: whether a message stops the robot; needed where it has a Header.
        """

        def offer(drive: Callable[[Any], None]) -> Driven:
            watch = Driven(drive, kind, timeout_s, is_zero=is_zero)
            self._hear_speeds(topic, kind, watch.take)
            return watch

        return offer

    @abstractmethod
    def _hear_speeds(self, topic: str, kind: type[Any], take: Callable[[Any], None]) -> None:
        """Have a function called with each message; of those that wait, with the last alone."""
