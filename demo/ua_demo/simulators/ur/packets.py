"""What the ports 30001 to 30003 send. Pure.

Layouts from the client interface tables ("Remote control via TCP/IP") for PolyScope 5.10 and later. The primary and
secondary clients get the version and, ten times a second, a robot state with the sub-packages 0 (robot mode),
1 (joints), 4 (Cartesian) and 3 (master board). Values that a simulated arm does not have are zero.
"""

from __future__ import annotations

import struct
from typing import Final

from ua_bridges.ur.modes import RobotStatus, RuntimeState, SafetyMode

from ua_demo.simulators.ur.controller import Controller, LogLine

__all__ = ["REALTIME_BYTES", "log_message", "realtime_packet", "robot_state", "version_message"]

_ROBOT_STATE: Final = 16
_ROBOT_MESSAGE: Final = 20
_VERSION, _RUNTIME_EXCEPTION, _TEXT = 3, 10, 0
REALTIME_BYTES: Final = 1220
_REALTIME: Final = struct.Struct(">i152d")
_JOINT_RUNNING: Final = 253
_ZERO: Final = [0.0] * 6
_SOURCE: Final = -2
"""A message of the program's interpreter."""


def realtime_packet(controller: Controller) -> bytes:
    """The packet of port 30003, once each cycle."""
    arm = controller.arm
    joint_mode = float(_JOINT_RUNNING if controller.status_bits & RobotStatus.POWER_ON else 239)
    values: list[float] = [controller.time, *arm.q, *arm.qd, *arm.qdd, *_ZERO, *_ZERO]
    values += [*arm.q, *arm.qd, *_ZERO, *_ZERO]
    values += [*arm.tcp_pose(), *arm.tcp_speed(), *_ZERO, *arm.tcp_pose(), *arm.tcp_speed()]
    values += [float(controller.digital_inputs), *[30.0] * 6, controller.jitter_s, 0.0]
    values += [float(controller.robot_mode), *[joint_mode] * 6, float(controller.safety_mode), *_ZERO]
    values += [0.0, 0.0, 9.81, *_ZERO, controller.speed_scaling, 0.0, 0.0, 0.0, 48.0, 48.0, 0.0, *[48.0] * 6]
    values += [float(controller.digital_outputs), float(controller.runtime), *_ZERO, float(controller.safety_mode)]
    values += [0.0, 0.0, 0.0, controller.payload, *controller.payload_cog, *controller.payload_inertia]
    return _REALTIME.pack(REALTIME_BYTES, *values)


def _message(kind: int, payload: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(payload), kind) + payload


def _part(kind: int, payload: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(payload), kind) + payload


def version_message(controller: Controller) -> bytes:
    """What a primary or secondary client gets first."""
    major, minor, bugfix, build = controller.settings.version
    name, date = b"URControl", b"01-01-2024, 00:00:00"
    payload = struct.pack(">QbbB", _microseconds(controller.time), _SOURCE, _VERSION, len(name)) + name
    return _message(_ROBOT_MESSAGE, payload + struct.pack(">BBii", major, minor, bugfix, build) + date)


def log_message(line: LogLine) -> bytes:
    """A program's text or error, for primary clients."""
    if line.kind == "exception":
        payload = struct.pack(">Qbbii", _microseconds(line.time), _SOURCE, _RUNTIME_EXCEPTION, line.line, 0)
    else:
        payload = struct.pack(">Qbb", _microseconds(line.time), _SOURCE, _TEXT)
    return _message(_ROBOT_MESSAGE, payload + line.text.encode())


def robot_state(controller: Controller) -> bytes:
    """The state for primary and secondary clients."""
    return _message(
        _ROBOT_STATE,
        _mode_part(controller) + _joint_part(controller) + _cartesian_part(controller) + _board_part(controller),
    )


def _microseconds(time: float) -> int:
    return round(time * 1e6)


def _mode_part(controller: Controller) -> bytes:
    powered = bool(controller.status_bits & RobotStatus.POWER_ON)
    mode = controller.safety_mode
    stopped = mode in (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)
    flags = struct.pack(
        ">7?",
        True,
        True,
        powered,
        stopped,
        mode is SafetyMode.PROTECTIVE_STOP,
        controller.is_playing,
        controller.runtime is RuntimeState.PAUSED,
    )
    numbers = struct.pack(
        ">BBdddB", controller.robot_mode, 0, controller.speed_slider, controller.speed_scaling, 1.0, 0
    )
    return _part(0, struct.pack(">Q", _microseconds(controller.time)) + flags + numbers)


def _joint_part(controller: Controller) -> bytes:
    mode = _JOINT_RUNNING if controller.status_bits & RobotStatus.POWER_ON else 239
    joints = [
        struct.pack(">dddffffB", q, q, qd, 0.0, 48.0, 30.0, 30.0, mode)
        for q, qd in zip(controller.arm.q, controller.arm.qd, strict=True)
    ]
    return _part(1, b"".join(joints))


def _cartesian_part(controller: Controller) -> bytes:
    return _part(4, struct.pack(">12d", *controller.arm.tcp_pose(), *controller.arm.tcp_offset))


def _board_part(controller: Controller) -> bytes:
    domains, inputs, outputs = controller.analog_domains, controller.analog_inputs, controller.analog_outputs
    return _part(
        3,
        struct.pack(
            ">iibbddbbdd", controller.digital_inputs, controller.digital_outputs, 1, 1, *inputs, *domains, *outputs
        )
        + struct.pack(">ffffBB", 30.0, 48.0, 0.0, 0.0, controller.safety_mode, 0)
        + struct.pack(">BiBB", 0, 0, 0, 0),
    )
