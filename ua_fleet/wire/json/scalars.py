"""Built-in types as JSON, in both directions, as far as they do not nest (OPC 10000-6 5.4.2, annex H).

A decoder gets the parsed value and raises RemoteWireError; an encoder returns what `orjson` writes and raises
LocalWireError. `variants.py` has the types that contain other values.
"""

from __future__ import annotations

import binascii
import math
import re
import uuid
from collections.abc import Callable
from struct import Struct
from struct import error as struct_error
from typing import Any, Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, LocalizedText, StatusCode, status_name
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.dates import decode_date, encode_date
from ua_fleet.wire.json.node_ids import (
    decode_expanded_node_id,
    decode_node_id,
    decode_qualified_name,
    encode_expanded_node_id,
    encode_node_id,
    encode_qualified_name,
)
from ua_fleet.wire.json.parsing import Reading, shown
from ua_fleet.wire.packed import is_packed

__all__ = [
    "DEFAULTS",
    "FLOAT",
    "RANGES",
    "SCALAR_DECODERS",
    "SCALAR_ENCODERS",
    "Decoder",
    "Encoder",
    "decode_byte_string",
    "decode_integer",
    "decode_status",
    "decode_string",
    "encode_status",
]

Decoder = Callable[[Reading, Any], Any]
Encoder = Callable[[tuple[str, ...], bool, Any], Any]
"""(namespaces, verbose, value) -> what JSON holds."""

RANGES: Final[dict[int, tuple[int, int]]] = {
    BuiltinType.SBYTE: (-0x80, 0x7F),
    BuiltinType.BYTE: (0, 0xFF),
    BuiltinType.INT16: (-0x8000, 0x7FFF),
    BuiltinType.UINT16: (0, 0xFFFF),
    BuiltinType.INT32: (-0x8000_0000, 0x7FFF_FFFF),
    BuiltinType.UINT32: (0, 0xFFFF_FFFF),
    BuiltinType.INT64: (-0x8000_0000_0000_0000, 0x7FFF_FFFF_FFFF_FFFF),
    BuiltinType.UINT64: (0, 0xFFFF_FFFF_FFFF_FFFF),
}
"""The smallest and largest value of each integer type."""

_TEXTS: Final = (BuiltinType.INT64, BuiltinType.UINT64)
"""The types that are numbers and yet written as text."""

_MOST_EXACT: Final = 2**53
"""Beyond it a float may be another integer than the one that the peer wrote."""

_NUMBER: Final = re.compile(r"-?\d{1,20}", re.ASCII)
_FLOAT_TEXT: Final = re.compile(r"-?\d{1,40}(?:\.\d{1,40})?(?:[eE][+-]?\d{1,4})?", re.ASCII)
_GUID: Final = re.compile(r"[0-9A-Fa-f]{8}(?:-[0-9A-Fa-f]{4}){3}-[0-9A-Fa-f]{12}")
_INFINITIES: Final = {"Infinity": math.inf, "-Infinity": -math.inf}
_OTHER_INFINITIES: Final = {"INF": math.inf, "+INF": math.inf, "-INF": -math.inf, "+Infinity": math.inf}

FLOAT: Final = Struct("<f")

NULL_GUID: Final = uuid.UUID(int=0)
NULL_TEXT: Final = LocalizedText(None)

_CODES: Final = {status_name(code): code.value for code in StatusCode} | {"Good": 0}


def _wrong(kind: int, value: Any) -> RemoteWireError:
    return RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no {BuiltinType(kind).name}")


def decode_integer(reading: Reading, kind: int, value: Any) -> int:
    """An integer of any type; its range is that of its type, whatever the text was."""
    low, high = RANGES[kind]
    number: int
    if value.__class__ is int:
        if kind in _TEXTS:
            reading.note(Leniency.INT64_AS_NUMBER)
        number = value
    elif value.__class__ is str:
        if not _NUMBER.fullmatch(value):
            raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no {BuiltinType(kind).name}")
        if kind not in _TEXTS:
            reading.note(Leniency.NUMBER_AS_TEXT)
        number = int(value)
    elif value.__class__ is float and value.is_integer() and abs(value) <= _MOST_EXACT:
        reading.note(Leniency.INTEGER_AS_FLOAT)
        number = int(value)
    elif value is None:
        reading.note(Leniency.NULL_NUMBER)
        return 0
    elif value.__class__ is float:
        raise RemoteWireError(JsonCause.VALUE_RANGE, f"{shown(value)} is no {BuiltinType(kind).name}")
    else:
        raise _wrong(kind, value)
    if not low <= number <= high:
        raise RemoteWireError(JsonCause.VALUE_RANGE, f"{shown(value)} is no {BuiltinType(kind).name}")
    return number


def _integer_decoder(kind: int) -> Decoder:
    low, high = RANGES[kind]

    def decode(reading: Reading, value: Any) -> int:
        if value.__class__ is int and low <= value <= high:
            number: int = value
            return number
        return decode_integer(reading, kind, value)

    def decode_text(reading: Reading, value: Any) -> int:
        return decode_integer(reading, kind, value)

    return decode_text if kind in _TEXTS else decode


def _decode_boolean(reading: Reading, value: Any) -> bool:
    if value.__class__ is bool:
        flag: bool = value
        return flag
    if value.__class__ is int and value in (0, 1):
        reading.note(Leniency.BOOLEAN_AS_NUMBER)
        return bool(value)
    if value is None:
        reading.note(Leniency.NULL_NUMBER)
        return False
    raise _wrong(BuiltinType.BOOLEAN, value)


def _decode_double(reading: Reading, value: Any) -> float:
    if value.__class__ is float or value.__class__ is int:
        return float(value)
    if value.__class__ is str:
        return _decode_float_text(reading, value)
    if value is None:
        reading.note(Leniency.NULL_NUMBER)
        return math.nan
    raise _wrong(BuiltinType.DOUBLE, value)


def _decode_float_text(reading: Reading, value: str) -> float:
    if value == "NaN":
        return math.nan
    if value in _INFINITIES:
        return _INFINITIES[value]
    if value in _OTHER_INFINITIES:
        reading.note(Leniency.INFINITY_NAME)
        return _OTHER_INFINITIES[value]
    if not _FLOAT_TEXT.fullmatch(value):
        raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no number")
    reading.note(Leniency.NUMBER_AS_TEXT)
    number = float(value)
    if math.isinf(number):
        raise RemoteWireError(JsonCause.VALUE_RANGE, f"{shown(value)} is no Double")
    return number


def _decode_float(reading: Reading, value: Any) -> float:
    """A Float: the nearest one that 32 bits can hold, as it would come in UADP."""
    number = _decode_double(reading, value)
    try:
        nearest: float = FLOAT.unpack(FLOAT.pack(number))[0]
    except (OverflowError, struct_error):
        raise RemoteWireError(JsonCause.VALUE_RANGE, f"{shown(value)} is no Float") from None
    return nearest


def decode_string(_reading: Reading, value: Any) -> str | None:
    """A String or XmlElement, or None for null."""
    if value.__class__ is str or value is None:
        text: str | None = value
        return text
    raise _wrong(BuiltinType.STRING, value)


def decode_byte_string(reading: Reading, value: Any) -> bytes | None:
    """A ByteString, or None for null."""
    if value.__class__ is not str:
        if value is None:
            return None
        raise _wrong(BuiltinType.BYTE_STRING, value)
    try:
        return binascii.a2b_base64(value, strict_mode=True)
    except ValueError:
        pass
    text = "".join(value.split()).replace("-", "+").replace("_", "/").rstrip("=")
    try:
        decoded = binascii.a2b_base64(text + "=" * (-len(text) % 4), strict_mode=True)
    except ValueError:
        raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no ByteString") from None
    reading.note(Leniency.BASE64_FORM)
    return decoded


def _decode_guid(reading: Reading, value: Any) -> uuid.UUID:
    if value.__class__ is not str:
        if value is None:
            return NULL_GUID
        raise _wrong(BuiltinType.GUID, value)
    if not _GUID.fullmatch(value):
        if len(value) > 60:
            raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no Guid")
        reading.note(Leniency.GUID_FORM)
    try:
        return uuid.UUID(value)
    except ValueError:
        raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no Guid") from None


def decode_status(reading: Reading, value: Any) -> int:
    """A StatusCode: `{"Code", "Symbol"}`, where an empty object is Good."""
    if value.__class__ is dict:
        code = value.get("Code")
        if code is None:
            symbol = value.get("Symbol")
            code = 0 if symbol is None else _CODES.get(symbol) if isinstance(symbol, str) else None
            if code is None:
                raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no StatusCode")
        return decode_integer(reading, BuiltinType.UINT32, code)
    if value is None or value.__class__ is int:
        reading.note(Leniency.OLD_STATUS_CODE)
        return decode_integer(reading, BuiltinType.UINT32, value or 0)
    raise _wrong(BuiltinType.STATUS_CODE, value)


def _decode_localized_text(reading: Reading, value: Any) -> LocalizedText:
    if value.__class__ is dict:
        text, locale = value.get("Text"), value.get("Locale")
        if isinstance(text, str | None) and isinstance(locale, str | None):
            return LocalizedText(text, locale)
    elif value is None:
        return NULL_TEXT
    elif value.__class__ is str:
        reading.note(Leniency.OLD_LOCALIZED_TEXT)
        return LocalizedText(value)
    raise _wrong(BuiltinType.LOCALIZED_TEXT, value)


def _encode_boolean(_namespaces: tuple[str, ...], _verbose: bool, value: Any) -> bool:
    if value.__class__ is not bool:
        raise LocalWireError(f"{value!r:.80} is no Boolean")
    flag: bool = value
    return flag


def _integer_encoder(kind: int) -> Encoder:
    low, high = RANGES[kind]
    is_text = kind in _TEXTS

    def encode(_namespaces: tuple[str, ...], _verbose: bool, value: Any) -> int | str:
        if not isinstance(value, int) or value.__class__ is bool or not low <= value <= high:
            raise LocalWireError(f"{value!r:.80} does not fit into {BuiltinType(kind).name}")
        number = int(value)  # an enumeration of ours is written as its number
        return str(number) if is_text else number

    return encode


def _encode_double(_namespaces: tuple[str, ...], _verbose: bool, value: Any) -> float | int | str:
    if value.__class__ is not float and (not isinstance(value, int | float) or value.__class__ is bool):
        raise LocalWireError(f"{value!r:.80} is no Double")
    try:
        number = float(value)
    except OverflowError:
        raise LocalWireError(f"{value!r:.80} is no Double") from None
    if math.isfinite(number):
        return number
    return "NaN" if number != number else "Infinity" if number > 0 else "-Infinity"


def _encode_float(namespaces: tuple[str, ...], verbose: bool, value: Any) -> float | int | str:
    number = _encode_double(namespaces, verbose, value)
    if number.__class__ is not str:
        try:
            FLOAT.pack(number)
        except OverflowError:
            raise LocalWireError(f"{value!r:.80} is no Float") from None
    return number


def _encode_string(_namespaces: tuple[str, ...], _verbose: bool, value: Any) -> str | None:
    if value is not None and not isinstance(value, str):
        raise LocalWireError(f"{value!r:.80} is no String")
    return value


def _encode_date(_namespaces: tuple[str, ...], _verbose: bool, value: Any) -> str:
    return encode_date(value)


def _encode_guid(_namespaces: tuple[str, ...], _verbose: bool, value: Any) -> str:
    if not isinstance(value, uuid.UUID):
        raise LocalWireError(f"{value!r:.80} is no Guid")
    return str(value)


def _encode_byte_string(_namespaces: tuple[str, ...], _verbose: bool, value: Any) -> str | None:
    if value is None:
        return None
    if not isinstance(value, bytes | bytearray) and not is_packed(value, "B"):
        raise LocalWireError(f"{value!r:.80} is no ByteString")
    return binascii.b2a_base64(value, newline=False).decode()


def encode_status(_namespaces: tuple[str, ...], verbose: bool, value: Any) -> dict[str, int | str]:
    """The object of a StatusCode; its symbol stands there in the VerboseEncoding, where we know it."""
    if not isinstance(value, int) or value.__class__ is bool or not 0 <= value <= 0xFFFF_FFFF:
        raise LocalWireError(f"{value!r:.80} is no StatusCode")
    if not value:
        return {}
    if verbose:
        name = status_name(value)
        if not name.startswith("0x"):
            return {"Code": int(value), "Symbol": name}
    return {"Code": int(value)}


def _encode_localized_text(_namespaces: tuple[str, ...], _verbose: bool, value: Any) -> dict[str, str]:
    if not isinstance(value, LocalizedText):
        raise LocalWireError(f"{value!r:.80} is no LocalizedText")
    out: dict[str, str] = {}
    if value.locale:
        out["Locale"] = value.locale
    if value.text:
        out["Text"] = value.text
    return out


def _named(encode: Callable[[tuple[str, ...], Any], Any]) -> Encoder:
    def encode_value(namespaces: tuple[str, ...], _verbose: bool, value: Any) -> Any:
        return encode(namespaces, value)

    return encode_value


SCALAR_DECODERS: Final[dict[int, Decoder]] = {
    BuiltinType.BOOLEAN: _decode_boolean,
    **{kind: _integer_decoder(kind) for kind in RANGES},
    BuiltinType.FLOAT: _decode_float,
    BuiltinType.DOUBLE: _decode_double,
    BuiltinType.STRING: decode_string,
    BuiltinType.DATETIME: decode_date,
    BuiltinType.GUID: _decode_guid,
    BuiltinType.BYTE_STRING: decode_byte_string,
    BuiltinType.XML_ELEMENT: decode_string,
    BuiltinType.NODE_ID: decode_node_id,
    BuiltinType.EXPANDED_NODE_ID: decode_expanded_node_id,
    BuiltinType.STATUS_CODE: decode_status,
    BuiltinType.QUALIFIED_NAME: decode_qualified_name,
    BuiltinType.LOCALIZED_TEXT: _decode_localized_text,
}

SCALAR_ENCODERS: Final[dict[int, Encoder]] = {
    BuiltinType.BOOLEAN: _encode_boolean,
    **{kind: _integer_encoder(kind) for kind in RANGES},
    BuiltinType.FLOAT: _encode_float,
    BuiltinType.DOUBLE: _encode_double,
    BuiltinType.STRING: _encode_string,
    BuiltinType.DATETIME: _encode_date,
    BuiltinType.GUID: _encode_guid,
    BuiltinType.BYTE_STRING: _encode_byte_string,
    BuiltinType.XML_ELEMENT: _encode_string,
    BuiltinType.NODE_ID: _named(encode_node_id),
    BuiltinType.EXPANDED_NODE_ID: _named(encode_expanded_node_id),
    BuiltinType.STATUS_CODE: encode_status,
    BuiltinType.QUALIFIED_NAME: _named(encode_qualified_name),
    BuiltinType.LOCALIZED_TEXT: _encode_localized_text,
}

DEFAULTS: Final[dict[int, Any]] = {
    BuiltinType.BOOLEAN: False,
    **dict.fromkeys(RANGES, 0),
    BuiltinType.FLOAT: 0.0,
    BuiltinType.DOUBLE: 0.0,
    BuiltinType.DATETIME: 0,
    BuiltinType.GUID: NULL_GUID,
    BuiltinType.STATUS_CODE: 0,
    BuiltinType.NODE_ID: decode_node_id(Reading(), None),
    BuiltinType.EXPANDED_NODE_ID: decode_expanded_node_id(Reading(), None),
    BuiltinType.QUALIFIED_NAME: decode_qualified_name(Reading(), None),
    BuiltinType.LOCALIZED_TEXT: NULL_TEXT,
}
"""The value that an absent member of a structure has; None for the other types (OPC 10000-6 table 1)."""
