"""Compiled plans for the payloads that writers send most: all fields, in the order of the metadata, of one form.

For the fields of one metadata functions are generated that check every value by its type, and convert what JSON holds
in another form. Whatever is not exactly as expected makes a plan give up (None, or GIVE_UP), and the general code
decides: a plan accepts nothing that the general code reads otherwise.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import orjson

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ARRAY, BuiltinType
from ua_fleet.wire.json.dates import decoding_names, encoding_names, lines_of_decoding, lines_of_encoding
from ua_fleet.wire.json.fields import Field, decode_field, encode_field
from ua_fleet.wire.json.parsing import Reading
from ua_fleet.wire.json.scalars import FLOAT, RANGES
from ua_fleet.wire.json.variants import Writing

__all__ = [
    "GIVE_UP",
    "LONG",
    "MOST_PLANNED_FIELDS",
    "PLAIN",
    "DecodePayload",
    "FieldPlan",
    "FieldPlans",
    "compile_fields",
    "lines_of_long",
    "lines_of_rounding",
    "write_fields",
]

GIVE_UP: Final = (
    struct.error,
    KeyError,
    TypeError,
    ValueError,
    AttributeError,
    OverflowError,
    LocalWireError,
    RemoteWireError,
    RecursionError,  # a value of many levels: the general code looks at how deep it is, before anything else
)

MOST_PLANNED_FIELDS: Final = 128
"""Generating the functions for more fields takes longer than it is worth."""

_B = BuiltinType
PLAIN: Final = frozenset(
    {_B.BOOLEAN, *RANGES, _B.FLOAT, _B.DOUBLE, _B.STRING, _B.XML_ELEMENT, _B.DATETIME, _B.DOUBLE | ARRAY}
)
"""Type codes for which checks are generated; others go through the general code, field by field."""
LONG: Final = (_B.INT64, _B.UINT64)
"""Integers that JSON holds as text."""

FEWEST_TOGETHER: Final = 8
"""Doubles in a row that are checked together."""

LARGEST_FLOAT: Final = float.fromhex("0x1.fffffep+127")
SMALLEST_NORMAL: Final = float.fromhex("0x1p-126")
"""Smaller Floats have fewer bits."""
_SPLITTER: Final = float(2**29 + 1)
"""A Double has 29 bits more than a Float."""


DecodePayload = Callable[[Reading, dict[str, Any]], tuple[Any, ...] | None]
"""The values of a payload; None for one of another form."""


class FieldPlan(NamedTuple):
    """How payloads of one form are read."""

    names: list[str]
    """The names of the fields, which the plan compares with those of a payload."""
    decode: DecodePayload
    is_compact: bool


FieldPlans = tuple[FieldPlan, ...]


def compile_fields(fields: Sequence[Field]) -> FieldPlans:
    """The plans for the bare and the Compact form; none where the fields do not suit."""
    if not 0 < len(fields) <= MOST_PLANNED_FIELDS or any(field.is_abstract for field in fields):
        return ()
    return tuple([_plan(fields, is_compact=is_compact) for is_compact in (False, True)])


def _plan(fields: Sequence[Field], *, is_compact: bool) -> FieldPlan:
    names: dict[str, Any] = {
        "GIVE_UP": GIVE_UP,
        "NAMES": [field.name for field in fields],
        "loads": orjson.loads,
        "decode_general": _decode_general,
        "pack": FLOAT.pack,
        "unpack": FLOAT.unpack,
    }
    lines = ["def decode(reading, payload):", " try:"]
    body = ["if [*payload] != NAMES: return None"]
    if not is_compact and len(fields) >= FEWEST_TOGETHER and all(field.code == _B.DOUBLE for field in fields):
        body += ["values = (*payload.values(),)", "for x in values:", " if x.__class__ is not float: return None"]
        body.append("return values")
    else:
        variables = [f"v{index}" for index in range(len(fields))]
        body.append(f"{', '.join(variables)}, = payload.values()")
        for variable, field in zip(variables, fields, strict=True):
            body += _checks(variable, field, names, is_compact=is_compact)
        body.append(f"return ({', '.join(variables)},)")
    lines += [f"  {line}" for line in body]
    lines += [" except GIVE_UP:", "  return None"]
    exec(compile("\n".join(lines), "<json field plan>", "exec"), names)  # noqa: S102 - made of our own words and numbers
    return FieldPlan(names["NAMES"], names["decode"], is_compact)


def _checks(v: str, field: Field, names: dict[str, Any], *, is_compact: bool) -> list[str]:
    """Lines that turn the JSON value `v` into a value of its type, or give up."""
    code = field.code
    if code not in PLAIN or field.names is not None:
        names[f"field_{v}"] = field
        return [f"{v} = decode_general(reading, field_{v}, {v})"]
    lines: list[str] = []
    if is_compact:
        names[f"kind_{v}"] = field.kind
        # Small integers are single objects, so `is not` tells 1 from True and from 1.0; at worst it gives up.
        lines += [
            f"if {v}['UaType'] is not kind_{v} or len({v}) != 2: return None",
            f"{v} = {v}['Value']",
        ]
    if code == _B.BOOLEAN:
        return [*lines, f"if {v}.__class__ is not bool: return None"]
    if code in (_B.STRING, _B.XML_ELEMENT):
        return [*lines, f"if {v}.__class__ is not str: return None"]
    if code == _B.DOUBLE:
        return [*lines, f"if {v}.__class__ is not float: return None"]
    if code == _B.DOUBLE | ARRAY:
        return [
            *lines,
            f"if {v}.__class__ is not list: return None",
            f"for x in {v}:",
            " if x.__class__ is not float: return None",
            f"{v} = tuple({v})",
        ]
    if code == _B.FLOAT:
        return [*lines, f"if {v}.__class__ is not float: return None", *lines_of_rounding(v)]
    if code == _B.DATETIME:
        names |= decoding_names(v)
        return [*lines, f"if {v}.__class__ is not str: return None", *lines_of_decoding(v, v)]
    if code in LONG:
        return [*lines, *lines_of_long(v, code)]
    low, high = RANGES[code]
    return [*lines, f"if {v}.__class__ is not int: return None", f"if not {low} <= {v} <= {high}: return None"]


def lines_of_long(v: str, code: int) -> list[str]:
    """Lines that make an Int64 or UInt64 of its text, or give up.

    It may be any integer of JSON, but without blanks around it: `strip` returns a text itself that has none.
    """
    low, high = RANGES[code]
    return [
        f"text = {v}",
        "if text.strip() is not text: return None",
        f"{v} = loads(text)",
        f"if {v}.__class__ is not int or not {low} <= {v} <= {high}: return None",
    ]


def lines_of_rounding(v: str) -> list[str]:
    """Lines that make a float the nearest Float, or give up on one beyond them.

    Mostly it is one already: then it is the same as its 24 leading bits, which Veltkamp's splitting gives, and has the
    exponent of a normal Float.
    """
    leading = f"{v} * {_SPLITTER} - ({v} * {_SPLITTER} - {v})"
    is_normal = f"{SMALLEST_NORMAL} <= {v} <= {LARGEST_FLOAT} or {-LARGEST_FLOAT} <= {v} <= {-SMALLEST_NORMAL}"
    return [f"if {leading} != {v} or not ({is_normal}): {v} = unpack(pack({v}))[0]"]


def _decode_general(reading: Reading, field: Field, item: Any) -> Any:
    noted = reading.leniencies
    reading.leniencies = {}
    try:
        kind, value, data_value = decode_field(reading, field, item)
        if kind != field.code or data_value is not None or reading.leniencies:
            raise ValueError  # the general code counts what was forgiven, once
    finally:
        reading.leniencies = noted
    return value


def write_fields(
    fields: Sequence[Field], types: tuple[int, ...], writing: Writing, names: dict[str, Any]
) -> tuple[list[str], dict[str, Any]]:
    """Lines that check `values` and put them into a payload, and that payload, which every message overwrites.

    A payload that stays costs a store for each field; one that is made anew costs several times that, most of all in
    the Compact form. `names` gets what the lines refer to. They raise one of GIVE_UP on what does not fit.
    """
    payload: dict[str, Any] = dict.fromkeys([field.name for field in fields])
    names |= {"encode_general": encode_field, "writing": writing, "payload": payload}
    checks: list[str] = []
    places: list[str] = []
    are_doubles = len(types) >= FEWEST_TOGETHER and all(code == _B.DOUBLE for code in types)
    if are_doubles:
        # A sum is finite only where each of them is; where the sum alone is not, the general code finds that out.
        checks += [
            "for x in values:",
            " if x.__class__ is not float: raise TypeError",
            "if (total := sum(values)) - total != 0.0: raise ValueError",
        ]
    for index, (field, code) in enumerate(zip(fields, types, strict=True)):
        variable, place = f"v{index}", f"payload[{field.name!r}]"
        places.append(place)
        if code != field.code or code not in PLAIN or field.names is not None:
            names[f"field{index}"] = field
            checks.append(f"{variable} = encode_general(writing, field{index}, {code}, {variable})")
            if not writing.verbose:
                checks.append(f"if {variable} is None: raise ValueError")
            continue
        names |= encoding_names(variable) if code == _B.DATETIME else {}
        if not are_doubles:
            checks += _write_checks(variable, code)
        if not writing.verbose:
            payload[field.name] = names[f"item{index}"] = {"UaType": field.kind, "Value": None}
            places[-1] = f"item{index}['Value']"
    if are_doubles:
        return [*checks, f"{', '.join(places)}, = values"], payload
    variables = [f"v{index}" for index in range(len(types))]
    stores = [f"{place} = {variable}" for place, variable in zip(places, variables, strict=True)]
    return [f"{', '.join(variables)}, = values", *checks, *stores], payload


def _write_checks(v: str, code: int) -> list[str]:
    """Lines that check a value, and leave in its variable what JSON holds of it."""
    if code == _B.BOOLEAN:
        return [f"if {v}.__class__ is not bool: raise TypeError"]
    if code in (_B.STRING, _B.XML_ELEMENT):
        return [f"if {v}.__class__ is not str: raise TypeError"]
    if code == _B.DOUBLE:
        return [f"if {v}.__class__ is not float or {v} - {v} != 0.0: raise TypeError"]
    if code == _B.FLOAT:
        return [f"if {v}.__class__ is not float or not {-LARGEST_FLOAT} <= {v} <= {LARGEST_FLOAT}: raise TypeError"]
    if code == _B.DOUBLE | ARRAY:
        return [
            f"if {v}.__class__ is not tuple: raise TypeError",
            f"if len({v}) < {FEWEST_TOGETHER}:",
            f" for x in {v}:",
            "  if x.__class__ is not float or x - x != 0.0: raise TypeError",
            "else:",
            f" for x in {v}:",
            "  if x.__class__ is not float: raise TypeError",
            f" if (total := sum({v})) - total != 0.0: raise ValueError",
        ]
    if code == _B.DATETIME:
        return lines_of_encoding(v, v, v)
    low, high = RANGES[code]
    lines = [f"if {v}.__class__ is not int or not {low} <= {v} <= {high}: raise TypeError"]
    return [*lines, f"{v} = str({v})"] if code in LONG else lines
