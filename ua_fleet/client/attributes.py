# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""All attributes of a node, as it has them (OPC 10000-3 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from asyncua import Client, ua

from ua_fleet.client.convert import exact_value

__all__ = ["NodeAttribute", "read_attributes"]

_NAMES: Final = tuple(one for one in ua.AttributeIds if one is not ua.AttributeIds.Value)


@dataclass(frozen=True, slots=True)
class NodeAttribute:
    """An attribute of a node."""

    name: str
    value: Any
    status: int


async def read_attributes(client: Client, node: ua.NodeId) -> list[NodeAttribute]:
    """The attributes that a node has, but its value; none of a node that there is not. Raises asyncua's errors."""
    wanted = ua.ReadParameters()
    wanted.NodesToRead = [ua.ReadValueId(NodeId=node, AttributeId=one) for one in _NAMES]
    wanted.TimestampsToReturn = ua.TimestampsToReturn.Neither
    found: list[NodeAttribute] = []
    for one, data in zip(_NAMES, await client.uaclient.read(wanted), strict=True):
        status = 0 if data.StatusCode is None else int(data.StatusCode.value)
        if status in (ua.StatusCodes.BadAttributeIdInvalid, ua.StatusCodes.BadNodeIdUnknown):
            continue
        value = exact_value(None if data.Value is None else data.Value.Value)
        if one is ua.AttributeIds.NodeClass and value is not None:
            value = ua.NodeClass(value).name
        found.append(NodeAttribute(one.name, value, status))
    return found
