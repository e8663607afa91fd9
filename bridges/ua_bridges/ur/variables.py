"""What a controller tells of itself: the names that `path` may have, and how ur-rtde reads them. Pure.

The names are those of RTDE. `actual_q[2]` is one joint, `actual_digital_input_bits[3]` one input. Beside them there are
the modes as words: `robot_mode_text`, `safety_mode_text`, `runtime_state_text`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from enum import Enum, auto
from typing import Any, Final, NamedTuple

from ua_bridges.ur.modes import RobotMode, RuntimeState, SafetyMode
from ua_fleet.config.base import ScalarType

__all__ = ["ALWAYS_READ", "VARIABLES", "Kind", "Reading", "Variable", "read_path", "register_names"]


class Kind(Enum):
    """What a variable holds."""

    FLOAT = auto()
    FLOATS = auto()
    INTEGER = auto()
    BITS = auto()
    TEXT = auto()


class Variable(NamedTuple):
    """One of them."""

    kind: Kind
    rtde: str
    """Name in an RTDE recipe."""
    getter: str
    """Of ur-rtde's RTDEReceiveInterface."""
    arguments: tuple[int, ...] = ()
    size: int = 1
    """Elements, or bits."""
    word: Callable[[int], str] | None = None
    """Of a TEXT: what a number is called."""


def _word(kind: type[RobotMode | SafetyMode | RuntimeState]) -> Callable[[int], str]:
    names = {int(member): member.name for member in kind}
    return lambda value: names.get(value, f"UNKNOWN_{value}")


_FIRST_REGISTER: Final = 12
_REGISTERS: Final = 8
"""ur-rtde reads the output registers 12 to 19."""

VARIABLES: Final[Mapping[str, Variable]] = {
    "timestamp": Variable(Kind.FLOAT, "timestamp", "getTimestamp"),
    **{
        name: Variable(Kind.FLOATS, name, getter, size=6)
        for name, getter in {
            "actual_q": "getActualQ",
            "actual_qd": "getActualQd",
            "target_q": "getTargetQ",
            "target_qd": "getTargetQd",
            "target_qdd": "getTargetQdd",
            "actual_current": "getActualCurrent",
            "target_current": "getTargetCurrent",
            "target_moment": "getTargetMoment",
            "joint_control_output": "getJointControlOutput",
            "joint_temperatures": "getJointTemperatures",
            "actual_joint_voltage": "getActualJointVoltage",
            "actual_TCP_pose": "getActualTCPPose",
            "actual_TCP_speed": "getActualTCPSpeed",
            "actual_TCP_force": "getActualTCPForce",
            "target_TCP_pose": "getTargetTCPPose",
            "target_TCP_speed": "getTargetTCPSpeed",
        }.items()
    },
    "actual_tool_accelerometer": Variable(
        Kind.FLOATS, "actual_tool_accelerometer", "getActualToolAccelerometer", size=3
    ),
    **{
        name: Variable(Kind.FLOAT, name, getter)
        for name, getter in {
            "actual_execution_time": "getActualExecutionTime",
            "speed_scaling": "getSpeedScaling",
            "target_speed_fraction": "getTargetSpeedFraction",
            "actual_momentum": "getActualMomentum",
            "actual_main_voltage": "getActualMainVoltage",
            "actual_robot_voltage": "getActualRobotVoltage",
            "actual_robot_current": "getActualRobotCurrent",
            "standard_analog_input0": "getStandardAnalogInput0",
            "standard_analog_input1": "getStandardAnalogInput1",
            "standard_analog_output0": "getStandardAnalogOutput0",
            "standard_analog_output1": "getStandardAnalogOutput1",
        }.items()
    },
    "actual_digital_input_bits": Variable(Kind.BITS, "actual_digital_input_bits", "getActualDigitalInputBits", size=18),
    "actual_digital_output_bits": Variable(
        Kind.BITS, "actual_digital_output_bits", "getActualDigitalOutputBits", size=18
    ),
    "robot_status_bits": Variable(Kind.BITS, "robot_status_bits", "getRobotStatus", size=4),
    "safety_status_bits": Variable(Kind.BITS, "safety_status_bits", "getSafetyStatusBits", size=11),
    "robot_mode": Variable(Kind.INTEGER, "robot_mode", "getRobotMode"),
    "safety_mode": Variable(Kind.INTEGER, "safety_mode", "getSafetyMode"),
    "runtime_state": Variable(Kind.INTEGER, "runtime_state", "getRuntimeState"),
    "robot_mode_text": Variable(Kind.TEXT, "robot_mode", "getRobotMode", word=_word(RobotMode)),
    "safety_mode_text": Variable(Kind.TEXT, "safety_mode", "getSafetyMode", word=_word(SafetyMode)),
    "runtime_state_text": Variable(Kind.TEXT, "runtime_state", "getRuntimeState", word=_word(RuntimeState)),
    **{
        f"output_int_register_{place}": Variable(
            Kind.INTEGER, f"output_int_register_{place}", "getOutputIntRegister", (place,)
        )
        for place in range(_FIRST_REGISTER, _FIRST_REGISTER + _REGISTERS)
    },
    **{
        f"output_double_register_{place}": Variable(
            Kind.FLOAT, f"output_double_register_{place}", "getOutputDoubleRegister", (place,)
        )
        for place in range(_FIRST_REGISTER, _FIRST_REGISTER + _REGISTERS)
    },
}

ALWAYS_READ: Final = (
    *("timestamp", "robot_mode", "safety_mode", "runtime_state", "actual_q", "actual_qd", "actual_TCP_pose"),
    *("actual_digital_output_bits", "target_speed_fraction", "standard_analog_output0", "standard_analog_output1"),
)
"""What skills and faults need, whatever `fleet.yaml` asks for."""

_PATH: Final = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:\[(\d{1,3})\])?")
_FIELD_TYPES: Final = {
    Kind.FLOAT: (ScalarType.DOUBLE, ScalarType.FLOAT),
    Kind.FLOATS: (ScalarType.DOUBLE, ScalarType.FLOAT),
    Kind.INTEGER: (ScalarType.INT32, ScalarType.INT64),
    Kind.BITS: (ScalarType.UINT32, ScalarType.UINT64),
    Kind.TEXT: (ScalarType.STRING,),
}


def register_names(kind: str, place: int) -> str:
    """Name of an output register, `kind` is `int` or `double`."""
    return f"output_{kind}_register_{place}"


class Reading(NamedTuple):
    """A field of a source: which variable, and which part of it."""

    name: str
    part: int | None
    variable: Variable

    @property
    def types(self) -> tuple[ScalarType, ...]:
        """The types that its field may have; the first is the usual one."""
        if self.part is not None and self.variable.kind is Kind.BITS:
            return (ScalarType.BOOLEAN,)
        return _FIELD_TYPES[self.variable.kind]

    @property
    def is_array(self) -> bool:
        """Whether its field is an array."""
        return self.variable.kind is Kind.FLOATS and self.part is None

    def of(self, values: Mapping[str, Any]) -> Any:
        """The field's value out of a sample, which is keyed by RTDE names."""
        value = values[self.variable.rtde]
        if self.variable.word is not None:
            return self.variable.word(value)
        if self.part is None:
            return tuple(value) if self.variable.kind is Kind.FLOATS else value
        return bool(value >> self.part & 1) if self.variable.kind is Kind.BITS else value[self.part]


def read_path(path: str) -> Reading | None:
    """What a path means; None where there is no such variable, or no such part of it."""
    match = _PATH.fullmatch(path)
    variable = VARIABLES.get(match[1]) if match is not None else None
    if match is None or variable is None:
        return None
    if match[2] is None:
        return Reading(match[1], None, variable)
    index = int(match[2])
    has_parts = variable.kind in (Kind.FLOATS, Kind.BITS)
    return Reading(match[1], index, variable) if has_parts and index < variable.size else None
