"""What clients write: checked before, published as data of space 0 after."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from datetime import UTC
from typing import Any

from asyncua import ua

from ua_fleet.endpoint.convert import fleet_variant
from ua_fleet.endpoint.users import User
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.commands import Commands, Publication
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.values import NodeId, StatusCode, datetime_from_ticks, ticks_from_datetime

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
        record: Callable[[ValueChanged], None] = lambda _change: None,
    ) -> None:
        """Connect the write service with the data of space 0.

        Args:
            commands: the DataSets that clients may write.
            nodes: the nodes that show them.
            publish: sends a DataSet.
            flush_soon: sees to it that `commands.flush` is published.
            wall_ticks: the time.
            record: told of each value that was written.
        """
        self._record = record
        self._commands = commands
        self._nodes = nodes
        self._publish = publish
        self._flush_soon = flush_soon
        self._wall_ticks = wall_ticks

    def check_write(self, node_id: ua.NodeId, value: ua.DataValue, user: User) -> int:
        """StatusCode of a write before it happens; 0 lets it go on."""
        del user  # the write service has looked at the role, the AccessLevel and the status before
        key = _key(node_id)
        code = int(self._commands.check(key, *fleet_variant(value.Value)))
        if code:
            return code
        # A DataSet goes to the robots with Good values and a time of 100 ns: what else a client gives would be lost.
        status = int(value.StatusCode.value) if value.StatusCode is not None else 0
        finer = value.SourcePicoseconds or value.ServerPicoseconds
        if status or finer or value.ServerTimestamp is not None:
            return int(StatusCode.BAD_WRITE_NOT_SUPPORTED)
        return int(self._commands.check_time(key, _ticks(value), self._wall_ticks()))

    def written(self, node_id: ua.NodeId, value: ua.DataValue, user: User) -> None:
        """A client's write has been done: publish it, and give the node the time that it is published with."""
        del user
        key = _key(node_id)
        type_code, content = fleet_variant(value.Value)
        source_timestamp = _ticks(value)
        timestamp, before = self._commands.write(key, type_code, content, source_timestamp, self._wall_ticks())
        if before is not None:
            self._publish(before)
        self._record(ValueChanged(key, type_code, content, int(StatusCode.GOOD), timestamp, False))
        if source_timestamp != timestamp:
            time: Any = datetime_from_ticks(timestamp)
            self._nodes.values[key].value = dataclasses.replace(value, SourceTimestamp=time, SourcePicoseconds=None)

    def request_done(self) -> None:
        """All writes of a request have been done: the fields of a DataSet that it has written are published at once.

        Not before: a request that takes long is worked on in several turns.
        """
        self._flush_soon()


def _key(node_id: ua.NodeId) -> NodeId:
    identifier: Any = node_id.Identifier
    return NodeId(int(node_id.NamespaceIndex), identifier)


def _ticks(value: ua.DataValue) -> int | None:
    given: Any = value.SourceTimestamp
    if given is None:
        return None
    return ticks_from_datetime(given.replace(tzinfo=UTC) if given.tzinfo is None else given)
