"""HistoryRead of events through the whole server: which there are, who may read them, filters, pages, bad requests."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import (
    ENGINEER,
    OBSERVER,
    OPERATOR,
    SPEED,
    fleet_config,
    reader,
    serving,
    ua,
    until,
)
from tests.integration.server_model.test_alarms import ACKNOWLEDGE, ALARM, event_filter, robots, say, text, watching
from tests.integration.server_model.test_history import SPEED_NODE, ask, attribute_of, raw, told
from ua_fleet.history.events import AUDIT_EVENTS, EVENTS, EventRecorder, KeptEvent, encode_event
from ua_fleet.history.rows import EARLIEST, LATEST, Row
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.storage.history_store import HISTORY_FILE, SqliteHistory
from ua_fleet.values import BuiltinType, ticks_from_datetime

SERVER = "i=2253"
ZERO = datetime(1601, 1, 1, tzinfo=UTC)
LONG_AGO, FUTURE = datetime(2020, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC)
OVERFLOW = ua.NodeId(ua.ObjectIds.EventQueueOverflowEventType)


def selecting(*names: str, where: Sequence[Any] = ()) -> Any:
    wanted: Any = ua.EventFilter()
    for name in names:
        clause = ua.SimpleAttributeOperand()
        clause.TypeDefinitionId, clause.AttributeId = ua.NodeId(ua.ObjectIds.BaseEventType), ua.AttributeIds.Value
        clause.BrowsePath = [ua.QualifiedName(part, 0) for part in name.split("/")]
        wanted.SelectClauses.append(clause)
    wanted.WhereClause.Elements = list(where)
    return wanted


def element(operator: Any, *operands: Any) -> Any:
    made: Any = ua.ContentFilterElement()
    made.FilterOperator, made.FilterOperands = operator, list(operands)
    return made


def literal(value: Any, kind: Any = None) -> Any:
    operand: Any = ua.LiteralOperand()
    operand.Value = ua.Variant(value, kind)
    return operand


def of_type(event_type: int) -> Any:
    return element(ua.FilterOperator.OfType, literal(ua.NodeId(event_type)))


def field(name: str) -> Any:
    return selecting(name).SelectClauses[0]


NAMES = ("Message", "EventId", "Time", "EventType", "Severity")


def reading(
    start: datetime | None = LONG_AGO, end: datetime | None = FUTURE, most: int = 0, evfilter: Any = None
) -> Any:
    return ua.ReadEventDetails(most, start or ZERO, end or ZERO, evfilter or selecting(*NAMES))


async def events_of(client: Any, details: Any, *, node: str = SERVER) -> list[list[Any]]:
    """The fields of all events, page by page."""
    found: list[list[Any]] = []
    point: bytes | None = None
    for _ in range(100):
        [result] = await ask(client, details, node, point=point)
        result.StatusCode.check()
        found += [[variant.Value for variant in event.EventFields] for event in result.HistoryData.Events]
        point = result.ContinuationPoint
        if not point:
            return found
    raise AssertionError("it never ends")


def stored(folder: Path, *times: datetime) -> None:
    """Events of the past, each named by its number, in the store of a server that does not run yet."""
    with contextlib.closing(SqliteHistory(folder / "state" / HISTORY_FILE)) as store:
        recorder = EventRecorder()
        for number, time in enumerate(times):
            ticks = ticks_from_datetime(time)
            fields = {
                "EventType": ua.ua_binary.variant_to_binary(ua.Variant(ua.NodeId(2041), ua.VariantType.NodeId)),
                "Message": ua.ua_binary.variant_to_binary(ua.Variant(ua.LocalizedText(f"event {number}"))),
                "Severity": ua.ua_binary.variant_to_binary(ua.Variant(number % 1_000, ua.VariantType.UInt16)),
            }
            store.write(recorder.take(ticks, encode_event(ticks, fields), ticks), ticks)


async def test_an_alarm_is_in_the_history_as_it_was_told(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={})
    begin = datetime.now(UTC) - timedelta(seconds=1)
    async with serving(tmp_path, config) as running, running.client() as client, watching(client) as watched:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        await say(running, client, 1.2)
        live = [await watched.next(ActiveState_Id=True)]
        await client.get_node(ALARM).call_method(ACKNOWLEDGE, live[0]["EventId"], text("seen"))
        live.append(await watched.next(AckedState_Id=True))
        await say(running, client, 0.5)
        live.append(await watched.next(ActiveState_Id=False))
        over = datetime.now(UTC)
        wanted = event_filter()
        wanted.WhereClause.Elements = [
            element(ua.FilterOperator.And, element_operand(1), element_operand(2)),
            of_type(ua.ObjectIds.LimitAlarmType),
            element(ua.FilterOperator.Equals, field("SourceName"), literal("rover.speed")),
        ]
        async with running.client(OBSERVER) as reader_:
            found = await events_of(reader_, reading(begin, over, evfilter=wanted))
        paths = ["/".join(part.Name for part in clause.BrowsePath) for clause in wanted.SelectClauses[:-1]]
        # On a busy machine a value may fall silent meanwhile, and its Quality is told, too.
        ids = [event["EventId"] for event in live]
        told_again = [past for past in found if past[0] in ids]
        for event, past in zip(live, told_again, strict=True):
            assert [event[path] for path in paths] == past[:-1]
            assert past[-1].to_string() == ALARM
        assert await events_of(client, reading(over, begin, evfilter=wanted)) == found[::-1]


def element_operand(index: int) -> Any:
    operand: Any = ua.ElementOperand()
    operand.Index = index
    return operand


async def test_audit_events_are_for_engineers(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={})
    audit = of_type(ua.ObjectIds.AuditEventType)
    names = ("EventType", "ClientUserId", "SourceName", "Status", "NewValue")
    async with serving(tmp_path, config) as running:
        async with running.client(OPERATOR) as client, watching(client) as watched:
            running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
            await say(running, client, 1.2)
            await watched.next(ActiveState_Id=True)
            await client.get_node("ns=2;i=1002").write_value(0.5)
            assert await events_of(client, reading(evfilter=selecting(*names, where=[audit]))) == []
        async with running.client(ENGINEER) as client:
            found = await events_of(client, reading(evfilter=selecting(*names, where=[audit])))
            written = [event for event in found if event[2] == "Attribute/Write"]
            assert written == [
                [ua.NodeId(ua.ObjectIds.AuditWriteUpdateEventType), OPERATOR[0], "Attribute/Write", True, 0.5]
            ]
            assert {event[1] for event in found if event[2] == "Session/ActivateSession"} == {OPERATOR[0], ENGINEER[0]}
            # Events of both kinds come in the order of their times.
            times = [event[0] for event in await events_of(client, reading(evfilter=selecting("Time")))]
            assert times == sorted(times)
            assert len(times) > len(found)


async def test_without_audit_and_without_events(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={"events": {"audit": False}})
    async with serving(tmp_path, config) as running, running.client(ENGINEER) as client:
        await client.get_node("ns=2;i=1002").write_value(0.5)
        assert await told(client, reading(), SERVER) in ("Good", "GoodNoData")
        audit = of_type(ua.ObjectIds.AuditEventType)
        assert await events_of(client, reading(evfilter=selecting("Time", where=[audit]))) == []
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={"events": False})
    async with serving(tmp_path, config) as running, running.client(ENGINEER) as client:
        assert await told(client, reading(), SERVER) == "BadHistoryOperationUnsupported"
        assert await attribute_of(client.nodes.server, ua.AttributeIds.EventNotifier) == 1
        capability = client.get_node(ua.NodeId(ua.ObjectIds.HistoryServerCapabilities_AccessHistoryEventsCapability))
        assert await capability.read_value() is False


async def test_the_nodes_say_so(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={})
    async with serving(tmp_path, config) as running, running.client(ENGINEER) as client:
        assert await attribute_of(client.nodes.server, ua.AttributeIds.EventNotifier) == 1 | 4
        state = client.get_node(ua.NodeId(ua.ObjectIds.Server_ServerStatus_State))
        assert await attribute_of(state, ua.AttributeIds.AccessLevel) == 1, "it has no history"
        for name, value in (("AccessHistoryEventsCapability", True), ("MaxReturnEventValues", 1_000)):
            node = client.get_node(ua.NodeId(getattr(ua.ObjectIds, f"HistoryServerCapabilities_{name}")))
            assert await node.read_value() == value
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        await say(running, client, 1.2)
        await until(reader(client, f"{ALARM}.Retain"), lambda found: found.Value.Value is True)
        # The filter of the node is one that a client may read with, and has all fields that are kept.
        told_filter = await (await client.nodes.server.get_child(["0:HistoricalEventFilter"])).read_value()
        found = await events_of(client, reading(evfilter=told_filter))
        assert len(found) > 3
        paths = ["/".join(part.Name for part in clause.BrowsePath) for clause in told_filter.SelectClauses]
        for event in found:
            assert event[paths.index("EventId")] is not None
    with contextlib.closing(SqliteHistory(tmp_path / "state" / HISTORY_FILE)) as store:
        rows = [row for key in (EVENTS, AUDIT_EVENTS) for row in store.series(key).between(EARLIEST, LATEST, 10_000)]
    names = {name for row in rows if row.value is not None for name in KeptEvent(row.value).names}
    assert "LimitState/CurrentState" in names
    assert "NewValue" not in names
    assert names - {*paths, "NodeId"} == set()


async def test_pages_and_points_outlast_a_restart(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    begin = datetime(2026, 3, 1, tzinfo=UTC)
    stored(tmp_path, *[begin + timedelta(milliseconds=number) for number in range(2_500)])
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={"events": {"days": 36_500, "audit": False}})
    details = reading(begin, begin + timedelta(days=1), evfilter=selecting("Message", "Severity"))
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        [first] = await ask(client, details, SERVER)
        assert len(first.HistoryData.Events) == 1_000
        point = first.ContinuationPoint
        # The point belongs to the filter, the node, and this kind of request.
        other = reading(begin, begin + timedelta(days=1), evfilter=selecting("Message"))
        assert await told(client, other, SERVER, point=point) == "BadContinuationPointInvalid"
        assert await told(client, raw(begin, FUTURE), SPEED_NODE, point=point) == "BadContinuationPointInvalid"
        forged = point[:20] + bytes([point[20] ^ 1]) + point[21:]
        assert await told(client, details, SERVER, point=forged) == "BadContinuationPointInvalid"
        assert await told(client, details, SERVER, point=b"x" * 100_000) == "BadContinuationPointInvalid"
        assert await told(client, details, SERVER, point=point, release=True) == "Good"
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        found = [event.EventFields[0].Value.Text for event in first.HistoryData.Events]
        while point:
            [page] = await ask(client, details, SERVER, point=point)
            found += [event.EventFields[0].Value.Text for event in page.HistoryData.Events]
            point = page.ContinuationPoint
        assert found == [f"event {number}" for number in range(2_500)]
        # What follows the restart is marked.
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        await say(running, client, 1.2)
        await until(reader(client, f"{ALARM}.Retain"), lambda found: found.Value.Value is True)
        marks = await events_of(client, reading(begin, FUTURE, evfilter=selecting("Message", where=[of_type(3035)])))
        [[message]] = marks
        assert message.Text.startswith("events are missing from here on")
        severe = element(ua.FilterOperator.GreaterThan, field("Severity"), literal(997, ua.VariantType.UInt16))
        chosen = reading(begin, begin + timedelta(days=1), evfilter=selecting("Message", where=[severe]))
        assert [event[0].Text for event in await events_of(client, chosen)] == [
            *("event 998", "event 999", "event 1998", "event 1999")
        ]
        newest = reading(None, begin + timedelta(days=1), 2, selecting("Message"))
        [page] = await ask(client, newest, SERVER)
        assert [event.EventFields[0].Value.Text for event in page.HistoryData.Events] == ["event 2499", "event 2498"]
        assert page.ContinuationPoint


async def test_a_small_answer_has_few_events_and_goes_on(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    begin = datetime(2026, 3, 1, tzinfo=UTC)
    stored(tmp_path, *[begin + timedelta(milliseconds=number) for number in range(1_500)])
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={"events": {"days": 36_500}})
    details = reading(begin, begin + timedelta(days=1), evfilter=selecting("Message"))
    async with serving(tmp_path, config) as running, running.client(OBSERVER, most_bytes=20_000) as client:
        [result] = await ask(client, details, SERVER)
        assert 100 < len(result.HistoryData.Events) < 1_000
        found = await events_of(client, details)
        assert [event[0].Text for event in found] == [f"event {number}" for number in range(1_500)]
        wide = reading(begin, begin + timedelta(milliseconds=2), evfilter=selecting(*["Message"] * 200))
        many = await events_of(client, wide)
        assert {field_.Text for field_ in many[1]} == {"event 1"}


async def test_the_nodes_of_a_request_share_its_work(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    """A node that is named again and again costs no more than once; what is left out has a continuation point."""
    begin = datetime(2026, 3, 1, tzinfo=UTC)
    stored(tmp_path, *[begin + timedelta(milliseconds=number) for number in range(2_500)])
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={"events": {"days": 36_500, "audit": False}})
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        for start, end in (
            (begin, begin + timedelta(days=1)),
            (begin + timedelta(days=1), begin - timedelta(seconds=1)),
        ):
            details = reading(start, end, evfilter=selecting("Message"))
            results = await ask(client, details, *[SERVER] * 40)
            assert all(result.StatusCode.name == "Good" and result.ContinuationPoint for result in results)
            counts = [len(result.HistoryData.Events) for result in results]
            assert counts[:5] == [1_000] * 5
            assert sum(counts) <= 10_000
            assert counts[-1] == 0
            found, point = list[str](), results[-1].ContinuationPoint
            while point:
                [page] = await ask(client, details, SERVER, point=point)
                found += [event.EventFields[0].Value.Text for event in page.HistoryData.Events]
                point = page.ContinuationPoint
            assert found == [f"event {number}" for number in range(2_500)][:: 1 if start < end else -1]
        # A look costs something even where it finds nothing.
        nothing = reading(LONG_AGO, LONG_AGO + timedelta(days=1), evfilter=selecting("Message"))
        names = [result.StatusCode.name for result in await ask(client, nothing, *[SERVER] * 200)]
        assert names == ["GoodNoData"] * 50 + ["Good"] * 150


async def test_bad_requests(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={})
    good = reading()
    no_filter, no_fields = ua.ReadEventDetails(0, LONG_AGO, FUTURE), reading(evfilter=selecting())
    no_fields.Filter.SelectClauses = []
    cycle = element(ua.FilterOperator.Not, element_operand(0))
    cases: list[tuple[Any, dict[str, Any], str]] = [
        (reading(None, None), {}, "BadHistoryOperationInvalid"),
        (reading(LONG_AGO, None), {}, "BadHistoryOperationInvalid"),
        (reading(None, None, 5), {}, "BadHistoryOperationInvalid"),
        (reading(FUTURE, None, 5), {}, "GoodNoData"),
        (reading(FUTURE, LONG_AGO), {}, "Good"),
        (no_filter, {}, "BadEventFilterInvalid"),
        (no_fields, {}, "BadEventFilterInvalid"),
        (reading(evfilter=selecting("Message", where=[cycle])), {}, "BadEventFilterInvalid"),
        (reading(evfilter=selecting(*["Message"] * 201)), {}, "BadEventFilterInvalid"),
        (reading(evfilter=selecting("Nothing")), {}, "Good"),
        (ua.ReadEventDetails2(0, LONG_AGO, FUTURE, selecting("Message")), {}, "BadHistoryOperationUnsupported"),
        (good, {"IndexRange": "0:1"}, "BadHistoryOperationUnsupported"),
        (good, {"DataEncoding": ua.QualifiedName("Default XML")}, "BadDataEncodingInvalid"),
        (good, {"timestamps": ua.TimestampsToReturn.Neither}, "Good"),
        (good, {"timestamps": ua.TimestampsToReturn.Server}, "Good"),
    ]
    async with serving(tmp_path, config) as running, running.client(ENGINEER) as client:
        for number, (details, options, expected) in enumerate(cases):
            assert await told(client, details, SERVER, **options) == expected, number
        assert await told(client, good, "ns=2;s=nowhere") == "BadNodeIdUnknown"
        for node in (SPEED_NODE, "ns=2;s=Robots.rover", "i=85"):
            assert await told(client, good, node) == "BadHistoryOperationUnsupported"
        assert await told(client, raw(LONG_AGO, FUTURE), SERVER) == "BadHistoryOperationUnsupported"
        results = await ask(client, good, *[SERVER] * 20)
        assert {result.StatusCode.name for result in results} == {"Good"}


@pytest.mark.parametrize("value", [True, {"days": 0}, {"hours": 3}])
def test_the_configuration_of_events(value: Any) -> None:
    if value is True:
        assert fleet_config("opc.udp://224.0.2.14:4840", 4840, history={"events": value}).history is not None
        return
    with pytest.raises(Exception, match=r"days|hours"):
        fleet_config("opc.udp://224.0.2.14:4840", 4840, history={"events": value})


async def test_a_broken_event_costs_no_other(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is a mistake, which is counted, logged and shown in the health."""
    mistakes: list[tuple[str, str]] = []

    def caught(_mistakes: Mistakes, loop: str, error: BaseException, **_ids: object) -> None:
        mistakes.append((loop, str(error).partition(" at ")[0]))

    monkeypatch.setattr(Mistakes, "caught", caught)
    begin = datetime.now(UTC) - timedelta(hours=1)
    stored(tmp_path, *(begin + timedelta(minutes=minute) for minute in range(5)))
    with contextlib.closing(SqliteHistory(tmp_path / "state" / HISTORY_FILE)) as store:
        for minute, data in ((5, b"broken"), (6, encode_event(7, {"Severity": b"\x05\x01", "Message": b"\x15\xff"}))):
            ticks = ticks_from_datetime(begin + timedelta(minutes=minute))
            store.write([(EVENTS, Row(ticks, 0, 15, data))], ticks)
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={})
    async with serving(tmp_path, config) as running, running.client() as client:
        over = begin + timedelta(minutes=10)
        where = [element(ua.FilterOperator.LessThan, field("Severity"), literal(4, ua.VariantType.UInt16))]
        found = await events_of(client, reading(begin, over, evfilter=selecting("Message", where=where)))
        assert [message.Text for (message,) in found] == ["event 0", "event 1", "event 2", "event 3"]
    assert mistakes == [("history", "the event of the history")] * 2
