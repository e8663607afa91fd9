"""The token of a carried run: what goes from the bridge that ended a segment to the one that has the next.

    Byte     version
    Byte     flags: 1 the branch has failed
    UInt16   segment that it is for
    Byte     slot of that segment, or 255: all of them
    UInt16   epoch
    8 bytes  hash of the plan
    Byte, n  run id, ASCII
    Byte, n  numbers of the repetitions around the segment, each UInt32, the outer ones first
    failed:  Byte, n  why, UTF-8
    else:    1 bit for each name that the slot needs, whether its value is there; then those values, each
             Byte 0 false, 1 true, 2 Int64, 3 Double, 4 UInt64, 5 text as Byte, n

Names do not travel: both sides have those that a slot needs in their parts, in one order. All numbers are little
endian, as in UADP. A plan whose token could be larger than 1,200 bytes is not carried, which `most_bytes` says before
it begins; so a token never is.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

from ua_fleet.errors import ScenarioError
from ua_fleet.scenario.expression import Value
from ua_fleet.values import BuiltinType, StatusCode

__all__ = [
    "HASH_BYTES",
    "MOST_LOOPS",
    "MOST_RUN_ID",
    "MOST_TEXT_BYTES",
    "MOST_TOKEN_BYTES",
    "WHOLE",
    "SegmentRound",
    "Token",
    "TokenInvalid",
    "decode_token",
    "encode_token",
    "most_bytes",
]

MOST_TOKEN_BYTES: Final = 1200
VERSION: Final = 2
HASH_BYTES: Final = 8
MOST_RUN_ID: Final = 40
MOST_LOOPS: Final = 16
"""Repetitions within each other whose steps several bridges do."""
MOST_TEXT_BYTES: Final = 64
"""Of a result that is a text and that later steps read, as UTF-8."""
MOST_REASON_BYTES: Final = 200
WHOLE: Final = 255
"""In place of a slot: nothing else comes to this segment, it has failed as a whole."""
_HEAD: Final = struct.Struct("<BBHBH8sB")
_FAILED: Final = 1
_ROUND: Final = struct.Struct("<I")
_INT64: Final = struct.Struct("<q")
_UINT64: Final = struct.Struct("<Q")
_DOUBLE: Final = struct.Struct("<d")


class TokenInvalid(ScenarioError):
    """What came as a token is none, or a value does not fit in one."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT
    remedy = "Run the same version of ua-fleet in all bridges; see which one sends it."


class SegmentRound(NamedTuple):
    """A segment in one round of the repetitions around it. It is begun once."""

    number: int
    """Of the segment."""
    rounds: tuple[int, ...] = ()
    """The numbers of those repetitions, the outer ones first."""

    def __str__(self) -> str:
        """Return `4`, or `4@0@2` within repetitions."""
        return f"{self.number}{''.join(f'@{number}' for number in self.rounds)}"

    @classmethod
    def parse(cls, text: str) -> SegmentRound:
        """The place of such a text; raises ValueError."""
        number, *rounds = text.split("@")
        return cls(int(number), tuple(map(int, rounds)))


@dataclass(frozen=True, slots=True)
class Token:
    """One token. `failed` is why its branch has failed; empty: it goes on."""

    run_id: str
    plan_hash: bytes
    epoch: int
    segment: int
    slot: int
    failed: str = ""
    values: Mapping[str, Value] = field(default_factory=dict[str, Value])
    """Results that are read from here on, by `task.result`; those that there are."""
    rounds: tuple[int, ...] = ()

    @property
    def place(self) -> SegmentRound:
        """The segment that it is for, and in which round."""
        return SegmentRound(self.segment, self.rounds)


def most_bytes(kinds: Iterable[int], loops: int = 0) -> int:
    """The most bytes that a token has whose slot needs results of these built-in types, within so many repetitions."""
    sizes = [_most_of(kind) for kind in kinds]
    head = _HEAD.size + MOST_RUN_ID + 1 + _ROUND.size * loops
    return head + max((len(sizes) + 7) // 8 + sum(sizes), 1 + MOST_REASON_BYTES)


def _most_of(kind: int) -> int:
    if kind == BuiltinType.BOOLEAN:
        return 1
    return 2 + MOST_TEXT_BYTES if kind == BuiltinType.STRING else 9


def encode_token(token: Token, names: Sequence[str]) -> bytes:
    """A token as bytes; `names` are those that its slot needs, in their order.

    Raises:
        TokenInvalid: a text is longer than 64 bytes, or a number than 64 bits.
    """
    run_id = token.run_id.encode("ascii")
    if len(run_id) > MOST_RUN_ID or len(token.plan_hash) != HASH_BYTES:
        raise TokenInvalid(f"run {token.run_id[:80]!r} cannot have a token: its id or hash has another length")
    if len(token.rounds) > MOST_LOOPS or any(not 0 <= number < 1 << 32 for number in token.rounds):
        raise TokenInvalid(f"run {run_id[:80]!r} cannot have a token in the repetitions {token.rounds[:20]}")
    flags = _FAILED if token.failed else 0
    head = _HEAD.pack(VERSION, flags, token.segment, token.slot, token.epoch, token.plan_hash, len(run_id))
    out = bytearray(head + run_id + bytes([len(token.rounds)]))
    for number in token.rounds:
        out += _ROUND.pack(number)
    if token.failed:
        reason = clipped(token.failed, MOST_REASON_BYTES).encode()
        return bytes(out + bytes([len(reason)]) + reason)
    there = sum(1 << number for number, name in enumerate(names) if name in token.values)
    out += there.to_bytes((len(names) + 7) // 8, "little")
    for name in names:
        if name in token.values:
            out += _encode_value(name, token.values[name])
    return bytes(out)


def clipped(text: str, most: int) -> str:
    """The beginning of a text that has at most so many bytes as UTF-8."""
    return text.encode("utf-8", "replace")[:most].decode("utf-8", "ignore")


def _encode_value(name: str, value: Value) -> bytes:
    if isinstance(value, bool):
        return bytes([value])
    if isinstance(value, float):
        return b"\3" + _DOUBLE.pack(value)
    if isinstance(value, int):
        if -(1 << 63) <= value < 1 << 63:
            return b"\2" + _INT64.pack(value)
        if 0 <= value < 1 << 64:
            return b"\4" + _UINT64.pack(value)
        raise TokenInvalid(f"the result {name} is {str(value)[:40]}, which has more than 64 bits")
    text = value.encode("utf-8", "replace")
    if len(text) > MOST_TEXT_BYTES:
        raise TokenInvalid(
            f"the result {name} is a text of {len(text)} bytes, and a token takes {MOST_TEXT_BYTES}; "
            "have the robot say less, or run the scenario orchestrated"
        )
    return bytes([5, len(text)]) + text


class _Reader:
    """Reads bytes from a stranger: never beyond the end."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    def take(self, count: int) -> bytes:
        """The next bytes."""
        end = self._at + count
        if end > len(self._content):
            raise TokenInvalid(f"a token of {len(self._content)} bytes ends too early")
        part, self._at = self._content[self._at : end], end
        return part

    def text(self) -> str:
        """A text with its length before it."""
        try:
            return self.take(self.take(1)[0]).decode()
        except UnicodeDecodeError as error:
            raise TokenInvalid("a token has a text that is not UTF-8") from error

    @property
    def is_over(self) -> bool:
        """Whether nothing is left."""
        return self._at == len(self._content)


def decode_token(content: bytes, names_of: Mapping[int, Sequence[Sequence[str]]] | None = None) -> Token:
    """The token in bytes that somebody has sent.

    Args:
        content: the bytes.
        names_of: the names that each slot of a segment needs, by the numbers of the segments; None reads the head
            alone, without values.

    Raises:
        TokenInvalid: it is none, or for a segment or slot that is not there.
    """
    if len(content) > MOST_TOKEN_BYTES:
        raise TokenInvalid(f"a token has at most {MOST_TOKEN_BYTES} bytes, this one {len(content)}")
    reader = _Reader(content)
    version, flags, segment, slot, epoch, plan_hash, length = _HEAD.unpack(reader.take(_HEAD.size))
    if version != VERSION or flags & ~_FAILED:
        raise TokenInvalid(f"a token of version {version} with flags {flags}; this program reads version {VERSION}")
    try:
        run_id = reader.take(length).decode("ascii")
    except UnicodeDecodeError as error:
        raise TokenInvalid("a token has a run id that is not ASCII") from error
    count = reader.take(1)[0]
    if count > MOST_LOOPS:
        raise TokenInvalid(f"a token is within {count} repetitions, and {MOST_LOOPS} are carried")
    rounds = tuple([int(_ROUND.unpack(reader.take(_ROUND.size))[0]) for _ in range(count)])
    failed = reader.text() if flags & _FAILED else ""
    token = Token(run_id, plan_hash, epoch, segment, slot, failed, rounds=rounds)
    if names_of is None:
        return token
    if segment not in names_of:
        raise TokenInvalid(f"segment {segment} of run {run_id[:80]} is not of this bridge")
    if slot != WHOLE and slot >= len(names_of[segment]):
        raise TokenInvalid(f"segment {segment} of run {run_id[:80]} has no slot {slot}")
    if slot == WHOLE and not failed:
        raise TokenInvalid("a token for all slots says why the segment has failed")
    values = {} if failed else _values(reader, names_of[segment][slot])
    if (flags & _FAILED and not failed) or not reader.is_over:
        raise TokenInvalid(f"a token of run {run_id[:80]} has {len(content)} bytes, and not those that it should")
    return replace(token, values=values)


def _values(reader: _Reader, names: Sequence[str]) -> dict[str, Value]:
    there = int.from_bytes(reader.take((len(names) + 7) // 8), "little")
    if there >> len(names):
        raise TokenInvalid("a token has values without names")
    return {name: _decode_value(reader) for number, name in enumerate(names) if there >> number & 1}


def _decode_value(reader: _Reader) -> Value:
    kind = reader.take(1)[0]
    match kind:
        case 0 | 1:
            return bool(kind)
        case 2:
            return int(_INT64.unpack(reader.take(8))[0])
        case 3:
            return float(_DOUBLE.unpack(reader.take(8))[0])
        case 4:
            return int(_UINT64.unpack(reader.take(8))[0])
        case 5:
            return reader.text()
        case _:
            raise TokenInvalid(f"a token has a value of kind {kind}")
