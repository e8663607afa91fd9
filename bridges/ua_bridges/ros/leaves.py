"""The leaves of a message type: each becomes one flat field."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import Final, NamedTuple

from ua_bridges.ros.errors import SchemaInvalid
from ua_bridges.ros.schema import Member, MessageSchema
from ua_fleet.values import BuiltinType

__all__ = ["BUILTIN_TYPES", "EMPTY_FIELD", "OCTETS", "Form", "Leaf", "leaves_of"]

BUILTIN_TYPES: Final = {
    "bool": BuiltinType.BOOLEAN,
    "byte": BuiltinType.BYTE,
    "char": BuiltinType.BYTE,
    "int8": BuiltinType.SBYTE,
    "uint8": BuiltinType.BYTE,
    "int16": BuiltinType.INT16,
    "uint16": BuiltinType.UINT16,
    "int32": BuiltinType.INT32,
    "uint32": BuiltinType.UINT32,
    "int64": BuiltinType.INT64,
    "uint64": BuiltinType.UINT64,
    "float32": BuiltinType.FLOAT,
    "float64": BuiltinType.DOUBLE,
    "string": BuiltinType.STRING,
    "wstring": BuiltinType.STRING,
}
OCTETS: Final = frozenset({"byte", "char", "uint8"})
"""Types whose arrays are one ByteString."""
EMPTY_FIELD: Final = "empty"
"""The field of a message without members: always true."""


class Form(Enum):
    """How a leaf of a message becomes a field."""

    SCALAR = "scalar"
    ARRAY = "array"
    OCTETS = "octets"
    """An array of bytes as one ByteString."""
    COLUMN = "column"
    """One member of all messages of an array, as an array."""
    RAGGED = "ragged"
    """An array of messages which are deeper than that: JSON in one String."""


class Leaf(NamedTuple):
    """One flat field of a message type."""

    name: str
    form: Form
    member: Member
    """The member whose value it is; of a COLUMN, the scalar within the array's messages."""
    path: str
    """Where the member (of a COLUMN: the array) stands in a message object."""
    array: Member | None = None
    """Of a COLUMN, the array of messages."""
    column_path: str = ""
    """Of a COLUMN, where the scalar stands in each message of the array."""

    @property
    def builtin(self) -> BuiltinType:
        """Built-in type of the field or of its elements."""
        if self.form is Form.OCTETS:
            return BuiltinType.BYTE_STRING
        return BuiltinType.STRING if self.form is Form.RAGGED else BUILTIN_TYPES[self.member.type]

    @property
    def is_array(self) -> bool:
        """Whether the field is an array on the wire."""
        return self.form in (Form.ARRAY, Form.COLUMN)


def _scalars(schema: MessageSchema, name: str, path: str) -> Iterator[tuple[str, str, Member]]:
    """Name, attribute path and member of every scalar; raises LookupError where an array stands."""
    for member in schema.members:
        if member.array:
            raise LookupError(member.name)
        if member.nested is None:
            yield name + member.name, path + member.attribute, member
        else:
            yield from _scalars(member.nested, f"{name}{member.name}.", f"{path}{member.attribute}.")


def _walk(schema: MessageSchema, name: str, path: str) -> Iterator[Leaf]:
    for member in schema.members:
        leaf_name, leaf_path = name + member.name, path + member.attribute
        if member.nested is None:
            form = Form.SCALAR
            if member.array:
                form = Form.OCTETS if member.type in OCTETS else Form.ARRAY
            yield Leaf(leaf_name, form, member, leaf_path)
        elif not member.array:
            yield from _walk(member.nested, f"{leaf_name}.", f"{leaf_path}.")
        else:
            try:
                columns = list(_scalars(member.nested, f"{leaf_name}.", ""))
            except LookupError:
                columns = []
            if not columns:
                yield Leaf(leaf_name, Form.RAGGED, member, leaf_path)
            for column, column_path, scalar in columns:
                yield Leaf(column, Form.COLUMN, scalar, leaf_path, member, column_path)


def leaves_of(schema: MessageSchema) -> tuple[Leaf, ...]:
    """The leaves of a message type in the order of its definition; none for an empty message."""
    leaves = tuple(_walk(schema, "", ""))
    if len({leaf.name for leaf in leaves}) < len(leaves):
        raise SchemaInvalid(schema.name, "two members have the same flat name")
    return leaves
