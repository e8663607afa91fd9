"""Changes reach the nodes and those who watch them."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import pytest

from tests.unit.nodes.model_server import children, fleet_built, ua
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.fleet import DataSetModel, FieldModel, SourceAdded, SourceQuarantined, SourceRemoved, ValueChanged
from ua_fleet.monitoring import Mistakes
from ua_fleet.nodes import projection as projection_module
from ua_fleet.nodes.projection import BATCH, LARGEST_BATCH, MOST_WAITING, WATCHERS, Projection
from ua_fleet.topics import Topic
from ua_fleet.values import UNIX_EPOCH_TICKS, BuiltinType, NodeId, StatusCode

NOW = datetime(2026, 1, 2, tzinfo=UTC)
DOUBLE = int(BuiltinType.DOUBLE)
SPEED = NodeId(2, 1001)
BUSY = NodeId(2, 1002)
FIRST = 2001
"""Id of the first value of a robot with many."""


def changed(value: Any, *, status: int = 0, key: NodeId = SPEED, ticks: int | None = UNIX_EPOCH_TICKS) -> ValueChanged:
    return ValueChanged(key, DOUBLE, value, status, ticks, False)


def state(value: bool) -> ValueChanged:
    return ValueChanged(BUSY, int(BuiltinType.BOOLEAN), value, 0, UNIX_EPOCH_TICKS, False)


def noted(server: Any, number: int, told: list[Any] | None = None) -> list[Any]:
    """What a watcher of a node is told from now on."""
    noted: list[Any] = [] if told is None else told

    async def note(_handle: int, data: Any, _error: Any = None) -> None:
        noted.append(data.Value.Value)

    server.iserver.aspace.add_datachange_callback(raw_id(number, 2), ua.AttributeIds.Value, note)
    return noted


def many(count: int) -> Mapping[str, Any]:
    """Robots with so many values."""
    data = {f"v{number}": {"id": FIRST + number, "type": "Double"} for number in range(count)}
    return {"big": {"bridge": "mobile", "data": data}}


def valued(number: int, value: float, *, can_wait: bool = False) -> ValueChanged:
    return changed(value, key=NodeId(2, FIRST + number))._replace(can_wait=can_wait)


async def test_a_change_becomes_value_status_and_both_times() -> None:
    async with fleet_built() as (server, nodes):
        Projection(nodes, lambda: NOW).put(changed(0.5))
        data = await server.get_node("ns=2;i=1001").read_data_value()
        assert (data.Value.Value, data.Value.VariantType.name, data.StatusCode.name) == (0.5, "Double", "Good")
        assert data.SourceTimestamp == datetime(1970, 1, 1, tzinfo=UTC)
        assert data.ServerTimestamp == NOW


async def test_what_is_written_ahead_waits_for_nothing() -> None:
    count = 2 * BATCH
    async with fleet_built(many(count)) as (server, nodes):
        told: list[Any] = []
        for number in range(count):
            noted(server, FIRST + number, told)
        projection = Projection(nodes)
        for number in range(1, count):
            projection.write(valued(number, float(number)))
        already, waiting = len(told), projection.waiting
        assert waiting == count - 1 - already > 0
        for ahead in (-1.0, -2.0):
            projection.write_ahead(valued(0, ahead))
        assert told[already:] == [-1.0, -2.0]
        assert projection.waiting == waiting
        while projection.waiting:
            projection.poll(0.0)
        assert told[already + 2 :] == [float(number) for number in range(already + 1, count)]


async def test_what_is_written_ahead_is_told_in_order_and_never_waits() -> None:
    """E.g. by a bridge that tells a thousand statuses while the server is at something else."""
    async with fleet_built() as (server, nodes):
        speeds, states = noted(server, 1001), noted(server, 1002)
        projection = Projection(nodes)
        flood = 2 * LARGEST_BATCH
        for value in range(flood):
            projection.write_ahead(changed(float(value)))
            projection.write_ahead(state(value % 2 == 0))
        assert projection.waiting == 0
        assert speeds == [float(value) for value in range(flood)]
        assert states == [True, False] * (flood // 2)


async def test_a_bad_node_keeps_its_last_value() -> None:
    async with fleet_built() as (server, nodes):
        Projection(nodes).put(changed(0.5, status=int(StatusCode.BAD_NO_COMMUNICATION)))
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
        assert [data.Value.Value for data in told] == [0.5, 0.5, 0.25]
        assert len({id(data) for data in told}) == 3


async def test_a_watcher_may_leave_while_it_is_told() -> None:
    async with fleet_built() as (server, nodes):
        space = server.iserver.aspace

        async def leave(handle: int, _data: Any, _error: Any = None) -> None:
            space.delete_datachange_callback(handle)

        for _ in range(3):
            space.add_datachange_callback(raw_id(1001, 2), ua.AttributeIds.Value, leave)
        Projection(nodes).put(changed(0.5))
        assert not nodes.values[SPEED].datachange_callbacks


async def test_others_get_their_turn_after_each_batch() -> None:
    count = BATCH * 4
    async with fleet_built(many(count)) as (_, nodes):
        woken = 0

        def sooner() -> None:
            nonlocal woken
            woken += 1

        projection = Projection(nodes, sooner=sooner)
        for number in range(count):
            projection.write(valued(number, 1.0))
        assert (projection.waiting, woken) == (count - BATCH, 1)
        turns = 0
        while projection.next_deadline(5.0) is not None:
            assert projection.next_deadline(5.0) == 5.0
            turns += 1
            projection.begin_turn()
            projection.poll(5.0)
            assert projection.waiting == count - BATCH * (turns + 1)
        assert turns == 3


async def test_a_batch_is_shorter_where_many_watch() -> None:
    async with fleet_built(many(BATCH)) as (server, nodes):
        told: list[Any] = []
        for number in range(BATCH):
            for _ in range(WATCHERS):
                noted(server, FIRST + number, told)
        projection = Projection(nodes)
        for number in range(BATCH):
            projection.write(valued(number, 1.0))
        assert projection.waiting == BATCH // 2
        assert len(told) == WATCHERS * BATCH // 2


async def test_of_a_node_that_waits_the_latest_analog_value_is_written_and_each_state() -> None:
    async with fleet_built(many(BATCH + 1)) as (server, nodes):
        told = noted(server, FIRST + BATCH)
        projection = Projection(nodes)
        for number in range(BATCH):
            projection.write(valued(number, 1.0))
        for value in (0.1, 0.2, 0.3):
            projection.write(valued(BATCH, value, can_wait=True))
        assert (told, projection.waiting) == ([], 1)
        for value in (1.0, 2.0):
            projection.write(valued(BATCH, value))
        for value in (0.4, 0.5):
            projection.write(valued(BATCH, value, can_wait=True))
        assert (told, projection.waiting) == ([], 4)
        projection.poll(0.0)
        assert told == [0.3, 1.0, 2.0, 0.5]
        assert projection.waiting == 0


async def test_nodes_come_before_their_values_and_go() -> None:
    async with fleet_built() as (server, nodes):
        projection = Projection(nodes)
        topic = Topic(5, 2, 700)
        source = DataSetModel(topic, "/odom", (FieldModel(NodeId(2, 700), "x", DOUBLE),))
        projection.put(SourceAdded(source))
        projection.put(changed(1.0, key=NodeId(2, 700)))
        assert await server.get_node("ns=2;i=700").read_value() == 1.0
        projection.put(SourceRemoved(source))
        projection.put(changed(2.0, key=NodeId(2, 700)))
        projection.put(SourceQuarantined(topic, "/odom", "", "why"))
        assert await children(server, "ns=2;s=Fleet.Discovered.Sources.G00") == {}
        assert "2:ua_5_2_700" in await children(server, "ns=2;s=Fleet.Discovered.Quarantine.G00")


async def test_in_a_flood_of_states_each_is_told_and_none_waits() -> None:
    """Each comes by a datagram, which is a turn."""
    async with fleet_built() as (server, nodes):
        told = noted(server, 1002)
        projection = Projection(nodes)
        for number in range(20_000):
            projection.begin_turn()
            projection.put(state(number % 2 == 0))
        assert projection.waiting == 0
        assert told == [True, False] * 10_000


async def test_a_flood_of_states_within_one_turn_is_told_in_turns() -> None:
    async with fleet_built() as (server, nodes):
        told = noted(server, 1002)
        projection = Projection(nodes)
        for number in range(2000):
            projection.put(state(number % 2 == 0))
        assert BATCH <= len(told) + 1 <= BATCH + 1
        for _ in range(2000 // BATCH):
            projection.poll(0.0)
        assert told == [True, False] * 1000


async def test_no_more_states_wait_than_memory_is_for() -> None:
    async with fleet_built() as (server, nodes):
        told = noted(server, 1002)
        projection = Projection(nodes)
        for number in range(2 * MOST_WAITING):
            projection.put(state(number % 2 == 0))
        assert projection.waiting <= MOST_WAITING + 1
        while projection.waiting:
            projection.poll(0.0)
        assert told == [True, False] * MOST_WAITING


async def test_a_change_of_quality_is_not_skipped() -> None:
    async with fleet_built(many(BATCH + 1)) as (server, nodes):
        told = noted(server, FIRST + BATCH)
        projection = Projection(nodes)
        for number in range(BATCH):
            projection.write(valued(number, 1.0))
        projection.put(valued(BATCH, 0.2, can_wait=True))
        projection.put(valued(BATCH, 0.3)._replace(status=int(StatusCode.BAD_NO_COMMUNICATION)))
        projection.put(valued(BATCH, 0.5, can_wait=True))
        projection.poll(0.0)
        assert told == [0.2, 0.3, 0.5]


async def test_an_event_is_told_between_the_values_before_and_after_it() -> None:
    count = BATCH * 3
    async with fleet_built(many(count + 1)) as (server, nodes):
        told: list[Any] = []
        for number in range(count + 1):
            noted(server, FIRST + number, told)
        projection = Projection(nodes)
        for number in range(count):
            projection.write(valued(number, float(number), can_wait=True))
        assert projection.waiting
        projection.then(lambda: told.append("event"))
        projection.write(valued(count, -1.0, can_wait=True))
        while projection.waiting:
            projection.poll(0.0)
        assert told == [*[float(number) for number in range(count)], "event", -1.0]


async def test_events_have_no_flood_of_values_written_at_once() -> None:
    """A fault of each robot had: 60,000 monitored items kept all others waiting for 8 s."""
    count = BATCH * 20
    async with fleet_built(many(count)) as (server, nodes):
        told: list[Any] = []
        for number in range(count):
            noted(server, FIRST + number, told)
        projection = Projection(nodes)
        turns: list[int] = []
        for turn in range(30):
            before = len(told)
            projection.begin_turn()
            for number in range(count):
                projection.write(valued(number, float(turn), can_wait=True))
            projection.then(lambda: told.append("event"))
            projection.poll(0.0)
            turns.append(len(told) - before)
        assert max(turns) <= 4 * LARGEST_BATCH
        while projection.waiting:
            projection.poll(0.0)
        assert told.count("event") == 30


async def test_no_more_events_wait_behind_values_than_memory_is_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projection_module, "MOST_WAITING", 10)
    async with fleet_built(many(BATCH + 2)) as (_, nodes):
        projection, told = Projection(nodes), list[int]()
        for number in range(BATCH + 2):
            projection.write(valued(number, 1.0, can_wait=True))
        for number in range(100):
            projection.then(functools.partial(told.append, number))
            assert projection.waiting <= 2 + 10
        while projection.waiting:
            projection.poll(0.0)
        assert told == list(range(100))


async def test_nodes_that_become_bad_at_once_are_written_in_turns_however_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projection_module, "MOST_WAITING", 10)
    count = BATCH * 4
    async with fleet_built(many(count)) as (server, nodes):
        told: list[Any] = []
        for number in range(count):
            noted(server, FIRST + number, told)
        projection = Projection(nodes)
        for number in range(count):
            projection.write(valued(number, 1.0))
        assert (len(told), projection.waiting) == (BATCH, count - BATCH)


async def test_a_source_that_goes_leaves_no_turn_without_a_bound() -> None:
    async with fleet_built(many(BATCH * 4)) as (_, nodes):
        projection = Projection(nodes)
        source = DataSetModel(Topic(5, 2, 700), "/odom", (FieldModel(NodeId(2, 700), "x", DOUBLE),))
        projection.put(SourceAdded(source))
        for number in range(BATCH * 2):
            projection.write(valued(number, 1.0, can_wait=True))
        projection.put(SourceRemoved(source))
        assert projection.waiting == 0
        for number in range(BATCH * 2):
            projection.write(valued(number, 2.0, can_wait=True))
        assert projection.waiting == BATCH * 2


async def test_who_wakes_the_timer_finds_what_waits() -> None:
    async with fleet_built(many(BATCH + 2)) as (_, nodes):
        seen: list[float | None] = []
        projection = Projection(nodes, sooner=lambda: seen.append(projection.next_deadline(7.0)))
        for number in range(BATCH + 2):
            projection.write(valued(number, 1.0))
        assert seen == [7.0]


async def test_no_event_waits() -> None:
    async with fleet_built() as (_, nodes):
        projection, told = Projection(nodes), 0

        def event() -> None:
            nonlocal told
            told += 1

        for number in range(10_005):
            projection.then(event)
            assert told == number + 1


async def test_a_source_that_changes_its_fields_all_the_time_leaves_its_last_nodes() -> None:
    async with fleet_built() as (server, nodes):
        projection = Projection(nodes)
        topic, key = Topic(2, 2, 700), NodeId(2, 700)
        kinds = [
            DataSetModel(topic, "flapping", (FieldModel(key, "data", kind),))
            for kind in (DOUBLE, int(BuiltinType.INT32))
        ]
        projection.put(SourceAdded(kinds[0]))
        for number in range(1000):
            projection.put(SourceRemoved(kinds[number % 2]))
            projection.put(SourceAdded(kinds[(number + 1) % 2]))
            projection.put(changed(1.0, key=key))
        assert projection.waiting <= 1
        projection.poll(0.0)
        assert (await server.get_node("ns=2;i=700").read_value()) == 1.0
        projection.put(SourceRemoved(kinds[0]))
        projection.put(SourceAdded(kinds[1]))
        assert (await server.get_node("ns=2;i=700").read_data_type()).Identifier == BuiltinType.INT32


async def test_a_mistake_costs_one_change_and_one_watcher() -> None:
    async with fleet_built() as (server, nodes):
        mistakes = Mistakes()
        projection = Projection(nodes, mistakes=mistakes)

        async def broken(_handle: int, _data: Any, _error: Any = None) -> None:
            raise ValueError("a client's item")

        def no_event() -> None:
            raise ValueError("an event")

        server.iserver.aspace.add_datachange_callback(raw_id(1001, 2), ua.AttributeIds.Value, broken)
        told = noted(server, 1001)
        taken = DataSetModel(Topic(9, 2, 1001), "taken", (FieldModel(SPEED, "data", DOUBLE),))
        projection.put(SourceAdded(taken))  # its id is another's
        projection.then(no_event)
        projection.put(changed(0.1)._replace(source_timestamp="today"))  # type: ignore[arg-type]
        projection.put(changed(0.2))
        assert told == [0.2]
        assert mistakes.counts == {"projection": 2, "values": 1, "monitored items": 1}
        projection.put(SourceRemoved(taken))
        assert await server.get_node("ns=2;i=1001").read_value() == 0.2
