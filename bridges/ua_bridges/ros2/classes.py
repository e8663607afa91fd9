# pyright: basic, reportMissingImports=false
"""ROS 2 message types that are installed here: their classes and their schemas."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable
from functools import cache
from typing import Any, Final, Literal, NamedTuple

from ua_bridges.ros.errors import Unreadable
from ua_bridges.ros.schema import MessageSchema, schema_from_ros2
from ua_bridges.ros2.elements import Elements
from ua_fleet.errors import UaFleetError
from ua_fleet.values import StatusCode

__all__ = ["MessageType", "TypeMissing", "load_type", "load_usual_types"]

_USUAL_PACKAGES: Final = ("std_msgs", "geometry_msgs", "sensor_msgs", "nav_msgs")
_HEADER: Final = "std_msgs/Header"


class TypeMissing(UaFleetError):
    """A message type that is not installed here."""

    ua_status = StatusCode.BAD_NOT_SUPPORTED
    remedy = "Install the package of the message type in the environment of the bridge."

    def __init__(self, ros_type: str, folder: Literal["msg", "srv", "action"] = "msg") -> None:
        package, _, name = ros_type.replace(f"/{folder}/", "/").partition("/")
        kind = {"msg": "message", "srv": "service", "action": "action"}[folder]
        super().__init__(f"the {kind} type {package}/{folder}/{name} is not installed here; install {package}")


class MessageType(NamedTuple):
    """An installed type, a `MessageKind`. `cls` is typed as anything, since ROS has no types."""

    name: str
    """`pkg/Name`."""
    cls: Any
    schema: MessageSchema
    has_header: bool
    """Whether a Header named `header` stands at the top level."""

    @property
    def header(self) -> str | None:
        """See MessageKind."""
        return "header" if self.has_header else None

    @property
    def definition(self) -> None:
        """See MessageKind: messages of ROS 2 are read by their fields alone."""

    def message_reader(self) -> Callable[[bytes], Any]:
        """See MessageKind."""
        elements = Elements(self.schema)

        def read(content: bytes) -> Any:
            from rclpy.serialization import deserialize_message

            elements.check(content)
            try:
                return deserialize_message(content, self.cls)
            except (RuntimeError, MemoryError, ValueError) as error:  # rclpy's RMWError is a RuntimeError
                raise Unreadable(self.name, " ".join(str(error).split())) from error

        return read


def _find_class(ros_type: str) -> Any:
    package, _, name = ros_type.replace("/msg/", "/").partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise TypeMissing(ros_type) from None


@cache
def load_type(ros_type: str) -> MessageType:
    """An installed type by its name `pkg/Name` or `pkg/msg/Name`.

    Raises:
        TypeMissing: it is not installed.
        SchemaInvalid: it has no flat form.
    """
    cls = _find_class(ros_type)
    schema = schema_from_ros2(ros_type, lambda name: _find_class(name).get_fields_and_field_types())
    has_header = any(
        member.name == "header" and not member.array and member.nested is not None and member.nested.name == _HEADER
        for member in schema.members
    )
    return MessageType(ros_type.replace("/msg/", "/"), cls, schema, has_header)


def make(native: str) -> Any:
    """An empty message of an installed type."""
    return _find_class(native)()


def load_usual_types() -> None:
    """Load the packages that most robots use (0.2 s), so that their first message need not wait for them."""
    for package in _USUAL_PACKAGES:
        with contextlib.suppress(ImportError):
            importlib.import_module(f"{package}.msg")
