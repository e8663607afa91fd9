"""Changes reach the nodes and those who watch them."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from typing import Any

from tests.unit.nodes.model_server import children, fleet_built, ua
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.fleet import DataSetModel, FieldModel, SourceAdded, SourceQuarantined, SourceRemoved, ValueChanged
from ua_fleet.monitoring import Mistakes
from ua_fleet.nodes.projection import BATCH, MOST_EVENTS, MOST_IN_ORDER, Projection
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


async def test_what_is_put_ahead_waits_for_nothing_but_what_was_put_so_before() -> None:
    async with fleet_built() as (server, nodes):
        told: list[Any] = []

        async def note(_handle: int, data: Any, _error: Any = None) -> None:
            told.append(data.Value.Value)

        for number in (1001, 1002):
            server.iserver.aspace.add_datachange_callback(raw_id(number, 2), ua.AttributeIds.Value, note)
        projection = Projection(nodes)
        for value in range(2 * BATCH):
            projection.put(changed(float(value)))
        writing = asyncio.ensure_future(projection.write_waiting())
        while not told:
            await asyncio.sleep(0)
        already = len(told)
        for ahead in (-1.0, -2.0):
            projection.put_ahead(changed(ahead, key=NodeId(2, 1002)))
        await writing
        assert told[already : already + 2] == [-1.0, -2.0]
        assert len(told) == 2 * BATCH + 2
        assert not projection.waiting


async def test_what_is_put_ahead_is_bounded_and_ends_with_what_was_put_last() -> None:
    """E.g. by a bridge that tells a thousand statuses while the server is at something else."""
    async with fleet_built() as (server, nodes):
        told: list[tuple[int, Any]] = []

        def note(number: int) -> Any:
            async def tell(_handle: int, data: Any, _error: Any = None) -> None:
                told.append((number, data.Value.Value))

            return tell

        for number in (1001, 1002):
            server.iserver.aspace.add_datachange_callback(raw_id(number, 2), ua.AttributeIds.Value, note(number))
        projection = Projection(nodes)
        for value in range(100):
            projection.put_ahead(ValueChanged(SPEED, DOUBLE, float(value % 2), 0, None, False))
            projection.put_ahead(ValueChanged(NodeId(2, 1002), DOUBLE, float(value), 0, None, True))
        assert projection.waiting == 101
        await projection.write_waiting()
        assert [value for number, value in told if number == 1001] == [0.0, 1.0] * 50
        assert told[-1] == (1002, 99.0)
        for value in range(2 * MOST_IN_ORDER):
            projection.put_ahead(ValueChanged(SPEED, DOUBLE, float(value), 0, None, False))
        assert projection.waiting == MOST_IN_ORDER + 1
        assert projection.untold == MOST_IN_ORDER - 1
        await projection.write_waiting()
        assert told[-1] == (1001, float(2 * MOST_IN_ORDER - 1))


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


async def test_others_get_their_turn_after_the_nodes_of_each_source() -> None:
    async with fleet_built() as (_, nodes):
        projection = Projection(nodes)
        for number in range(20):
            field = FieldModel(NodeId(2, 700 + number), "x", DOUBLE)
            projection.put(SourceAdded(DataSetModel(Topic(5, 2, 700 + number), "/odom", (field,))))
        writing = asyncio.ensure_future(projection.write_waiting())
        turns = 0
        while not writing.done():
            turns += 1
            await asyncio.sleep(0)
        assert turns >= 20


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


BUSY = NodeId(2, 1002)


def state(value: bool) -> ValueChanged:
    return ValueChanged(BUSY, int(BuiltinType.BOOLEAN), value, 0, UNIX_EPOCH_TICKS, False)


def noted(server: Any, number: int) -> list[Any]:
    told: list[Any] = []

    async def note(_handle: int, data: Any, _error: Any = None) -> None:
        told.append(data.Value.Value)

    server.iserver.aspace.add_datachange_callback(raw_id(number, 2), ua.AttributeIds.Value, note)
    return told


async def test_a_flood_keeps_what_waits_small_and_counts_the_states_that_nobody_is_told() -> None:
    async with fleet_built() as (server, nodes):
        told = noted(server, 1002)
        projection = Projection(nodes)
        flood = 300_000
        for number in range(flood):
            projection.put(state(number % 2 == 0))
        projection.put(state(True))
        assert projection.waiting <= MOST_IN_ORDER
        await projection.write_waiting()
        assert told[-1] is True
        assert len(told) + projection.untold == flood + 1


async def test_of_an_analog_value_that_waits_the_latest_is_written_and_a_change_of_quality_is_not_skipped() -> None:
    async with fleet_built() as (server, nodes):
        told = noted(server, 1001)
        projection = Projection(nodes)
        for value in (0.1, 0.2, 0.3):
            projection.put(changed(value)._replace(can_wait=True))
        projection.put(changed(0.3, status=int(StatusCode.BAD_NO_COMMUNICATION)))
        for value in (0.4, 0.5):
            projection.put(changed(value)._replace(can_wait=True))
        await projection.write_waiting()
        assert told == [0.3, 0.3, 0.5]
        assert projection.untold == 0


async def test_an_event_is_told_between_the_values_before_and_after_it() -> None:
    async with fleet_built() as (server, nodes):
        told = noted(server, 1001)
        projection = Projection(nodes)

        async def event() -> None:
            told.append("event")

        projection.put(changed(0.1)._replace(can_wait=True))
        projection.tell(event)
        projection.put(changed(0.2)._replace(can_wait=True))
        await projection.write_waiting()
        assert told == [0.1, "event", 0.2]


async def test_events_are_bounded_and_counted() -> None:
    async with fleet_built() as (_, nodes):
        projection, told = Projection(nodes), 0

        async def event() -> None:
            nonlocal told
            told += 1

        for _ in range(MOST_EVENTS + 5):
            projection.tell(event)
        assert projection.untold == 5
        await projection.write_waiting()
        assert told == MOST_EVENTS
        projection.tell(event)
        await projection.write_waiting()
        assert (told, projection.untold) == (MOST_EVENTS + 1, 5)


async def test_a_source_that_changes_its_fields_all_the_time_waits_twice_at_most() -> None:
    async with fleet_built() as (server, nodes):
        projection = Projection(nodes)
        topic, key = Topic(2, 2, 700), NodeId(2, 700)
        kinds = [
            DataSetModel(topic, "flapping", (FieldModel(key, "data", kind),))
            for kind in (DOUBLE, int(BuiltinType.INT32))
        ]
        projection.put(SourceAdded(kinds[0]))
        await projection.write_waiting()
        for number in range(1000):
            projection.put(SourceRemoved(kinds[number % 2]))
            projection.put(SourceAdded(kinds[(number + 1) % 2]))
            projection.put(changed(1.0, key=key))
        assert projection.waiting < 20
        await projection.write_waiting()
        assert (await server.get_node("ns=2;i=700").read_value()) == 1.0
        projection.put(SourceRemoved(kinds[0]))
        projection.put(SourceAdded(kinds[1]))
        await projection.write_waiting()
        assert (await server.get_node("ns=2;i=700").read_data_type()).Identifier == BuiltinType.INT32


async def test_a_mistake_costs_one_change_and_one_watcher() -> None:
    async with fleet_built() as (server, nodes):
        mistakes = Mistakes()
        projection = Projection(nodes, mistakes=mistakes)

        async def broken(_handle: int, _data: Any, _error: Any = None) -> None:
            raise ValueError("a client's item")

        async def no_event() -> None:
            raise ValueError("an event")

        server.iserver.aspace.add_datachange_callback(raw_id(1001, 2), ua.AttributeIds.Value, broken)
        told = noted(server, 1001)
        taken = DataSetModel(Topic(9, 2, 1001), "taken", (FieldModel(SPEED, "data", DOUBLE),))
        projection.put(SourceAdded(taken))  # its id is another's
        projection.tell(no_event)
        projection.put(changed(0.1)._replace(source_timestamp="today"))  # type: ignore[arg-type]
        projection.put(changed(0.2))
        await projection.write_waiting()
        assert told == [0.2]
        assert mistakes.counts == {"projection": 2, "values": 1, "monitored items": 1}
        projection.put(SourceRemoved(taken))
        await projection.write_waiting()
        assert await server.get_node("ns=2;i=1001").read_value() == 0.2
