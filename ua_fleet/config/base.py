"""What all models of `fleet.yaml` share."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field

from ua_fleet.values import BuiltinType

__all__ = ["RANGED", "DataSetId", "FieldPath", "Model", "Name", "Port", "ScalarType"]

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
DataSetId = Annotated[int, Field(ge=1, le=65535)]
Port = Annotated[int, Field(ge=0, le=65535)]
FieldPath = Annotated[
    str,
    Field(
        pattern=r"^[A-Za-z][A-Za-z0-9_]*(\[[0-9]{1,6}\])*(\.[A-Za-z][A-Za-z0-9_]*(\[[0-9]{1,6}\])*)*$",
        examples=["twist.linear.x"],
    ),
]


class Model(BaseModel, frozen=True):
    """Base of all models of `fleet.yaml`: unknown keys are errors, and so are numbers that no float holds (`1e999`)."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


class ScalarType(StrEnum):
    """The types that a field may have in `fleet.yaml`: names of OPC UA built-in types."""

    BOOLEAN = "Boolean"
    SBYTE = "SByte"
    BYTE = "Byte"
    INT16 = "Int16"
    UINT16 = "UInt16"
    INT32 = "Int32"
    UINT32 = "UInt32"
    INT64 = "Int64"
    UINT64 = "UInt64"
    FLOAT = "Float"
    DOUBLE = "Double"
    STRING = "String"
    DATETIME = "DateTime"
    BYTE_STRING = "ByteString"

    @property
    def builtin(self) -> BuiltinType:
        """The built-in type with this name."""
        return BuiltinType[{"DateTime": "DATETIME", "ByteString": "BYTE_STRING"}.get(self.value, self.value.upper())]


RANGED: Final = tuple(
    one
    for one in ScalarType
    if one not in (ScalarType.BOOLEAN, ScalarType.STRING, ScalarType.DATETIME, ScalarType.BYTE_STRING)
)
"""The types whose values have a least and a greatest one."""
