"""The variables of RTDE: their types, and where they are in the controller.

Names and types from the RTDE guide for PolyScope 5. What a simulated arm does not have (currents, forces,
temperatures) has the value of one that rests.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from ua_demo.simulators.ur.controller import REGISTERS, Controller

__all__ = ["INPUTS", "OUTPUTS", "TYPES", "Input", "Output"]

TYPES: Final = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
"""RTDE type to the format of `struct`, all in network byte order."""

_SCALARS: Final = frozenset(name for name in TYPES if not name.startswith("VECTOR"))
_REST: Final = [0.0] * 6
_JOINT_RUNNING: Final = 253
_JOINT_POWER_OFF: Final = 239
_TEMPERATURE: Final = [30.0] * 6


@dataclass(frozen=True)
class Output:
    """A variable that clients read."""

    type: str
    read: Callable[[Controller], Any]

    @property
    def is_scalar(self) -> bool:
        """Whether its value is one number, and no vector."""
        return self.type in _SCALARS


@dataclass(frozen=True)
class Input:
    """A variable that clients write. `write` gets all values of a message: some inputs go with a mask."""

    type: str
    write: Callable[[Controller, dict[str, Any]], None] | None = None


def _joint_mode(controller: Controller) -> list[int]:
    return [_JOINT_RUNNING if controller.status_bits & 1 else _JOINT_POWER_OFF] * 6


def _bits(bits: Sequence[bool], first: int) -> int:
    return sum(1 << place for place, bit in enumerate(bits[first : first + 32]) if bit)


OUTPUTS: Final[dict[str, Output]] = {
    "timestamp": Output("DOUBLE", lambda c: c.time),
    "target_q": Output("VECTOR6D", lambda c: c.arm.q),
    "target_qd": Output("VECTOR6D", lambda c: c.arm.qd),
    "target_qdd": Output("VECTOR6D", lambda c: c.arm.qdd),
    "target_current": Output("VECTOR6D", lambda c: _REST),
    "target_moment": Output("VECTOR6D", lambda c: _REST),
    "actual_q": Output("VECTOR6D", lambda c: c.arm.q),
    "actual_qd": Output("VECTOR6D", lambda c: c.arm.qd),
    "actual_current": Output("VECTOR6D", lambda c: _REST),
    "actual_current_window": Output("VECTOR6D", lambda c: _REST),
    "joint_control_output": Output("VECTOR6D", lambda c: _REST),
    "actual_TCP_pose": Output("VECTOR6D", lambda c: c.arm.tcp_pose()),
    "actual_TCP_speed": Output("VECTOR6D", lambda c: c.arm.tcp_speed()),
    "actual_TCP_force": Output("VECTOR6D", lambda c: _REST),
    "target_TCP_pose": Output("VECTOR6D", lambda c: c.arm.tcp_pose()),
    "target_TCP_speed": Output("VECTOR6D", lambda c: c.arm.tcp_speed()),
    "actual_digital_input_bits": Output("UINT64", lambda c: c.digital_inputs),
    "joint_temperatures": Output("VECTOR6D", lambda c: _TEMPERATURE),
    "actual_execution_time": Output("DOUBLE", lambda c: c.jitter_s),
    "robot_mode": Output("INT32", lambda c: int(c.robot_mode)),
    "joint_mode": Output("VECTOR6INT32", _joint_mode),
    "safety_mode": Output("INT32", lambda c: int(c.safety_mode)),
    "safety_status": Output("INT32", lambda c: int(c.safety_mode)),
    "actual_tool_accelerometer": Output("VECTOR3D", lambda c: (0.0, 0.0, 9.81)),
    "speed_scaling": Output("DOUBLE", lambda c: c.speed_scaling),
    "target_speed_fraction": Output("DOUBLE", lambda c: c.speed_slider),
    "actual_momentum": Output("DOUBLE", lambda c: 0.0),
    "actual_main_voltage": Output("DOUBLE", lambda c: 48.0),
    "actual_robot_voltage": Output("DOUBLE", lambda c: 48.0 if c.status_bits & 1 else 0.0),
    "actual_robot_current": Output("DOUBLE", lambda c: 0.0),
    "actual_joint_voltage": Output("VECTOR6D", lambda c: [48.0] * 6 if c.status_bits & 1 else _REST),
    "actual_digital_output_bits": Output("UINT64", lambda c: c.digital_outputs),
    "runtime_state": Output("UINT32", lambda c: int(c.runtime)),
    "elbow_position": Output("VECTOR3D", lambda c: (0.0, 0.0, 0.0)),
    "elbow_velocity": Output("VECTOR3D", lambda c: (0.0, 0.0, 0.0)),
    "robot_status_bits": Output("UINT32", lambda c: int(c.status_bits)),
    "safety_status_bits": Output("UINT32", lambda c: int(c.safety_bits)),
    "analog_io_types": Output("UINT32", lambda c: c.analog_domains[0] << 2 | c.analog_domains[1] << 3),
    "standard_analog_input0": Output("DOUBLE", lambda c: c.analog_inputs[0]),
    "standard_analog_input1": Output("DOUBLE", lambda c: c.analog_inputs[1]),
    "standard_analog_output0": Output("DOUBLE", lambda c: c.analog_outputs[0]),
    "standard_analog_output1": Output("DOUBLE", lambda c: c.analog_outputs[1]),
    "io_current": Output("DOUBLE", lambda c: 0.0),
    "tcp_force_scalar": Output("DOUBLE", lambda c: 0.0),
    "tcp_offset": Output("VECTOR6D", lambda c: c.arm.tcp_offset),
    "ft_raw_wrench": Output("VECTOR6D", lambda c: _REST),
    "payload": Output("DOUBLE", lambda c: c.payload),
    "payload_cog": Output("VECTOR3D", lambda c: c.payload_cog),
    "payload_inertia": Output("VECTOR6D", lambda c: c.payload_inertia),
    "script_control_line": Output("UINT32", lambda c: 0),
    "output_bit_registers0_to_31": Output("UINT32", lambda c: _bits(c.outputs.bits, 0)),
    "output_bit_registers32_to_63": Output("UINT32", lambda c: _bits(c.outputs.bits, 32)),
    "input_bit_registers0_to_31": Output("UINT32", lambda c: _bits(c.inputs.bits, 0)),
    "input_bit_registers32_to_63": Output("UINT32", lambda c: _bits(c.inputs.bits, 32)),
}


def _masked(mask: str, value: str, first: int) -> Callable[[Controller, dict[str, Any]], None]:
    def write(controller: Controller, values: dict[str, Any]) -> None:
        wanted, bits = int(values.get(mask, 0)) << first, int(values.get(value, 0)) << first
        controller.digital_outputs = (controller.digital_outputs & ~wanted) | (bits & wanted)

    return write


def _write_slider(controller: Controller, values: dict[str, Any]) -> None:
    fraction = values.get("speed_slider_fraction", -1.0)
    if values.get("speed_slider_mask") and 0.0 <= fraction <= 1.0:
        controller.speed_slider = fraction


def _write_analog(controller: Controller, values: dict[str, Any]) -> None:
    mask, domains = values.get("standard_analog_output_mask", 0), values.get("standard_analog_output_type", 0)
    for place in (0, 1):
        part = values.get(f"standard_analog_output_{place}", -1.0)
        if mask >> place & 1 and 0.0 <= part <= 1.0:
            voltage = domains >> place & 1
            low, high = (0.0, 10.0) if voltage else (0.004, 0.020)
            controller.analog_domains[place] = voltage
            controller.analog_outputs[place] = low + part * (high - low)


def _write_bits(name: str, first: int) -> Callable[[Controller, dict[str, Any]], None]:
    def write(controller: Controller, values: dict[str, Any]) -> None:
        for place in range(32):
            controller.inputs.bits[first + place] = bool(values[name] >> place & 1)

    return write


INPUTS: Final[dict[str, Input]] = {
    "speed_slider_mask": Input("UINT32"),
    "speed_slider_fraction": Input("DOUBLE", _write_slider),
    "standard_digital_output_mask": Input("UINT8"),
    "standard_digital_output": Input("UINT8", _masked("standard_digital_output_mask", "standard_digital_output", 0)),
    "configurable_digital_output_mask": Input("UINT8"),
    "configurable_digital_output": Input(
        "UINT8", _masked("configurable_digital_output_mask", "configurable_digital_output", 8)
    ),
    "tool_digital_output_mask": Input("UINT8"),
    "tool_digital_output": Input("UINT8", _masked("tool_digital_output_mask", "tool_digital_output", 16)),
    "standard_analog_output_mask": Input("UINT8", _write_analog),
    "standard_analog_output_type": Input("UINT8"),
    "standard_analog_output_0": Input("DOUBLE"),
    "standard_analog_output_1": Input("DOUBLE"),
    "input_bit_registers0_to_31": Input("UINT32", _write_bits("input_bit_registers0_to_31", 0)),
    "input_bit_registers32_to_63": Input("UINT32", _write_bits("input_bit_registers32_to_63", 32)),
    "external_force_torque": Input("VECTOR6D"),
}


def _add_registers() -> None:
    def ints(place: int) -> None:
        def write(controller: Controller, values: dict[str, Any]) -> None:
            controller.inputs.ints[place] = values[f"input_int_register_{place}"]

        OUTPUTS[f"output_int_register_{place}"] = Output("INT32", lambda c: c.outputs.ints[place])
        OUTPUTS[f"input_int_register_{place}"] = Output("INT32", lambda c: c.inputs.ints[place])
        INPUTS[f"input_int_register_{place}"] = Input("INT32", write)

    def doubles(place: int) -> None:
        def write(controller: Controller, values: dict[str, Any]) -> None:
            controller.inputs.doubles[place] = values[f"input_double_register_{place}"]

        OUTPUTS[f"output_double_register_{place}"] = Output("DOUBLE", lambda c: c.outputs.doubles[place])
        OUTPUTS[f"input_double_register_{place}"] = Output("DOUBLE", lambda c: c.inputs.doubles[place])
        INPUTS[f"input_double_register_{place}"] = Input("DOUBLE", write)

    def bits(place: int) -> None:
        def write(controller: Controller, values: dict[str, Any]) -> None:
            controller.inputs.bits[place] = values[f"input_bit_register_{place}"]

        OUTPUTS[f"output_bit_register_{place}"] = Output("BOOL", lambda c: c.outputs.bits[place])
        OUTPUTS[f"input_bit_register_{place}"] = Output("BOOL", lambda c: c.inputs.bits[place])
        INPUTS[f"input_bit_register_{place}"] = Input("BOOL", write)

    for place in range(REGISTERS):
        ints(place)
        doubles(place)
    for place in range(64, 128):
        bits(place)


_add_registers()


def packed(types: Sequence[str]) -> struct.Struct:
    """The layout of a message with fields of these types."""
    return struct.Struct(">" + "".join(TYPES[name] for name in types))
