"""Values in words: tables of bytes, and the way there and back."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.registers import (
    ByteOrder,
    Register,
    RegisterType,
    RegisterUnfit,
    Table,
    cast,
    decode,
    encode,
    fit_problem,
)
from ua_fleet.values import BuiltinType, StatusCode

HOLDING = Table.HOLDING


def holding(kind: RegisterType, **more: Any) -> Register:
    return Register(HOLDING, 0, kind, **more)


WORDS: list[tuple[RegisterType, ByteOrder, tuple[int, ...], Any]] = [
    # 123456789.0 as a double is 0x419D6F34_54000000, 1.5 as a float 0x3FC00000, -2 all ones but the last bit.
    (RegisterType.INT16, ByteOrder.ABCD, (0xFFFE,), -2),
    (RegisterType.INT16, ByteOrder.CDAB, (0xFFFE,), -2),
    (RegisterType.INT16, ByteOrder.BADC, (0xFEFF,), -2),
    (RegisterType.UINT16, ByteOrder.DCBA, (0x3412,), 0x1234),
    (RegisterType.UINT32, ByteOrder.ABCD, (0xAABB, 0xCCDD), 0xAABBCCDD),
    (RegisterType.UINT32, ByteOrder.CDAB, (0xCCDD, 0xAABB), 0xAABBCCDD),
    (RegisterType.UINT32, ByteOrder.BADC, (0xBBAA, 0xDDCC), 0xAABBCCDD),
    (RegisterType.UINT32, ByteOrder.DCBA, (0xDDCC, 0xBBAA), 0xAABBCCDD),
    (RegisterType.INT32, ByteOrder.CDAB, (0xFFFE, 0xFFFF), -2),
    (RegisterType.FLOAT32, ByteOrder.ABCD, (0x3FC0, 0x0000), 1.5),
    (RegisterType.FLOAT32, ByteOrder.CDAB, (0x0000, 0x3FC0), 1.5),
    (RegisterType.FLOAT32, ByteOrder.BADC, (0xC03F, 0x0000), 1.5),
    (RegisterType.FLOAT32, ByteOrder.DCBA, (0x0000, 0xC03F), 1.5),
    (RegisterType.UINT64, ByteOrder.ABCD, (0x0102, 0x0304, 0x0506, 0x0708), 0x0102030405060708),
    (RegisterType.UINT64, ByteOrder.CDAB, (0x0708, 0x0506, 0x0304, 0x0102), 0x0102030405060708),
    (RegisterType.UINT64, ByteOrder.BADC, (0x0201, 0x0403, 0x0605, 0x0807), 0x0102030405060708),
    (RegisterType.UINT64, ByteOrder.DCBA, (0x0807, 0x0605, 0x0403, 0x0201), 0x0102030405060708),
    (RegisterType.INT64, ByteOrder.ABCD, (0xFFFF, 0xFFFF, 0xFFFF, 0xFFFE), -2),
    (RegisterType.FLOAT64, ByteOrder.ABCD, (0x419D, 0x6F34, 0x5400, 0x0000), 123456789.0),
    (RegisterType.FLOAT64, ByteOrder.DCBA, (0x0000, 0x0054, 0x346F, 0x9D41), 123456789.0),
]


@pytest.mark.parametrize(("kind", "order", "words", "value"), WORDS)
def test_numbers_lie_as_the_order_says(
    kind: RegisterType, order: ByteOrder, words: tuple[int, ...], value: Any
) -> None:
    register = holding(kind, order=order)
    assert decode(register, words) == value
    assert encode(register, value) == words
    assert register.span.count == len(words)


@pytest.mark.parametrize(
    ("order", "words", "text"),
    [
        (ByteOrder.ABCD, (0x4142, 0x4300, 0x0000), "ABC"),
        (ByteOrder.CDAB, (0x4142, 0x4300, 0x0000), "ABC"),
        (ByteOrder.BADC, (0x4241, 0x0043, 0x0000), "ABC"),
        (ByteOrder.DCBA, (0x4241, 0x0043, 0x0000), "ABC"),
        (ByteOrder.ABCD, (0x4142, 0x4344, 0x4546), "ABCDEF"),
        (ByteOrder.ABCD, (0, 0, 0), ""),
        (ByteOrder.ABCD, (0xC3BC, 0x0000, 0x0000), "ü"),
    ],
)
def test_text_keeps_its_words_in_order(order: ByteOrder, words: tuple[int, ...], text: str) -> None:
    register = holding(RegisterType.STRING, length=3, order=order)
    assert decode(register, words) == text
    assert encode(register, text) == words


def test_text_ends_at_its_first_zero_whatever_lies_behind_it() -> None:
    assert decode(holding(RegisterType.STRING, length=2), (0x4100, 0x4242)) == "A"


@pytest.mark.parametrize(
    ("bit", "order", "word"),
    [(0, ByteOrder.ABCD, 1), (15, ByteOrder.ABCD, 0x8000), (0, ByteOrder.BADC, 0x0100), (9, ByteOrder.DCBA, 2)],
)
def test_bit_of_a_word(bit: int, order: ByteOrder, word: int) -> None:
    register = holding(RegisterType.BOOL, bit=bit, order=order)
    assert encode(register, True) == (word,)
    assert encode(register, False) == (0,)
    assert decode(register, (word,)) is True
    assert decode(register, (0xFFFF & ~word,)) is False


def test_coil_is_a_bit() -> None:
    register = Register(Table.COIL, 7, RegisterType.BOOL)
    assert encode(register, True) == (True,)
    assert encode(register, 0) == (False,)
    assert decode(register, (False,)) is False


@pytest.mark.parametrize(
    ("scale", "offset", "raw", "value"),
    [
        (0.1, 0.0, 3, 0.3),
        (0.1, 0.0, 123, 12.3),
        (0.001, 0.0, 7, 0.007),
        (2.0, -40.0, 50, 60.0),
        (-0.5, 1.0, 4, -1.0),
        (1e-310, 0.0, 3, 3e-310),
    ],
)
def test_scaled_values_are_the_decimals_that_were_meant(scale: float, offset: float, raw: int, value: float) -> None:
    register = holding(RegisterType.INT16, scale=scale, offset=offset)
    assert decode(register, (raw,)) == value
    assert encode(register, value) == (raw,)


REFUSED: list[tuple[Register, Any, str]] = [
    (holding(RegisterType.INT16), 32768, "32768 does not fit into int16"),
    (holding(RegisterType.UINT16), -1, "-1 does not fit into uint16"),
    (holding(RegisterType.INT16, scale=0.1), 3276.8, "3276.8 does not fit into int16"),
    (holding(RegisterType.INT32), math.nan, "nan does not fit into int32"),
    (holding(RegisterType.INT32), math.inf, "inf does not fit into int32"),
    (holding(RegisterType.FLOAT32), 1e39, "1e+39 does not fit into float32"),
    (holding(RegisterType.FLOAT64, scale=1e-320), 3.0, "3.0 does not fit into float64"),
    (holding(RegisterType.INT16), "5", "'5' is no number"),
    (holding(RegisterType.INT16), [5], "[5] is no number"),
    (holding(RegisterType.FLOAT64), 10**400, "the number does not fit into float64"),
    (holding(RegisterType.INT16, scale=0.1), -(10**400), "the number does not fit into int16"),
    (holding(RegisterType.STRING, length=1), "ABC", "the text has 3 bytes; holding 0 holds 2"),
    (holding(RegisterType.STRING, length=2), "A\0B", "the text has a character 0, which ends a text"),
    (holding(RegisterType.STRING, length=2), 5, "5 is no text"),
    (holding(RegisterType.STRING, length=4, encoding="ascii"), "ü", "the text has characters that ascii does not have"),
    (Register(Table.COIL, 0, RegisterType.BOOL), 2, "2 is neither true nor false"),
]


@pytest.mark.parametrize(("register", "value", "reason"), REFUSED, ids=[reason for *_, reason in REFUSED])
def test_what_does_not_fit_is_refused(register: Register, value: Any, reason: str) -> None:
    with pytest.raises(RegisterUnfit) as caught:
        encode(register, value)
    assert caught.value.reason == reason


def test_bytes_that_are_no_text_are_refused() -> None:
    with pytest.raises(RegisterUnfit, match="are no text in utf-8") as caught:
        decode(holding(RegisterType.STRING, length=1), (0xFFFF,))
    assert caught.value.status == StatusCode.BAD_DECODING_ERROR


@pytest.mark.parametrize(
    ("value", "wanted", "result"),
    [
        (True, BuiltinType.BOOLEAN, True),
        ("a", BuiltinType.STRING, "a"),
        (7, BuiltinType.BYTE, 7),
        (7.6, BuiltinType.INT16, 8),
        (7, BuiltinType.DOUBLE, 7.0),
        (7, BuiltinType.FLOAT, 7.0),
        (math.inf, BuiltinType.FLOAT, math.inf),
        (256, BuiltinType.BYTE, RegisterUnfit),
        (math.nan, BuiltinType.INT32, RegisterUnfit),
        (1e39, BuiltinType.FLOAT, RegisterUnfit),
        (True, BuiltinType.INT16, RegisterUnfit),
        ("a", BuiltinType.BOOLEAN, RegisterUnfit),
        (1, BuiltinType.BOOLEAN, RegisterUnfit),
        (1, BuiltinType.STRING, RegisterUnfit),
        (1, BuiltinType.DATETIME, RegisterUnfit),
    ],
)
def test_values_become_those_of_their_field(value: Any, wanted: BuiltinType, result: Any) -> None:
    if result is RegisterUnfit:
        with pytest.raises(RegisterUnfit):
            cast(value, wanted)
    else:
        made = cast(value, wanted)
        assert made == result
        assert type(made) is type(result)


@pytest.mark.parametrize(
    ("register", "wanted", "problem"),
    [
        (holding(RegisterType.INT16), BuiltinType.INT16, ""),
        (holding(RegisterType.INT16), BuiltinType.INT32, ""),
        (holding(RegisterType.INT64), BuiltinType.INT64, ""),
        (holding(RegisterType.UINT64), BuiltinType.UINT64, ""),
        (holding(RegisterType.INT64), BuiltinType.DOUBLE, ""),
        (holding(RegisterType.FLOAT64), BuiltinType.FLOAT, ""),
        (holding(RegisterType.BOOL, bit=0), BuiltinType.BOOLEAN, ""),
        (holding(RegisterType.STRING, length=1), BuiltinType.STRING, ""),
        (holding(RegisterType.UINT16), BuiltinType.INT16, "uint16 goes from 0 to 65535, Int16 from -32768 to 32767"),
        (
            holding(RegisterType.INT16, scale=10.0),
            BuiltinType.INT16,
            "int16 as scaled goes from -327680 to 327670, Int16 from -32768 to 32767",
        ),
        (holding(RegisterType.INT16, scale=-1.0), BuiltinType.INT32, ""),
        (
            holding(RegisterType.UINT64, scale=1e300),
            BuiltinType.INT16,
            "uint64 as scaled goes from 0 to 1.84e+319, Int16 from -32768 to 32767",
        ),
        (
            holding(RegisterType.INT16, scale=0.1),
            BuiltinType.INT16,
            "scale and offset make fractions, which Int16 has not; use Float or Double",
        ),
        (
            holding(RegisterType.FLOAT32),
            BuiltinType.UINT32,
            "float32 has fractions, which UInt32 has not; use Float or Double",
        ),
        (holding(RegisterType.UINT16), BuiltinType.BOOLEAN, "uint16 is no Boolean"),
        (holding(RegisterType.BOOL, bit=1), BuiltinType.SBYTE, "bool is no SByte"),
        (holding(RegisterType.STRING, length=1), BuiltinType.DOUBLE, "string is no Double"),
        (holding(RegisterType.INT16), BuiltinType.DATETIME, "registers hold no DateTime"),
        (holding(RegisterType.INT16), BuiltinType.BYTE_STRING, "registers hold no ByteString"),
    ],
)
def test_types_that_can_never_fit(register: Register, wanted: BuiltinType, problem: str) -> None:
    assert fit_problem(register, wanted) == problem


ORDERS = st.sampled_from(list(ByteOrder))
NUMBERS = st.sampled_from([kind for kind in RegisterType if kind not in (RegisterType.BOOL, RegisterType.STRING)])


@given(NUMBERS, ORDERS, st.data())
def test_every_number_comes_back(kind: RegisterType, order: ByteOrder, data: st.DataObject) -> None:
    if kind.is_integer:
        value: float = data.draw(st.integers(*kind.integer_range))
    else:
        value = data.draw(st.floats(width=32 if kind is RegisterType.FLOAT32 else 64, allow_nan=False))
    register = holding(kind, order=order)
    assert decode(register, encode(register, value)) == value


@given(NUMBERS, ORDERS, st.data())
def test_every_word_comes_back(kind: RegisterType, order: ByteOrder, data: st.DataObject) -> None:
    words = tuple(data.draw(st.lists(st.integers(0, 0xFFFF), min_size=kind.words, max_size=kind.words)))
    register = holding(kind, order=order)
    value = decode(register, words)
    if isinstance(value, float) and math.isnan(value):
        return  # a NaN's payload is nobody's value
    assert encode(register, value) == words


@given(st.integers(-(2**15), 2**15 - 1), st.sampled_from([0.1, 0.01, 0.001, 0.5, 2.0, -0.1]), st.integers(-100, 100))
def test_scaling_loses_nothing(raw: int, scale: float, offset: int) -> None:
    register = holding(RegisterType.INT16, scale=scale, offset=float(offset))
    words = struct.unpack(">H", struct.pack(">h", raw))
    assert encode(register, decode(register, words)) == words


@given(st.text(alphabet=st.characters(exclude_characters="\0", codec="utf-8"), max_size=8), ORDERS)
def test_every_text_comes_back(text: str, order: ByteOrder) -> None:
    register = holding(RegisterType.STRING, length=16, order=order)
    assert decode(register, encode(register, text)) == text
