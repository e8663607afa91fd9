"""Variants that are encoded as OPC 10000-6 wants it, and hold what programs do not expect."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

__all__ = ["odd_variants"]

_NULL: Final = struct.pack("<i", -1)


def _text(data: bytes) -> bytes:
    return struct.pack("<i", len(data)) + data


_TEXTS: Final = [_NULL, *map(_text, (b"", b"x", b"\0", "\uffff\u202e\U0010ffff".encode(), b"a" * 70_000))]
_WHOLE: Final = {2: "b", 3: "B", 4: "h", 5: "H", 6: "i", 7: "I", 8: "q", 9: "Q"}
_NODE_IDS: Final = [
    b"\0\0",
    b"\0\xff",
    b"\2\xff\xff" + b"\xff" * 4,
    b"\3\2\0" + _text(b""),
    b"\3\2\0" + _text(b"Robots"),
    b"\4\2\0" + bytes(16),
    b"\5\2\0" + _text(b"\xff\xfe"),
]
_NAN, _INFINITE = struct.pack("<d", float("nan")), struct.pack("<d", float("-inf"))


def _scalars() -> dict[int, list[bytes]]:
    """Values of each built-in type, by its number."""
    found: dict[int, list[bytes]] = {0: [b""], 1: [b"\0", b"\1", b"\xff"]}
    for kind, code in _WHOLE.items():
        bits = 8 * struct.calcsize(code)
        least, most = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if code.islower() else (0, 2**bits - 1)
        found[kind] = [struct.pack(f"<{code}", value) for value in (least, 0, most)]
    found[10] = [struct.pack("<f", value) for value in (float("nan"), float("inf"), -0.0, 1e-45)]
    found[11] = [_NAN, _INFINITE, *[struct.pack("<d", value) for value in (-0.0, 5e-324, 1e308)]]
    found[12] = found[15] = _TEXTS
    found[13] = [struct.pack("<q", value) for value in (-(2**63), -1, 0, 1, 2**62, 2**63 - 1)]
    found[14] = [bytes(16), b"\xff" * 16]
    found[16] = [_NULL, _text(b"<a>"), _text(b"")]
    found[17] = _NODE_IDS
    found[18] = [*_NODE_IDS, b"\x80\1" + _text(b"urn:x"), b"\x40\1" + b"\xff" * 4, b"\xc0\1" + _NULL + bytes(4)]
    found[19] = [struct.pack("<I", value) for value in (0, 1, 0x8000_0000, 0xFFFF_FFFF)]
    found[20] = [b"\0\0" + _NULL, b"\xff\xff" + _text(b"x"), b"\0\x80" + _text(b"")]
    found[21] = [b"\0", b"\1" + _text(b"xx-"), b"\3" + _NULL + _NULL, b"\2" + _text(b"\0")]
    argument = _text(b"a") + b"\0\1" + struct.pack("<ii", -9, 2) + b"\xff" * 8 + b"\0"
    known = b"\1\0" + struct.pack("<H", 298) + b"\1"
    found[22] = [b"\0\0\0", b"\0\1\1" + _text(b"x"), b"\1\2\xff\xff\1" + _text(b""), known + _text(argument)]
    found[23] = [b"\0", b"\1\0", b"\2\0\0\0\x80", b"\x3f\x0b" + _NAN + bytes(4) + b"\xff" * 8 + b"\xff\xff" + bytes(10)]
    found[25] = [b"\0", b"\1" + _NULL, b"\x3f" + bytes(24)]
    return found


def odd_variants() -> Iterator[tuple[str, bytes]]:
    """Names and bytes: scalars, empty and null arrays, arrays with dimensions that fit, and nested ones."""
    for kind, scalars in _scalars().items():
        yield from ((f"{kind} scalar {number}", bytes((kind,)) + scalar) for number, scalar in enumerate(scalars))
        if not kind:
            continue
        array, matrix = bytes((kind | 0x80,)), bytes((kind | 0xC0,))
        yield f"{kind} null array", array + _NULL
        yield f"{kind} empty array", array + struct.pack("<i", 0)
        yield f"{kind} array", array + struct.pack("<i", len(scalars)) + b"".join(scalars)
        yield f"{kind} 1 x 1 x 1", matrix + struct.pack("<i", 1) + scalars[0] + struct.pack("<iiii", 3, 1, 1, 1)
        yield f"{kind} 2 x 1", matrix + struct.pack("<i", 2) + scalars[0] * 2 + struct.pack("<iii", 2, 2, 1)
        yield f"{kind} 0 x 5", matrix + struct.pack("<i", 0) + struct.pack("<iii", 2, 0, 5)
    inner = b"\x0b" + _NAN
    nested = b"\x98" + struct.pack("<i", 1) + inner
    for _ in range(20):
        nested = b"\x98" + struct.pack("<i", 1) + nested
    yield "nested", nested
    yield "mixed", b"\x98" + struct.pack("<i", 3) + inner + b"\0" + b"\x0c" + _NULL
