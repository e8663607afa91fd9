"""Whether a value fits its node: the one place that decides, for robots' values and for clients' writes."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from ua_fleet.fleet.model import FieldModel
from ua_fleet.values import ARRAY, BuiltinType, Matrix, StatusCode

__all__ = ["ANALOG_TYPES", "Misfit", "is_analog", "misfit", "type_name"]

ANALOG_TYPES: Final = frozenset(range(BuiltinType.SBYTE, BuiltinType.DOUBLE + 1))
_NAMES: Final = {kind: "".join(part.capitalize() for part in kind.name.split("_")) for kind in BuiltinType}
_BUILTIN: Final = 0x3F


class Misfit(NamedTuple):
    """Why a value does not fit its node."""

    status: int
    reason: str
    is_usable: bool = False
    """Whether the value may be shown all the same."""


def is_analog(type_code: int) -> bool:
    """Whether values of the type are numbers, of which the last in quick succession will do."""
    return type_code & _BUILTIN in ANALOG_TYPES


def type_name(type_code: int) -> str:
    """The name of a type for people: `Int32`, `Double[]`."""
    name = _NAMES.get(BuiltinType(type_code & _BUILTIN), "") if type_code & _BUILTIN in _KNOWN else str(type_code)
    return f"{name}[]" if type_code & ARRAY else name


def misfit(field: FieldModel, type_code: int, value: Any) -> Misfit | None:
    """Why a value does not fit its node; None where it does.

    A number outside the range is usable: it is shown as Uncertain. NaN is outside every range.
    """
    if type_code != field.type:
        return Misfit(
            StatusCode.BAD_TYPE_MISMATCH, f"a value of type {type_name(type_code)} for {type_name(field.type)}"
        )
    is_array = bool(type_code & ARRAY)
    elements = value.values if isinstance(value, Matrix) else value if is_array else (value,)
    if field.length and len(elements or ()) != field.length:
        return Misfit(StatusCode.BAD_OUT_OF_RANGE, f"an array of another length than {field.length}")
    limits = field.range
    if limits is None or elements is None:
        return None
    low, high = limits
    for element in elements:
        if not low <= element <= high:
            return Misfit(StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED, f"outside {low:g} to {high:g}", True)
    return None


_KNOWN: Final = frozenset(BuiltinType)
