"""Values that contain values: arrays, matrices, Variant, DataValue, DiagnosticInfo, ExtensionObject (OPC 10000-6 5.4).

The older forms are read too (OPC 10000-6 annex H): `Type` and `Body`, nested arrays, `TypeId` and `Body`.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, cast

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, DataValue, DiagnosticInfo, Matrix, Variant
from ua_fleet.wire.cursor import DEEPEST_NESTING
from ua_fleet.wire.json import structures
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.data_types import NO_TYPES, DataTypes
from ua_fleet.wire.json.dates import decode_date, encode_date
from ua_fleet.wire.json.parsing import Reading, shown
from ua_fleet.wire.json.scalars import (
    DEFAULTS,
    SCALAR_DECODERS,
    SCALAR_ENCODERS,
    decode_integer,
    decode_status,
    decode_string,
    encode_status,
)
from ua_fleet.wire.packed import LETTERS, is_packed

__all__ = [
    "DATA_VALUE_MEMBERS",
    "NEVER_NULL",
    "VARIANT_MEMBERS",
    "Writing",
    "decode_data_value",
    "decode_element",
    "decode_shape",
    "decode_value",
    "decode_variant",
    "dimensions_of",
    "encode_data_value",
    "encode_element",
    "encode_value",
    "encode_variant",
    "read_sides",
    "write_sides",
]

TYPE_BITS: Final = 0x3F
MOST_DIMENSIONS: Final = 16

VARIANT_MEMBERS: Final = frozenset({"UaType", "Value", "Dimensions", "UaDimensions"})
_SIDE_MEMBERS: Final = frozenset(
    {
        "Status",
        "StatusCode",
        "SourceTimestamp",
        "SourcePicoseconds",
        "SourcePicoSeconds",
        "ServerTimestamp",
        "ServerPicoseconds",
        "ServerPicoSeconds",
    }
)
DATA_VALUE_MEMBERS: Final = VARIANT_MEMBERS | _SIDE_MEMBERS

NEVER_NULL: Final = frozenset(range(BuiltinType.BOOLEAN, BuiltinType.STRING)) | {BuiltinType.STATUS_CODE}
"""Built-in types that have no null (OPC 10000-6 table 1): a Variant of one without a Value has the default of its type,
which the CompactEncoding of others leaves out."""

_ABSENT: Final = object()


class Writing(NamedTuple):
    """How values are written."""

    namespaces: tuple[str, ...] = ()
    verbose: bool = True
    raw: bool = False
    """RawData: `UaType` and `UaTypeId` are left out."""
    types: DataTypes = NO_TYPES
    level: int = 0
    """How many values that contain values are around this one."""


def _inside(writing: Writing) -> Writing:
    """For what stands in another value; raises LocalWireError where that is too deep, as the binary encoding does."""
    if writing.level >= DEEPEST_NESTING:
        raise LocalWireError(f"values nested deeper than {DEEPEST_NESTING} levels")
    return writing._replace(level=writing.level + 1)


def _wrong(what: str, value: Any) -> RemoteWireError:
    return RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no {what}")


# --- arrays and matrices


def encode_element(writing: Writing, kind: int, value: Any) -> Any:
    """What JSON holds of a scalar of a built-in type."""
    encode = SCALAR_ENCODERS.get(kind)
    if encode is not None:
        return encode(writing.namespaces, writing.verbose, value)
    if kind == BuiltinType.VARIANT:
        return encode_variant(_inside(writing), value)
    if kind == BuiltinType.DATA_VALUE:
        return encode_data_value(_inside(writing), value)
    if kind == BuiltinType.EXTENSION_OBJECT:
        return structures.encode_extension_object(writing, value)
    if kind == BuiltinType.DIAGNOSTIC_INFO:
        return _encode_diagnostic_info(_inside(writing), value)
    raise LocalWireError(f"{kind} is no built-in type")


def _encode_elements(writing: Writing, kind: int, elements: Any) -> list[Any]:
    if is_packed(elements, LETTERS.get(kind, "")):
        elements = elements.tolist()
    elif not isinstance(elements, tuple | list):
        raise LocalWireError(f"{elements!r:.80} is no array")
    return [encode_element(writing, kind, element) for element in cast("tuple[Any, ...]", elements)]


def encode_value(writing: Writing, code: int, value: Any) -> tuple[Any, list[int] | None]:
    """What JSON holds of a value of a type code, and the dimensions of a matrix, which is a flat list."""
    kind = code & TYPE_BITS
    if not code & ARRAY:
        if code & DIMENSIONS:
            raise LocalWireError(f"0x{code:02x} is no type code")
        return encode_element(writing, kind, value), None
    if not code & DIMENSIONS:
        return None if value is None else _encode_elements(writing, kind, value), None
    if not isinstance(value, Matrix):
        raise LocalWireError(f"{value!r:.80} is no Matrix")
    elements = _encode_elements(writing, kind, value.values)
    if _product(value.dimensions, len(elements)) != len(elements):
        raise LocalWireError(f"{len(elements)} elements do not fill the dimensions {value.dimensions}")
    return elements, list(value.dimensions)


def _product(dimensions: tuple[int, ...], limit: int) -> int:
    product = 1 if dimensions else 0
    for dimension in dimensions:
        product *= max(dimension, 0)
        if product > limit:
            break
    return product


def decode_element(reading: Reading, kind: int, value: Any) -> Any:
    """A scalar of a built-in type."""
    decode = SCALAR_DECODERS.get(kind)
    if decode is not None:
        return decode(reading, value)
    if kind == BuiltinType.VARIANT:
        return decode_variant(reading, value)
    if kind == BuiltinType.DATA_VALUE:
        return decode_data_value(reading, value)
    if kind == BuiltinType.EXTENSION_OBJECT:
        return structures.decode_extension_object(reading, value)
    if kind == BuiltinType.DIAGNOSTIC_INFO:
        return _decode_diagnostic_info(reading, value)
    raise RemoteWireError(JsonCause.UA_TYPE, f"built-in type {shown(kind)}")


def decode_value(reading: Reading, kind: int, value: Any, dimensions: Any = None) -> tuple[int, Any]:
    """The type code and value of what may be a scalar, an array or a matrix."""
    bits, shaped = decode_shape(reading, value, dimensions)
    if not bits:
        return kind, decode_element(reading, kind, shaped)
    decode = SCALAR_DECODERS.get(kind)
    elements: Any = shaped if bits == ARRAY else shaped.values
    if decode is not None:
        elements = tuple([decode(reading, element) for element in elements])
    else:
        elements = tuple([decode_element(reading, kind, element) for element in elements])
    return kind | bits, elements if bits == ARRAY else Matrix(elements, shaped.dimensions)


def decode_shape(reading: Reading, value: Any, dimensions: Any = None) -> tuple[int, Any]:
    """Bits of a type code, with the value itself, a list, or a Matrix of elements that are still JSON."""
    if value.__class__ is dict and value.keys() == {"Array", "Dimensions"}:
        value, dimensions = value["Array"], value["Dimensions"]
        if value.__class__ is not list:
            raise _wrong("array", value)
    if value.__class__ is not list:
        if dimensions:
            raise RemoteWireError(JsonCause.DIMENSIONS, f"{shown(value)} with dimensions")
        return 0, value
    if dimensions is None and value and value[0].__class__ is list:
        reading.note(Leniency.OLD_MATRIX)
        dimensions, value = _flatten(value)
    if not dimensions:
        return ARRAY, value
    lengths = _decode_dimensions(reading, dimensions)
    if _product(lengths, len(value)) != len(value):
        raise RemoteWireError(JsonCause.DIMENSIONS, f"{len(value)} elements do not fill {lengths!s:.80}")
    if len(lengths) == 1:
        return ARRAY, value
    return ARRAY | DIMENSIONS, Matrix(tuple(value), lengths)


def _decode_dimensions(reading: Reading, dimensions: Any) -> tuple[int, ...]:
    if dimensions.__class__ is not list or len(dimensions) > MOST_DIMENSIONS:
        raise RemoteWireError(JsonCause.DIMENSIONS, f"{shown(dimensions)}")
    return tuple([decode_integer(reading, BuiltinType.INT32, dimension) for dimension in dimensions])


def _flatten(rows: list[Any]) -> tuple[list[int], list[Any]]:
    """Dimensions and elements of nested arrays (OPC 10000-6 H.9)."""
    dimensions: list[int] = []
    level: list[Any] = rows
    lengths = {len(rows)}
    while True:
        if len(lengths) != 1 or len(dimensions) == MOST_DIMENSIONS:
            raise RemoteWireError(JsonCause.DIMENSIONS, "nested arrays of different lengths, or too many in each other")
        dimensions.append(lengths.pop())
        nested = [element.__class__ is list for element in level]
        if not any(nested):
            return dimensions, level
        if not all(nested):
            raise RemoteWireError(JsonCause.DIMENSIONS, "an array with elements beside arrays")
        lengths = {len(row) for row in level}
        level = [element for row in level for element in row]


# --- Variant and DataValue


def encode_variant(writing: Writing, value: Any) -> dict[str, Any] | None:
    """The object of a Variant, None for null."""
    if not isinstance(value, Variant):
        raise LocalWireError(f"{value!r:.80} is no Variant")
    if not value.type:
        return None
    out: dict[str, Any] = {}
    _write_variant(writing, value, out)
    return out


def _write_variant(writing: Writing, value: Variant, out: dict[str, Any]) -> None:
    kind = value.type & TYPE_BITS
    if value.type == BuiltinType.VARIANT:
        raise LocalWireError("a Variant in a Variant")
    if not writing.raw:
        out["UaType"] = kind
    held, dimensions = encode_value(writing, value.type, value.value)
    if held is not None or kind in NEVER_NULL:
        out["Value"] = [] if held is None else held  # a null array of numbers is an empty one
    if dimensions is not None:
        out["Dimensions"] = dimensions


def decode_variant(reading: Reading, value: Any) -> Variant:
    """A Variant of the current or the older form; null is the Variant of type 0."""
    if value is None:
        return Variant(0, None)
    if value.__class__ is not dict:
        raise _wrong("Variant", value)
    if "UaType" in value:
        return _read_variant(reading, value["UaType"], value.get("Value", _ABSENT), dimensions_of(reading, value))
    if "Type" in value:
        reading.note(Leniency.OLD_VARIANT)
        return _read_variant(reading, value["Type"], value.get("Body", _ABSENT), value.get("Dimensions"))
    if not value:
        return Variant(0, None)
    raise RemoteWireError(JsonCause.UA_TYPE, f"a Variant without its type: {shown(value)}")


def dimensions_of(reading: Reading, value: dict[str, Any]) -> Any:
    """What an object says of the dimensions of its value; None where it says nothing."""
    if "UaDimensions" in value:
        reading.note(Leniency.UA_DIMENSIONS)
        return value["UaDimensions"]
    return value.get("Dimensions")


def _read_variant(reading: Reading, kind: Any, value: Any, dimensions: Any) -> Variant:
    if kind.__class__ is not int or not 0 <= kind <= BuiltinType.DIAGNOSTIC_INFO:
        raise RemoteWireError(JsonCause.UA_TYPE, f"built-in type {shown(kind)}")
    if not kind:
        return Variant(0, None)
    if (value is None or value is _ABSENT) and dimensions is None:
        if kind == BuiltinType.VARIANT:
            return Variant(0, None)
        if kind in NEVER_NULL:
            if value is _ABSENT:
                return Variant(kind, DEFAULTS[kind])
            # null for what has no null: peers write it for NaN and infinities, which JSON has no numbers for.
            is_float = kind in (BuiltinType.FLOAT, BuiltinType.DOUBLE)
            return Variant(kind, decode_element(reading, kind, None)) if is_float else Variant(0, None)
    if value is _ABSENT:
        value = None
    if kind == BuiltinType.VARIANT and value.__class__ is not list:
        raise RemoteWireError(JsonCause.UA_TYPE, "a Variant in a Variant")
    return Variant(*decode_value(reading, kind, value, dimensions))


def encode_data_value(writing: Writing, value: Any) -> dict[str, Any]:
    """The object of a DataValue."""
    if not isinstance(value, DataValue):
        raise LocalWireError(f"{value!r:.80} is no DataValue")
    out: dict[str, Any] = {}
    if value.variant is not None and value.variant.type:
        _write_variant(writing, value.variant, out)
    write_sides(writing, value, out)
    return out


def write_sides(writing: Writing, value: DataValue, out: dict[str, Any]) -> None:
    """Status and times of a DataValue, as far as there are some."""
    if value.status:
        out["Status"] = encode_status(writing.namespaces, writing.verbose, value.status)
    if value.source_timestamp:
        out["SourceTimestamp"] = encode_date(value.source_timestamp)
    if value.source_picoseconds:
        out["SourcePicoseconds"] = SCALAR_ENCODERS[BuiltinType.UINT16]((), False, value.source_picoseconds)
    if value.server_timestamp:
        out["ServerTimestamp"] = encode_date(value.server_timestamp)
    if value.server_picoseconds:
        out["ServerPicoseconds"] = SCALAR_ENCODERS[BuiltinType.UINT16]((), False, value.server_picoseconds)


def decode_data_value(reading: Reading, value: Any) -> DataValue:
    """A DataValue of the current or the older form."""
    if value is None:
        return DataValue(None)
    if value.__class__ is not dict:
        raise _wrong("DataValue", value)
    variant: Variant | None
    variant = decode_variant(reading, value) if "UaType" in value else decode_variant(reading, value.get("Value"))
    return read_sides(reading, value, variant if variant.type else None)


def read_sides(reading: Reading, value: dict[str, Any], variant: Variant | None) -> DataValue:
    """The DataValue with status and times of an object; an absent status is Good."""
    status = value.get("Status")
    if status is None and "StatusCode" in value:
        reading.note(Leniency.STATUS_CODE_MEMBER)
        status = value["StatusCode"]
    source, server = value.get("SourceTimestamp"), value.get("ServerTimestamp")
    return DataValue(
        variant,
        0 if status is None else decode_status(reading, status),
        None if source is None else decode_date(reading, source),
        None if server is None else decode_date(reading, server),
        _picoseconds(reading, value, "SourcePicoseconds", "SourcePicoSeconds"),
        _picoseconds(reading, value, "ServerPicoseconds", "ServerPicoSeconds"),
    )


def _picoseconds(reading: Reading, value: dict[str, Any], name: str, old_name: str) -> int | None:
    number = value.get(name)
    if number is None:
        number = value.get(old_name)
        if number is None:
            return None
        reading.note(Leniency.OLD_PICOSECONDS)
    return decode_integer(reading, BuiltinType.UINT16, number)


# --- DiagnosticInfo

_NUMBERS: Final = (
    ("SymbolicId", "symbolic_id"),
    ("NamespaceUri", "namespace_uri"),
    ("Locale", "locale"),
    ("LocalizedText", "localized_text"),
)


def _encode_diagnostic_info(writing: Writing, value: Any) -> dict[str, Any] | None:
    if value is None:
        return None
    if not isinstance(value, DiagnosticInfo):
        raise LocalWireError(f"{value!r:.80} is no DiagnosticInfo")
    encode = SCALAR_ENCODERS[BuiltinType.INT32]
    out: dict[str, Any] = {
        name: encode((), False, getattr(value, attribute))
        for name, attribute in _NUMBERS
        if getattr(value, attribute) is not None
    }
    if value.additional_info is not None:
        out["AdditionalInfo"] = value.additional_info
    if value.inner_status:
        out["InnerStatusCode"] = encode_status((), False, value.inner_status)
    if value.inner is not None:
        out["InnerDiagnosticInfo"] = _encode_diagnostic_info(_inside(writing), value.inner)
    return out


def _decode_diagnostic_info(reading: Reading, value: Any) -> DiagnosticInfo | None:
    if value is None:
        return None
    if value.__class__ is not dict:
        raise _wrong("DiagnosticInfo", value)
    numbers = {
        attribute: decode_integer(reading, BuiltinType.INT32, value[name])
        for name, attribute in _NUMBERS
        if value.get(name) is not None
    }
    status = value.get("InnerStatusCode")
    return DiagnosticInfo(
        **numbers,
        additional_info=decode_string(reading, value.get("AdditionalInfo")),
        inner_status=None if status is None else decode_status(reading, status),
        inner=_decode_diagnostic_info(reading, value.get("InnerDiagnosticInfo")),
    )
