"""What the controller said last, and what keeps the robot from moving. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from ua_bridges.ur.modes import RobotMode, RuntimeState, SafetyMode, mode_of

__all__ = ["ControllerClock", "State", "WallClock", "remark_of", "stop_of"]

_STANDS_RAD_S: Final = 1e-3
_LEAK_S_S: Final = 2e-4
"""So fast the clock follows a controller's that is slower than ours."""
_AT_ONCE_NS: Final = 20_000
"""What it takes to look at two clocks, at most."""


@dataclass(frozen=True, slots=True)
class State:
    """One sample."""

    time: float
    """The controller's own clock, s since it was switched on."""
    source_time_ns: int
    """The same time, ns since 1970."""
    taken_s: float
    """The same time, s of this machine's monotonic clock."""
    values: Mapping[str, Any]
    """By names of RTDE."""

    @property
    def robot_mode(self) -> RobotMode:
        """Whether the arm has power."""
        return mode_of(RobotMode, self.values["robot_mode"], RobotMode.NO_CONTROLLER)

    @property
    def safety_mode(self) -> SafetyMode:
        """Whether it may move."""
        return mode_of(SafetyMode, self.values["safety_mode"], SafetyMode.UNDEFINED)

    @property
    def runtime(self) -> RuntimeState:
        """The program on the controller."""
        return mode_of(RuntimeState, self.values["runtime_state"], RuntimeState.STOPPED)

    @property
    def joints(self) -> Sequence[float]:
        """Positions in rad."""
        joints: Sequence[float] = self.values["actual_q"]
        return joints

    @property
    def pose(self) -> Sequence[float]:
        """Of the tool's centre."""
        pose: Sequence[float] = self.values["actual_TCP_pose"]
        return pose

    @property
    def stands(self) -> bool:
        """Whether no joint moves."""
        speeds: Sequence[float] = self.values["actual_qd"]
        return all(abs(speed) < _STANDS_RAD_S for speed in speeds)


class ControllerClock:
    """The controller's time since it was switched on, in our monotonic time, which nobody sets.

    The offset is the least that was seen between the two: a sample that waited on its way does not make it later. One
    for each connection, since the controller may have been off in between.
    """

    def __init__(self, most_late_s: float) -> None:
        """`most_late_s`: no sample comes later, since the connection is given up then."""
        self._most_late_s = most_late_s
        self._offset_s = math.inf
        self._last = -math.inf

    def taken_s(self, stamp: float, received_s: float) -> float:
        """When a sample was taken, s."""
        offset = received_s - stamp
        if stamp < self._last:  # the controller was switched off in between
            self._offset_s = offset
        elif self._offset_s < math.inf:
            learnt = min(offset, self._offset_s + (stamp - self._last) * _LEAK_S_S)
            # More means that its clock stood, or that it is a simulator's, and slow.
            self._offset_s = max(learnt, offset - self._most_late_s)
        else:
            self._offset_s = offset
        self._last = stamp
        return self._offset_s + stamp


class WallClock:
    """Our wall clock beside our monotonic one, as it is set now."""

    def __init__(self) -> None:
        self._offset_ns: int | None = None

    def looked_at(self, before_ns: int, wall_ns: int, after_ns: int) -> None:
        """Both were looked at: the monotonic one before and after. Nothing is learnt where something came between."""
        if self._offset_ns is None or after_ns - before_ns <= _AT_ONCE_NS:
            self._offset_ns = wall_ns - before_ns

    def unix_ns(self, monotonic_s: float) -> int:
        """A time of the monotonic clock, ns since 1970."""
        assert self._offset_ns is not None, "it was never looked at"
        return round(monotonic_s * 1e9) + self._offset_ns


_STOPS: Final[Mapping[SafetyMode, str]] = {
    SafetyMode.PROTECTIVE_STOP: "protective stop: see why, then unlock it",
    SafetyMode.RECOVERY: "recovery: the arm is outside of its safety limits; drive it back by hand",
    SafetyMode.SAFEGUARD_STOP: "safeguard stop: close the gate, then reset it",
    SafetyMode.SYSTEM_EMERGENCY_STOP: "emergency stop of the cell: release it, then power on",
    SafetyMode.ROBOT_EMERGENCY_STOP: "emergency stop at the robot: release it, then power on",
    SafetyMode.VIOLATION: "safety violation: see the robot's log, then restart its safety system",
    SafetyMode.FAULT: "safety fault: see the robot's log, then restart its safety system",
    SafetyMode.VALIDATE_JOINT_ID: "a joint was exchanged: confirm it on the teach pendant",
}


def stop_of(state: State) -> str:
    """Why the safety system lets the arm move no more, in one line; the empty text where it does not say that it does.

    The arm may still slow down: it has stopped where `State.stands`, too.
    """
    return _STOPS.get(state.safety_mode, "")


def remark_of(state: State, remote_control: bool | None) -> str:
    """What else keeps the robot from new work, and says nothing of what it does now; the empty text where nothing does.

    Args:
        state: the last sample.
        remote_control: False in local control, None where it is not known or does not matter.
    """
    if state.safety_mode is SafetyMode.UNDEFINED:
        return "the safety system says nothing; see the teach pendant"
    return "remote control is off: switch it on at the teach pendant" if remote_control is False else ""
