"""asyncua's names, with types that fit what it takes, and its errors beside ours."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import struct
import uuid
from typing import Final

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.object_ids import ObjectIds
from asyncua.ua.status_codes import StatusCodes

from ua_fleet.errors import UaFleetError

__all__ = [
    "DECODE_ERRORS",
    "GOOD",
    "AttributeIds",
    "ObjectIds",
    "Refusal",
    "StatusCodes",
    "guid_id",
    "name_of",
    "ns0",
    "opaque_id",
    "shown",
    "status",
    "status_of",
]

DECODE_ERRORS: Final = (
    ua.UaError,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    RecursionError,
    MemoryError,
    struct.error,
)
"""What asyncua's codec raises for bytes that are no valid structure, and for values that it cannot encode."""


_SHOWN: Final = 200


class Refusal(UaFleetError):
    """A service, or one operation of it, is refused with this StatusCode; the reason is for the audit log."""

    remedy = "Correct the request of the client; the StatusCode says what is wrong with it (docs/services.md)."

    def __init__(self, code: int, reason: str = "") -> None:
        self.ua_status = int(code)
        super().__init__(reason or name_of(int(code)))


def status(code: int) -> ua.StatusCode:
    """A StatusCode in asyncua's form."""
    return ua.StatusCode(ua.UInt32(code))


GOOD: Final = status(0)


def name_of(code: int) -> str:
    """The name of a StatusCode, e.g. `BadNotWritable`."""
    return str(status(code).name)


def status_of(error: BaseException) -> int | None:
    """The StatusCode that an error on purpose stands for, or None for an error by mistake."""
    if isinstance(error, UaFleetError):
        return int(error.ua_status)
    if isinstance(error, ServiceError | ua.UaStatusCodeError):
        return int(error.code)
    return None


def shown(node_id: ua.NodeId) -> str:
    """A NodeId as text for a log; a client's NodeId may be megabytes long."""
    identifier = node_id.Identifier
    if isinstance(identifier, str | bytes) and len(identifier) > _SHOWN:
        return f"ns={node_id.NamespaceIndex};{identifier[:_SHOWN]!r}.."
    return str(node_id.to_string())


def ns0(identifier: int) -> ua.NodeId:
    """A node of the base namespace."""
    return ua.NodeId(ua.Int32(identifier), ua.Int16(0))


def guid_id(identifier: uuid.UUID, namespace: int = 0) -> ua.NodeId:
    """A NodeId with a Guid."""
    return ua.NodeId(ua.Guid(int=identifier.int), ua.Int16(namespace))


def opaque_id(identifier: bytes) -> ua.NodeId:
    """A NodeId of opaque bytes."""
    return ua.NodeId(ua.ByteString(identifier), ua.Int16(0), ua.NodeIdType.ByteString)
