"""Requests that are bombs by their grammar: counts that lie, elements of no bytes, dimensions, nesting, structures.

A generator writes the bytes of a structure field by field, as asyncua's decoder will read them, and goes wrong on
purpose here and there. The same seed gives the same bytes.
"""

from __future__ import annotations

import importlib
import random
import struct
from collections.abc import Callable
from typing import Any, Final

from ua_fleet.endpoint.scan import steps_of

ua: Any = importlib.import_module("asyncua.ua")

LIES: Final = (-2, -5, -1000, -(2**31), 2**31 - 1, 10**8, 70_000, 3_000)
"""Lengths that no array or text has."""
_BUILTIN: Final = tuple(ua.VariantType)
_KNOWN: Final = tuple(
    sorted(
        ((key.Identifier, cls) for key, cls in ua.extension_objects_by_typeid.items()), key=lambda pair: str(pair[0])
    )
)


def length(value: int) -> bytes:
    """An Int32."""
    return struct.pack("<i", value)


class BombMaker:
    """Writes bombs.

    Args:
        seed: of all that is chosen.
        most_elements: of an array that is really there, e.g. of a Variant's 60,000 empty DataValues.
    """

    def __init__(self, seed: int, most_elements: int = 60_000) -> None:
        self.random = random.Random(seed)
        self._most_elements = most_elements
        self._deepest = 6

    def parameters(self, structure: Any) -> bytes:
        """The parameters of a request."""
        self._deepest = self.random.choice((3, 6, 6, 12))
        return self._structure(structure, 0)

    def _count(self, honest: int) -> bytes:
        return length(self.random.choice(LIES) if self.random.random() < 0.04 else honest)

    def value(self, kind: Any, depth: int = 0) -> bytes:
        """A value of a type of asyncua's."""
        name = getattr(kind, "__name__", str(kind))
        if name in _FIXED:
            return self.random.randbytes(_FIXED[name])
        if name in ("String", "ByteString", "CharArray", "Bytes", "XmlElement"):
            return self._text()
        writer = {"Variant": self._variant, "ExtensionObject": self._extension_object}.get(name)
        if writer is not None:
            return writer(depth)
        if name in ("NodeId", "ExpandedNodeId"):
            return self._node_id()
        if issubclass(kind, ua.UaUnion) or not hasattr(kind, "__dataclass_fields__"):
            return self.random.randbytes(4) if self.random.random() < 0.2 else length(self.random.randrange(4))
        return self._structure(kind, depth)

    def _text(self) -> bytes:
        chosen = self.random.random()
        if chosen < 0.3:
            return b"\xff\xff\xff\xff"
        if chosen < 0.05 + 0.3:
            return length(self.random.choice(LIES))
        content = self.random.choice((b"", b"x", b"urn:x", b"\xff\xfe", "\u00e4\U0001f600".encode()))
        return length(len(content)) + content

    def _node_id(self) -> bytes:
        kind = self.random.choice((0, 0, 1, 2, 3, 4, 5, 6, 0x80, 0xC3, 63))
        body = {0: 1, 1: 3, 2: 6, 4: 18}.get(kind & 0x3F)
        data = bytes((kind,)) + (self.random.randbytes(body) if body else b"\0\0" + self._text())
        return data + (self._text() if kind & 0x80 else b"") + (b"\0\0\0\0" if kind & 0x40 else b"")

    def _variant(self, depth: int) -> bytes:
        kind = self.random.choice(_BUILTIN)
        if self.random.random() < 0.4:
            return bytes((kind.value,)) + self._builtin(kind, depth + 1)
        dimensions = self.random.random() < 0.3
        mask = kind.value | 0x80 | (0x40 if dimensions else 0)
        return (
            bytes((mask,))
            + self._array(lambda: self._builtin(kind, depth + 1))
            + (self._dimensions() if dimensions else b"")
        )

    def _array(self, element: Callable[[], bytes]) -> bytes:
        chosen = self.random.random()
        if chosen < 0.02:
            one, count = element(), self.random.randrange(1, self._most_elements)
            return self._count(count) + one * min(count, 2_000_000 // max(len(one), 1))
        count = 0 if chosen < 0.3 else self.random.randrange(4)
        return self._count(count) + b"".join([element() for _ in range(count)])

    def _dimensions(self) -> bytes:
        count = self.random.choice((1, 2, 2, 3, 33))
        lengths = [self.random.choice((0, 1, 1, 2, 3, 1000, 2**31 - 1, -1)) for _ in range(count)]
        return self._count(count) + b"".join(length(value) for value in lengths)

    def _builtin(self, kind: Any, depth: int) -> bytes:
        if depth > self._deepest:
            return b"\0"
        return b"" if kind.value == 0 else self.value(getattr(ua, kind.name, kind), depth)

    def _extension_object(self, depth: int) -> bytes:
        chosen = self.random.random()
        if chosen < 0.3 or depth > self._deepest:
            return b"\0\0\0"
        if chosen < 0.5:
            return self._node_id() + b"\1" + self._text()
        identifier, structure = self.random.choice(_KNOWN)
        body = self.value(structure, depth + 1)
        encoding = self.random.choice((1, 1, 1, 1, 1, 0, 2, 3))
        return (
            b"\1\0" + struct.pack("<H", int(identifier) & 0xFFFF) + bytes((encoding,)) + self._count(len(body)) + body
        )

    def _structure(self, kind: Any, depth: int) -> bytes:
        if depth > self._deepest:
            return b""
        try:
            parts = steps_of(kind)
        except (AttributeError, NameError, TypeError):  # asyncua cannot decode it either
            return self.random.randbytes(8)
        mask = self.random.randrange(256) if any(part.switch for part in parts) else 0
        written: list[bytes] = []
        for part in parts:
            if part.switch < 0:
                size = part.step.size or 1
                written.append(mask.to_bytes(size, "little"))
            elif part.switch == 0 or mask & part.switch:
                one = self._element(part.kind, depth + 1)
                written.append(self._array(one) if part.is_array else one())
        return b"".join(written)

    def _element(self, kind: Any, depth: int) -> Callable[[], bytes]:
        return lambda: self.value(kind, depth)


_FIXED: Final = {
    "Boolean": 1,
    "SByte": 1,
    "Byte": 1,
    "Char": 1,
    "Int16": 2,
    "UInt16": 2,
    "Int32": 4,
    "UInt32": 4,
    "Int64": 8,
    "UInt64": 8,
    "Float": 4,
    "Double": 8,
    "DateTime": 8,
    "Guid": 16,
    "StatusCode": 4,
}
