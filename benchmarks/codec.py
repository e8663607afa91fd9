"""The UADP codec beside asyncua's, on the same bytes, through the functions that Publisher and Subscriber call.

The message is the one that our publishers send: PublisherId UInt16, WriterGroupId, one DataSetMessage with sequence
number, timestamp, status and both versions, Variant fields. Sixteen messages of each layout with other values, and
other lengths of what has a length, are taken in turn. Before anything is timed both codecs must make the same bytes and
read the same values.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import timedelta
from typing import Any

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.pubsub import uadp

from benchmarks.harness import Figure, at_least, interleaved, seconds_per_call
from ua_fleet.values import ARRAY, BuiltinType, datetime_from_ticks
from ua_fleet.wire import Codec
from ua_fleet.wire.encode_plan import EncodeFields
from ua_fleet.wire.messages import NetworkMessage

GOAL = 30.0
MESSAGES = 16
ROUNDS = 3
"""A round takes a few milliseconds here, so three are taken for each one asked for: the machine's noise is longer."""
PUBLISHER_ID, WRITER_GROUP_ID, DATA_SET_WRITER_ID = 2, 2, 1001
MAJOR_VERSION, MINOR_VERSION = 826_000_001, 826_000_002
NOON = 133_500_000_000_000_000
"""2024-01-17 in ticks; our timestamps are whole microseconds here, since asyncua knows no finer ones."""

DOUBLE = BuiltinType.DOUBLE.value
MIXED_TYPES = (
    DOUBLE,
    BuiltinType.FLOAT.value,
    BuiltinType.INT32.value,
    BuiltinType.UINT32.value,
    BuiltinType.INT64.value,
    BuiltinType.BOOLEAN.value,
    BuiltinType.DATETIME.value,
    BuiltinType.STRING.value,
    BuiltinType.STRING.value,
    ARRAY | DOUBLE,
)


def _mixed(i: int) -> tuple[Any, ...]:
    ranges = tuple(float(k) for k in range(3 + i % 3))
    return (1.5 + i, 0.25 * i, -i, i, 10**12 + i, i % 2 == 0, NOON + 10 * i, f"robot-{i}", "map"[: i % 4], ranges)


_Message = tuple[int, int, int, tuple[Any, ...]]
"""Sequence number, timestamp, status, values."""

LAYOUTS: dict[str, tuple[tuple[int, ...], Callable[[int], tuple[Any, ...]]]] = {
    "1x1": ((DOUBLE,), lambda i: (1.5 + i,)),
    "1x10 mixed": (MIXED_TYPES, _mixed),
    "1x50": ((DOUBLE,) * 50, lambda i: tuple(float(i + k) for k in range(50))),
}


def _asyncua_time(ticks: int) -> ua.DateTime:
    moment = datetime_from_ticks(ticks).replace(tzinfo=None)
    fields = (moment.year, moment.month, moment.day, moment.hour, moment.minute, moment.second, moment.microsecond)
    return ua.DateTime(*fields)


def _asyncua_variant(type_code: int, value: Any) -> ua.Variant:
    if type_code == BuiltinType.DATETIME:
        value = _asyncua_time(value)
    elif type_code & ARRAY:
        value = list(value)
    return ua.Variant(value, ua.VariantType(type_code & ~ARRAY))


def _asyncua_message(types: tuple[int, ...], values: tuple[Any, ...], sequence_number: int, ticks: int) -> Any:
    header = uadp.UadpDataSetMessageHeader(
        SequenceNo=ua.UInt16(sequence_number),
        Timestamp=_asyncua_time(ticks),
        Status=ua.UInt16(0),
        CfgMajorVersion=ua.UInt32(MAJOR_VERSION),
        CfgMinorVersion=ua.UInt32(MINOR_VERSION),
    )
    variants = [_asyncua_variant(code, value) for code, value in zip(types, values, strict=True)]
    return uadp.UadpNetworkMessage(
        Header=uadp.UadpHeader(ua.UInt16(PUBLISHER_ID)),
        GroupHeader=uadp.UadpGroupHeader(ua.UInt16(WRITER_GROUP_ID)),
        DataSetPayloadHeader=[ua.UInt16(DATA_SET_WRITER_ID)],
        Payload=[uadp.UadpDataSetVariant(header, variants)],
    )


def _asyncua_decode(datagram: bytes) -> Any:
    return uadp.UadpNetworkMessage.from_binary(Buffer(datagram))


def _check_decoded(codec: Codec, datagram: bytes, types: tuple[int, ...], values: tuple[Any, ...]) -> None:
    ours, theirs = codec.decode(datagram), _asyncua_decode(datagram)
    assert isinstance(ours, NetworkMessage)
    assert (ours.messages[0].types, ours.messages[0].values) == (types, values)
    for ours_value, code, variant in zip(values, types, theirs.Payload[0].Data, strict=True):
        theirs_value = variant.Value
        if code == BuiltinType.DATETIME:
            assert abs(theirs_value - datetime_from_ticks(ours_value)) < timedelta(microseconds=1)
        else:
            assert (list(ours_value) if code & ARRAY else ours_value) == theirs_value


def _seconds_per_encode(encode: EncodeFields, messages: list[_Message], repeats: int) -> float:
    """As `seconds_per_call`, for a function with the four arguments that a Publisher has at hand."""
    started = time.perf_counter()
    for _ in range(repeats):
        for sequence_number, timestamp, status, values in messages:
            encode(sequence_number, timestamp, status, values)
    return (time.perf_counter() - started) / (repeats * len(messages))


def _layout(name: str, types: tuple[int, ...], make: Callable[[int], tuple[Any, ...]], rounds: int) -> list[Figure]:
    codec = Codec()
    plan = codec.writer_plan(PUBLISHER_ID, WRITER_GROUP_ID, DATA_SET_WRITER_ID, types, MAJOR_VERSION, MINOR_VERSION)
    ours: list[_Message] = [(i, NOON + 10_000 * i, 0, make(i)) for i in range(MESSAGES)]
    theirs = [_asyncua_message(types, values, i, ticks) for i, ticks, _, values in ours]
    datagrams = [message.to_binary() for message in theirs]
    for arguments, datagram in zip(ours, datagrams, strict=True):
        assert plan.encode(*arguments) == datagram
        _check_decoded(codec, datagram, types, arguments[3])

    our_encode, their_encode, our_decode, their_decode = interleaved(
        ROUNDS * rounds,
        [
            lambda: _seconds_per_encode(plan.encode, ours, 600),
            lambda: seconds_per_call(uadp.UadpNetworkMessage.to_binary, theirs, 40),
            lambda: seconds_per_call(codec.decode, datagrams, 600),
            lambda: seconds_per_call(_asyncua_decode, datagrams, 40),
        ],
    )
    return [
        at_least(f"{what} {name}", value * 1e6, "us", reference="asyncua 2.1.0", reference_value=peer * 1e6, goal=GOAL)
        for what, value, peer in (("encode", our_encode, their_encode), ("decode", our_decode, their_decode))
    ]


def figures(rounds: int) -> list[Figure]:
    return [figure for name, (types, make) in LAYOUTS.items() for figure in _layout(name, types, make, rounds)]
