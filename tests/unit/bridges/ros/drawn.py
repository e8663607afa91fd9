"""Values of all fields of a message type, drawn at random, and bytes that are nearly a message."""

from __future__ import annotations

from random import Random
from typing import Any, Final

from ua_bridges.ros.leaves import Form, Leaf, leaves_of
from ua_bridges.ros.schema import Member, MessageSchema

from ua_fleet.values import BuiltinType

BITS: Final = {
    BuiltinType.SBYTE: (8, True),
    BuiltinType.BYTE: (8, False),
    BuiltinType.INT16: (16, True),
    BuiltinType.UINT16: (16, False),
    BuiltinType.INT32: (32, True),
    BuiltinType.UINT32: (32, False),
    BuiltinType.INT64: (64, True),
    BuiltinType.UINT64: (64, False),
}


def _scalar(leaf: Leaf, random: Random) -> Any:
    if leaf.member.limits is not None:
        return random.randint(*leaf.member.limits)
    kind = leaf.builtin
    if kind is BuiltinType.BOOLEAN:
        return random.random() < 0.5
    if kind is BuiltinType.STRING:
        return "".join(random.choice("abÄ€😀") for _ in range(random.randrange(6)))
    if kind is BuiltinType.FLOAT:
        return random.randrange(-1000, 1000) / 4
    if kind is BuiltinType.DOUBLE:
        return random.uniform(-1e6, 1e6)
    bits, signed = BITS[kind]
    least = -(1 << bits - 1) if signed else 0
    return random.randint(least, least + (1 << bits) - 1)


def _count(member: Member, random: Random) -> int:
    if member.length is not None:
        return member.length
    return random.randrange(min(5, (member.bound or 9) + 1))


def values_of(schema: MessageSchema, random: Random) -> tuple[Any, ...]:
    """Values of the flat fields."""
    drawn: list[Any] = []
    counts: dict[str, int] = {}
    for leaf in leaves_of(schema):
        if leaf.form is Form.SCALAR:
            drawn.append(_scalar(leaf, random))
        elif leaf.form is Form.OCTETS:
            drawn.append(random.randbytes(_count(leaf.member, random)))
        else:
            count = _count(leaf.array or leaf.member, random)
            count = counts.setdefault(leaf.path, count) if leaf.form is Form.COLUMN else count
            drawn.append(tuple(_scalar(leaf, random) for _ in range(count)))
    return tuple(drawn) or (True,)


def mutated(content: bytes, random: Random) -> bytes:
    """The bytes with some of them other ones, cut off, or more than they were."""
    changed = bytearray(content)
    for _ in range(random.randrange(1, 4)):
        at = random.randrange(len(changed) + 1)
        match random.randrange(4):
            case 0:
                del changed[at:]
            case 1:
                changed[at:at] = random.randbytes(random.randrange(8))
            case 2:
                changed[at : at + 4] = random.choice(
                    [b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x10", b"\0\0\0\0"]
                )
            case _:
                changed[at : at + 1] = random.randbytes(1)
    return bytes(changed)
