"""Which values of a message `fleet.yaml` can map by themselves. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from ua_bridges.ros.leaves import BUILTIN_TYPES, OCTETS
from ua_bridges.ros.schema import MessageSchema
from ua_fleet.config.base import ScalarType
from ua_fleet.config.topics_seen import FieldSeen

__all__ = ["ROS_TOPICS", "action_topics", "offered_fields"]

ROS_TOPICS: Final = frozenset({"/rosout", "/rosout_agg", "/parameter_events", "/clock"})
"""Topics of ROS itself, which are no robot's."""
_TIME: Final = "builtin_interfaces/Time"
_HEADER: Final = "std_msgs/Header"
_ACTION: Final = ("goal", "cancel", "status", "feedback", "result")


def offered_fields(schema: MessageSchema) -> tuple[FieldSeen, ...]:
    """The values of a message type, each in the type that loses nothing.

    Its own header is left out, whose stamp becomes the time of the values; arrays of messages have no single value.
    """
    if schema.name == _TIME and schema.members[0].attribute != "sec" and schema.ros == 1:
        return (FieldSeen(schema.members[0].attribute.partition(".")[0], ScalarType.DATETIME),)  # std_msgs/Time
    return tuple(_fields(schema, ""))


def _fields(schema: MessageSchema, prefix: str) -> Iterator[FieldSeen]:
    for member in schema.members:
        path = prefix + member.attribute
        if member.nested is not None:
            if member.array or (not prefix and member.nested.name == _HEADER):
                continue
            if member.nested.name == _TIME:
                yield FieldSeen(path, ScalarType.DATETIME)
            else:
                yield from _fields(member.nested, f"{path}.")
        elif member.array and member.type in OCTETS:
            yield FieldSeen(path, ScalarType.BYTE_STRING)
        elif member.type != "byte":
            yield FieldSeen(path, _BY_NAME[BUILTIN_TYPES[member.type]], member.array)


_BY_NAME: Final = {kind.builtin: kind for kind in ScalarType}


def action_topics(types: Iterable[tuple[str, str]]) -> dict[str, str]:
    """The topics by which actionlib talks, with the name of the action; `types` are topics with their types."""
    found: dict[str, str] = {}
    for topic, kind in types:
        action, _, last = topic.rpartition("/")
        if last == "status" and kind == "actionlib_msgs/GoalStatusArray":
            found.update({f"{action}/{part}": action for part in _ACTION})
    return found
