"""JSON text to Python values and back, with budgets that are checked before anything is built.

`orjson` parses: of two members with the same name the last one counts, an integer of more than 64 bits becomes a float
(so whoever takes a number checks its range by type), and a float that no Double can hold is no JSON.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import orjson

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.data_types import NO_TYPES, DataTypes

__all__ = [
    "BYTE_ORDER_MARK",
    "DEFAULT_LIMITS",
    "Limits",
    "Reading",
    "check_depth",
    "dump",
    "is_deeper",
    "load",
    "parse",
    "shown",
]

BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"


class Limits(NamedTuple):
    """What one message may have at most."""

    bytes: int = 4 * 1024 * 1024
    elements: int = 200_000
    """Members of objects and elements of arrays. A small one costs some fifty times the memory of its text."""
    depth: int = 32
    """Objects and arrays in each other. Those of a message take 4 of them."""


DEFAULT_LIMITS: Final = Limits()

MOST_PACKED: Final = 200_000
"""Structures of one message and their members, and every try of a union, together. Descriptions say how many a short
text stands for: each structure has members of structures that are left out, and each union has its ways."""


class Reading:
    """One message while it is decoded: the namespaces that its values refer to, and what was forgiven."""

    __slots__ = ("leniencies", "namespaces", "packed", "types")

    def __init__(self, namespaces: tuple[str, ...] = (), types: DataTypes = NO_TYPES) -> None:
        """Begin one; `namespaces` are those of the metadata, of which the first has the index 1."""
        self.namespaces = namespaces
        self.types = types
        self.leniencies: dict[Leniency, int] = {}
        self.packed = 0

    def spend(self, count: int) -> None:
        """Count what structures are made of; raises RemoteWireError where it is too much for one message."""
        self.packed += count
        if self.packed > MOST_PACKED:
            raise RemoteWireError(JsonCause.ELEMENTS, f"structures of more than {MOST_PACKED} members")

    def note(self, leniency: Leniency) -> None:
        """Count something that was forgiven."""
        self.leniencies[leniency] = self.leniencies.get(leniency, 0) + 1


def load(text: bytes, limits: Limits = DEFAULT_LIMITS) -> Any:
    """The value of a JSON text, however deep; raises RemoteWireError. `check_depth` has to follow, or no recursion."""
    size = len(text)
    if size > limits.elements:  # no element takes less than a byte, so a shorter text needs no count
        if size > limits.bytes:
            raise RemoteWireError(JsonCause.SIZE, f"{size} bytes, at most {limits.bytes}")
        # Commas in texts count too, so the budget is a bound and no exact number.
        if text.count(b"{") + text.count(b"[") + text.count(b",") > limits.elements:
            raise RemoteWireError(JsonCause.ELEMENTS, f"more than {limits.elements} members and elements")
    try:
        return orjson.loads(text)
    except (orjson.JSONDecodeError, RecursionError) as error:
        raise RemoteWireError(JsonCause.SYNTAX, str(error)[:200]) from None


def check_depth(text: bytes, value: Any, limits: Limits = DEFAULT_LIMITS) -> None:
    """Raise RemoteWireError where a value is nested too deep."""
    depth = limits.depth
    if text.count(b"{") + text.count(b"[") > depth and _may_be_deeper(text, depth) and is_deeper(value, depth):
        raise RemoteWireError(JsonCause.DEPTH, f"more than {depth} objects and arrays in each other")


def parse(text: bytes, reading: Reading, limits: Limits = DEFAULT_LIMITS) -> Any:
    """The value of a JSON text; raises RemoteWireError."""
    if text.startswith(BYTE_ORDER_MARK):
        reading.note(Leniency.BYTE_ORDER_MARK)
        text = text[len(BYTE_ORDER_MARK) :]
    value = load(text, limits)
    check_depth(text, value, limits)
    return value


_NO_BRACKETS: Final = bytes([byte for byte in range(256) if byte not in b"{}[]"])


def _may_be_deeper(text: bytes, depth: int) -> bool:
    """Whether the brackets of a text, those in its texts among them, do not cancel out in so many rounds.

    It takes a third of the time of looking at the values, and mostly says no.
    """
    brackets = text.translate(None, _NO_BRACKETS)
    for _ in range(depth):
        brackets = brackets.replace(b"{}", b"").replace(b"[]", b"")
        if not brackets:
            return False
    return True


def is_deeper(value: Any, depth: int) -> bool:
    """Whether more than `depth` objects and arrays stand in each other."""
    level: list[Any] = [value] if value.__class__ in (dict, list) else []
    while level:
        if not depth:
            return True
        depth -= 1
        level = [
            child
            for parent in level
            for child in (parent.values() if parent.__class__ is dict else parent)
            if child.__class__ in (dict, list)
        ]
    return False


def shown(value: Any) -> str:
    """A value of a peer in some words, for the text of an error: neither long nor made of all that is in it."""
    if value.__class__ is str:
        return repr(value[:60])
    if value.__class__ is dict:
        return f"an object of {len(value)} members"
    if value.__class__ is list or value.__class__ is tuple:
        return f"an array of {len(value)} elements"
    return repr(value)[:60]


def dump(value: Any) -> bytes:
    """The JSON text of a value; raises LocalWireError."""
    try:
        return orjson.dumps(value)
    except (TypeError, RecursionError) as error:  # orjson.JSONEncodeError is a TypeError
        raise LocalWireError(f"a value that JSON cannot hold: {error!s:.200}") from None
