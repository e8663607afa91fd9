"""`sources` of `fleet.yaml`: publishers that are no bridges of the fleet, as the data of its robots."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ua_fleet.config.base import Model, Name, ScalarType
from ua_fleet.document import KeyPath
from ua_fleet.names import closest
from ua_fleet.wire.messages import PublisherIdType

__all__ = [
    "PublishedFieldConfig",
    "PublishedSourceConfig",
    "PublisherIdTypeName",
    "source_problems",
    "wire_publisher_id",
]

Problem = tuple[KeyPath, str, str]
_MOST: dict[str, int] = {"Byte": 0xFF, "UInt16": 0xFFFF, "UInt32": 0xFFFF_FFFF, "UInt64": 0xFFFF_FFFF_FFFF_FFFF}
_TYPES = {
    "Byte": PublisherIdType.BYTE,
    "UInt16": PublisherIdType.UINT16,
    "UInt32": PublisherIdType.UINT32,
    "UInt64": PublisherIdType.UINT64,
    "String": PublisherIdType.STRING,
}


PublisherIdTypeName = Literal["Byte", "UInt16", "UInt32", "UInt64", "String"]


def _type_name(publisher_id: int | str, type_name: str | None) -> str:
    return type_name or ("String" if isinstance(publisher_id, str) else "UInt16")


def wire_publisher_id(publisher_id: int | str, type_name: str | None) -> tuple[int, int | str]:
    """A PublisherId of `fleet.yaml` as messages have it: its type and value. Raises ValueError where they disagree."""
    kind = _type_name(publisher_id, type_name)
    if (kind == "String") is not isinstance(publisher_id, str):
        raise ValueError(f"publisher_id: {publisher_id!r} is no {kind}")
    if isinstance(publisher_id, int) and not 0 <= publisher_id <= _MOST[kind]:
        raise ValueError(f"publisher_id: a {kind} is 0 to {_MOST[kind]}")
    return int(_TYPES[kind]), publisher_id


class PublishedFieldConfig(Model, frozen=True):
    """One field of a DataSet that somebody else publishes."""

    type: ScalarType
    """Its built-in type."""
    array: bool = False
    """Whether it is an array of that type."""


class PublishedSourceConfig(Model, frozen=True):
    """One DataSetWriter that is no bridge's, and the data of a robot that it is."""

    publisher_id: int | Annotated[str, Field(min_length=1, max_length=1024)]
    """PublisherId of its messages."""
    publisher_id_type: PublisherIdTypeName | None = None
    """Type of the PublisherId. Left out: UInt16 for a number, String for a text."""
    writer_group_id: int | None = Field(default=None, ge=0, le=65535)
    """WriterGroupId of its messages; left out where they have none."""
    data_set_writer_id: int = Field(ge=1, le=65535)
    """DataSetWriterId of its messages."""
    robot: Name
    """The robot whose data it is."""
    data: Name
    """The data source of that robot, which has no `source` of its own."""
    fields: dict[Annotated[str, Field(min_length=1, max_length=128)], PublishedFieldConfig] = {}
    """The fields of the DataSet in the order of its messages, for a publisher that announces no metadata (open62541).
    The node's fields are found among them by name. Left out: as the publisher announces them."""

    @model_validator(mode="after")
    def _check(self) -> PublishedSourceConfig:
        wire_publisher_id(self.publisher_id, self.publisher_id_type)
        return self

    @property
    def type_name(self) -> str:
        """Type of the PublisherId."""
        return _type_name(self.publisher_id, self.publisher_id_type)

    @property
    def type_code(self) -> int:
        """Type of the PublisherId, as messages say it."""
        return int(_TYPES[self.type_name])


def source_problems(
    sources: Mapping[str, PublishedSourceConfig],
    data: Mapping[tuple[str, str], tuple[str, bool]],
    *,
    is_secured: bool,
) -> Iterator[Problem]:
    """What is wrong between the sources and the fleet.

    Args:
        sources: those that are valid by themselves.
        data: origin of each data source, by robot and name, and whether it is read from something else.
        is_secured: whether messages are signed.
    """
    robots = {robot for robot, _ in data}
    targets: dict[tuple[str, str], str] = {}
    writers: dict[tuple[object, ...], str] = {}
    for name, source in sources.items():
        path: KeyPath = ("sources", name)
        target = (source.robot, source.data)
        if source.robot not in robots:
            yield (*path, "robot"), f"there is no robot `{source.robot}` with data", closest(source.robot, robots)
        elif target not in data:
            known = [one for robot, one in data if robot == source.robot]
            yield (*path, "data"), f"`{source.robot}` has no data `{source.data}`", closest(source.data, known)
        elif data[target][0] != "robot":
            yield (*path, "data"), "it is data that clients write", "name data whose origin is the robot"
        elif data[target][1]:
            yield (*path, "data"), f"`{source.data}` has a `source` already", "remove one of the two"
        if (other := targets.setdefault(target, name)) != name:
            yield (*path, "data"), f"`{source.robot}.{source.data}` is that of `{other}` already", "remove one of them"
        writer = (source.type_code, source.publisher_id, source.writer_group_id, source.data_set_writer_id)
        if (other := writers.setdefault(writer, name)) != name:
            yield (*path, "data_set_writer_id"), f"it is the DataSetWriter of `{other}`", "remove one of them"
        if is_secured and source.type_name != "UInt16":
            text = f"messages are signed, and a PublisherId that is a {source.type_name} has no SecurityGroup"
            yield (*path, "publisher_id"), text, "give the publisher a UInt16, and its key in t-<PublisherId>"
