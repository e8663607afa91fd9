"""JSON messages beside `orjson` on the same plain dictionaries, which is what any JSON codec has below it.

The message is the one that our publishers send: all headers, one DataSetMessage with sequence number, version, time and
status, and its fields. Ours turns typed values into text and back, and checks each by its type; the floor turns into
text what is a dictionary already, and back. Before anything is timed both must make the same text and read the same
values.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import orjson

from benchmarks.codec import LAYOUTS, MAJOR_VERSION, MESSAGES, MINOR_VERSION, NOON
from benchmarks.harness import Figure, at_most, interleaved, seconds_per_call
from ua_fleet.values import ARRAY
from ua_fleet.wire.json import DataSetFields, Form, JsonData, JsonWriterPlan, Source, decode_json
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData

GOALS = {"1x1": 5.0, "1x10 mixed": 3.0, "1x50": 3.0}
ROUNDS = 3
"""A round takes some milliseconds here, so three are taken for each one asked for: the machine's noise is longer."""
REPEATS = 200

_Message = tuple[str, int, int, int, tuple[Any, ...]]
"""MessageId, sequence number, timestamp, status, values."""


def _fields(types: tuple[int, ...]) -> DataSetFields:
    fields = [
        FieldMetaData(f"field{i}", code & ~ARRAY, value_rank=1 if code & ARRAY else -1) for i, code in enumerate(types)
    ]
    return DataSetFields(DataSetMetaData("bench", tuple(fields), ConfigurationVersion(MAJOR_VERSION, MINOR_VERSION)))


def _seconds_per_encode(
    encode: Callable[[str, int, int, int, tuple[Any, ...]], bytes], messages: list[_Message]
) -> float:
    """As `seconds_per_call`, for a function with the five arguments that a publisher has at hand."""
    started = time.perf_counter()
    for _ in range(REPEATS):
        for message_id, sequence_number, timestamp, status, values in messages:
            encode(message_id, sequence_number, timestamp, status, values)
    return (time.perf_counter() - started) / (REPEATS * len(messages))


def _layout(name: str, form: Form, rounds: int) -> list[Figure]:
    types, make = LAYOUTS[name]
    fields = _fields(types)
    plan = JsonWriterPlan(fields, form, source=Source("2", "group", 1001, "writer"))
    ours: list[_Message] = [
        (f"32235546-05d9-4fd7-97df-{i:012}", i, NOON + 10_000 * i, 0, make(i)) for i in range(MESSAGES)
    ]
    texts = [plan.encode(*message) for message in ours]
    trees = [orjson.loads(text) for text in texts]

    def fields_of(_source: Source) -> DataSetFields:
        return fields

    def decode(text: bytes) -> object:
        return decode_json(text, fields_of)

    for message, text, tree in zip(ours, texts, trees, strict=True):
        assert orjson.dumps(tree) == text
        decoded = decode(text)
        assert isinstance(decoded, JsonData)
        (part,) = decoded.message.messages
        assert (part.types, part.values) == (types, message[4])
        assert not decoded.leniencies

    our_encode, their_encode, our_decode, their_decode = interleaved(
        ROUNDS * rounds,
        [
            lambda: _seconds_per_encode(plan.encode, ours),
            lambda: seconds_per_call(orjson.dumps, trees, REPEATS),
            lambda: seconds_per_call(decode, texts, REPEATS),
            lambda: seconds_per_call(orjson.loads, texts, REPEATS),
        ],
    )
    return [
        at_most(
            f"{what} {name} {form.value}",
            value * 1e6,
            "us",
            reference=f"orjson {orjson.__version__}",
            reference_value=floor * 1e6,
            goal=GOALS[name],
        )
        for what, value, floor in (("encode", our_encode, their_encode), ("decode", our_decode, their_decode))
    ]


def figures(rounds: int) -> list[Figure]:
    return [
        figure for name in LAYOUTS for form in (Form.COMPACT, Form.VERBOSE) for figure in _layout(name, form, rounds)
    ]
