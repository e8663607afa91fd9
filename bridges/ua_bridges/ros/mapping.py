"""A robot's own topics as DataSets: the fields that `fleet.yaml` picks out of a message, in the types it gives them.

What does not fit (another message type, NaN into an integer, an array that is too short) is no exception: the field
gets a Bad StatusCode in place of its value, the reason is told beside it, and the other fields go on.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from numbers import Integral, Real
from typing import Any, Final, NamedTuple, TypeGuard

from ua_fleet.config.schema import DataSetConfig, FieldConfig, ScalarType
from ua_fleet.values import BuiltinType, StatusCode, Variant, ticks_from_unix_ns

__all__ = ["FieldProblem", "FieldUnfit", "MappedSource", "cast_scalar", "compile_path"]

INTEGER_RANGES: Final = {
    ScalarType.SBYTE: (-(1 << 7), (1 << 7) - 1),
    ScalarType.BYTE: (0, (1 << 8) - 1),
    ScalarType.INT16: (-(1 << 15), (1 << 15) - 1),
    ScalarType.UINT16: (0, (1 << 16) - 1),
    ScalarType.INT32: (-(1 << 31), (1 << 31) - 1),
    ScalarType.UINT32: (0, (1 << 32) - 1),
    ScalarType.INT64: (-(1 << 63), (1 << 63) - 1),
    ScalarType.UINT64: (0, (1 << 64) - 1),
}
"""Least and greatest value of each integer type (OPC 10000-6 table 1)."""
MAX_FLOAT: Final = 3.4028234663852886e38
"""Greatest finite value of an IEEE 754 single."""

_NUMBER = re.compile(r"-?\b\d[\d.e+-]*")
_STEP = re.compile(r"([A-Za-z][A-Za-z0-9_]*)((?:\[\d{1,6}\])*)", re.ASCII)


class FieldUnfit(Exception):
    """A value that the configured field cannot hold."""

    def __init__(self, status: int, reason: str) -> None:
        self.status, self.reason = status, reason
        super().__init__(reason)


class FieldProblem(NamedTuple):
    """Why a field is Bad. `new` once for each reason until the field is Good again: a log needs no more."""

    field: str
    status: int
    reason: str
    new: bool


def compile_path(path: str) -> Callable[[Any], Any]:
    """A function that follows `twist.linear.x` or `position[2]` into a message; it raises FieldUnfit."""
    steps: list[str | int] = []
    for part in path.split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            raise ValueError(f"{path!r} is not the path of a field; write it like `twist.linear.x` or `position[2]`")
        steps.append(match[1])
        steps.extend(int(index) for index in re.findall(r"\d+", match[2]))

    def follow(message: Any) -> Any:
        value = message
        for step in steps:
            try:
                value = getattr(value, step) if isinstance(step, str) else value[step]
            except AttributeError:
                raise FieldUnfit(
                    StatusCode.BAD_CONFIGURATION_ERROR, f"the message has no field {path!r}; correct `path`"
                ) from None
            except (IndexError, TypeError):
                raise FieldUnfit(StatusCode.BAD_OUT_OF_RANGE, f"the array of {path!r} has another length") from None
        return value

    return follow


def _mismatch(value: Any, wanted: ScalarType) -> FieldUnfit:
    return FieldUnfit(StatusCode.BAD_TYPE_MISMATCH, f"a {type(value).__name__} is not a {wanted.value}")


def _to_int(value: Any, wanted: ScalarType) -> int:
    if not isinstance(value, Real):  # the ABCs also know numpy's numbers, which rclpy's arrays hold
        raise _mismatch(value, wanted)
    if not isinstance(value, Integral):
        if not math.isfinite(value):
            raise FieldUnfit(StatusCode.BAD_OUT_OF_RANGE, f"{value} does not fit into {wanted.value}")
        value = round(value)
    least, greatest = INTEGER_RANGES[wanted]
    number = int(value)
    if not least <= number <= greatest:
        raise FieldUnfit(StatusCode.BAD_OUT_OF_RANGE, f"{number} does not fit into {wanted.value}")
    return number


def _to_float(value: Any, wanted: ScalarType) -> float:
    if not isinstance(value, Real):
        raise _mismatch(value, wanted)
    number = float(value)
    if wanted is ScalarType.FLOAT and math.isfinite(number) and abs(number) > MAX_FLOAT:
        raise FieldUnfit(StatusCode.BAD_OUT_OF_RANGE, f"{number} does not fit into Float")
    return number


def _to_bool(value: Any) -> bool:
    if isinstance(value, Integral) and value in (0, 1):  # bool is an int; many ROS 1 messages flag with uint8
        return bool(value)
    raise _mismatch(value, ScalarType.BOOLEAN)


def _to_ticks(value: Any) -> int:
    seconds = getattr(value, "secs", getattr(value, "sec", None))
    nanoseconds = getattr(value, "nsecs", getattr(value, "nanosec", None))
    if not isinstance(seconds, int) or not isinstance(nanoseconds, int):
        raise _mismatch(value, ScalarType.DATETIME)
    return ticks_from_unix_ns(seconds * 1_000_000_000 + nanoseconds)


def cast_scalar(value: Any, wanted: ScalarType) -> Any:
    """`value` as a Python object of the built-in type; raises FieldUnfit where that would lose more than a fraction."""
    if wanted in INTEGER_RANGES:
        return _to_int(value, wanted)
    if wanted in (ScalarType.FLOAT, ScalarType.DOUBLE):
        return _to_float(value, wanted)
    if wanted is ScalarType.BOOLEAN:
        return _to_bool(value)
    if wanted is ScalarType.DATETIME:
        return _to_ticks(value)
    if wanted is ScalarType.STRING and isinstance(value, str):
        return value
    if wanted is ScalarType.BYTE_STRING:
        if isinstance(value, bytes | bytearray):
            return bytes(value)
        if _is_array(value):
            return bytes(_to_int(item, ScalarType.BYTE) for item in value)
    raise _mismatch(value, wanted)


def _is_array(value: Any) -> TypeGuard[Iterable[Any]]:
    return isinstance(value, Iterable) and not isinstance(value, str | bytes | bytearray)


def _cast_field(value: Any, field: FieldConfig) -> Any:
    wanted = field.type
    if not field.array:
        if _is_array(value) and wanted is not ScalarType.BYTE_STRING:
            raise FieldUnfit(StatusCode.BAD_TYPE_MISMATCH, "the message has an array there; set `array: true`")
        return cast_scalar(value, wanted)
    if isinstance(value, bytes | bytearray):
        value = tuple(value)
    if not _is_array(value):
        raise FieldUnfit(StatusCode.BAD_TYPE_MISMATCH, "the message has a single value there; set `array: false`")
    return tuple(cast_scalar(item, wanted) for item in value)


class _Field(NamedTuple):
    name: str
    config: FieldConfig
    follow: Callable[[Any], Any]
    told: list[str]
    """The reasons told since the field was last Good."""


class MappedSource:
    """Reads a DataSet out of the messages of a robot's own topic."""

    def __init__(self, dataset: DataSetConfig, browse_name: str) -> None:
        """Raises ValueError for a `path` that cannot be followed.

        A single field has the DataSet's browse name, and without `path` the path `data` of the std_msgs.
        """
        assert dataset.source_topic is not None
        self.message_type = dataset.source_topic.type.replace("/msg/", "/")
        self.fields: tuple[tuple[str, BuiltinType, bool], ...] = tuple(
            (name or browse_name, field.type.builtin, field.array) for name, field in dataset.all_fields().items()
        )
        """Name, built-in type and whether it is an array, of each field."""
        self._fields = tuple(
            _Field(name or browse_name, field, compile_path(field.path or name or "data"), [])
            for name, field in dataset.all_fields().items()
        )

    def read(self, message: Any, message_type: str) -> tuple[tuple[Any, ...], tuple[FieldProblem, ...]]:
        """The values in the order of `fields`, and what is wrong with those that are Bad.

        A Bad field is a `Variant` of type StatusCode in place of its value.
        """
        values: list[Any] = []
        problems: list[FieldProblem] = []
        for field in self._fields:
            try:
                if message_type != self.message_type:
                    raise FieldUnfit(
                        StatusCode.BAD_TYPE_MISMATCH,
                        f"the topic carries {message_type}, fleet.yaml says {self.message_type}",
                    )
                values.append(_cast_field(field.follow(message), field.config))
                field.told.clear()
            except FieldUnfit as unfit:
                values.append(Variant(BuiltinType.STATUS_CODE, unfit.status))
                reason = _NUMBER.sub("#", unfit.reason)  # else each new number would be a new reason
                problems.append(FieldProblem(field.name, unfit.status, unfit.reason, reason not in field.told))
                if reason not in field.told:
                    field.told.append(reason)
        return tuple(values), tuple(problems)
