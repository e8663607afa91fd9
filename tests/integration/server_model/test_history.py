"""HistoryRead through the whole server: what was kept of values, in which form, and what bad requests get."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import (
    OBSERVER,
    OPERATOR,
    ROBOTS,
    SPEED,
    Running,
    fleet_config,
    reader,
    serving,
    ua,
    until,
)
from ua_fleet.errors import StorageAway, StorageUnavailable
from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import BAD_DATA_LOST, Row
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.storage.history_store import HISTORY_FILE, SqliteHistory
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, NodeId, datetime_from_ticks, ticks_from_datetime

SPEED_NODE, GOAL_NODE, FRAME_NODE = "ns=2;i=1001", "ns=2;i=1002", "ns=2;s=1004.frame"
KEY = NodeId(2, 1001)
START = datetime(2026, 3, 1, 12, tzinfo=UTC)
DOUBLE = ua.VariantType.Double
LONG = 36_500
"""Days: what stands in the store for these tests lies in the past."""
AVERAGE = ua.NodeId(ua.ObjectIds.AggregateFunction_Average)


@contextlib.asynccontextmanager
async def historian(
    udp_url: str, tcp_port: int, folder: Path, *, robots: Mapping[str, Any] = ROBOTS, **history: Any
) -> AsyncGenerator[Running]:
    config = fleet_config(udp_url, tcp_port, robots=robots, history={"days": LONG, **history})
    async with serving(folder, config) as running:
        yield running


def stored(folder: Path, *seconds: float, key: NodeId = KEY) -> None:
    """Values of the past, each the number of its second, in the store of a server that does not run yet."""
    path = folder / "state" / HISTORY_FILE
    with contextlib.closing(SqliteHistory(path)) as store:
        rows: list[Kept] = [(key, Row(tick(second), 0, int(BuiltinType.DOUBLE), float(second))) for second in seconds]
        store.write(rows, rows[-1][1].time)


def tick(second: float) -> int:
    return ticks_from_datetime(START) + int(second * TICKS_PER_SECOND)


def moment(second: float) -> datetime:
    return START + timedelta(seconds=second)


def raw(start: datetime | None, end: datetime | None, most: int = 0, *, bounds: bool = False) -> Any:
    zero = datetime(1601, 1, 1, tzinfo=UTC)
    return ua.ReadRawModifiedDetails(False, start or zero, end or zero, most, bounds)


def processed(start: datetime, end: datetime, interval_ms: float, *kinds: Any, **configuration: Any) -> Any:
    said = ua.AggregateConfiguration(UseServerCapabilitiesDefaults=not configuration, **configuration)
    return ua.ReadProcessedDetails(start, end, interval_ms, list(kinds or (AVERAGE,)), said)


async def ask(client: Any, details: Any, *nodes: Any, point: bytes | None = None, **options: Any) -> list[Any]:
    parameters = ua.HistoryReadParameters()
    parameters.HistoryReadDetails = details
    parameters.TimestampsToReturn = options.pop("timestamps", ua.TimestampsToReturn.Both)
    parameters.ReleaseContinuationPoints = options.pop("release", False)
    parameters.NodesToRead = [
        node
        if isinstance(node, ua.HistoryReadValueId)
        else ua.HistoryReadValueId(ua.NodeId.from_string(node), **options)
        for node in nodes
    ]
    for node in parameters.NodesToRead:
        node.ContinuationPoint = point
    found: list[Any] = await client.uaclient.history_read(parameters)
    return found


async def asked(client: Any, details: Any, nodes: list[Any]) -> list[Any]:
    """The results of nodes that have a continuation point each."""
    parameters = ua.HistoryReadParameters(details, ua.TimestampsToReturn.Both, False, nodes)
    found: list[Any] = await client.uaclient.history_read(parameters)
    return found


def shows(value: float) -> Callable[[Any], bool]:
    return lambda data: data.Value is not None and data.Value.Value == value


async def attribute_of(node: Any, attribute: Any) -> Any:
    return (await node.read_attribute(attribute)).Value.Value


def values_of(result: Any) -> list[Any]:
    return [data.Value.Value if data.Value is not None else None for data in result.HistoryData.DataValues]


async def told(client: Any, details: Any, node: str = SPEED_NODE, **options: Any) -> str:
    """The name of the StatusCode that one node gets."""
    try:
        [result] = await ask(client, details, node, **options)
    except ua.UaStatusCodeError as error:
        return str(ua.StatusCode(error.code).name)
    return str(result.StatusCode.name)


async def test_values_are_kept_as_they_change(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client(OBSERVER) as client:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        begin = datetime.now(UTC)
        for value in (0.25, 0.5, 0.75):
            running.peer.publish(SPEED, value)
            await until(reader(client, SPEED_NODE), shows(value))
        running.peer.lose(SPEED)

        async def read() -> Any:
            return (await ask(client, raw(begin, datetime.now(UTC)), SPEED_NODE))[0]

        result = await until(read, lambda result: len(values_of(result)) >= 3)
        assert values_of(result)[:3] == [0.25, 0.5, 0.75]
        first = result.HistoryData.DataValues[0]
        assert first.StatusCode.is_good()
        assert begin - timedelta(seconds=1) < first.SourceTimestamp.replace(tzinfo=UTC) < datetime.now(UTC)
        # The source falls silent: its last value is Bad from then on, and this is kept too.
        silent = await until(read, lambda result: not result.HistoryData.DataValues[-1].StatusCode.is_good())
        assert silent.HistoryData.DataValues[-1].StatusCode.name == "BadNoCommunication"
        assert not result.ContinuationPoint


async def test_what_clients_write_is_kept(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client() as client:
        begin = datetime.now(UTC)
        node = client.get_node(GOAL_NODE)
        for value in (0.5, 0.5, 1.0):
            await node.write_attribute(ua.AttributeIds.Value, ua.DataValue(ua.Variant(value, DOUBLE)))
        [result] = await ask(client, raw(begin, datetime.now(UTC) + timedelta(seconds=5)), GOAL_NODE)
        assert values_of(result) == [0.5, 0.5, 1.0]


async def test_nodes_say_that_they_have_a_history_and_which(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    data = dict(ROBOTS["rover"]["data"])
    data["speed"] = {**data["speed"], "history": {"deadband": 0.5, "days": 2}}
    data["goal"] = {**data["goal"], "history": False}
    robots = {"rover": {**ROBOTS["rover"], "data": data}}
    started = historian(udp_url, tcp_port, tmp_path, robots=robots, at_most_each_s=2)
    async with started as running, running.client(OBSERVER) as client:
        speed, goal = client.get_node(SPEED_NODE), client.get_node(GOAL_NODE)
        for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
            assert await attribute_of(speed, attribute) == 1 | 4
            assert await attribute_of(goal, attribute) & 4 == 0
        assert await attribute_of(speed, ua.AttributeIds.Historizing) is True
        assert await attribute_of(goal, ua.AttributeIds.Historizing) is False
        assert await told(client, raw(START, moment(1)), GOAL_NODE) == "BadHistoryOperationUnsupported"
        [configuration] = await speed.get_referenced_nodes(ua.ObjectIds.HasHistoricalConfiguration)
        assert (await configuration.read_browse_name()).Name == "HA Configuration"
        assert await configuration.read_type_definition() == ua.NodeId(ua.ObjectIds.HistoricalDataConfigurationType)
        said = {
            name: await (await configuration.get_child(path)).read_value()
            for name, path in {
                "Stepped": ["0:Stepped"],
                "MinTimeInterval": ["0:MinTimeInterval"],
                "MaxTimeInterval": ["0:MaxTimeInterval"],
                "ExceptionDeviation": ["0:ExceptionDeviation"],
                "MaxTimeStoredValues": ["0:MaxTimeStoredValues"],
                "PercentDataGood": ["0:AggregateConfiguration", "0:PercentDataGood"],
            }.items()
        }
        assert said == {
            "Stepped": False,
            "MinTimeInterval": 2000,
            "MaxTimeInterval": 60_000,
            "ExceptionDeviation": 0.5,
            "MaxTimeStoredValues": 2 * 86_400_000,
            "PercentDataGood": 100,
        }
        [frame] = await client.get_node(FRAME_NODE).get_referenced_nodes(ua.ObjectIds.HasHistoricalConfiguration)
        assert await (await frame.get_child(["0:Stepped"])).read_value() is True
        prefix = "HistoryServerCapabilities_"
        for name, value in (("AccessHistoryDataCapability", True), ("AccessHistoryEventsCapability", True)):
            node = client.get_node(ua.NodeId(getattr(ua.ObjectIds, prefix + name)))
            assert await node.read_value() is value
        most = client.get_node(ua.NodeId(ua.ObjectIds.HistoryServerCapabilities_MaxReturnDataValues))
        assert await most.read_value() == 2000
        functions = client.get_node(ua.NodeId(ua.ObjectIds.HistoryServerCapabilities_AggregateFunctions))
        names = {(await child.read_browse_name()).Name for child in await functions.get_children()}
        assert {"Average", "TimeAverage", "Minimum", "Maximum", "Count", "PercentGood"} <= names
        for name in names:
            kind = ua.NodeId(getattr(ua.ObjectIds, f"AggregateFunction_{name}"))
            assert await told(client, processed(START, moment(1), 0, kind)) == "Good"


async def test_without_a_history_nobody_promises_one(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        assert await attribute_of(client.get_node(SPEED_NODE), ua.AttributeIds.AccessLevel) == 1
        assert await told(client, raw(START, moment(1))) == "BadHistoryOperationUnsupported"
        assert await client.get_node(SPEED_NODE).get_referenced_nodes(ua.ObjectIds.HasHistoricalConfiguration) == []
        node = client.get_node(ua.NodeId(ua.ObjectIds.HistoryServerCapabilities_AccessHistoryDataCapability))
        assert await node.read_value() is False
        assert not (tmp_path / "state" / HISTORY_FILE).exists()


async def test_pages_go_on_after_a_new_connection_and_a_restart(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    stored(tmp_path, *range(10))
    found: list[Any] = []
    async with historian(udp_url, tcp_port, tmp_path) as running:
        async with running.client(OBSERVER) as client:
            [page] = await ask(client, raw(START, moment(100), 4, bounds=True), SPEED_NODE)
            found += values_of(page)
        async with running.client(OPERATOR) as client:
            [page] = await ask(client, raw(START, moment(1)), SPEED_NODE, point=page.ContinuationPoint)
            found += values_of(page)
            # It is this node's alone, and nobody can make one.
            point = page.ContinuationPoint
            assert await told(client, raw(START, moment(1)), FRAME_NODE, point=point) == "BadContinuationPointInvalid"
            forged = point[:20] + bytes([point[20] ^ 1]) + point[21:]
            assert await told(client, raw(START, moment(1)), point=forged) == "BadContinuationPointInvalid"
            assert await told(client, processed(START, moment(1), 0), point=point) == "BadContinuationPointInvalid"
            assert await told(client, raw(START, moment(1)), point=b"x" * 100_000) == "BadContinuationPointInvalid"
            assert await told(client, raw(START, moment(1)), point=point, release=True) == "Good"
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client() as client:
        [page] = await ask(client, raw(START, moment(1)), SPEED_NODE, point=page.ContinuationPoint)
        found += values_of(page)
        assert not page.ContinuationPoint
    assert found == [float(second) for second in range(10)] + [None]
    assert page.HistoryData.DataValues[-1].StatusCode.name == "BadBoundNotFound"


async def test_large_answers_come_in_pages(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    stored(tmp_path, *range(5_000))
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client() as client:
        found: list[float] = []
        point = None
        for _ in range(3):
            [page] = await ask(client, raw(START, moment(9_999)), SPEED_NODE, point=point)
            assert len(values_of(page)) <= 2_000
            found += values_of(page)
            point = page.ContinuationPoint
        assert point is None
        assert found == [float(second) for second in range(5_000)]
        every = processed(START, moment(5_000), 1_000)
        [page] = await ask(client, every, SPEED_NODE)
        [following] = await ask(client, every, SPEED_NODE, point=page.ContinuationPoint)
        assert values_of(page) + values_of(following) == [float(second) for second in range(4_000)]


async def test_a_value_that_no_answer_has_room_for_does_not_end_a_read(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    """Those that fit into an answer of their own come, also where two nodes are read at once."""
    texts = {1: "a", 2: "b" * 100_000, 3: "c" * 200_000, 4: "d" * 100_000, 5: "e"}
    frame = NodeId(2, "1004.frame")
    with contextlib.closing(SqliteHistory(tmp_path / "state" / HISTORY_FILE)) as store:
        rows: list[Kept] = [(frame, Row(tick(at), 0, int(BuiltinType.STRING), text)) for at, text in texts.items()]
        store.write(rows, rows[-1][1].time)
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client(most_bytes=300_000) as client:
        found: list[list[Any]] = [[], []]
        details, points = raw(START, moment(9)), dict[int, bytes | None]({0: None, 1: None})
        for _ in range(10):
            wanted = [
                ua.HistoryReadValueId(ua.NodeId.from_string(FRAME_NODE), ContinuationPoint=point)
                for point in points.values()
            ]
            answer = await asked(client, details, wanted)
            for number, result in zip(list(points), answer, strict=True):
                result.StatusCode.check()
                found[number] += result.HistoryData.DataValues
                points[number] = result.ContinuationPoint
                if not result.ContinuationPoint:
                    del points[number]
            if not points:
                break
        for values in found:
            shown = [data.Value.Value if data.StatusCode.is_good() else data.StatusCode.name for data in values]
            assert shown == ["a", texts[2], "BadEncodingLimitsExceeded", texts[4], "e"]


async def test_values_are_calculated(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    stored(tmp_path, 0, 10, 20, 30)
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client(OBSERVER) as client:
        [result] = await ask(client, processed(START, moment(40), 20_000), SPEED_NODE)
        assert values_of(result) == [5.0, 25.0]
        assert [data.StatusCode.value & 0xFFFF for data in result.HistoryData.DataValues] == [0x0401, 0x0401]
        times = [data.SourceTimestamp.replace(tzinfo=UTC) for data in result.HistoryData.DataValues]
        assert times == [moment(0), moment(20)]
        details = ua.ReadAtTimeDetails([moment(15), moment(30), moment(-1)], False)
        [result] = await ask(client, details, SPEED_NODE)
        assert values_of(result) == [15.0, 30.0, None]
        bits = [data.StatusCode.value & 0x041F for data in result.HistoryData.DataValues]
        assert bits[:2] == [0x0402, 0]
        kinds = [ua.NodeId(ua.ObjectIds.AggregateFunction_Count), ua.NodeId(ua.ObjectIds.AggregateFunction_Maximum)]
        both = await ask(client, processed(START, moment(40), 0, *kinds), SPEED_NODE, SPEED_NODE)
        assert [values_of(result) for result in both] == [[4], [30.0]]


async def test_a_restart_is_a_gap(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    stored(tmp_path, 0, 10)
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client() as client:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        running.peer.publish(SPEED, 0.25)
        await until(reader(client, SPEED_NODE), shows(0.25))
        [result] = await ask(client, raw(START, datetime.now(UTC) + timedelta(minutes=1)), SPEED_NODE)
        assert values_of(result)[:2] == [0.0, 10.0]
        marks = [data for data in result.HistoryData.DataValues if data.StatusCode.value == BAD_DATA_LOST]
        assert len(marks) == 1
        assert ticks_from_datetime(marks[0].SourceTimestamp.replace(tzinfo=UTC)) in (tick(10), tick(10) + 10)
        assert values_of(result).index(0.25) > 2


async def test_bad_requests(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    stored(tmp_path, *range(10))
    config = fleet_config(udp_url, tcp_port, history={"days": LONG}, max_nodes_per_request=20)
    first, last = datetime(1601, 1, 1, 0, 0, 1, tzinfo=UTC), datetime(9999, 12, 31, 23, 59, 58, tzinfo=UTC)
    good = raw(START, moment(5))
    text = ua.NodeId(ua.ObjectIds.AggregateFunction_Range)
    cases: list[tuple[Any, dict[str, Any], str]] = [
        (raw(None, None), {}, "BadHistoryOperationInvalid"),
        (raw(START, None), {}, "BadHistoryOperationInvalid"),
        (raw(None, None, 5), {}, "BadHistoryOperationInvalid"),
        (raw(first, last), {}, "Good"),
        (raw(last, first, 0xFFFF_FFFF, bounds=True), {}, "Good"),
        (raw(last, None, 5), {}, "GoodNoData"),
        (raw(moment(100), moment(200)), {}, "GoodNoData"),
        (ua.ReadRawModifiedDetails(True, START, moment(5), 0, False), {}, "BadHistoryOperationUnsupported"),
        (ua.ReadEventDetails(), {}, "BadHistoryOperationUnsupported"),
        (good, {"IndexRange": "0:1"}, "BadHistoryOperationUnsupported"),
        (good, {"DataEncoding": ua.QualifiedName("Default XML")}, "BadDataEncodingInvalid"),
        (good, {"timestamps": ua.TimestampsToReturn.Server}, "BadTimestampNotSupported"),
        (good, {"timestamps": ua.TimestampsToReturn.Neither}, "BadTimestampsToReturnInvalid"),
        (processed(START, START, 1000), {}, "BadInvalidArgument"),
        (processed(START, moment(5), -1), {}, "BadInvalidArgument"),
        (processed(START, moment(5), float("nan")), {}, "BadInvalidArgument"),
        (processed(first, last, 1), {}, "BadInvalidArgument"),
        (processed(first, last, 86_400_000), {}, "Good"),
        (processed(last, first, 0), {}, "Good"),
        (processed(START, moment(5), 0, text), {}, "BadAggregateNotSupported"),
        (processed(START, moment(5), 0, AVERAGE, AVERAGE), {}, "BadAggregateListMismatch"),
        (processed(START, moment(5), 0, PercentDataBad=101, PercentDataGood=100), {}, "BadAggregateInvalidInputs"),
        (processed(START, moment(5), 0, PercentDataBad=10, PercentDataGood=10), {}, "BadAggregateInvalidInputs"),
        (ua.ReadAtTimeDetails([], False), {}, "BadNothingToDo"),
        (ua.ReadAtTimeDetails([START] * 1_001, False), {}, "BadTooManyOperations"),
        (ua.ReadAtTimeDetails([first, last], True), {}, "Good"),
    ]
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        for number, (details, options, expected) in enumerate(cases):
            assert await told(client, details, **options) == expected, number
        assert await told(client, good, "ns=2;s=nowhere") == "BadNodeIdUnknown"
        assert await told(client, good, "ns=2;s=Robots.rover.State") == "BadHistoryOperationUnsupported"
        with pytest.raises(ua.UaStatusCodeError, match="BadTooManyOperations"):
            await ask(client, good, *[SPEED_NODE] * 21)
        results = await ask(client, good, *[SPEED_NODE] * 20)
        assert [values_of(result) for result in results] == [[0.0, 1.0, 2.0, 3.0, 4.0]] * 20


async def test_a_store_that_is_away_costs_no_live_value(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = True
    write = SqliteHistory.write

    def fail(self: SqliteHistory, batch: Any, now: int) -> None:
        if away:
            raise StorageUnavailable("the disk is full; free some space")
        write(self, batch, now)

    monkeypatch.setattr(SqliteHistory, "write", fail)
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client() as client:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        begin = datetime.now(UTC)
        for value in (0.25, 0.5):
            running.peer.publish(SPEED, value)
            await until(reader(client, SPEED_NODE), shows(value))
            assert await told(client, raw(begin, datetime.now(UTC))) in ("Good", "GoodNoData", "BadDataUnavailable")
        away = False

        async def read() -> Any:
            return (await ask(client, raw(begin, datetime.now(UTC)), SPEED_NODE))[0]

        def has_both(result: Any) -> bool:
            return result.StatusCode.name == "Good" and values_of(result)[:2] == [0.25, 0.5]

        await until(read, has_both)


async def test_a_database_that_is_away_is_tried_once_for_all_nodes_of_a_request(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A try may take 10 s, and a request has up to 10,000 nodes."""
    tries: list[int] = []

    def fail(_self: SqliteHistory, *_options: Any, **_more: Any) -> Any:
        tries.append(1)
        raise StorageAway("PostgreSQL cannot be reached")

    monkeypatch.setattr(SqliteHistory, "between", fail)
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client() as client:
        results = await ask(client, raw(moment(0), moment(9)), *[SPEED_NODE, GOAL_NODE] * 10)
        assert {result.StatusCode.name for result in results} == {"BadDataUnavailable"}
        assert len(tries) == 1


async def test_a_value_is_found_at_the_time_that_it_has(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also between two microseconds, where asyncua has no times."""
    exact = tick(1) + 7
    path = tmp_path / "state" / HISTORY_FILE
    with contextlib.closing(SqliteHistory(path)) as store:
        store.write([(KEY, Row(exact + 10 * at, 0, int(BuiltinType.DOUBLE), float(at))) for at in range(3)], exact)
    encoded = ua.datetime_to_win_epoch

    def encoded_exactly(time: datetime) -> int:
        return exact if time == moment(1) else int(encoded(time))

    monkeypatch.setattr(ua, "datetime_to_win_epoch", encoded_exactly)
    async with historian(udp_url, tcp_port, tmp_path) as running, running.client() as client:
        [result] = await ask(client, ua.ReadAtTimeDetails([moment(1)], False), SPEED_NODE)
        [data] = result.HistoryData.DataValues
        assert (data.Value and data.Value.Value, data.StatusCode.value) == (0.0, 0)


async def test_a_store_that_cannot_be_used_is_said_at_the_start(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    path = tmp_path / "state" / HISTORY_FILE
    path.parent.mkdir()
    path.write_bytes(b"no database at all" * 100)
    with pytest.raises(StorageUnavailable, match=r"history\.db"):
        async with historian(udp_url, tcp_port, tmp_path):
            await asyncio.sleep(0)


def test_times_come_back() -> None:
    assert datetime_from_ticks(tick(1.5)) == moment(1.5)
