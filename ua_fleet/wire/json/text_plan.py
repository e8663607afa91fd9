"""Plans that read the values of a payload from its text, without a dictionary in between.

`msgspec` parses the text into an object whose type has a member for each field, and checks the values by their types on
the way. Which texts it takes for what is held against the general way by `tests/unit/wire/json/test_text_plan.py`: a
type stands here only where both read the same. Whatever is not exactly as expected makes a plan give up (None).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, Any, Final, Literal

import msgspec
import orjson

from ua_fleet.values import ARRAY, BuiltinType
from ua_fleet.wire.json.dates import decoding_names, lines_of_decoding
from ua_fleet.wire.json.field_plan import GIVE_UP, LONG, MOST_PLANNED_FIELDS, PLAIN, lines_of_long, lines_of_rounding
from ua_fleet.wire.json.fields import Field
from ua_fleet.wire.json.scalars import FLOAT, RANGES

__all__ = ["DecodeText", "compile_text_plan", "decode_no_text"]

DecodeText = Callable[[bytes], tuple[Any, ...] | None]
"""The values of the text of a payload; None for one of another form, and for one that is no JSON."""

_B = BuiltinType
_TYPES: Final[dict[int, Any]] = {
    _B.BOOLEAN: bool,
    **{code: Annotated[int, msgspec.Meta(ge=low, le=high)] for code, (low, high) in RANGES.items() if code not in LONG},
    **dict.fromkeys(LONG, str),
    _B.FLOAT: float,
    _B.DOUBLE: float,
    _B.STRING: str,
    _B.XML_ELEMENT: str,
    # Times of `msgspec` end at the microsecond.
    _B.DATETIME: str,
    _B.DOUBLE | ARRAY: tuple[float, ...],
}
"""What JSON holds of a value of each type code. A `float` may be written as an integer."""


def decode_no_text(_text: bytes) -> tuple[Any, ...] | None:
    """What reads payloads for which there is no plan."""
    return None


def compile_text_plan(fields: Sequence[Field], *, is_compact: bool) -> DecodeText:
    """The plan for the Compact or for the bare form; `decode_no_text` where the fields do not suit.

    It makes one type, which goes when the plan goes.
    """
    if not 0 < len(fields) <= MOST_PLANNED_FIELDS or not all(_is_plain(field) for field in fields):
        return decode_no_text
    variables = [f"v{index}" for index in range(len(fields))]
    types = [_variant_type(field.code) if is_compact else _TYPES[field.code] for field in fields]
    try:
        payload_type = msgspec.defstruct(
            "Payload",
            list(zip(variables, types, strict=True)),
            forbid_unknown_fields=True,
            gc=False,  # nothing in it refers to others
            rename={variable: field.name for variable, field in zip(variables, fields, strict=True)},
        )
    except ValueError:  # a name that stands in texts only with escapes
        return decode_no_text
    names: dict[str, Any] = {
        "GIVE_UP": (msgspec.MsgspecError, *GIVE_UP),
        "parse": msgspec.json.Decoder(payload_type).decode,
        "astuple": msgspec.structs.astuple,
        "loads": orjson.loads,
        "pack": FLOAT.pack,
        "unpack": FLOAT.unpack,
    }
    body = [f"{', '.join(variables)}, = astuple(parse(text))"]
    for variable, field in zip(variables, fields, strict=True):
        body += [f"{variable} = {variable}.Value"] if is_compact else []
        body += _conversion(variable, field.code, names)
    body.append(f"return ({', '.join(variables)},)")
    if len(body) == 2:
        body = ["return astuple(parse(text))"]
    lines = ["def decode(text):", " try:", *(f"  {line}" for line in body), " except GIVE_UP:", "  return None"]
    exec(compile("\n".join(lines), "<json text plan>", "exec"), names)  # noqa: S102 - made of our own words and numbers
    decode: DecodeText = names["decode"]
    return decode


def _is_plain(field: Field) -> bool:
    return field.code in PLAIN and field.names is None and not field.is_abstract


@cache
def _variant_type(code: int) -> type[msgspec.Struct]:
    """The type of a Variant that holds a value of a type code; there are as many as there are codes."""
    return msgspec.defstruct(
        "Variant",
        [("UaType", Literal[code & ~ARRAY]), ("Value", _TYPES[code])],
        forbid_unknown_fields=True,
        gc=False,
    )


def _conversion(v: str, code: int, names: dict[str, Any]) -> list[str]:
    """Lines that make the value of a field of what JSON holds, where that is another."""
    if code == _B.FLOAT:
        return lines_of_rounding(v)
    if code == _B.DATETIME:
        names |= decoding_names(v)
        return lines_of_decoding(v, v)
    return lines_of_long(v, code) if code in LONG else []
