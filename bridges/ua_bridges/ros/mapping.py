"""A robot's own topics as DataSets: the fields that `fleet.yaml` picks out of a message, in the types it gives them.

What does not fit (another message type, NaN into an integer, an array that is too short) is no exception: the field
gets a Bad StatusCode in place of its value, the reason is told beside it, and the other fields go on.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from numbers import Integral, Real
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeGuard, cast

from ua_bridges.ros.leaves import Form, Leaf, leaves_of
from ua_bridges.ros.schema import MessageSchema
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_fleet.config.schema import DataSetConfig, FieldConfig, ScalarType
from ua_fleet.values import BuiltinType, StatusCode, Variant, ticks_from_unix_ns
from ua_fleet.wire.packed import LETTERS, is_packed

if TYPE_CHECKING:
    from typing_extensions import Buffer

__all__ = [
    "FieldProblem",
    "FieldUnfit",
    "FlatPaths",
    "Follow",
    "MappedSource",
    "cast_scalar",
    "compile_path",
    "flat_path",
    "steps_of",
]

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

_FITS: Final = {
    ScalarType.BYTE: "B",
    ScalarType.SBYTE: "b",
    ScalarType.INT16: "bBh",
    ScalarType.UINT16: "BH",
    ScalarType.INT32: "bBhHi",
    ScalarType.UINT32: "BHI",
    ScalarType.INT64: "bBhHiIlq",
    ScalarType.UINT64: "BHILQ",
    ScalarType.FLOAT: "f",
    ScalarType.DOUBLE: "fd",
}
"""Arrays whose every element is a value of the type as it stands, by the letters of `struct`."""

_NUMBER = re.compile(r"-?\b\d[\d.e+-]*")
_STEP = re.compile(r"([A-Za-z][A-Za-z0-9_]*)((?:\[\d{1,6}\])*)", re.ASCII)


Follow = Callable[[Any], Any]
"""Finds a value in a message object, or in the values of its flat fields; raises FieldUnfit."""


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


def steps_of(path: str) -> list[str | int]:
    """The names and indices of a path; raises ValueError for what is none."""
    steps: list[str | int] = []
    for part in path.split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            raise ValueError(f"{path!r} is not the path of a field; write it like `twist.linear.x` or `position[2]`")
        steps.append(match[1])
        steps.extend(int(index) for index in re.findall(r"\d+", match[2]))
    return steps


def compile_path(path: str) -> Follow:
    """A function that follows `twist.linear.x` or `position[2]` into a message; it raises FieldUnfit."""
    steps = steps_of(path)

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
        if is_packed(value, "B"):
            return value
        if isinstance(value, bytes | bytearray) or _buffer_format(value) == "B":
            return bytes(value)
        if _is_array(value):
            return bytes(_to_int(item, ScalarType.BYTE) for item in value)
    raise _mismatch(value, wanted)


def _buffer_format(value: object) -> str:
    """The letter of `struct` for the elements of an array of rclpy's; empty for what is none.

    Such an array is taken as a whole: each pixel of an image by itself took a second.
    """
    try:
        view = memoryview(cast("Buffer", value))
    except TypeError:
        return ""
    return view.format if view.ndim == 1 and view.contiguous else ""


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
    if is_packed(value, LETTERS.get(wanted.builtin)):
        return value
    if (letter := _buffer_format(value)) and letter in _FITS.get(wanted, ""):
        return tuple(memoryview(cast("Buffer", value)).tolist())
    return tuple(cast_scalar(item, wanted) for item in value)


class FlatPaths(NamedTuple):
    """How fields are found in the flat fields of a message."""

    follow: tuple[Follow, ...]
    wanted: frozenset[str]
    """The flat fields that are needed."""


class _Time(NamedTuple):
    sec: int
    nanosec: int


def flat_path(leaves: Sequence[Leaf], path: str) -> tuple[Follow, tuple[int, ...]] | None:
    """A function like that of `compile_path` for flat fields, and which of them it needs; None where there is none."""
    steps = steps_of(path)
    numbers = [step for step in steps if isinstance(step, int)]
    whole = ".".join(step for step in steps if isinstance(step, str))
    for index, leaf in enumerate(leaves):
        parts = [leaf.path, leaf.column_path] if leaf.form is Form.COLUMN else [leaf.path]
        if ".".join(parts) != whole or leaf.form is Form.RAGGED or leaf.member.type == "byte":
            continue
        if not numbers and leaf.form is not Form.COLUMN:
            return itemgetter(index), (index,)
        indexed = leaf.path.count(".") + 1
        if len(numbers) == 1 and leaf.form is not Form.SCALAR and isinstance(steps[indexed], int):
            return _element(index, numbers[0], path), (index,)
        return None
    pair = [index for index, leaf in enumerate(leaves) if leaf.form is Form.SCALAR and leaf.path in _times_of(whole)]
    if len(pair) == 2 and not numbers:
        seconds, nanoseconds = pair
        return (lambda values: _Time(values[seconds], values[nanoseconds])), (seconds, nanoseconds)
    return None


def _times_of(path: str) -> tuple[str, ...]:
    return f"{path}.sec", f"{path}.nanosec", f"{path}.secs", f"{path}.nsecs"


def _element(index: int, element: int, path: str) -> Follow:
    def follow(values: Any) -> Any:
        try:
            return values[index][element]
        except IndexError:
            raise FieldUnfit(StatusCode.BAD_OUT_OF_RANGE, f"the array of {path!r} has another length") from None

    return follow


class _Field(NamedTuple):
    name: str
    config: FieldConfig
    path: str
    follow: Follow
    told: list[str]
    """The reasons told since the field was last Good."""


class MappedSource:
    """Reads a DataSet out of the messages of a robot's own topic."""

    def __init__(self, dataset: DataSetConfig, browse_name: str) -> None:
        """Raises ValueError for a `path` that cannot be followed.

        A single field has the DataSet's browse name, and without `path` the path `data` of the std_msgs.
        """
        assert isinstance(dataset.source, TopicMapping)
        self.message_type = dataset.source.message_type
        self.fields: tuple[tuple[str, BuiltinType, bool], ...] = tuple(
            (name or browse_name, field.type.builtin, field.array) for name, field in dataset.all_fields().items()
        )
        """Name, built-in type and whether it is an array, of each field."""
        self._fields = tuple(
            _Field(name or browse_name, field, path := field.path or name or "data", compile_path(path), [])
            for name, field in dataset.all_fields().items()
        )

    def flat(self, schema: MessageSchema) -> FlatPaths | None:
        """How the values are found in the flat fields of a message; None where that takes the message object."""
        leaves = leaves_of(schema)
        found = [flat_path(leaves, field.path) for field in self._fields]
        wanted = frozenset(leaves[index].name for each in found if each is not None for index in each[1])
        follow = [each[0] for each in found if each is not None]
        return FlatPaths(tuple(follow), wanted) if len(follow) == len(found) else None

    def read(
        self, message: Any, message_type: str, follow: Sequence[Follow] | None = None
    ) -> tuple[tuple[Any, ...], tuple[FieldProblem, ...]]:
        """The values in the order of `fields`, and what is wrong with those that are Bad.

        A Bad field is a `Variant` of type StatusCode in place of its value. With `follow` (of `flat`) the message is
        the values of its flat fields.
        """
        values: list[Any] = []
        problems: list[FieldProblem] = []
        for index, field in enumerate(self._fields):
            try:
                if message_type != self.message_type:
                    raise FieldUnfit(
                        StatusCode.BAD_TYPE_MISMATCH,
                        f"the topic carries {message_type}, fleet.yaml says {self.message_type}",
                    )
                found = (field.follow if follow is None else follow[index])(message)
                values.append(_cast_field(found, field.config))
                field.told.clear()
            except FieldUnfit as unfit:
                values.append(Variant(BuiltinType.STATUS_CODE, unfit.status))
                reason = _NUMBER.sub("#", unfit.reason)  # else each new number would be a new reason
                problems.append(FieldProblem(field.name, unfit.status, unfit.reason, reason not in field.told))
                if reason not in field.told:
                    field.told.append(reason)
        return tuple(values), tuple(problems)
