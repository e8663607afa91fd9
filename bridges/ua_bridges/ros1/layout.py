"""How many objects a ROS 1 message makes, found out from its type and its bytes before anything is built. Pure.

A few lines of a definition, or four bytes of a message, can ask for more objects than there is memory: a fixed array
is built as soon as an empty message is, and an array of messages without content takes no bytes at all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

__all__ = ["MOST_NUMBERS", "MOST_OBJECTS", "Layout", "TooMany", "layout_of"]

MOST_OBJECTS: Final = 250_000
"""Messages and texts in one message; each takes some hundred bytes of memory."""
MOST_NUMBERS: Final = 8_000_000
"""Numbers in the arrays of one message, those of bytes left out."""
MOST_FIXED: Final = 100_000
"""Of both, in the fixed arrays of a type, which are built with each empty message."""
MOST_DEPTH: Final = 32
"""Messages within messages."""

_SIZES: Final = {
    **dict.fromkeys(("bool", "byte", "char", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "float64", "time", "duration"), 8),
}
_OCTETS: Final = frozenset({"char", "uint8"})
"""Their arrays are one object."""
_FIELD = re.compile(
    r"(?P<type>[A-Za-z0-9_/]+)(?P<array>\[(?P<length>\d*)\])?\s+(?P<name>[A-Za-z][A-Za-z0-9_]*)", re.ASCII
)
_SEPARATOR = "=" * 80


class TooMany(Exception):
    """A type or a message of more elements than anybody needs; one line for people."""


@dataclass(slots=True)
class _Part:
    """One member: `count` (or as many as the message says) of a scalar of `size` bytes, a text, or a message."""

    size: int = 0
    is_text: bool = False
    is_octet: bool = False
    message: _Message | None = None
    count: int | None = 1
    """None: the message says how many."""

    @property
    def least(self) -> int:
        """Least bytes of one element."""
        return 4 if self.is_text else self.message.least if self.message else self.size


@dataclass(slots=True)
class _Message:
    parts: list[_Part] = field(default_factory=list[_Part])
    least: int = 0
    """Least bytes."""
    fixed: int = 0
    """Objects and numbers that an empty one is made of, itself included."""
    densest: float = 0.0
    """Most objects for each byte, in the arrays whose length the message says."""


class Layout:
    """How the bytes of a message type stand, as far as elements need to be counted."""

    def __init__(self, message: _Message) -> None:
        self._message = message
        self._counts_numbers = _has_number_arrays(message)

    def check(self, content: bytes) -> None:
        """Raise TooMany where a message would make more objects than anybody needs.

        Most messages are too short for that, and are not looked at. What ends too early is left to who reads it.
        """
        size = len(content)
        most = self._message.fixed + size * self._message.densest
        if most <= MOST_OBJECTS and (size <= MOST_NUMBERS or not self._counts_numbers):
            return
        try:
            _Walk(content).message(self._message, 0)
        except _Ended:
            return


class _Ended(Exception):
    """The bytes are over."""


class _Walk:
    """Goes over a message, and counts."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._objects = self._numbers = 0

    def message(self, message: _Message, at: int) -> int:
        self._objects += 1
        if self._objects > MOST_OBJECTS:
            raise TooMany(f"a message of more than {MOST_OBJECTS} elements")
        for part in message.parts:
            at = self._part(part, at)
        return at

    def _length(self, at: int) -> int:
        if at + 4 > len(self._content):
            raise _Ended
        return int.from_bytes(self._content[at : at + 4], "little")

    def _part(self, part: _Part, at: int) -> int:
        count = part.count
        if count is None:
            count, at = self._length(at), at + 4
        if part.message is None and not part.is_text:
            if not part.is_octet:
                self._numbers += count
                if self._numbers > MOST_NUMBERS:
                    raise TooMany(f"a message of more than {MOST_NUMBERS} numbers")
            return at + count * part.size
        if self._objects + count > MOST_OBJECTS:
            raise TooMany(f"a message of more than {MOST_OBJECTS} elements")
        for _ in range(count):
            if part.message is not None:
                at = self.message(part.message, at)
            else:
                self._objects += 1
                at += 4 + self._length(at)
        return at


def _has_number_arrays(message: _Message) -> bool:
    return any(
        _has_number_arrays(part.message) if part.message else part.count is None and not (part.is_text or part.is_octet)
        for part in message.parts
    )


def layout_of(message_type: str, definition: str) -> Layout:
    """The layout of a message type.

    Args:
        message_type: `pkg/Name`.
        definition: its text with nothing in it but declarations, and those of the types that it needs.

    Raises:
        TooMany: its fixed arrays have too many elements, or its arrays could have elements without end.
        ValueError: what it needs is not in the definition.
    """
    first, *others = definition.split(f"{_SEPARATOR}\n")
    texts = {message_type: first}
    for section in others:
        head, _, body = section.partition("\n")
        name = head.removeprefix("MSG:").strip()
        if texts.setdefault(name, body) != body:
            raise ValueError(f"{name} is defined twice")
    return Layout(_message(message_type, texts, {}, 0))


def _message(name: str, texts: Mapping[str, str], known: dict[str, _Message], depth: int) -> _Message:
    if name in known:
        return known[name]
    if depth > MOST_DEPTH:
        raise TooMany(f"messages within messages, more than {MOST_DEPTH} deep")
    text = texts.get(name)
    if text is None:
        raise ValueError(f"the definition of {name} is missing")
    message = _Message(fixed=1)
    for line in text.splitlines():
        match = _FIELD.fullmatch(line)
        if match is None:  # a constant, or an empty line
            continue
        part = _part(match["type"], name, texts, known, depth)
        if match["array"]:
            part.count = int(match["length"]) if match["length"] else None
        _add(message, part, f"{name} field {match['name']}")
    known[name] = message
    return message


def _part(kind: str, parent: str, texts: Mapping[str, str], known: dict[str, _Message], depth: int) -> _Part:
    if kind in _SIZES:
        return _Part(size=_SIZES[kind], is_octet=kind in _OCTETS)
    if kind == "string":
        return _Part(is_text=True)
    if kind in ("Header", "roslib/Header"):
        kind = "std_msgs/Header"
    elif "/" not in kind:
        kind = f"{parent.split('/', 1)[0]}/{kind}"
    return _Part(message=_message(kind, texts, known, depth + 1))


def _add(message: _Message, part: _Part, where: str) -> None:
    message.parts.append(part)
    inner = part.message
    if part.count is None:
        message.least += 4
        if part.least == 0:
            raise TooMany(f"{where} is an array of messages without content, whose length nothing bounds")
        if inner is not None or part.is_text:
            each = inner.fixed if inner else 1
            message.densest = max(message.densest, each / part.least, inner.densest if inner else 0.0)
        return
    message.least += part.count * part.least
    message.fixed += part.count * (inner.fixed if inner else 0 if part.is_octet else 1)
    if message.fixed > MOST_FIXED:
        raise TooMany(f"{where}: more than {MOST_FIXED} elements in fixed arrays")
    message.densest = max(message.densest, inner.densest if inner else 0.0)
