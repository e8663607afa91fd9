"""The mapped topics of a fleet held against the message types that are installed here: `config check --ros`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Final, Literal

from ua_bridges.ros.errors import ConversionError, SchemaInvalid
from ua_bridges.ros.installed import Missing, look_up
from ua_bridges.ros.leaves import OCTETS, Leaf, leaves_of
from ua_bridges.ros.mapping import flat_path, steps_of
from ua_bridges.ros.schema import Member, MessageSchema
from ua_bridges.ros.sink import compile_sink
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_fleet.config.schema import DataSetConfig, FieldConfig, MachineFinding, RobotConfig, ScalarType
from ua_fleet.document import KeyPath
from ua_fleet.names import closest, listed

__all__ = ["message_type_findings", "source_problem"]

_TIMES: Final = ("builtin_interfaces/Time", "builtin_interfaces/Duration")
_TEXTS: Final = ("string", "wstring")
_SEQ: Final = Member("seq", "seq", "uint32")


def message_type_findings(
    robots: Mapping[str, RobotConfig], bridge: str, ros: Literal[1, 2]
) -> Iterator[tuple[KeyPath, MachineFinding]]:
    """What is wrong with the mapped topics of a bridge's robots, by the message types that are installed here.

    Args:
        robots: of the fleet.
        bridge: the bridge's name.
        ros: that it speaks.
    """
    for robot_name, robot in robots.items():
        if robot.bridge != bridge:
            continue
        for name, data in robot.data.items():
            for side, topic in (("source", data.source), ("sink", data.sink)):
                if not isinstance(topic, TopicMapping):
                    continue
                path: KeyPath = ("robots", robot_name, "data", name)
                found = look_up(topic.type, ros)
                if isinstance(found, Missing):
                    yield (*path, side, "type"), _missing(topic.type, found, ros)
                elif found is not None:
                    for field, finding in _field_findings(data, name, found, side):
                        yield (*path, *field), finding


def _missing(ros_type: str, missing: Missing, ros: Literal[1, 2]) -> MachineFinding:
    name = ros_type.replace("/msg/", "/")
    if not missing.types:
        text = f"messages of {missing.package} for ROS {ros} are not installed here: {name} was not looked at"
        return MachineFinding(text, "install the package here, or check where the bridge runs", is_doubt=True)
    hint = f"{closest(name, missing.types)} {missing.package} has: {listed(missing.types)}".strip()
    return MachineFinding(f"{missing.package} has no message type {name} in ROS {ros}", hint)


def _field_findings(
    data: DataSetConfig, name: str, schema: MessageSchema, side: str
) -> Iterator[tuple[KeyPath, MachineFinding]]:
    for field_name, field in data.all_fields().items():
        path = field.path or field_name or "data"
        where: KeyPath = ("fields", field_name) if field_name else ()
        where = (*where, "path") if field.path else where
        problem = source_problem(schema, path, field) if side == "source" else _sink_problem(schema, path)
        if problem is not None:
            yield where, MachineFinding(problem[0] if field_name else f"{name}: {problem[0]}", problem[1])


def _sink_problem(schema: MessageSchema, path: str) -> tuple[str, str] | None:
    try:
        compile_sink(schema, [(path, path)])
    except ConversionError as error:
        return f"{schema.name}: {error.reason}", _known(schema, path)
    return None


def source_problem(schema: MessageSchema, path: str, field: FieldConfig) -> tuple[str, str] | None:
    """Why a message of a type has no value for a field at this path, and what to do; None where it has."""
    steps = steps_of(path)
    try:
        leaves = leaves_of(schema)
    except SchemaInvalid:
        leaves = ()
    if (flat := flat_path(leaves, path)) is not None:
        leaf = leaves[flat[1][0]]
        if len(flat[1]) > 1:
            return None if field.type is ScalarType.DATETIME else (f"{path} is a time", "give `type: DateTime`")
        is_element = any(isinstance(step, int) for step in steps)
        if is_element and (too_far := _beyond(schema, leaf, steps)) is not None:
            return too_far
        is_array = leaf.is_array and not is_element
        is_octets = not is_element and leaf.member.type in OCTETS and leaf.member.array
        return _unfit(path, leaf.member.type, field, is_array=is_array, is_octets=is_octets)
    return _walk(schema, steps, path, field)


def _beyond(schema: MessageSchema, leaf: Leaf, steps: list[str | int]) -> tuple[str, str] | None:
    length = (leaf.array or leaf.member).length
    index = next(step for step in steps if isinstance(step, int))
    return None if length is None or index < length else (_has_only(schema, leaf.path, length), "")


def _has_only(schema: MessageSchema, path: str, length: int) -> str:
    return f"{schema.name}: {path} has {length} elements, the last is [{length - 1}]"


def _walk(schema: MessageSchema, steps: list[str | int], path: str, field: FieldConfig) -> tuple[str, str] | None:
    """Follow a path into a message object, as the bridge does where a value is no flat field."""
    around: MessageSchema | None = schema
    member: Member | None = None
    is_array, at = False, ""
    for step in steps:
        if isinstance(step, int):
            if member is None or not is_array:
                return f"{schema.name}: {at} is no array, so that it has no [{step}]", f"leave [{step}] out of the path"
            if member.length is not None and step >= member.length:
                return _has_only(schema, at, member.length), ""
            is_array, at = False, f"{at}[{step}]"
            continue
        if is_array:
            return f"{schema.name}: {at} is an array of messages", f"name one of them, such as {at}[0]"
        member, around = _member(around, step)
        if member is None:
            return f"{schema.name} has no field {at}.{step}" if at else f"{schema.name} has no field {step}", (
                _known(schema, path, around, at)
            )
        around, is_array, at = member.nested, member.array, f"{at}.{step}" if at else step
    assert member is not None, "a path has a step"
    if member.nested is not None:
        if member.nested.name in _TIMES and not is_array and field.type is ScalarType.DATETIME:
            return None
        names = (f"{at}.{one.attribute}" for one in member.nested.members)
        return f"{schema.name}: {at} is a message of type {member.nested.name}, not a value", f"it has: {listed(names)}"
    return _unfit(path, member.type, field, is_array=is_array, is_octets=is_array and member.type in OCTETS)


def _member(schema: MessageSchema | None, name: str) -> tuple[Member | None, MessageSchema | None]:
    """The member that a step names, and where it was looked for; the times of `std_msgs` stand a level deeper."""
    if schema is None:
        return None, None
    if name == "seq" and schema.seq_at is not None:
        return _SEQ, schema
    inner = [one for one in schema.members if one.attribute.startswith(f"{name}.")]
    if inner:
        parts = tuple(replace(one, attribute=one.attribute.partition(".")[2]) for one in inner)
        nested = MessageSchema("builtin_interfaces/Time", "time", schema.ros, parts)
        return Member(name, name, nested.name, nested), schema
    return next((one for one in schema.members if one.attribute == name), None), schema


def _unfit(path: str, kind: str, field: FieldConfig, *, is_array: bool, is_octets: bool) -> tuple[str, str] | None:
    """Why what stands there cannot be a field of its type."""
    wanted = field.type
    if is_octets and wanted is ScalarType.BYTE_STRING and not field.array:
        return None
    if (is_array or is_octets) and not field.array:
        return f"{path} is an array of {kind}", "add `array: true`" + (", or `type: ByteString`" if is_octets else "")
    if field.array and not (is_array or is_octets):
        return f"{path} is a single {kind}", "remove `array`"
    if (kind in _TEXTS) is not (wanted is ScalarType.STRING):
        return f"{path} is a {kind}, which no {wanted.value} is made of", f"give `type: {_TYPES[kind]}`"
    if wanted in (ScalarType.BYTE_STRING, ScalarType.DATETIME):
        return f"{path} is a {kind}, which no {wanted.value} is made of", f"give `type: {_TYPES[kind]}`"
    if wanted is ScalarType.BOOLEAN and kind.startswith("float"):
        return f"{path} is a {kind}, which no Boolean is made of", f"give `type: {_TYPES[kind]}`"
    return None


_TYPES: Final = {
    "bool": "Boolean",
    "byte": "Byte",
    "char": "Byte",
    "int8": "SByte",
    "uint8": "Byte",
    "int16": "Int16",
    "uint16": "UInt16",
    "int32": "Int32",
    "uint32": "UInt32",
    "int64": "Int64",
    "uint64": "UInt64",
    "float32": "Float",
    "float64": "Double",
    "string": "String",
    "wstring": "String",
}


def _known(schema: MessageSchema, path: str, inner: MessageSchema | None = None, at: str = "") -> str:
    """What was probably meant, and what there is: in the whole message, or in the one that stands `at` a place."""
    there = [f"{at}.{name}" if at else name for name in _paths(inner or schema)]
    return f"{closest(path, _paths(schema))} it has: {listed(there)}".strip()


def _paths(schema: MessageSchema) -> list[str]:
    """Where values stand in a message."""
    try:
        leaves = leaves_of(schema)
    except SchemaInvalid:
        return [member.attribute for member in schema.members]
    return [f"{leaf.path}.{leaf.column_path}" if leaf.column_path else leaf.path for leaf in leaves]
