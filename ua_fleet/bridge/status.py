"""A bridge's own status as a DataSet, which the server shows as the bridge's object."""

from __future__ import annotations

from typing import Any, Final

from ua_fleet.bridge.core import NODE_ONLY
from ua_fleet.bridge.driver import DriverStatus
from ua_fleet.config.schema import BridgeConfig, FleetConfig
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

__all__ = ["STATUS_FIELDS", "STATUS_INTERVAL_S", "status_topic", "status_values"]

STATUS_INTERVAL_S: Final = 1.0

_UINT64: Final = BuiltinType.UINT64
STATUS_FIELDS: Final = (
    make_field("Name", BuiltinType.STRING, properties={NODE_ONLY: True}),
    make_field("Kind", BuiltinType.STRING),
    make_field("Connected", BuiltinType.BOOLEAN),
    make_field("Detail", BuiltinType.STRING),
    make_field("MessagesIn", _UINT64),
    make_field("MessagesOut", _UINT64),
    make_field("FromSpace", _UINT64),
    make_field("ToSpace", _UINT64),
    make_field("Gaps", _UINT64),
    make_field("Looped", _UINT64),
    *(make_field(f"Drops.{drop.value}", _UINT64) for drop in Drop),
)
"""Fields of the status DataSet of every bridge."""


def status_topic(config: FleetConfig, bridge: BridgeConfig) -> Topic | None:
    """The topic of a bridge's status DataSet; None where `fleet.yaml` gives it no `status_id`."""
    if bridge.status_id is None:
        return None
    return Topic.checked(bridge.space, config.fleet.namespace_index, bridge.status_id)


def status_values(name: str, kind: str, status: DriverStatus, counters: Counters) -> tuple[Any, ...]:
    """The values of STATUS_FIELDS now."""
    return (
        name,
        kind,
        status.connected,
        status.detail,
        counters.messages_in,
        counters.messages_out,
        counters.from_space,
        counters.to_space,
        counters.gaps,
        counters.looped,
        *(counters.drops[drop] for drop in Drop),
    )
