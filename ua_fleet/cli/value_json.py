"""Values as JSON; docs/pubsub.md describes the form.

Numbers, Booleans and Strings are JSON's own. Infinity and NaN are Strings, a DateTime is ISO 8601 in UTC, a ByteString
is base64, a StatusCode its name (or 0x and eight digits), a NodeId its text form. Arrays are lists, matrices lists of
lists.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from typing import Any, Final

from ua_fleet.dissect.spans import type_name, value_text
from ua_fleet.values import (
    ARRAY,
    DIMENSIONS,
    BuiltinType,
    DataValue,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    StatusCode,
    Variant,
    datetime_from_ticks,
    status_name,
)

__all__ = ["data_value_as_json", "status_text", "time_text", "value_as_json"]

TICKS_IN_A_MICROSECOND: Final = 10


def time_text(ticks: int | None) -> str | None:
    """A DateTime as ISO 8601 in UTC, to the 100 ns that it has."""
    if ticks is None:
        return None
    text = datetime_from_ticks(ticks).isoformat(timespec="microseconds").removesuffix("+00:00")
    return f"{text}{ticks % TICKS_IN_A_MICROSECOND}".rstrip("0").rstrip(".") + "Z"


def status_text(status: int) -> str:
    """A StatusCode by its name where that says all of it."""
    return status_name(status) if status in list(StatusCode) else f"0x{status:08X}"


def value_as_json(code: int, value: Any) -> Any:
    """A value of a type code as JSON can hold it."""
    if code & DIMENSIONS:
        matrix: Matrix = value
        flat = [value_as_json(code & ~(ARRAY | DIMENSIONS), element) for element in matrix.values]
        return _nested(flat, matrix.dimensions) if flat else []  # dimensions of nothing may be as large as they like
    if code & ARRAY:
        return None if value is None else [value_as_json(code & ~(ARRAY | DIMENSIONS), element) for element in value]
    if code == BuiltinType.DATETIME:
        return time_text(value)
    if code == BuiltinType.STATUS_CODE:
        return status_text(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value).replace("inf", "Infinity").replace("nan", "NaN")
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    return _structure_as_json(code, value)


def _nested(flat: list[Any], dimensions: Sequence[int]) -> list[Any]:
    if len(dimensions) < 2:
        return flat
    size = len(flat) // dimensions[0]
    return [_nested(flat[start * size : (start + 1) * size], dimensions[1:]) for start in range(dimensions[0])]


def _structure_as_json(code: int, value: Any) -> Any:
    if isinstance(value, Variant):
        return {"type": type_name(value.type), "value": value_as_json(*value)}
    if isinstance(value, DataValue):
        return data_value_as_json(value)
    if isinstance(value, LocalizedText):
        return {"locale": value.locale, "text": value.text}
    if isinstance(value, ExtensionObject):
        return {
            "type_id": value_text(BuiltinType.NODE_ID, value.type_id),
            "body": value_as_json(BuiltinType.BYTE_STRING, value.body),
        }
    if isinstance(value, NodeId | ExpandedNodeId | QualifiedName):
        return value_text(code, value)
    if hasattr(value, "_asdict"):
        return {name: value_as_json(BuiltinType.DIAGNOSTIC_INFO, part) for name, part in value._asdict().items()}
    return str(value)  # a Guid


def data_value_as_json(value: DataValue) -> dict[str, Any]:
    """A DataValue: its value with type, and what else it has."""
    variant = value.variant or Variant(BuiltinType.NULL, None)
    parts = {
        "source_timestamp": time_text(value.source_timestamp),
        "server_timestamp": time_text(value.server_timestamp),
        "source_picoseconds": value.source_picoseconds,
        "server_picoseconds": value.server_picoseconds,
    }
    return {
        "type": type_name(variant.type),
        "value": value_as_json(*variant),
        "status": status_text(value.status),
        **{name: part for name, part in parts.items() if part is not None},
    }
