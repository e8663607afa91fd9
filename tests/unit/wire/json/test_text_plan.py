"""Values read from the text of a payload are those that the general way reads, for each type and whatever stands there.

The general way is `decode_by_names`, without any plan: `orjson` parses, and each value is looked at by its own decoder.
"""

from __future__ import annotations

import gc
import random
import struct
import weakref
from collections import Counter
from typing import Any

import msgspec
import orjson
import pytest

from tests.unit.wire.json.samples import KEY, METADATA, NOON, SOURCE, TYPES, VALUES, data
from tests.unit.wire.json.test_fuzz import ALL, MUTATIONS, corpus, mutate, outcome
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import ARRAY
from ua_fleet.values import BuiltinType as B
from ua_fleet.wire.json import DataSetFields, Form, JsonWriterPlan, Reading, decode_json, encode_data
from ua_fleet.wire.json import known_text as known
from ua_fleet.wire.json.data_messages import decode_data
from ua_fleet.wire.json.field_plan import PLAIN
from ua_fleet.wire.json.parsing import load, parse
from ua_fleet.wire.json.text_plan import DecodeText, compile_text_plan, decode_no_text
from ua_fleet.wire.messages import DataSetMessage, FieldMetaData

CODES = sorted(PLAIN)


def fields_by(codes: dict[str, int]) -> DataSetFields:
    fields = [FieldMetaData(name, code & ~ARRAY, value_rank=1 if code & ARRAY else -1) for name, code in codes.items()]
    return DataSetFields(METADATA._replace(fields=tuple(fields)))


def without_plans(fields: DataSetFields) -> DataSetFields:
    """The same fields in the general way alone."""
    general = DataSetFields(fields.metadata)
    general.plans = ()
    return general


def check(fields: DataSetFields, text: bytes, *, is_compact: bool, plan: DecodeText | None = None) -> bool:
    """Whether the plan reads a payload; what it reads is what the general way reads and does not need to forgive."""
    values = (plan or compile_text_plan(fields.fields, is_compact=is_compact))(text)
    if values is None:
        return False
    reading = Reading()
    message = without_plans(fields).decode(reading, DataSetMessage(1), load(text))
    assert not reading.leniencies
    assert message == DataSetMessage(1, types=fields.planned_types, values=message.values)
    # As text, so that 1 is not 1.0, 0.0 not -0.0 and a list no tuple.
    assert repr(values) == repr(message.values)
    return True


SHORT_ITEMS = r"""
null true false True NaN Infinity -Infinity nul 0 -0 0.0 -0.0 1 -1 1.0 1.5 1e2 1E+2 100e-2 0.1 01 +1 1. .5 - 1e 127
128 -128 -129 255 256 32767 32768 -32768 -32769 65535 65536 2147483647 2147483648 -2147483648 -2147483649 4294967295
4294967296 9007199254740993 9223372036854775807 9223372036854775808 -9223372036854775808 -9223372036854775809
18446744073709551615 18446744073709551616 18446744073709551617 1000000000000000000000000000000 1e308
1.7976931348623157e308 1.7976931348623159e308 1e309 1e400 -1e400 5e-324 2e-324 1e-400 2.2250738585072011e-308 8.5
3.4028234663852886e38 3.4028235677973366e38 3.5e38 1e-45 1e-46 1.17549435e-38 16777217
0.3333333333333333148296162562473909929394721984863281 "" "x" "NaN" "nan" "Infinity" "-Infinity" "INF" "1" "-1"
"1.0" "1e2" "+1" "01" "-0" "1_0" "٣" "\t1" "9223372036854775807" "9223372036854775808" "-9223372036854775808"
"-9223372036854775809" "18446744073709551615" "18446744073709551616" "true" "null" "[1]" "2024-01-17T21:20:00Z"
"2024-01-17T21:20:00.1234567Z" "2024-01-17T21:20:00.1Z" "2024-01-17T21:20:00z" "2024-01-17t21:20:00.1234567Z"
"2024-01-17T21:20:00.1234567" "2024-01-17T21:20:00.1234567+01:00" "2024-01-17T21:20:00+00:00"
"2024-01-17T21:20:00.12345678Z" "2024-01-17T21:20:60Z" "2024-02-30T21:20:00Z" "0001-01-01T00:00:00Z"
"0001-01-01T00:00:00.0000001Z" "1600-12-31T23:59:59.9999999Z" "1601-01-01T00:00:00.0000001Z" "9999-12-31T23:59:59Z"
"2024-W03-3" "9999-12-31T23:59:59.9999999Z" "9999-12-31T23:59:58.9999999Z" "2024-01-17" "a\u0000b" "\ud83e\udd16"
"\ud800" "\udd16" "\udd16\ud83e" "\ud83ex" "\ud83e\n" "\u00e9" "é" "🤖" "\/" "\x" "\u12" " "\" "\"" 'x' [] [1.5]
[1,2.5] [-0] [null] ["NaN"] ["1"] [true] [1.5,] [[1.5]] [[]] [1e400] [1.5 {} {"Value":1} {"UaType":11,"Value":1.5}
{"Code":5} {"Array":[1.5]} {"Array":[1.5],"Dimensions":[1]} 1x 1, /**/1
"""
WHAT_JSON_HAS = [
    *SHORT_ITEMS.split(),
    *("", "9" * 400, "9" * 5000, "0." + "0" * 400 + "1", '" "', '" 1"', '"1 "', f'"{"9" * 5000}"'),
    *('"2024-01-17 21:20:00.1234567Z"', '"2024-01-17T21:20:00.123456 Z"', '"a\x00b"', '"\t"', '"\x7f"', '"\x1f"'),
    *("[" * 5000, "[" * 500 + "]" * 500, '{"a":' * 40 + "1" + "}" * 40, "1 ", " 1", "1\n", "1\x0b", "1\x00"),
]
NO_UTF8 = [
    b'"\xff"',
    b'"\xed\xa0\x80"',
    b'"\xc0\x80"',
    b'"\xf4\x90\x80\x80"',
    b'"\xc3"',
    b'"' + b"a" * 99 + b'\xff"',
    b"\xff",
]
ITEMS = [*(text.encode() for text in WHAT_JSON_HAS), *NO_UTF8]
KINDS = [
    b"0",
    b"-0",
    b"11.0",
    b"true",
    b'"11"',
    b"null",
    b"18446744073709551627",
    b"[11]",
    *(b"%d" % kind for kind in range(1, 26)),
]


@pytest.mark.parametrize("code", CODES)
def test_each_type_reads_what_the_general_way_reads(code: int) -> None:
    fields = fields_by({"a": code})
    read = [item for item in ITEMS if check(fields, b'{"a":%b}' % item, is_compact=False)]
    assert len(read) >= 2
    plan = compile_text_plan(fields.fields, is_compact=True)
    for item in ITEMS:
        variants = {kind: b'{"a":{"UaType":%b,"Value":%b}}' % (kind, item) for kind in KINDS}
        fitting = [kind for kind, text in variants.items() if check(fields, text, is_compact=True, plan=plan)]
        assert fitting == ([b"%d" % (code & ~ARRAY)] if item in read else [])


@pytest.mark.parametrize("code", [B.DOUBLE, B.FLOAT, B.DOUBLE | ARRAY])
def test_numbers_of_many_digits_are_rounded_alike(code: int) -> None:
    fields = fields_by({"a": code})
    decode, general = compile_text_plan(fields.fields, is_compact=False), without_plans(fields)
    chance = random.Random(20_261_130)
    read = 0
    for _ in range(MUTATIONS):
        digits = str(chance.randrange(10 ** chance.randrange(1, 40)))
        match chance.randrange(4):
            case 0:
                number = digits
            case 1:
                number = f"{digits}.{chance.randrange(10 ** chance.randrange(1, 30))}"
            case 2:
                number = f"{digits}.{digits}{chance.choice('eE')}{chance.randrange(-360, 330)}"
            case _:  # halfway between two neighbours, where one digit decides
                (exact,) = struct.unpack("<d", chance.randbytes(8))
                number = repr(exact) if exact - exact == 0.0 else "0"
        number = chance.choice(["", "-"]) + number.lstrip("-")
        text = b'{"a":%b}' % (f"[{number}]" if code & ARRAY else number).encode()
        values = decode(text)
        if values is not None:
            read += 1
            assert repr(values) == repr(general.decode(Reading(), DataSetMessage(1), load(text)).values), number
    assert read > MUTATIONS // 2


@pytest.mark.parametrize(
    ("text", "is_read"),
    [
        (b'{"a":1.5,"b":"x"}', True),
        (b'{"b":"x","a":1.5}', True),
        (b'{"a":0.5,"a":1.5,"b":"x"}', True),  # the last one counts
        (b'{"a":0.5,"b":"x","a":-0.0,"b":"y"}', True),
        (b'{"a":0.5,"b":"x","a":null}', False),
        (b'{"a":null,"b":"x","a":0.5}', False),
        (b'{"\\u0061":1.5,"b":"x"}', True),
        (b' {\t"a" : 1.5\r\n, "b":"x"} ', True),
        (b'{"a":1.5}', False),
        (b"{}", False),
        (b'{"a":1.5,"b":"x","c":1}', False),
        (b'{"a":1.5,"b":"x","":1}', False),
        (b'{"a":1.5,"b":"x","c\xff":1}', False),
        (b'{"a":1.5,"b":"x"', False),
        (b'{"a":1.5,"b":"x"}}', False),
        (b'{"a":1.5,"b":"x"},{}', False),
        (b'{"a":1.5,"b":"x"},"Payload":{}', False),
        (b'{"a":1.5,,"b":"x"}', False),
        (b'{"a":1.5,"b":"x",}', False),
        (b'{"a":1.5 "b":"x"}', False),
        (b'{"a" 1.5,"b":"x"}', False),
        (b"{'a':1.5,'b':'x'}", False),
        (b'\xef\xbb\xbf{"a":1.5,"b":"x"}', False),
        (b'{"a":1.5,"b":"x"}\0', False),
        (b'[1.5,"x"]', False),
        (b"null", False),
        (b"", False),
    ],
)
def test_members_are_found_as_in_an_object(text: bytes, is_read: bool) -> None:
    assert check(fields_by({"a": B.DOUBLE, "b": B.STRING}), text, is_compact=False) is is_read


@pytest.mark.parametrize(
    ("variant", "is_read"),
    [
        (b'{"UaType":11,"Value":1.5}', True),
        (b'{"Value":1.5,"UaType":11}', True),
        (b'{"UaType":10,"Value":1.5,"UaType":11}', False),
        (b'{"UaType":11,"Value":1,"Value":2}', True),
        (b'{"UaType":11}', False),
        (b'{"Value":1.5}', False),
        (b'{"UaType":11,"Value":null}', False),
        (b'{"UaType":11,"Value":1.5,"Dimensions":[1]}', False),
        (b'{"UaType":11,"Value":1.5,"Status":{"Code":5}}', False),
        (b'{"UaType":11,"Value":{"UaType":11,"Value":1.5}}', False),
        (b"1.5", False),
        (b"null", False),
    ],
)
def test_a_variant_is_its_type_and_its_value(variant: bytes, is_read: bool) -> None:
    assert check(fields_by({"a": B.DOUBLE}), b'{"a":%b}' % variant, is_compact=True) is is_read


@pytest.mark.parametrize("name", ["", " ", "é ☃", "type", "__class__", "self", "v1", "None", "\x7f", "x" * 10_000])
def test_a_field_may_have_any_name(name: str) -> None:
    text = orjson.dumps({name: 1.5, "b": 2.5})
    assert check(fields_by({name: B.DOUBLE, "b": B.DOUBLE}), text, is_compact=False)


@pytest.mark.parametrize("name", ['a"', "a\\", "a\n", "\0"])
def test_a_name_with_escapes_goes_the_other_way(name: str) -> None:
    assert compile_text_plan(fields_by({name: B.DOUBLE}).fields, is_compact=False) is decode_no_text


ALL_PLAIN = fields_by({f"f{code}": code for code in CODES})
SAMPLES = dict(zip(TYPES, VALUES, strict=True)) | {B.DOUBLE | ARRAY.real: (0.5, -1.5)}
PLAIN_VALUES = tuple([SAMPLES[code] for code in CODES])


def plain_texts() -> list[bytes]:
    """A message of each form, with all types that are read from the text of a payload."""
    return [
        JsonWriterPlan(ALL_PLAIN, form, source=SOURCE).encode("m-1", 7, NOON + 1, 0, PLAIN_VALUES)
        for form in (Form.COMPACT, Form.VERBOSE)
    ]


def _with_other_digits(chance: random.Random, text: bytes, begin: bytes, end: bytes) -> bytes:
    """The payload of a text with some of its digits replaced, which leaves most of them readable."""
    payload = bytearray(text.removeprefix(begin).removesuffix(end))
    places = [place for place, byte in enumerate(payload) if chr(byte).isdigit() and payload[place - 1] != ord("f")]
    for place in chance.sample(places, chance.randrange(1, 4)):
        payload[place] = ord(chance.choice("01234567890123456789.-"))
    return bytes(payload)


def test_mutated_messages_are_read_as_in_the_general_way() -> None:
    """Most of them are of a known outline, with something else in the payload."""
    texts = plain_texts()
    payloads = [text[text.index(b'"Payload":') + len(b'"Payload":') : -len(b"}]}")] for text in texts]
    trees = [orjson.loads(payload) for payload in payloads]
    whole_trees = [orjson.loads(text) for text in texts]
    general_fields = without_plans(ALL_PLAIN)
    begin, end = texts[0].split(payloads[0])
    chance = random.Random(20_261_131)
    read = Counter[bool]()
    for _ in range(ALL if MUTATIONS == ALL else 8_000):
        text = chance.choice(texts)
        if chance.random() < 0.2:
            decode_json(text, lambda _source: ALL_PLAIN)  # which form is expected next
        which = chance.random()
        payload = _with_other_digits(chance, text, begin, end) if which < 0.3 else mutate(chance, payloads, trees)
        is_whole = which > 0.9
        text = mutate(chance, texts, whole_trees) if is_whole else begin + payload + end

        def general(text: bytes = text) -> Any:
            reading = Reading()
            return decode_data(reading, parse(text, reading), lambda _source: general_fields, SOURCE)

        def ours(text: bytes = text) -> Any:
            return decode_json(text, lambda _source: ALL_PLAIN, source=SOURCE)

        if not is_whole:
            read[ALL_PLAIN.decode_text(payload) is not None] += 1
        if not is_whole or b'"ua-data"' in text:
            assert outcome(ours) == outcome(general), text
    assert read[True] > 300
    assert read[False] > 2_500


def test_messages_of_every_kind_are_read_as_in_the_general_way() -> None:
    for text in [*corpus(), *plain_texts(), *plain_texts()]:
        for fields in (ALL_PLAIN, DataSetFields(METADATA)):
            general_fields = without_plans(fields)

            def general(text: bytes = text, fields: DataSetFields = general_fields) -> Any:
                return decode_json(text, lambda _source: fields, source=SOURCE)

            def ours(text: bytes = text, fields: DataSetFields = fields) -> Any:
                return decode_json(text, lambda _source: fields, source=SOURCE)

            assert outcome(ours) == outcome(general)
            assert outcome(ours) == outcome(general)  # now with what was learned


def test_the_second_message_of_a_writer_is_read_from_its_text(monkeypatch: pytest.MonkeyPatch) -> None:
    """One plan a form is made, when a text needs it first, and is kept when forms alternate."""
    made: list[bool] = []

    def compile_counted(fields: Any, *, is_compact: bool) -> Any:
        made.append(is_compact)
        return compile_text_plan(fields, is_compact=is_compact)

    monkeypatch.setattr("ua_fleet.wire.json.data_sets.compile_text_plan", compile_counted)
    known._outlines.clear()  # pyright: ignore[reportPrivateUsage]
    fields = DataSetFields(ALL_PLAIN.metadata)
    compact, verbose = plain_texts()
    decode_json(verbose, lambda _source: fields)
    assert made == []
    assert fields.decode_text(b"{}") is None
    assert made == [False]
    for text in [verbose, compact, compact, compact, verbose, compact, verbose, verbose]:
        decode_json(text, lambda _source: fields)
    assert made == [False, True]
    payload = verbose[verbose.index(b'"Payload":') + 10 : -3]
    assert fields.decode_text(payload) == PLAIN_VALUES
    monkeypatch.setattr("ua_fleet.wire.json.usual_message.loads", None)  # nothing else parses the payload
    decoded: Any = decode_json(verbose, lambda _source: fields)
    assert decoded.message.messages[0].values == PLAIN_VALUES


def test_a_plan_takes_its_type_along_when_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A publisher that announces one metadata after the other leaves no types behind."""
    types: list[weakref.ref[Any]] = []
    decoder: Any = msgspec.json.Decoder

    def remembered(payload_type: Any) -> Any:
        types.append(weakref.ref(payload_type))
        return decoder(payload_type)

    monkeypatch.setattr(msgspec.json, "Decoder", remembered)
    for count in range(1, 50):
        fields = fields_by({f"f{index}": CODES[index % len(CODES)] for index in range(count)})
        for is_compact in (False, True):
            compile_text_plan(fields.fields, is_compact=is_compact)
    gc.collect()
    assert len(types) == 98
    assert [one() for one in types] == [None] * 98


def test_fields_that_others_nest_in_have_no_plan() -> None:
    for name, kind in {"a": B.VARIANT, "b": B.GUID, "c": B.EXTENSION_OBJECT, "d": B.STATUS_CODE}.items():
        assert compile_text_plan(fields_by({name: kind}).fields, is_compact=False) is decode_no_text
    enumeration = DataSetFields(METADATA._replace(fields=(next(f for f in METADATA.fields if f.name == "Colour"),)))
    assert compile_text_plan(enumeration.fields, is_compact=False) is decode_no_text
    assert compile_text_plan(fields_by({}).fields, is_compact=False) is decode_no_text
    text = encode_data(data(KEY), [DataSetFields(METADATA)])
    with pytest.raises(RemoteWireError):
        decode_json(text.replace(b'"Active"', b'"Active'), lambda _source: ALL_PLAIN)
