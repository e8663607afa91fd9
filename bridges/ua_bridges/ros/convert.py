"""Compiled conversion of whole messages, by attribute access alone: the same for the classes of ROS 1 and ROS 2.

A reader trusts the types of a message that ROS itself has decoded; a writer trusts nothing and checks every value
before it touches the message, so that none is ever filled by half.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.leaves import EMPTY_FIELD, Form, Leaf, leaves_of
from ua_bridges.ros.ragged import ragged_reader, ragged_writer
from ua_bridges.ros.scalars import (
    Convert,
    array_writer,
    check_length,
    integer,
    is_array,
    octets_reader,
    octets_writer,
    scalar_writer,
)
from ua_bridges.ros.schema import Member, MessageSchema

__all__ = ["Assign", "Make", "Reader", "Writer", "compile_reader", "compile_writer", "setter"]

Reader = Callable[[Any], tuple[Any, ...]]
Writer = Callable[[Any, Sequence[Any]], None]
Make = Callable[[str], Any]
"""Gives an empty message of a type, by its name in its own ROS (also `time` and `duration` in ROS 1)."""
Assign = Callable[[Any, Any], None]

_FAILURES = (AttributeError, TypeError, ValueError, OverflowError)


def _array_reader(member: Member) -> Convert:
    def read(value: Any) -> tuple[Any, ...]:
        values = tuple(value.tolist() if hasattr(value, "tolist") else value)  # numpy's numbers are not Python's
        if member.length is not None:
            check_length(len(values), member)
        return values

    return read


def _scalar_reader(member: Member, schema: MessageSchema) -> Convert | None:
    """The conversion of one value, None where the value is taken as it is."""
    if member.limits is not None:
        return integer(*member.limits)
    if member.type != "byte":
        return None
    return (lambda value: value & 0xFF) if schema.ros == 1 else (lambda value: value[0])


def _column_reader(leaf: Leaf, schema: MessageSchema) -> Convert:
    get, convert = attrgetter(leaf.column_path), _scalar_reader(leaf.member, schema)
    assert leaf.array is not None
    array = leaf.array

    def read(messages: Any) -> tuple[Any, ...]:
        check_length(len(messages), array)
        values = map(get, messages)
        return tuple(values) if convert is None else tuple(map(convert, values))

    return read


def _leaf_reader(leaf: Leaf, schema: MessageSchema) -> Convert | None:
    if leaf.form is Form.SCALAR:
        return _scalar_reader(leaf.member, schema)
    if leaf.form is Form.ARRAY:
        return _array_reader(leaf.member)
    if leaf.form is Form.OCTETS:
        return octets_reader(leaf.member, schema.ros)
    return _column_reader(leaf, schema) if leaf.form is Form.COLUMN else ragged_reader(leaf.member)


def compile_reader(schema: MessageSchema) -> Reader:
    """A function from a message object to the values of its flat fields, in the order of `fields_of`.

    The function raises ConversionError, which names the field.
    """
    leaves = leaves_of(schema)
    if not leaves:
        return lambda _message: (True,)
    get = attrgetter(*(leaf.path for leaf in leaves))
    converts = [(index, convert) for index, leaf in enumerate(leaves) if (convert := _leaf_reader(leaf, schema))]

    def culprit(message: Any, error: Exception) -> ConversionError:
        """The error with the field's name. Only here is each leaf looked at alone."""
        for leaf in leaves:
            convert = _leaf_reader(leaf, schema)
            try:
                value = attrgetter(leaf.path)(message)
                _ = convert(value) if convert else value
            except _FAILURES as failure:
                return ConversionError(leaf.name, str(failure))
        return ConversionError(leaves[0].name, str(error))

    if len(leaves) == 1:
        only = converts[0][1] if converts else None

        def read_one(message: Any) -> tuple[Any, ...]:
            try:
                return (get(message),) if only is None else (only(get(message)),)
            except _FAILURES as error:
                raise culprit(message, error) from error

        return read_one

    def read(message: Any) -> tuple[Any, ...]:
        try:
            raw: tuple[Any, ...] = get(message)
            if not converts:
                return raw
            values = list(raw)
            for index, convert in converts:
                values[index] = convert(values[index])
        except _FAILURES as error:
            raise culprit(message, error) from error
        return tuple(values)

    return read


def setter(path: str) -> Assign:
    """A function that sets a dotted attribute of a message."""
    parent, _, name = path.rpartition(".")
    if not parent:
        return lambda message, value: setattr(message, name, value)
    get = attrgetter(parent)
    return lambda message, value: setattr(get(message), name, value)


def _leaf_writer(leaf: Leaf, schema: MessageSchema, make: Make) -> Convert:
    if leaf.form is Form.SCALAR:
        return scalar_writer(leaf.member, schema.ros)
    if leaf.form is Form.ARRAY:
        return array_writer(leaf.member, schema.ros, leaf.name)
    if leaf.form is Form.OCTETS:
        return octets_writer(leaf.member, schema.ros)
    return ragged_writer(leaf.member, leaf.name, make)


def _columns_writer(leaves: Sequence[Leaf], schema: MessageSchema, make: Make) -> Callable[[Sequence[Any]], list[Any]]:
    """Makes the messages of an array from one array for each of their scalars."""
    array = leaves[0].array
    assert array is not None
    assert array.nested is not None
    native = array.nested.native
    columns = [(leaf.name, scalar_writer(leaf.member, schema.ros), setter(leaf.column_path)) for leaf in leaves]

    def write(values: Sequence[Any]) -> list[Any]:
        converted: list[list[Any]] = []
        for (name, convert, _), column in zip(columns, values, strict=True):
            column = () if column is None else column
            if not is_array(column):
                raise ConversionError(name, f"a {type(column).__name__} is not an array")
            elements: list[Any] = []
            for index, value in enumerate(column):
                try:
                    elements.append(convert(value))
                except _FAILURES as error:
                    raise ConversionError(f"{name}[{index}]", str(error)) from error
            if converted and len(elements) != len(converted[0]):
                raise ConversionError(name, f"{len(elements)} elements, but {columns[0][0]} has {len(converted[0])}")
            converted.append(elements)
        try:
            check_length(len(converted[0]), array)
        except ValueError as error:
            raise ConversionError(columns[0][0], str(error)) from error
        messages = [make(native) for _ in converted[0]]
        for (_, _, assign), elements in zip(columns, converted, strict=True):
            for message, value in zip(messages, elements, strict=True):
                assign(message, value)
        return messages

    return write


def compile_writer(schema: MessageSchema, names: Sequence[str], make: Make, *, partial: bool = False) -> Writer:
    """A function that fills a message object from values, all of them or, when one does not fit, none.

    Args:
        schema: the type of the message objects.
        names: the flat field of each value, in their order.
        make: gives empty messages of the types that stand in arrays.
        partial: whether fields of the type may be missing in `names`; they keep what the message has there.

    The function raises ConversionError, which names the field.

    Raises:
        ConversionError: a name that the type does not have, or (unless `partial`) one of the type that is missing.
    """
    leaves = {leaf.name: leaf for leaf in leaves_of(schema)}
    known = set(leaves) or {EMPTY_FIELD}
    for name in names:
        if name not in known:
            raise ConversionError(name, f"{schema.name} has no such field here")
    if not partial and (missing := [name for name in known if name not in names]):
        raise ConversionError(missing[0], f"{schema.name} has this field here, the source has not")
    singles: list[tuple[int, str, Convert, Assign]] = []
    groups: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        leaf = leaves.get(name)
        if leaf is None:
            continue
        if leaf.form is Form.COLUMN:
            groups.setdefault(leaf.path, []).append(index)
        else:
            singles.append((index, name, _leaf_writer(leaf, schema, make), setter(leaf.path)))
    tables = [
        (indices, _columns_writer([leaves[names[i]] for i in indices], schema, make), setter(path))
        for path, indices in groups.items()
    ]
    count = len(names)

    def write(message: Any, values: Sequence[Any]) -> None:
        if len(values) != count:
            raise ConversionError("*", f"{len(values)} values for {count} fields")
        converted: list[tuple[Assign, Any]] = []
        for index, name, convert, assign in singles:
            try:
                converted.append((assign, convert(values[index])))
            except _FAILURES as error:
                raise ConversionError(name, str(error)) from error
        for indices, convert_columns, assign in tables:
            converted.append((assign, convert_columns([values[index] for index in indices])))
        for assign, value in converted:
            assign(message, value)

    return write
