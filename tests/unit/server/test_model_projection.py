"""Changes reach the nodes and those who watch them."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from typing import Any

from tests.unit.server.model_server import children, fleet_built, ua
from ua_fleet.fleet import DataSetModel, FieldModel, SourceAdded, SourceQuarantined, SourceRemoved, ValueChanged
from ua_fleet.server.convert import raw_id
from ua_fleet.server.projection import BATCH, Projection
from ua_fleet.topics import Topic
from ua_fleet.values import UNIX_EPOCH_TICKS, BuiltinType, NodeId, StatusCode

NOW = datetime(2026, 1, 2, tzinfo=UTC)
DOUBLE = int(BuiltinType.DOUBLE)
SPEED = NodeId(2, 1001)


def changed(value: Any, *, status: int = 0, key: NodeId = SPEED, ticks: int | None = UNIX_EPOCH_TICKS) -> ValueChanged:
    return ValueChanged(key, DOUBLE, value, status, ticks, False)


async def test_a_change_becomes_value_status_and_both_times() -> None:
    async with fleet_built() as (server, nodes):
        projection = Projection(nodes, lambda: NOW)
        projection.put(changed(0.5))
        await projection.write_waiting()
        data = await server.get_node("ns=2;i=1001").read_data_value()
        assert (data.Value.Value, data.Value.VariantType.name, data.StatusCode.name) == (0.5, "Double", "Good")
        assert data.SourceTimestamp == datetime(1970, 1, 1, tzinfo=UTC)
        assert data.ServerTimestamp == NOW


async def test_a_bad_node_keeps_its_last_value() -> None:
    async with fleet_built() as (server, nodes):
        projection = Projection(nodes)
        projection.put(changed(0.5, status=int(StatusCode.BAD_NO_COMMUNICATION)))
        await projection.write_waiting()
        data = await server.get_node("ns=2;i=1001").read_data_value(raise_on_bad_status=False)
        assert (data.Value.Value, data.StatusCode.name) == (0.5, "BadNoCommunication")


async def test_every_write_is_told_with_a_data_value_of_its_own() -> None:
    async with fleet_built() as (server, nodes):
        told: list[Any] = []

        async def note(_handle: int, data: Any, _error: Any = None) -> None:
            told.append(data)

        server.iserver.aspace.add_datachange_callback(raw_id(1001, 2), ua.AttributeIds.Value, note)
        projection = Projection(nodes)
        for value in (0.5, 0.5, 0.25):
            projection.put(changed(value))
        await projection.write_waiting()
        assert [data.Value.Value for data in told] == [0.5, 0.5, 0.25]
        assert len({id(data) for data in told}) == 3


async def test_a_watcher_may_leave_while_it_is_told() -> None:
    async with fleet_built() as (server, nodes):
        space = server.iserver.aspace

        async def leave(handle: int, _data: Any, _error: Any = None) -> None:
            space.delete_datachange_callback(handle)

        for _ in range(3):
            space.add_datachange_callback(raw_id(1001, 2), ua.AttributeIds.Value, leave)
        projection = Projection(nodes)
        projection.put(changed(0.5))
        await projection.write_waiting()
        assert not nodes.values[SPEED].datachange_callbacks


async def test_others_get_their_turn_after_each_batch() -> None:
    async with fleet_built() as (_, nodes):
        projection = Projection(nodes)
        for number in range(BATCH * 4):
            projection.put(changed(float(number)))
        writing = asyncio.ensure_future(projection.write_waiting())
        turns = 0
        while not writing.done():
            turns += 1
            await asyncio.sleep(0)
        assert turns >= 4


async def test_nodes_come_before_their_values_and_go() -> None:
    async with fleet_built() as (server, nodes):
        projection = Projection(nodes)
        topic = Topic(5, 2, 700)
        source = DataSetModel(topic, "/odom", (FieldModel(NodeId(2, 700), "x", DOUBLE),))
        projection.put(SourceAdded(source))
        projection.put(changed(1.0, key=NodeId(2, 700)))
        await projection.write_waiting()
        assert await server.get_node("ns=2;i=700").read_value() == 1.0
        projection.put(SourceRemoved(source))
        projection.put(changed(2.0, key=NodeId(2, 700)))
        projection.put(SourceQuarantined(topic, "/odom", "", "why"))
        await projection.write_waiting()
        assert await children(server, "ns=2;s=Fleet.Discovered.Sources.G00") == {}
        assert "2:ua_5_2_700" in await children(server, "ns=2;s=Fleet.Discovered.Quarantine.G00")
