"""Values out of words, and words for values. Pure.

What does not fit (NaN for an integer, a number beyond the type, a text that is too long, bytes that are no text) is
refused with its reason; nothing is cut, clamped or wrapped.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Callable, Sequence
from decimal import Decimal
from typing import Final

from ua_fleet.registers.model import ByteOrder, Register, RegisterType
from ua_fleet.values import BuiltinType, StatusCode

__all__ = [
    "Cell",
    "RegisterUnfit",
    "cast",
    "decode",
    "encode",
    "fit_problem",
    "make_decoder",
    "make_encoder",
    "type_name",
]

Cell = int | bool
"""What an address holds: a word of 16 bits, or a bit."""
Value = bool | int | float | str

_FORMATS: Final = {
    RegisterType.INT16: ">h",
    RegisterType.UINT16: ">H",
    RegisterType.INT32: ">i",
    RegisterType.UINT32: ">I",
    RegisterType.INT64: ">q",
    RegisterType.UINT64: ">Q",
    RegisterType.FLOAT32: ">f",
    RegisterType.FLOAT64: ">d",
}
_INTEGERS: Final[dict[int, tuple[int, int]]] = {
    BuiltinType.SBYTE: (-(2**7), 2**7 - 1),
    BuiltinType.BYTE: (0, 2**8 - 1),
    BuiltinType.INT16: (-(2**15), 2**15 - 1),
    BuiltinType.UINT16: (0, 2**16 - 1),
    BuiltinType.INT32: (-(2**31), 2**31 - 1),
    BuiltinType.UINT32: (0, 2**32 - 1),
    BuiltinType.INT64: (-(2**63), 2**63 - 1),
    BuiltinType.UINT64: (0, 2**64 - 1),
}
_MAX_FLOAT: Final = 3.4028234663852886e38
"""Greatest finite IEEE 754 single."""
_LONG: Final = 10**20
"""Numbers from here on are not written out."""
_WHOLE: Final = 1e-9
"""1 / scale that is so near to a whole number was meant as one: 0.1 is a tenth."""


class RegisterUnfit(ValueError):
    """A value that its register, or its field, cannot hold."""

    def __init__(self, status: int, reason: str) -> None:
        self.status, self.reason = status, reason
        super().__init__(reason)


def _bytes_of(words: Sequence[Cell], order: ByteOrder, *, turn_words: bool = True) -> bytes:
    if order.swaps_words and turn_words:
        words = words[::-1]
    return struct.pack(f"{'<' if order.swaps_bytes else '>'}{len(words)}H", *words)


def _words_of(content: bytes, order: ByteOrder, *, turn_words: bool = True) -> tuple[int, ...]:
    words = struct.unpack(f"{'<' if order.swaps_bytes else '>'}{len(content) // 2}H", content)
    return words[::-1] if order.swaps_words and turn_words else words


def _divisor(scale: float) -> float | None:
    """10 for a scale of 0.1: dividing by it gives 0.3 where multiplying gives 0.30000000000000004."""
    inverse = 1 / scale
    if not math.isfinite(inverse):
        return None
    whole = round(inverse)
    return float(whole) if abs(whole) > 1 and abs(inverse - whole) < _WHOLE * abs(whole) else None


def _scaler(register: Register) -> Callable[[float], float]:
    offset, divisor, scale = register.offset, _divisor(register.scale), register.scale
    if divisor is not None:
        return lambda raw: raw / divisor + offset
    return lambda raw: raw * scale + offset


def make_decoder(register: Register) -> Callable[[Sequence[Cell]], Value]:
    """A function that takes exactly the cells of `register.span` and gives the value; it raises RegisterUnfit."""
    if register.type is RegisterType.BOOL:
        if register.table.is_bits:
            return lambda cells: bool(cells[0])
        mask = _mask(register)
        return lambda cells: bool(cells[0] & mask)
    order = register.order
    if register.type is RegisterType.STRING:
        encoding = register.encoding

        def text(cells: Sequence[Cell]) -> Value:
            content = _bytes_of(cells, order, turn_words=False)
            try:
                return content.split(b"\0", 1)[0].decode(encoding)
            except UnicodeDecodeError as error:
                reason = f"the bytes in {register.span.text} are no text in {encoding}"
                raise RegisterUnfit(StatusCode.BAD_DECODING_ERROR, reason) from error

        return text
    raw = _raw_decoder(register)
    if not register.is_scaled:
        return raw
    scaled = _scaler(register)
    return lambda cells: scaled(raw(cells))


def _raw_decoder(register: Register) -> Callable[[Sequence[Cell]], int | float]:
    """What lies in the register. Most values are single words, and have a shorter way."""
    order = register.order
    if register.type is RegisterType.UINT16 and not order.swaps_bytes:
        return lambda cells: int(cells[0])
    if register.type is RegisterType.INT16 and not order.swaps_bytes:
        return lambda cells: (int(cells[0]) ^ 0x8000) - 0x8000
    unpack = struct.Struct(_FORMATS[register.type]).unpack
    return lambda cells: unpack(_bytes_of(cells, order))[0]


def decode(register: Register, cells: Sequence[Cell]) -> Value:
    """The value that lies in the cells of `register.span`; raises RegisterUnfit."""
    return make_decoder(register)(cells)


def _mask(register: Register) -> int:
    assert register.bit is not None, "a bool in a word has its bit"
    position = register.bit
    return 1 << (position ^ 8 if register.order.swaps_bytes else position)


def make_encoder(register: Register) -> Callable[[Value], tuple[Cell, ...]]:
    """A function that gives the cells of `register.span` for a value; it raises RegisterUnfit.

    A bool in a word gives the word with that bit alone: what is beside it is not ours to write.
    """
    if register.type is RegisterType.BOOL:
        if register.table.is_bits:
            return lambda value: (_is_true(value),)
        mask = _mask(register)
        return lambda value: (mask if _is_true(value) else 0,)
    if register.type is RegisterType.STRING:
        return lambda value: _text_cells(register, value)
    pack, order = struct.Struct(_FORMATS[register.type]).pack, register.order
    return lambda value: _words_of(pack(_raw(register, value)), order)


def encode(register: Register, value: Value) -> tuple[Cell, ...]:
    """The cells that a value is written as; raises RegisterUnfit."""
    return make_encoder(register)(value)


def _is_true(value: Value) -> bool:
    if isinstance(value, bool) or value in (0, 1):
        return bool(value)
    raise RegisterUnfit(StatusCode.BAD_TYPE_MISMATCH, f"{value!r} is neither true nor false")


def _text_cells(register: Register, value: Value) -> tuple[int, ...]:
    if not isinstance(value, str):
        raise RegisterUnfit(StatusCode.BAD_TYPE_MISMATCH, f"{value!r} is no text")
    try:
        content = value.encode(register.encoding)
    except UnicodeEncodeError as error:
        reason = f"the text has characters that {register.encoding} does not have"
        raise RegisterUnfit(StatusCode.BAD_ENCODING_ERROR, reason) from error
    if len(content) > 2 * register.length:
        reason = f"the text has {len(content)} bytes; {register.span.text} holds {2 * register.length}"
        raise RegisterUnfit(StatusCode.BAD_OUT_OF_RANGE, reason)
    if b"\0" in content:
        raise RegisterUnfit(StatusCode.BAD_ENCODING_ERROR, "the text has a character 0, which ends a text")
    return _words_of(content.ljust(2 * register.length, b"\0"), register.order, turn_words=False)


def _raw(register: Register, value: Value) -> int | float:
    """What has to lie in the register for a value."""
    if not isinstance(value, int | float):
        raise RegisterUnfit(StatusCode.BAD_TYPE_MISMATCH, f"{value!r} is no number")
    if isinstance(value, int) and abs(value) > sys.float_info.max:  # which no float, and so no scale, can take
        raise RegisterUnfit(StatusCode.BAD_OUT_OF_RANGE, f"the number does not fit into {register.type}")
    number: int | float = int(value) if isinstance(value, bool) else value
    if register.is_scaled:
        divisor = _divisor(register.scale)
        number = (number - register.offset) * divisor if divisor else (number - register.offset) / register.scale
    if register.type.is_integer:
        if not math.isfinite(number):
            raise RegisterUnfit(StatusCode.BAD_OUT_OF_RANGE, f"{value} does not fit into {register.type}")
        least, greatest = register.type.integer_range
        whole = round(number)
        if not least <= whole <= greatest:
            raise RegisterUnfit(StatusCode.BAD_OUT_OF_RANGE, f"{value} does not fit into {register.type}")
        return whole
    has_overflown = math.isinf(number) and math.isfinite(value)
    if has_overflown or (register.type is RegisterType.FLOAT32 and _is_beyond_float(number)):
        raise RegisterUnfit(StatusCode.BAD_OUT_OF_RANGE, f"{value} does not fit into {register.type}")
    return float(number)


def _is_beyond_float(number: float) -> bool:
    return math.isfinite(number) and abs(number) > _MAX_FLOAT


def cast(value: Value, wanted: int) -> Value:
    """A value out of registers as one of an OPC UA built-in type; raises RegisterUnfit where it does not fit.

    Args:
        value: as `decode` gives it.
        wanted: BuiltinType: Boolean, an integer type, Float, Double or String.
    """
    if isinstance(value, bool | str):
        if wanted == (BuiltinType.BOOLEAN if isinstance(value, bool) else BuiltinType.STRING):
            return value
        raise RegisterUnfit(StatusCode.BAD_TYPE_MISMATCH, f"{value!r} is no {type_name(wanted)}")
    if wanted == BuiltinType.DOUBLE or (wanted == BuiltinType.FLOAT and not _is_beyond_float(value)):
        return float(value)
    if wanted not in _INTEGERS and wanted != BuiltinType.FLOAT:
        raise RegisterUnfit(StatusCode.BAD_TYPE_MISMATCH, f"a number is no {type_name(wanted)}")
    least, greatest = _INTEGERS.get(wanted, (1, 0))
    if not math.isfinite(value) or not least <= round(value) <= greatest:
        raise RegisterUnfit(StatusCode.BAD_OUT_OF_RANGE, f"{value} does not fit into {type_name(wanted)}")
    return round(value)


def make_cast(register: Register, wanted: int) -> Callable[[Value], Value]:
    """`cast` for what lies in one register."""
    if wanted == BuiltinType.DOUBLE and register.type not in (RegisterType.BOOL, RegisterType.STRING):
        return float
    return lambda value: cast(value, wanted)


def fit_problem(register: Register, wanted: int) -> str:
    """Why values of a built-in type and a register can never fit each other; empty where they may. For `config check`.

    Args:
        register: where the value lies.
        wanted: BuiltinType of the field.
    """
    name = type_name(wanted)
    if wanted == BuiltinType.BOOLEAN or register.type is RegisterType.BOOL:
        is_fit = wanted == BuiltinType.BOOLEAN and register.type is RegisterType.BOOL
        return "" if is_fit else f"{register.type} is no {name}"
    if wanted == BuiltinType.STRING or register.type is RegisterType.STRING:
        is_fit = wanted == BuiltinType.STRING and register.type is RegisterType.STRING
        return "" if is_fit else f"{register.type} is no {name}"
    if wanted in (BuiltinType.FLOAT, BuiltinType.DOUBLE):
        return ""
    if wanted not in _INTEGERS:
        return f"registers hold no {name}"
    if not register.type.is_integer:
        return f"{register.type} has fractions, which {name} has not; use Float or Double"
    if not (register.scale.is_integer() and register.offset.is_integer()):
        return f"scale and offset make fractions, which {name} has not; use Float or Double"
    ends = sorted(end * int(register.scale) + int(register.offset) for end in register.type.integer_range)
    least, greatest = _INTEGERS[wanted]
    if ends[0] < least or ends[1] > greatest:
        scaled = " as scaled" if register.is_scaled else ""
        first, last = (str(end) if abs(end) < _LONG else f"{Decimal(end):.3g}" for end in ends)
        return f"{register.type}{scaled} goes from {first} to {last}, {name} from {least} to {greatest}"
    return ""


def type_name(wanted: int) -> str:
    """The name of a built-in type as OPC UA writes it."""
    special = {"DATETIME": "DateTime", "BYTE_STRING": "ByteString", "SBYTE": "SByte"}
    name = BuiltinType(wanted).name
    if name in special:
        return special[name]
    return f"UI{name[2:].lower()}" if name.startswith("UI") else name.capitalize()
