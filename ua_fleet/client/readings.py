# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Values of nodes with their qualities and times, as they are read and as subscriptions bring them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from asyncua import Node, ua
from asyncua.common.subscription import DataChangeNotif

from ua_fleet.client.convert import exact_value, plain_value
from ua_fleet.client.structures import Structures
from ua_fleet.client.subscriptions import Feed

__all__ = ["Change", "Changes", "Reading", "monitored_item", "reading_of", "with_fields"]


@dataclass(frozen=True, slots=True)
class Reading:
    """A node's value with its quality and times."""

    node_id: str
    value: Any
    type_name: str | None
    status: int
    source_time: datetime | None
    server_time: datetime | None
    raw: Any = field(default=None, repr=False, compare=False)

    @property
    def exact(self) -> Any:
        """The value with nothing lost: bytes and times as such, NaN and infinity as floats."""
        return exact_value(self.raw)

    @property
    def status_text(self) -> str:
        """Name of the StatusCode, e.g. `Good` or `BadNoCommunication`."""
        return str(ua.StatusCode(ua.UInt32(self.status)).name)


Change = Reading
"""A value that a subscription reports."""


def reading_of(node_id: str, data: ua.DataValue) -> Reading:
    """What a server says of a node's value."""
    variant = data.Value
    return Reading(
        node_id=node_id,
        value=None if variant is None else plain_value(variant.Value),
        type_name=None if variant is None else variant.VariantType.name,
        status=0 if data.StatusCode is None else data.StatusCode.value,
        source_time=_aware(data.SourceTimestamp),
        server_time=_aware(data.ServerTimestamp),
        raw=None if variant is None else variant.Value,
    )


def _aware(moment: datetime | None) -> datetime | None:
    return moment if moment is None or moment.tzinfo is not None else moment.replace(tzinfo=UTC)


class Changes(Feed[Change]):
    """The subscription handler: hands each change to whoever iterates."""

    def datachange_notification(self, node: Node, val: Any, data: DataChangeNotif) -> None:
        """Called by asyncua with each change."""
        self.put(reading_of(node.nodeid.to_string(), data.monitored_item.Value))


async def with_fields(structures: Structures, reading: Reading) -> Reading:
    """A value with its structures, where it has some that asyncua does not know, as mappings of their fields."""
    value = reading.raw
    if not isinstance(value[0] if isinstance(value, list) and value else value, ua.ExtensionObject):
        return reading
    raw = await structures.shown(ua.NodeId.from_string(reading.node_id), value)
    return replace(reading, value=plain_value(raw), raw=raw)


def monitored_item(
    node_id: ua.NodeId, handle: int, with_times: bool, *, newest_only: bool = False
) -> ua.MonitoredItemCreateRequest:
    """Each write of a node's value is to be told; `with_times`: also where the SourceTimestamp alone is another.

    `newest_only`: of what is written between two publications nothing but the last.
    """
    item = ua.MonitoredItemCreateRequest()
    item.ItemToMonitor.NodeId = node_id
    item.ItemToMonitor.AttributeId = ua.AttributeIds.Value
    item.MonitoringMode = ua.MonitoringMode.Reporting
    asked = item.RequestedParameters
    asked.ClientHandle, asked.SamplingInterval = ua.IntegerId(handle), ua.Duration(0)
    asked.QueueSize, asked.DiscardOldest = ua.Counter(1 if newest_only else 1000), True
    if with_times:
        asked.Filter = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
    return item
