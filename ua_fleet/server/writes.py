"""What clients write: checked before, published as data of space 0 after."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from ua_fleet.fleet.commands import Commands, Publication
from ua_fleet.server.address_space import FleetNodes
from ua_fleet.server.convert import fleet_variant
from ua_fleet.server.users import User
from ua_fleet.values import NodeId, datetime_from_ticks, ticks_from_datetime

__all__ = ["ClientWrites"]


class ClientWrites:
    """The gate that the write service asks; see `server.hardened.NodeGate`."""

    def __init__(
        self,
        commands: Commands,
        nodes: FleetNodes,
        publish: Callable[[Publication], None],
        flush_soon: Callable[[], None],
        wall_ticks: Callable[[], int],
    ) -> None:
        """Connect the write service with the data of space 0.

        Args:
            commands: the DataSets that clients may write.
            nodes: the nodes that show them.
            publish: sends a DataSet.
            flush_soon: sees to it that `commands.flush` is published when the current request is done.
            wall_ticks: the time.
        """
        self._commands = commands
        self._nodes = nodes
        self._publish = publish
        self._flush_soon = flush_soon
        self._wall_ticks = wall_ticks

    def check_write(self, node_id: ua.NodeId, value: ua.DataValue, user: User) -> int:
        """StatusCode of a write before it happens; 0 lets it go on."""
        del user  # the write service has looked at the role, the AccessLevel and the status before
        return int(self._commands.check(_key(node_id), *fleet_variant(value.Value)))

    def written(self, node_id: ua.NodeId, value: ua.DataValue, user: User) -> None:
        """A client's write has been done: publish it, and give the node the time that it is published with."""
        del user
        key = _key(node_id)
        type_code, content = fleet_variant(value.Value)
        given: Any = value.SourceTimestamp
        source_timestamp = None if given is None else ticks_from_datetime(_aware(given))
        timestamp, before = self._commands.write(key, type_code, content, source_timestamp, self._wall_ticks())
        if before is not None:
            self._publish(before)
        if source_timestamp != timestamp:
            time: Any = datetime_from_ticks(timestamp)
            self._nodes.values[key].value = dataclasses.replace(value, SourceTimestamp=time, SourcePicoseconds=None)
        self._flush_soon()


def _key(node_id: ua.NodeId) -> NodeId:
    identifier: Any = node_id.Identifier
    return NodeId(int(node_id.NamespaceIndex), identifier)


def _aware(moment: datetime) -> datetime:
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
