"""The arm as it is driven by hand: speeds come from the event loop, and the commander's thread sends the latest.

    (idle)   somebody asks for the arm          -> ur-rtde's control program is started under RTDE's watchdog: armed
    armed    a speed is written                 -> it is sent, and the watchdog is kicked
    armed    IDLE_S after the last zero, or nobody begins to drive within UNUSED_S -> the program is stopped: idle
    armed    the program is seen to be stopped, or the connection is lost          -> idle, which ends the lease

The controller itself stops its program, and so the arm, when the watchdog is not kicked for `robot_timeout_s`: the
robot's own watch, which works where this bridge is dead. While the arm is driven only a speed kicks it. To start the
program takes a second at most; who asks meanwhile is refused, since nobody is to drive an arm that does not follow yet.

A program that has ended is started again by the next one who asks for the arm, never by the lease that ends with it.
The arm stands by then, and follows once a zero was written: what is left of an earlier ramp would set it in motion.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final

from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.modes import RuntimeState
from ua_bridges.ur.outputs import SPEEDS
from ua_bridges.ur.state import State
from ua_fleet.errors import SkillError, SkillFailed
from ua_fleet.teleoperation import TeleoperationModel

__all__ = ["Speeding"]

IDLE_S: Final = 0.3
UNUSED_S: Final = 5.0
_SEEN_S: Final = 1.0
"""The state shows within this that the control program runs."""
_LOOK_S: Final = 0.01
_AXES: Final = 6
_SPARE: Final = 2.0
"""The controller may accelerate so much more than the setpoints do, so that it follows each within its period."""
_STARTING: Final = "its control program is being started; acquire it again in a moment"


class Speeding:
    """The speeds of one arm."""

    def __init__(self, model: TeleoperationModel, output: str, paths: Sequence[str]) -> None:
        """Make it for the data of a teleoperation.

        Args:
            model: the teleoperation.
            output: `joint_speed` or `tool_speed`.
            paths: which of its six numbers each axis of the model is.
        """
        self._method = "speedJ" if output == "joint_speed" else "speedL"
        self._places = [SPEEDS[output].index(path) for path in paths]
        self._timeout_s = model.robot_timeout_s
        limits = [each for _, each in model.axes]
        self._acceleration = _SPARE * max(max(each.acceleration, each.deceleration) for each in limits)
        self._deceleration = max(each.deceleration for each in limits)
        self._latest: tuple[float, tuple[float, ...]] = (-math.inf, ())
        """When the last speed was written, and which."""
        self._is_waiting = self._is_arming = False
        """Whether the commander was told that there is a speed, or that the program is wanted."""
        self._problem = ""
        """Why the last start failed, or what has ended."""
        self._has_ended = False
        """Whether the program has ended, and nobody was told."""
        self._has_failed = False
        """Whether the program has ended by itself or by somebody else, and `take_failure` has not said so."""
        self._awaits_zero = False
        """Whether speeds are zero for the arm until one is."""
        self.is_armed = False
        self._armed_at = -math.inf

    # The event loop's side

    def write(self, values: tuple[float, ...]) -> bool:
        """Take a speed; whether the commander has to be told."""
        if self._awaits_zero:
            self._awaits_zero = any(values)
            values = (0.0,) * len(values)
        self._latest = time.monotonic(), values
        was_waiting, self._is_waiting = self._is_waiting, True
        return not was_waiting

    def problem(self) -> str:
        """Why a speed that is written now does not reach the arm; empty where it does."""
        return "" if self.is_armed else self._problem or _STARTING

    def wants_arming(self) -> bool:
        """Whether the commander has to be told to start the program; said once until it was tried.

        Asked of each problem that somebody is told.
        """
        if self._has_ended:
            self._has_ended, self._problem = False, ""
            return False
        was_arming, self._is_arming = self._is_arming, True
        return not (was_arming or self.is_armed)

    # The commander's side

    def arm(self, link: CommandLink, state: State | None) -> None:
        """Start the control program under the watchdog."""
        self._awaits_zero = True
        try:
            if state is not None and not self.is_armed:
                link.take_control(is_playing=state.runtime is RuntimeState.PLAYING)
                link.check_own_program()  # somebody may have begun another one that the state does not show yet
                if not link.call("control", "setWatchdog", 1 / self._timeout_s):
                    raise SkillFailed("it does not set its watchdog; see the robot's log")
                self._problem = ""
                self._latest = (-math.inf, ())
                self._armed_at, self.is_armed = time.monotonic(), True
        except SkillError as error:
            self._problem = f"its control program cannot be started: {error}"
        finally:
            self._is_arming = False

    def send(self, link: CommandLink) -> None:
        """Send the latest speed."""
        self._is_waiting = False
        _, values = self._latest
        if not self.is_armed or not values:
            return
        speeds = [0.0] * _AXES
        for place, value in zip(self._places, values, strict=True):
            speeds[place] = value
        try:
            if not link.call("control", self._method, speeds, self._acceleration, 0.0):
                self._end("the controller does not take speeds; see the robot's log")
            link.call("control", "kickWatchdog")
        except SkillError as error:
            self._end(f"the controller does not take speeds: {error}")

    def look(self, link: CommandLink, state_of: Callable[[], State | None], now: float) -> None:
        """While it is armed: keep the watchdog content where nobody drives, and end where nobody will."""
        (at, values), state = self._latest, state_of()
        is_shown = now > self._armed_at + _SEEN_S
        if not link.has_control:
            self._end("the connection to the controller was lost")
        elif is_shown and (state is None or state.runtime is not RuntimeState.PLAYING):
            self._end("the controller has stopped the control program")
        elif any(values):
            return
        elif now > (self._armed_at + UNUSED_S if not values else at + IDLE_S):
            self.leave(link, state_of)
        else:
            with suppress(SkillError):
                link.call("control", "kickWatchdog")

    def leave(self, link: CommandLink, state_of: Callable[[], State | None]) -> None:
        """Stop the control program, and wait until the state shows it: what comes next begins with its own."""
        self._end("")
        with suppress(SkillError):  # the watchdog stops it then
            link.call("control", "speedStop", self._deceleration)
            link.stop_control()
        until = time.monotonic() + _SEEN_S
        while (state := state_of()) is not None and state.runtime is RuntimeState.PLAYING and time.monotonic() < until:
            time.sleep(_LOOK_S)

    def take_failure(self) -> bool:
        """Whether the program has ended otherwise than by `leave`; said once."""
        has_failed, self._has_failed = self._has_failed, False
        return has_failed

    def _end(self, problem: str) -> None:
        self.is_armed, self._problem, self._has_ended = False, problem, bool(problem)
        self._has_failed = bool(problem)
