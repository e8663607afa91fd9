"""Alarms of values through a whole server: nodes, events, Methods with their StatusCodes, roles, restart, faults."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import pytest

from tests.integration.server_model.harness import (
    ENGINEER,
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
from ua_fleet.endpoint.certificates import CertificateFiles, certificates_folder, create_certificate
from ua_fleet.operation.runs.robot_news import RobotNews
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

ALARM: Final = "ns=2;s=Alarms.rover.speed"
FIELDS: Final = (
    *("EventId", "EventType", "SourceName", "Message", "Severity", "Retain", "EnabledState/Id", "AckedState/Id"),
    *("ConfirmedState/Id", "ActiveState/Id", "LimitState/CurrentState", "Comment", "ClientUserId", "Quality"),
    *("SuppressedOrShelved", "ShelvingState/CurrentState", "SuppressedState/Id"),
)
ACKNOWLEDGE, CONFIRM, ADD_COMMENT, ENABLE, DISABLE = (ua.NodeId(one, 0) for one in (9111, 9113, 9029, 9027, 9028))
SUPPRESS, UNSUPPRESS, REFRESH, REFRESH2 = (ua.NodeId(one, 0) for one in (16403, 17868, 3875, 12912))
UNSHELVE, ONE_SHOT, TIMED = (ua.NodeId(one, 0) for one in (2947, 2948, 2949))


def robots(**limits: Any) -> Any:
    rover = ROBOTS["rover"]
    speed = {**rover["data"]["speed"], "limits": {"high": 1, "high_high": 1.5, "hysteresis": 0.1, **limits}}
    return {"rover": {**rover, "data": {**rover["data"], "speed": speed}}}


class Watched:
    """The alarms that one subscription is told of."""

    def __init__(self, client: Any) -> None:
        self.client = client
        self.found: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self.subscription: Any = None
        self.item = 0

    def event_notification(self, event: Any) -> None:
        self.found.put_nowait({**{name: getattr(event, name, None) for name in FIELDS}, "id": event.NodeId})

    async def next(self, **wanted: Any) -> dict[str, Any]:
        """The next event with these fields, of the speed's alarm without another SourceName.

        A bridge that says nothing for a while on a busy machine has an alarm too.
        """
        wanted = {"SourceName": "rover.speed", **wanted}
        while True:
            event = await asyncio.wait_for(self.found.get(), 20)
            if all(event[name.replace("_Id", "/Id")] == value for name, value in wanted.items()):
                return event


def event_filter() -> Any:
    wanted: Any = ua.EventFilter()
    clauses: list[Any] = []
    for name in FIELDS:
        clause = ua.SimpleAttributeOperand()
        clause.TypeDefinitionId, clause.AttributeId = ua.NodeId(2041, 0), ua.AttributeIds.Value
        clause.BrowsePath = [ua.QualifiedName(part, 0) for part in name.split("/")]
        clauses.append(clause)
    clause = ua.SimpleAttributeOperand()
    clause.TypeDefinitionId, clause.AttributeId = ua.NodeId(2782, 0), ua.AttributeIds.NodeId
    clauses.append(clause)
    wanted.SelectClauses = clauses
    of_type = ua.ContentFilterElement()
    of_type.FilterOperator = ua.FilterOperator.OfType
    of_type.FilterOperands = [ua.LiteralOperand(Value=ua.Variant(ua.NodeId(2782, 0)))]
    wanted.WhereClause.Elements = [of_type]
    return wanted


@asynccontextmanager
async def watching(client: Any) -> AsyncGenerator[Watched]:
    watched = Watched(client)
    watched.subscription = await client.create_subscription(20, watched)
    watched.item = await watched.subscription.subscribe_events(client.nodes.server, evfilter=event_filter())
    yield watched
    await watched.subscription.delete()


async def say(running: Running, client: Any, value: float) -> None:
    running.peer.publish(SPEED, value)
    await until(reader(client, "ns=2;i=1001"), lambda found: found.Value.Value == value)


async def refused(code: str, node: Any, method: Any, *arguments: Any) -> None:
    with pytest.raises(ua.UaStatusCodeError, match=code):
        await node.call_method(method, *arguments)


def text(words: str | None) -> Any:
    return ua.Variant(ua.LocalizedText(words), ua.VariantType.LocalizedText)


async def test_an_alarm_from_active_to_forgotten(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(confirm=True, severity=400))
    async with serving(tmp_path, config) as running, running.client() as client, watching(client) as watched:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        alarm = client.get_node(ALARM)
        await say(running, client, 1.2)
        active = await watched.next(ActiveState_Id=True)
        assert (active["SourceName"], active["Severity"]) == ("rover.speed", 400)
        assert active["EventType"] == ua.NodeId(ua.ObjectIds.ExclusiveLevelAlarmType, 0)
        assert active["id"].to_string() == ALARM
        assert active["LimitState/CurrentState"].Text == "High"
        assert active["Message"].Text == "rover.speed: 1.2 m/s is above 1 m/s"
        await refused("BadEventIdUnknown", alarm, ACKNOWLEDGE, b"x" * 16, text("?"))
        await alarm.call_method(ACKNOWLEDGE, active["EventId"], text("seen"))
        seen = await watched.next(AckedState_Id=True)
        assert (seen["Comment"].Text, seen["ClientUserId"]) == ("seen", OPERATOR[0])
        await refused("BadConditionBranchAlreadyAcked", alarm, ACKNOWLEDGE, active["EventId"], text("?"))
        await say(running, client, 0.5)
        over = await watched.next(ActiveState_Id=False)
        assert (over["Retain"], over["ConfirmedState/Id"]) == (True, False)
        await alarm.call_method(ADD_COMMENT, over["EventId"], text("a stone"))
        await watched.next(Retain=True)
        await alarm.call_method(CONFIRM, over["EventId"], text(None))
        done = await watched.next(Retain=False)
        assert done["Comment"].Text == "a stone"
        await refused("BadConditionBranchAlreadyConfirmed", alarm, CONFIRM, over["EventId"], text("?"))


async def test_the_nodes_are_those_of_the_standard(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(delay_s=0.01))
    async with serving(tmp_path, config) as running, running.client() as client:
        speed = client.get_node("ns=2;i=1001")
        [alarm] = await speed.get_referenced_nodes(refs=ua.ObjectIds.HasCondition)
        assert alarm.nodeid.to_string() == ALARM
        sources = await client.nodes.server.get_referenced_nodes(refs=ua.ObjectIds.HasEventSource)
        assert speed.nodeid in [one.nodeid for one in sources]
        assert (await alarm.read_type_definition()) == ua.NodeId(ua.ObjectIds.ExclusiveLevelAlarmType, 0)
        declared = await mandatory(client, ua.ObjectIds.ExclusiveLevelAlarmType)
        names = {one.Name for one in [await child.read_browse_name() for child in await alarm.get_children()]}
        assert declared <= names
        assert {"HighLimit", "HighHighLimit", "OnDelay", "SuppressedState", "MaxTimeShelved"} <= names
        assert "LowLimit" not in names
        shelving = await alarm.get_child("0:ShelvingState")
        inner = {one.Name for one in [await child.read_browse_name() for child in await shelving.get_children()]}
        assert {"CurrentState", "UnshelveTime", "TimedShelve", "OneShotShelve", "Unshelve"} <= inner
        assert await client.get_node(f"{ALARM}.HighLimit").read_value() == 1
        assert (await client.get_node("ns=2;s=Alarms.mobile_side.Online").read_type_definition()) == ua.NodeId(
            ua.ObjectIds.OffNormalAlarmType, 0
        )


async def mandatory(client: Any, kind: int) -> set[str]:
    """The mandatory members of an EventType and its supertypes; LocalTime and what is optional is not."""
    names: set[str] = set()
    node = client.get_node(ua.NodeId(kind, 0))
    while node is not None:
        for child in await node.get_children(refs=ua.ObjectIds.Aggregates):
            rules = await child.get_referenced_nodes(refs=ua.ObjectIds.HasModellingRule)
            if [rule.nodeid.Identifier for rule in rules] == [ua.ObjectIds.ModellingRule_Mandatory]:
                names.add((await child.read_browse_name()).Name)
        above = await node.get_referenced_nodes(
            refs=ua.ObjectIds.HasSubtype, direction=ua.BrowseDirection.Inverse, includesubtypes=False
        )
        node = above[0] if above else None
    return names


async def test_shelving_suppressing_disabling_and_who_may(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots())
    async with (
        serving(tmp_path, config) as running,
        running.client() as operator,
        running.client(ENGINEER) as engineer,
        running.client(OBSERVER) as observer,
        watching(observer) as watched,
    ):
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        await say(running, operator, 1.2)
        active = await watched.next(ActiveState_Id=True)
        alarm, shelving = operator.get_node(ALARM), operator.get_node(f"{ALARM}.ShelvingState")
        milliseconds = ua.Variant(300.0, ua.VariantType.Double)
        await refused("BadUserAccessDenied", observer.get_node(ALARM), ACKNOWLEDGE, active["EventId"], text("?"))
        await refused("BadUserAccessDenied", observer.get_node(f"{ALARM}.ShelvingState"), ONE_SHOT)
        for method in (SUPPRESS, DISABLE):
            await refused("BadUserAccessDenied", alarm, method)
        await refused("BadConditionNotShelved", shelving, UNSHELVE)
        await refused("BadShelvingTimeOutOfRange", shelving, TIMED, ua.Variant(-1.0, ua.VariantType.Double))
        await shelving.call_method(TIMED, milliseconds)
        shelved = await watched.next(SuppressedOrShelved=True)
        assert shelved["ShelvingState/CurrentState"].Text == "TimedShelved"
        again = await watched.next(SuppressedOrShelved=False)
        assert again["ShelvingState/CurrentState"].Text == "Unshelved", "by its own timer"
        await shelving.call_method(ONE_SHOT)
        await refused("BadConditionAlreadyShelved", shelving, ONE_SHOT)
        await shelving.call_method(UNSHELVE)
        theirs = engineer.get_node(ALARM)
        await theirs.call_method(SUPPRESS)
        await watched.next(SuppressedState_Id=True)
        await theirs.call_method(UNSUPPRESS)
        await refused("BadConditionAlreadyEnabled", theirs, ENABLE)
        await theirs.call_method(DISABLE)
        assert (await watched.next(EnabledState_Id=False))["Retain"] is False
        await refused("BadConditionDisabled", alarm, ACKNOWLEDGE, active["EventId"], text("?"))
        await refused("BadConditionAlreadyDisabled", theirs, DISABLE)
        await theirs.call_method(ENABLE)
        assert (await watched.next(EnabledState_Id=True))["Retain"] is True


async def test_who_watches_what_is_put_aside_is_told_of_it(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots())
    async with (
        serving(tmp_path, config) as running,
        running.client(ENGINEER) as engineer,
        running.client(OBSERVER) as observer,
    ):
        told: asyncio.Queue[list[str]] = asyncio.Queue()

        class Handler:
            def datachange_notification(self, node: Any, val: list[str], data: Any) -> None:
                del node, data
                told.put_nowait(val)

        put_aside, alarm = observer.get_node("ns=2;s=Fleet.Alarms.PutAside"), engineer.get_node(ALARM)
        subscription = await observer.create_subscription(10, Handler())
        await subscription.subscribe_data_change(put_aside)
        for method, expected in ((None, []), (DISABLE, ["rover.speed"]), (ENABLE, [])):
            if method is not None:
                await alarm.call_method(method)
            assert await put_aside.read_value() == expected
            assert await asyncio.wait_for(told.get(), 20) == expected


async def test_refresh_tells_what_is_retained(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots())
    async with serving(tmp_path, config) as running, running.client() as client:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        await say(running, client, 1.2)
        types = client.get_node(ua.NodeId(2782, 0))
        await until(reader(client, f"{ALARM}.Retain"), lambda found: found.Value.Value is True)
        async with watching(client) as watched:
            number = ua.Variant(watched.subscription.subscription_id, ua.VariantType.UInt32)
            item = ua.Variant(watched.item, ua.VariantType.UInt32)
            wrong = ua.Variant(4_000_000_000, ua.VariantType.UInt32)
            await types.call_method(REFRESH, number)
            first = await watched.next(ActiveState_Id=True)
            await types.call_method(REFRESH2, number, item)
            assert (await watched.next(ActiveState_Id=True))["EventId"] == first["EventId"]
            await refused("BadSubscriptionIdInvalid", types, REFRESH, wrong)
            await refused("BadMonitoredItemIdInvalid", types, REFRESH2, number, wrong)


async def test_all_states_outlive_a_restart(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(confirm=True, fault=["mobile"]))
    async with serving(tmp_path, config) as running, running.client() as client, watching(client) as watched:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        await say(running, client, 1.8)
        active = await watched.next(ActiveState_Id=True)
        fault = await watched.next(ActiveState_Id=True, SourceName="rover")
        assert fault["Message"].Text.startswith("rover lacks mobile: rover.speed: 1.8 m/s is above 1.5 m/s")
        alarm = client.get_node(ALARM)
        await alarm.call_method(ACKNOWLEDGE, active["EventId"], text("seen"))
        await client.get_node(f"{ALARM}.ShelvingState").call_method(ONE_SHOT)
        last = await watched.next(SuppressedOrShelved=True)
    async with serving(tmp_path, config) as running, running.client() as client, watching(client) as watched:
        number = ua.Variant(watched.subscription.subscription_id, ua.VariantType.UInt32)
        await client.get_node(ua.NodeId(2782, 0)).call_method(REFRESH, number)
        again = await watched.next()
        same = [name for name in FIELDS if name != "Quality"]
        assert {name: again[name] for name in same} == {name: last[name] for name in same}
        await client.get_node(ALARM).call_method(CONFIRM, last["EventId"], text("mended"))
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        await say(running, client, 0.5)
        over = await watched.next(ActiveState_Id=False)
        assert over["ShelvingState/CurrentState"].Text == "Unshelved"
        assert (await watched.next(SourceName="rover", ActiveState_Id=False))["Message"].Text.startswith("rover: over")


async def test_a_kill_between_an_alarm_and_its_fault_leaves_them_agreed(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are two commits: the next start has the fault follow the alarm, in both directions."""
    config = fleet_config(udp_url, tcp_port, robots=robots(fault=["mobile"]))
    fault = "ns=2;s=Fleet.Faults.rover.alarm.speed.ActiveState.Id"

    def nothing(_news: RobotNews, _found: object) -> None:
        """The fault's commit never comes."""

    async def killed(value: float, *, active: bool) -> None:
        """A server that writes down the alarm, and ends before the fault."""
        with monkeypatch.context() as cut:
            cut.setattr(RobotNews, "alarms_found", nothing)
            async with serving(tmp_path, config) as running, running.client() as client:
                running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
                await say(running, client, value)
                await until(reader(client, f"{ALARM}.ActiveState.Id"), lambda found: found.Value.Value is active)

    await killed(1.2, active=True)
    async with serving(tmp_path, config) as running, running.client() as client:
        await until(reader(client, fault), lambda found: found.Value.Value is True)
    await killed(0.5, active=False)
    async with serving(tmp_path, config) as running, running.client() as client:
        await until(reader(client, fault), lambda found: found.Value.Value is False)


async def test_a_certificate_that_ends_is_an_alarm(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port)
    folder = certificates_folder(tmp_path / config.server.state_dir) / "trusted"
    folder.mkdir(parents=True)
    files = CertificateFiles(folder / "plc.der", tmp_path / "plc.pem")
    create_certificate(files, application_uri="urn:plc", common_name="plc", days=5)
    async with serving(tmp_path, config) as running, running.client() as client:
        path = "ns=2;s=Alarms.certificates.trusted.plc"
        await until(reader(client, f"{path}.Retain"), lambda found: found.Value.Value is True)
        alarm = client.get_node(path)
        assert (await alarm.read_type_definition()) == ua.NodeId(ua.ObjectIds.CertificateExpirationAlarmType, 0)
        message = await client.get_node(f"{path}.Message").read_value()
        assert message.Text.startswith("certificate trusted.plc: expires on ")
        assert message.Text.endswith("then: ua-fleet cert trust FILE")
        assert await client.get_node(f"{path}.Certificate").read_value() == files.certificate.read_bytes()
        ends = await client.get_node(f"{path}.ExpirationDate").read_value()
        assert 3 <= (ends.replace(tzinfo=UTC) - datetime.now(UTC)).days <= 5


async def test_a_bridge_that_is_away_is_an_alarm(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port)
    async with serving(tmp_path, config) as running, running.client() as client, watching(client) as watched:
        away = await watched.next(SourceName="mobile_side", ActiveState_Id=True)
        assert away["Severity"] == 700
