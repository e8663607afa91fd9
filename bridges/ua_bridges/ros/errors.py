"""What can go wrong between ROS messages and flat fields."""

from __future__ import annotations

from ua_fleet.errors import UaFleetError
from ua_fleet.values import StatusCode

__all__ = ["ConversionError", "SchemaInvalid", "Unreadable"]


class SchemaInvalid(UaFleetError):
    """A message definition that cannot be understood, or that is too large; `ros_type` is the offender."""

    ua_status = StatusCode.BAD_NOT_SUPPORTED
    remedy = "Correct the definition of the message type; such messages are dropped and counted."

    def __init__(self, ros_type: str, reason: str) -> None:
        self.ros_type, self.reason = ros_type, reason
        super().__init__(f"message type {ros_type}: {reason}")


class ConversionError(UaFleetError):
    """A value does not fit its place on the other side. `field` is the flat field, with an index where there is one."""

    ua_status = StatusCode.BAD_TYPE_MISMATCH
    remedy = "Give the value a type in fleet.yaml that holds it (docs/ros.md); the field is Bad until then."

    def __init__(self, field: str, reason: str) -> None:
        self.field, self.reason = field, reason
        super().__init__(f"field {field}: {reason}")


class Unreadable(ConversionError):
    """Bytes that are no message of their type."""

    def __init__(self, ros_type: str, reason: str) -> None:
        super().__init__("*", f"its bytes are no {ros_type}: {reason}")
