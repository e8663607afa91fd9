"""What can be set on a controller by ur-rtde's client for inputs and outputs. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from ua_fleet.config.base import ScalarType

__all__ = ["ALL_OUTPUTS", "OUTPUT_NAMES", "SPEEDS", "Output", "find_output"]

_FLOATS: Final = (ScalarType.DOUBLE, ScalarType.FLOAT)
_BOOLEAN: Final = (ScalarType.BOOLEAN,)
_INTEGERS: Final = (ScalarType.INT32, ScalarType.INT16, ScalarType.BYTE, ScalarType.SBYTE)
_NAME: Final = re.compile(r"([a-z_]+)(?:\[(\d{1,2})\])?")
_TOLERANCE: Final = 0.005


class _Setter(NamedTuple):
    method: str
    """Of ur-rtde's RTDEIOInterface."""
    types: tuple[ScalarType, ...]
    places: range
    """The numbers that it has; empty where there is only one."""
    least: float
    most: float


_SETTERS: Final[Mapping[str, _Setter]] = {
    "standard_digital_out": _Setter("setStandardDigitalOut", _BOOLEAN, range(8), 0, 1),
    "configurable_digital_out": _Setter("setConfigurableDigitalOut", _BOOLEAN, range(8), 0, 1),
    "tool_digital_out": _Setter("setToolDigitalOut", _BOOLEAN, range(2), 0, 1),
    "analog_out_voltage": _Setter("setAnalogOutputVoltage", _FLOATS, range(2), 0, 1),
    "analog_out_current": _Setter("setAnalogOutputCurrent", _FLOATS, range(2), 0, 1),
    "speed_slider": _Setter("setSpeedSlider", _FLOATS, range(0), 0, 1),
    "input_int_register": _Setter("setInputIntRegister", _INTEGERS, range(18, 23), -(2**31), 2**31 - 1),
    "input_double_register": _Setter("setInputDoubleRegister", _FLOATS, range(18, 23), -math.inf, math.inf),
}
_FIRST_BIT: Final = {"standard_digital_out": 0, "configurable_digital_out": 8, "tool_digital_out": 16}
_ANALOG: Final = {"analog_out_voltage": (0.0, 10.0), "analog_out_current": (0.004, 0.020)}


class Output(NamedTuple):
    """One thing that can be set."""

    name: str
    place: int | None
    setter: _Setter

    @property
    def types(self) -> tuple[ScalarType, ...]:
        """The types that its value may have."""
        return self.setter.types

    def call(self, value: Any) -> tuple[str, list[Any]]:
        """The method and its arguments.

        Raises:
            ValueError: a value that the controller does not take.
        """
        if self.types is _BOOLEAN:
            if not isinstance(value, bool):
                raise ValueError(f"{value!r} is neither True nor False")
            given: Any = value
        else:
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise ValueError(f"{value!r} is no number")
            if not self.setter.least <= value <= self.setter.most:
                raise ValueError(f"{value} is not within {self.setter.least:g} to {self.setter.most:g}")
            given = int(value) if self.types is _INTEGERS else float(value)
        return self.setter.method, [given] if self.place is None else [self.place, given]

    def is_seen(self, value: Any, state: Mapping[str, Any]) -> bool:
        """Whether the controller shows the value; what it does not show counts as seen."""
        if self.name in _FIRST_BIT and self.place is not None:
            bit = _FIRST_BIT[self.name] + self.place
            return bool(int(state["actual_digital_output_bits"]) >> bit & 1) is value
        if self.name == "speed_slider":
            return abs(float(state["target_speed_fraction"]) - float(value)) <= _TOLERANCE
        if self.name in _ANALOG:
            low, high = _ANALOG[self.name]
            shown = (float(state[f"standard_analog_output{self.place}"]) - low) / (high - low)
            return abs(shown - float(value)) <= _TOLERANCE
        return True


def find_output(name: str) -> Output | None:
    """The output of a name such as `standard_digital_out[3]` or `speed_slider`; None where there is none."""
    match = _NAME.fullmatch(name)
    setter = _SETTERS.get(match[1]) if match is not None else None
    if match is None or setter is None:
        return None
    place = None if match[2] is None else int(match[2])
    fits = place in setter.places if setter.places else place is None
    return Output(match[1], place, setter) if fits else None


SPEEDS: Final[Mapping[str, tuple[str, ...]]] = {
    "joint_speed": ("base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"),
    "tool_speed": ("x", "y", "z", "rx", "ry", "rz"),
}
"""What an arm is driven by hand by, with the names of its numbers: rad/s, or m/s and rad/s in the base."""

ALL_OUTPUTS: Final = tuple(
    f"{name}[{place}]" if setter.places else name
    for name, setter in _SETTERS.items()
    for place in setter.places or range(1)
)
"""Every output by its name."""
OUTPUT_NAMES: Final = tuple(
    [f"{name}[{setter.places[0]}]" if setter.places else name for name, setter in _SETTERS.items()]
)
"""One example of each, for messages."""
