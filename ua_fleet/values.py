"""Values as they travel: built-in types, StatusCodes, quality and time (OPC 10000-6 section 5, OPC 10000-4 section 7).

A value is a plain Python object beside a *type code*. The type code of a value is the encoding byte of its
Variant (OPC 10000-6 5.2.2.16): bits 0 to 5 hold the built-in type, bit 7 says "array", bit 6 says "the array has
dimensions". So `0x0B` is a Double, `0x8B` an array of Double, `0xCB` a matrix of Double.

    Boolean                         bool
    SByte .. UInt64                 int
    Float, Double                   float
    String, XmlElement              str or None
    DateTime                        int, 100 ns ticks since 1601-01-01 UTC (lossless; see `datetime_from_ticks`)
    Guid                            uuid.UUID
    ByteString                      bytes or None
    NodeId                          NodeId
    ExpandedNodeId                  ExpandedNodeId
    StatusCode                      int, all 32 bits
    QualifiedName, LocalizedText    QualifiedName, LocalizedText
    ExtensionObject                 ExtensionObject
    DataValue, Variant              DataValue, Variant
    DiagnosticInfo                  DiagnosticInfo
    any of them as an array         tuple, or None for a null array
    any of them as a matrix         Matrix
"""

from __future__ import annotations

import math
import uuid
from datetime import UTC, datetime, timedelta
from enum import IntEnum
from typing import Any, Final, NamedTuple

__all__ = [
    "ARRAY",
    "DIMENSIONS",
    "TICKS_PER_SECOND",
    "UNIX_EPOCH_TICKS",
    "BuiltinType",
    "DataValue",
    "DiagnosticInfo",
    "ExpandedNodeId",
    "ExtensionObject",
    "LocalizedText",
    "Matrix",
    "NodeId",
    "QualifiedName",
    "Quality",
    "StatusCode",
    "Variant",
    "datetime_from_ticks",
    "is_finite",
    "quality_of",
    "status_name",
    "ticks_from_datetime",
    "ticks_from_unix_ns",
    "unix_ns_from_ticks",
]

ARRAY: Final = 0x80
"""Bit of a type code: the value is an array."""
DIMENSIONS: Final = 0x40
"""Bit of a type code: the array carries its dimensions."""

TICKS_PER_SECOND: Final = 10_000_000
UNIX_EPOCH_TICKS: Final = 116_444_736_000_000_000
"""1970-01-01 in ticks of 100 ns since 1601-01-01 (OPC 10000-6 5.2.2.5)."""


class BuiltinType(IntEnum):
    """The built-in types of OPC UA (OPC 10000-6 table 1); the numbers are those on the wire."""

    NULL = 0
    BOOLEAN = 1
    SBYTE = 2
    BYTE = 3
    INT16 = 4
    UINT16 = 5
    INT32 = 6
    UINT32 = 7
    INT64 = 8
    UINT64 = 9
    FLOAT = 10
    DOUBLE = 11
    STRING = 12
    DATETIME = 13
    GUID = 14
    BYTE_STRING = 15
    XML_ELEMENT = 16
    NODE_ID = 17
    EXPANDED_NODE_ID = 18
    STATUS_CODE = 19
    QUALIFIED_NAME = 20
    LOCALIZED_TEXT = 21
    EXTENSION_OBJECT = 22
    DATA_VALUE = 23
    VARIANT = 24
    DIAGNOSTIC_INFO = 25


class StatusCode(IntEnum):
    """The StatusCodes that this project uses itself (OPC 10000-6 annex A); others travel as plain integers."""

    GOOD = 0x0000_0000
    UNCERTAIN = 0x4000_0000
    UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE = 0x408F_0000
    UNCERTAIN_LAST_USABLE_VALUE = 0x4090_0000
    UNCERTAIN_SUBSTITUTE_VALUE = 0x4091_0000
    UNCERTAIN_INITIAL_VALUE = 0x4092_0000
    UNCERTAIN_ENGINEERING_UNITS_EXCEEDED = 0x4094_0000
    BAD = 0x8000_0000
    BAD_UNEXPECTED_ERROR = 0x8001_0000
    BAD_INTERNAL_ERROR = 0x8002_0000
    BAD_RESOURCE_UNAVAILABLE = 0x8004_0000
    BAD_COMMUNICATION_ERROR = 0x8005_0000
    BAD_ENCODING_ERROR = 0x8006_0000
    BAD_ENCODING_LIMITS_EXCEEDED = 0x8008_0000
    BAD_DECODING_ERROR = 0x8007_0000
    BAD_TIMEOUT = 0x800A_0000
    BAD_SERVICE_UNSUPPORTED = 0x800B_0000
    BAD_TOO_MANY_OPERATIONS = 0x8010_0000
    BAD_SECURITY_CHECKS_FAILED = 0x8013_0000
    BAD_USER_ACCESS_DENIED = 0x801F_0000
    BAD_IDENTITY_TOKEN_REJECTED = 0x8021_0000
    BAD_INVALID_TIMESTAMP = 0x8023_0000
    BAD_SESSION_ID_INVALID = 0x8025_0000
    BAD_SUBSCRIPTION_ID_INVALID = 0x8028_0000
    BAD_REQUEST_CANCELLED_BY_CLIENT = 0x802C_0000
    BAD_NO_COMMUNICATION = 0x8031_0000
    BAD_WAITING_FOR_INITIAL_DATA = 0x8032_0000
    BAD_NODE_ID_INVALID = 0x8033_0000
    BAD_NODE_ID_UNKNOWN = 0x8034_0000
    BAD_OUT_OF_RANGE = 0x803C_0000
    BAD_NOT_SUPPORTED = 0x803D_0000
    BAD_NOT_FOUND = 0x803E_0000
    BAD_NOT_WRITABLE = 0x803B_0000
    BAD_NOT_READABLE = 0x803A_0000
    BAD_HISTORY_OPERATION_UNSUPPORTED = 0x8072_0000
    BAD_WRITE_NOT_SUPPORTED = 0x8073_0000
    BAD_TYPE_MISMATCH = 0x8074_0000
    BAD_CONFIGURATION_ERROR = 0x8089_0000
    BAD_NOT_CONNECTED = 0x808A_0000
    BAD_DEVICE_FAILURE = 0x808B_0000
    BAD_SENSOR_FAILURE = 0x808C_0000
    BAD_OUT_OF_SERVICE = 0x808D_0000
    BAD_INVALID_ARGUMENT = 0x80AB_0000
    BAD_INVALID_STATE = 0x80AF_0000
    BAD_MAX_CONNECTIONS_REACHED = 0x80B7_0000
    BAD_REQUEST_TOO_LARGE = 0x80B8_0000
    BAD_DATA_ENCODING_INVALID = 0x8038_0000
    BAD_CONDITION_ALREADY_ENABLED = 0x80CC_0000
    BAD_CONDITION_ALREADY_DISABLED = 0x8098_0000
    BAD_CONDITION_DISABLED = 0x8099_0000
    BAD_EVENT_ID_UNKNOWN = 0x809A_0000
    BAD_DIALOG_NOT_ACTIVE = 0x80CD_0000
    BAD_DIALOG_RESPONSE_INVALID = 0x80CE_0000
    BAD_CONDITION_BRANCH_ALREADY_ACKED = 0x80CF_0000
    BAD_CONDITION_BRANCH_ALREADY_CONFIRMED = 0x80D0_0000
    BAD_CONDITION_ALREADY_SHELVED = 0x80D1_0000
    BAD_CONDITION_NOT_SHELVED = 0x80D2_0000
    BAD_SHELVING_TIME_OUT_OF_RANGE = 0x80D3_0000
    BAD_REQUEST_NOT_ALLOWED = 0x80E4_0000
    BAD_SERVER_TOO_BUSY = 0x80EE_0000
    BAD_NOT_EXECUTABLE = 0x8111_0000


class Quality(IntEnum):
    """The severity of a StatusCode: its two highest bits (OPC 10000-4 7.39)."""

    GOOD = 0
    UNCERTAIN = 1
    BAD = 2


class Variant(NamedTuple):
    """A value with its type code."""

    type: int
    value: Any


class Matrix(NamedTuple):
    """A flat array with its dimensions, rows first."""

    values: tuple[Any, ...]
    dimensions: tuple[int, ...]


class NodeId(NamedTuple):
    """A NodeId; the identifier is an int, a str, a Guid or bytes."""

    namespace: int
    identifier: int | str | uuid.UUID | bytes


class ExpandedNodeId(NamedTuple):
    """A NodeId that may name its namespace by URI and its server by index."""

    node_id: NodeId
    namespace_uri: str | None = None
    server_index: int = 0


class QualifiedName(NamedTuple):
    """A name with its namespace index."""

    namespace: int
    name: str | None


class LocalizedText(NamedTuple):
    """A text with its locale."""

    text: str | None
    locale: str | None = None


class ExtensionObject(NamedTuple):
    """A structure whose body is not looked into: its encoding's NodeId and the raw bytes (or XML)."""

    type_id: NodeId
    body: bytes | str | None


class DiagnosticInfo(NamedTuple):
    """Diagnostics as in OPC 10000-6 5.2.2.12."""

    symbolic_id: int | None = None
    namespace_uri: int | None = None
    localized_text: int | None = None
    locale: int | None = None
    additional_info: str | None = None
    inner_status: int | None = None
    inner: DiagnosticInfo | None = None


class DataValue(NamedTuple):
    """A value with its status and times; times are ticks, picoseconds are units of 10 ps."""

    variant: Variant | None
    status: int = StatusCode.GOOD
    source_timestamp: int | None = None
    server_timestamp: int | None = None
    source_picoseconds: int | None = None
    server_picoseconds: int | None = None


_EPOCH = datetime(1601, 1, 1, tzinfo=UTC)
_NAMES = {code.value: "".join(part.capitalize() for part in code.name.split("_")) for code in StatusCode}


def status_name(status: int) -> str:
    """The name of a StatusCode as clients show it (`BadNoCommunication`), or its hexadecimal form."""
    return _NAMES.get(status & 0xFFFF_0000, f"0x{status:08X}")


_QUALITIES = (Quality(0), Quality(1), Quality(2), Quality(2))
"""By the severity, the two highest bits of a StatusCode."""


def quality_of(status: int) -> Quality:
    """The quality that a StatusCode stands for; the reserved severity 3 counts as Bad."""
    return _QUALITIES[status >> 30 & 3]


def ticks_from_unix_ns(unix_ns: int) -> int:
    """OPC UA ticks of a time in nanoseconds since 1970; what is finer than 100 ns is cut off."""
    return unix_ns // 100 + UNIX_EPOCH_TICKS


def unix_ns_from_ticks(ticks: int) -> int:
    """Nanoseconds since 1970 of a time in OPC UA ticks."""
    return (ticks - UNIX_EPOCH_TICKS) * 100


def ticks_from_datetime(moment: datetime) -> int:
    """OPC UA ticks of an aware datetime."""
    delta = moment - _EPOCH
    return (delta.days * 86_400 + delta.seconds) * TICKS_PER_SECOND + delta.microseconds * 10


def is_finite(number: float) -> bool:
    """Whether a number is one that a Double can hold: neither NaN nor infinite, nor an integer beyond its range."""
    try:
        return math.isfinite(number)
    except OverflowError:
        return False


def datetime_from_ticks(ticks: int) -> datetime:
    """The datetime (UTC) of OPC UA ticks, cut to microseconds and to the years that Python knows."""
    try:
        return _EPOCH + timedelta(microseconds=ticks // 10)
    except OverflowError:
        return datetime.max.replace(tzinfo=UTC) if ticks > 0 else datetime.min.replace(tzinfo=UTC)
