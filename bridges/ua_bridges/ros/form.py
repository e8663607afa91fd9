"""The message in which the data of another space is published: of the type that it came in, was given, or JSON. Pure.

What comes from ROS says its type. A single value has a type of std_msgs. Several values that came out of registers, a
socket or the mapped topic of another robot have no type; `ros_type` in `fleet.yaml` names one whose members have the
names of the fields, and without it they are a std_msgs/String with a JSON object.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, cast

from ua_bridges.ros.errors import SchemaInvalid
from ua_bridges.ros.fields import ros_type_of
from ua_bridges.ros.leaves import leaves_of
from ua_bridges.ros.schema import MessageSchema
from ua_fleet.bridge.configured import every_data_set
from ua_fleet.config.nodes import events_topic
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, LocalizedText, NodeId, datetime_from_ticks, unix_ns_from_ticks
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["Form", "form_of", "named_types", "with_stamp"]

JSON_TYPE: Final = "std_msgs/String"
STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")

Values = tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Form:
    """How a DataSet is published."""

    ros_type: str
    """`pkg/Name`."""
    definition: str | None
    """Of ROS 1, where it came along."""
    names: tuple[str, ...]
    """The flat field of the message that each value goes to."""
    is_whole: bool = True
    """Whether these are all that the type has; else the others stay zero."""
    convert: Callable[[Values], Values] = tuple
    """From the values of the DataSet."""

    def values(self, message: DataSetMessage) -> Values:
        """The values of `names`."""
        return self.convert(message.values)


@dataclass(frozen=True, slots=True)
class _Stamped(Form):
    """Also says when: the Header has the time of the DataSet."""

    def values(self, message: DataSetMessage) -> Values:
        nanoseconds = 0 if message.timestamp is None else unix_ns_from_ticks(message.timestamp)
        return (*self.convert(message.values), *divmod(nanoseconds, 1_000_000_000))


def named_types(config: FleetConfig) -> dict[Topic, str]:
    """The data of several fields that `fleet.yaml` has: the type that is named for it, or an empty text."""
    named = {topic: data.ros_type or "" for _, _, topic, data in every_data_set(config) if data.fields}
    if (events := events_topic(config)) is not None:
        named[events] = ""
    return named


def form_of(topic: Topic, metadata: DataSetMetaData, named: Mapping[Topic, str]) -> Form:
    """How a DataSet of another space is published.

    Args:
        topic: the DataSet.
        metadata: what it has.
        named: see `named_types`.

    Raises:
        SchemaInvalid: ROS has no type for it, and `fleet.yaml` does not know it.
    """
    names = tuple(field.name for field in metadata.fields)
    if wanted := named.get(topic):
        return Form(wanted.replace("/msg/", "/"), None, names, is_whole=False)
    found = ros_type_of(metadata.fields)
    if found is not None:
        return Form(*found)
    if topic not in named:
        raise SchemaInvalid(topic.name, "several fields without a ROS type, or a type that ROS does not have")
    kinds = [BuiltinType(field.builtin_type) for field in metadata.fields]
    return Form(JSON_TYPE, None, ("data",), convert=partial(_as_json, names, kinds))


def with_stamp(form: Form, schema: MessageSchema) -> Form:
    """The form, with the time of the DataSet in the type's Header where the fields leave it out."""
    if form.is_whole or not {leaf.name for leaf in leaves_of(schema)}.issuperset(STAMP):
        return form
    if any(name in STAMP for name in form.names):
        return form
    return _Stamped(form.ros_type, form.definition, (*form.names, *STAMP), is_whole=False, convert=form.convert)


def _as_json(names: Sequence[str], kinds: Sequence[BuiltinType], values: Values) -> Values:
    content = {name: _plain(kind, value) for name, kind, value in zip(names, kinds, values, strict=True)}
    return (json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False),)


def _plain(kind: BuiltinType, value: Any) -> Any:
    """A value as JSON has it; null for what it cannot say (NaN, infinity)."""
    if isinstance(value, LocalizedText):
        return value.text
    if isinstance(value, NodeId):
        return f"ns={value.namespace};{'i' if isinstance(value.identifier, int) else 's'}={value.identifier!s}"
    if isinstance(value, tuple | list):
        return [_plain(kind, item) for item in cast("Sequence[Any]", value)]
    if value is None:
        return None
    if kind is BuiltinType.BYTE_STRING:
        return base64.b64encode(value).decode("ascii")
    if kind is BuiltinType.DATETIME:
        return datetime_from_ticks(value).isoformat()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, bool | int | str) else str(value)
