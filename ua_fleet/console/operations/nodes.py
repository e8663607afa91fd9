"""The address space: browse, read, write, the past of numbers.

A picture is read whole when it is looked at, and not by a feed.
"""

from __future__ import annotations

from datetime import UTC, timedelta
from typing import Annotated, Any, Final

from pydantic import Field

from ua_fleet.client import FleetClient
from ua_fleet.console.operations.kinds import Bytes, OperationKind, OperationParameters
from ua_fleet.console.pictures import MOST_BYTES, picture_type
from ua_fleet.console.shown import harmless_value, shown_reading, shown_time, shown_value

__all__ = ["NODE_OPERATIONS"]


_CURRENT_TIME: Final = "i=2258"
_MS: Final = timedelta(milliseconds=1)
Address = Annotated[str, Field(min_length=1, max_length=4096)]


class OfNode(OperationParameters):
    """A node by its NodeId, e.g. `ns=2;i=1001`, or by its path."""

    node: Address


class RawFields(OperationParameters):
    """The fields of a `sensor_msgs/Image` that say how its bytes are to be read, as nodes."""

    encoding: Address
    width: Address
    height: Address
    step: Address
    is_bigendian: Address | None = None


class OfPicture(OfNode):
    """A ByteString, and `raw` where it has the points of a picture as they are."""

    raw: RawFields | None = None


class OfTrends(OperationParameters):
    """Numbers, and how much of their past is wanted in how many points."""

    nodes: list[Address] = Field(min_length=1, max_length=250)
    span_s: float = Field(gt=0, le=86_400)
    points: int = Field(ge=2, le=500)


class Written(OfNode):
    """The value as a text, in the node's own type; arrays as JSON."""

    value: str = Field(max_length=500_000)


async def _browse(client: FleetClient, asked: OfNode) -> list[dict[str, Any]]:
    return [
        {
            "node": one.node_id,
            "name": harmless_value(one.browse_name),
            "display": harmless_value(one.display_name),
            "class": one.node_class,
            "type": one.type_name,
            "property": one.is_property,
            "below": one.left_out,
        }
        for one in await client.browse(asked.node)
    ]


async def _read(client: FleetClient, asked: OfNode) -> dict[str, Any]:
    reading = await client.read(asked.node)
    (details,) = await client.details([reading.node_id])
    return {
        "node": reading.node_id,
        "type": reading.type_name,
        "value": shown_reading(reading, details.unit),
        "names": {str(number): harmless_value(name) for number, name in details.names.items()},
    }


async def _picture(client: FleetClient, asked: OfPicture) -> Bytes:
    """The picture that a ByteString is; `type` is null where it is none, and nothing follows one that is too large."""
    fields: dict[str, str] = asked.raw.model_dump(exclude_none=True) if asked.raw else {}
    # In one request: what a camera tells next does not come between.
    picture, *others = await client.read([asked.node, *fields.values()])
    content = picture.exact if isinstance(picture.exact, bytes) else b""
    worst = max((picture, *others), key=lambda reading: reading.status >> 30)
    head = {"bytes": len(content), "s": worst.status, "t": shown_time(picture.source_time)}
    told = {name: shown_value(reading.exact) for name, reading in zip(fields, others, strict=True)}
    kind = "raw" if fields else picture_type(content)
    return Bytes({**head, **told, "type": kind}, content if kind and len(content) <= MOST_BYTES else b"")


async def _trends(client: FleetClient, asked: OfTrends) -> dict[str, Any]:
    """The server's time, and lines of those that have a history: times in ms before it, and numbers from then on."""
    now = (await client.read(_CURRENT_TIME)).exact
    now = now if now.tzinfo is not None else now.replace(tzinfo=UTC)
    # What has come since the server renewed its time is wanted too.
    since, until = now - timedelta(seconds=asked.span_s), now + timedelta(seconds=2)
    found = await client.trends(asked.nodes, since, until, asked.points)
    lines = {
        node: {
            "back": [round((now - at) / _MS) for at in trend.times],
            "values": list(trend.values),
            "average": trend.is_average,
        }
        for node, trend in found.items()
    }
    return {"now": shown_time(now), "lines": lines}


async def _write(client: FleetClient, asked: Written) -> dict[str, Any]:
    reading = await client.write(asked.node, asked.value)
    return {"node": reading.node_id, "type": reading.type_name, "value": shown_reading(reading)}


async def _attributes(client: FleetClient, asked: OfNode) -> list[dict[str, Any]]:
    return [
        {"name": one.name, "v": shown_value(one.value), "s": one.status} for one in await client.attributes(asked.node)
    ]


NODE_OPERATIONS: Final = (
    OperationKind("node.browse", OfNode, _browse, "Browse", "observer"),
    OperationKind("node.read", OfNode, _read, "Read", "observer"),
    OperationKind("node.picture", OfPicture, _picture, "Read", "observer"),
    OperationKind("node.trends", OfTrends, _trends, "HistoryRead", "observer"),
    OperationKind("node.attributes", OfNode, _attributes, "Read", "observer"),
    OperationKind("node.write", Written, _write, "Write of this node", "operator"),
)
