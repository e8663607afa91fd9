"""The list of the alarms that people have put aside costs nothing until somebody looks at it."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

from tests.unit.nodes.model_server import fleet_built, ua
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.nodes.alarm_nodes import AlarmNodes
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.projection import Projection
from ua_fleet.operation.alarms.condition import Condition, ConditionState
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind
from ua_fleet.values import NodeId

COUNT = 500
IDS = [f"a{number}" for number in range(COUNT)]
PUT_ASIDE = raw_id("Fleet.Alarms.PutAside", 2)


@asynccontextmanager
async def alarms_built() -> AsyncGenerator[tuple[Any, AlarmNodes, Projection]]:
    """A server with the folder of alarms."""
    async with fleet_built() as (server, fleet):
        parts = NodeFactory(server.iserver.aspace, 2)
        parts.values = fleet.values
        projection = Projection(fleet)
        nodes = AlarmNodes(parts, ServerEvents(server.iserver), projection)
        nodes.build()
        yield server, nodes, projection


def definition(alarm_id: str) -> AlarmDefinition:
    return AlarmDefinition(alarm_id, AlarmKind.OFF_NORMAL, NodeId(0, 2253), "a door", None)


async def listed(server: Any) -> Any:
    """What a client reads."""
    return await server.get_node(PUT_ASIDE).read_value()


async def test_alarms_that_were_put_aside_before_a_start_are_listed_without_a_list_for_each() -> None:
    async with alarms_built() as (server, nodes, projection):
        assert await listed(server) == []
        for alarm_id in IDS:
            nodes.add(Condition(definition(alarm_id), lambda: b"", ConditionState(enabled=False)))
        assert projection.waiting == 0
        assert await listed(server) == IDS


async def test_who_watches_the_list_is_told_once_of_all_that_has_changed_since() -> None:
    async with alarms_built() as (server, nodes, _):
        told: list[Any] = []

        async def note(_handle: int, data: Any, _error: Any = None) -> None:
            told.append(data.Value.Value)

        server.iserver.aspace.add_datachange_callback(PUT_ASIDE, ua.AttributeIds.Value, note)
        await nodes.tell()
        told.clear()  # what it is at the beginning
        state = ConditionState(enabled=False)
        for alarm_id in IDS:
            nodes.notify(definition(alarm_id), state)
        # It is read as it is, though the alarms' events wait for their turns.
        assert (await listed(server), told) == (IDS, [])
        await nodes.tell()
        await nodes.tell()
        assert told == [IDS]
        nodes.notify(definition(IDS[0]), replace(state, enabled=True))
        await nodes.tell()
        assert told == [IDS, IDS[1:]]
