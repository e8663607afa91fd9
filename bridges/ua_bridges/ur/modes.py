"""What a Universal Robots controller calls its states, as RTDE and the dashboard server give them.

Values from the RTDE guide and the client interface tables of PolyScope 5.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import TypeVar

__all__ = ["RobotMode", "RobotStatus", "RuntimeState", "SafetyMode", "SafetyStatus", "mode_of"]


class RobotMode(IntEnum):
    """`robot_mode`: whether the arm has power, and may move."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    """Powered, with its brakes on."""
    BACKDRIVE = 6
    RUNNING = 7
    """Powered, brakes released: it does what programs say."""
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """`safety_mode`: why the arm stands still, where the safety system says so."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED = 11

    @property
    def may_move(self) -> bool:
        """Whether programs may move the arm."""
        return self in (SafetyMode.NORMAL, SafetyMode.REDUCED)


class RuntimeState(IntEnum):
    """`runtime_state`: the program on the controller."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class RobotStatus(IntFlag):
    """`robot_status_bits`."""

    POWER_ON = 1
    PROGRAM_RUNNING = 2
    TEACH_BUTTON = 4
    POWER_BUTTON = 8


class SafetyStatus(IntFlag):
    """`safety_status_bits`."""

    NORMAL = 1 << 0
    REDUCED = 1 << 1
    PROTECTIVE_STOPPED = 1 << 2
    RECOVERY = 1 << 3
    SAFEGUARD_STOPPED = 1 << 4
    SYSTEM_EMERGENCY_STOPPED = 1 << 5
    ROBOT_EMERGENCY_STOPPED = 1 << 6
    EMERGENCY_STOPPED = 1 << 7
    VIOLATION = 1 << 8
    FAULT = 1 << 9
    STOPPED_DUE_TO_SAFETY = 1 << 10


_Mode = TypeVar("_Mode", RobotMode, SafetyMode, RuntimeState)


def mode_of(kind: type[_Mode], value: int, unknown: _Mode) -> _Mode:
    """The mode of a number; `unknown` for what a newer controller may say."""
    try:
        return kind(value)
    except ValueError:
        return unknown
