"""A bridge's own status as a DataSet, which the server shows as the bridge's object."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import islice
from typing import Any, Final

from ua_fleet.bridge.core import NODE_ONLY
from ua_fleet.bridge.driver import DriverStatus
from ua_fleet.config.schema import BridgeConfig, FleetConfig
from ua_fleet.counters import OF_BRIDGES, Counters
from ua_fleet.pubsub.group_figures import FIGURES_FIELD, GroupFigures, packed
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

__all__ = ["STATUS_FIELDS", "STATUS_INTERVAL_S", "aside_text", "status_topic", "status_values"]

STATUS_INTERVAL_S: Final = 1.0
_MOST_TOLD: Final = 3
"""Sources that the status names; the others it counts."""

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
    *(make_field(f"Drops.{drop.value}", _UINT64) for drop in OF_BRIDGES),
    make_field("LagP99", BuiltinType.DOUBLE),
    make_field("OldestWaiting", BuiltinType.DOUBLE),
    make_field(FIGURES_FIELD, BuiltinType.UINT32, array=True),
)
"""Fields of the status DataSet of every bridge."""


def status_topic(config: FleetConfig, bridge: BridgeConfig) -> Topic | None:
    """The topic of a bridge's status DataSet; None where `fleet.yaml` gives it no `status_id`."""
    if bridge.status_id is None:
        return None
    return Topic.checked(bridge.space, config.fleet.namespace_index, bridge.status_id)


def aside_text(aside: Mapping[str, str]) -> str:
    """The part of a status that tells which sources were put aside, and why; at least one was."""
    told = [f"{name} ({reason})" for name, reason in islice(aside.items(), _MOST_TOLD)]
    if (others := len(aside) - len(told)) > 0:
        told.append(f"{others} more")
    return f"put aside, and tried again later: {', '.join(told)}"


def status_values(
    name: str,
    kind: str,
    status: DriverStatus,
    counters: Counters,
    *,
    lag_p99_s: float = 0.0,
    oldest_s: float = 0.0,
    figures: Iterable[GroupFigures] = (),
) -> tuple[Any, ...]:
    """The values of STATUS_FIELDS now.

    Args:
        name: of the bridge.
        kind: of the bridge.
        status: its driver's.
        counters: its own.
        lag_p99_s: what 99 of 100 messages needed from the driver's callback to the wire.
        oldest_s: how long the message has waited that waits longest.
        figures: of its PubSubConnection and WriterGroups.
    """
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
        *(counters.drops[drop] for drop in OF_BRIDGES),
        round(lag_p99_s * 1000, 3),
        round(oldest_s * 1000, 3),
        packed(figures),
    )
