"""The information model of PubSub (OPC 10000-14 clause 9) of a whole server with a real bridge."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import pytest
from asyncua.client.client import Client

from tests.integration.server_model.harness import (
    ENGINEER,
    OBSERVER,
    OPERATOR,
    SPACE,
    Running,
    fleet_config,
    reader,
    serving,
    ua,
    until,
)
from tests.integration.server_model.test_walks import OneSource
from ua_fleet.bridge import run_bridge
from ua_fleet.operation.pubsub import bridges
from ua_fleet.server import pubsub_model
from ua_fleet.transport.udp import UdpTransport

DISABLED, PAUSED, OPERATIONAL = 0, 1, 2
ROOT: Final = "i=14443"
SERVER: Final = "ns=2;s=PubSub.server"
BRIDGE: Final = "ns=2;s=PubSub.bridges.mobile_side"
SPEED_WRITER: Final = f"{BRIDGE}.W2.1001"
SPEED_READER: Final = f"{SERVER}.R{SPACE}.2.1001"
GOAL_WRITER: Final = f"{SERVER}.W2.1002"
NEVER_KNOWN: Final = {"BadWaitingForInitialData"}
"""What a value may be that is not there yet."""


class Fleet:
    """A server with a bridge that has one source."""

    def __init__(self, running: Running, source: OneSource) -> None:
        self.running, self.source = running, source


@asynccontextmanager
async def a_fleet(folder: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[Fleet]:
    config, source = fleet_config(udp_url, tcp_port), OneSource()
    async with serving(folder, config) as running:
        transport = UdpTransport(udp_url, "lo", hears_itself=False)
        bridge = asyncio.ensure_future(
            run_bridge(config, "mobile_side", source, transport, state_dir=folder / "bridge")
        )
        try:
            async with running.client() as client:
                await until(reader(client, f"{SPEED_WRITER}.Status.State"), lambda data: data.StatusCode.is_good())
            yield Fleet(running, source)
        finally:
            bridge.cancel()
            await asyncio.wait([bridge])


async def value(client: Client, node_id: str) -> Any:
    return await client.get_node(node_id).read_value()


async def switch(client: Client, key: str, method: str) -> None:
    """Call Enable or Disable as the type has it."""
    node = getattr(ua.ObjectIds, f"PubSubStatusType_{method}")
    await client.get_node(f"{key}.Status").call_method(ua.NodeId(node))


async def crawled(client: Client) -> dict[str, Any]:
    """The DataValues of all Variables below PublishSubscribe, by the way down to each."""
    found: dict[str, Any] = {}
    waiting: list[tuple[Any, str]] = [(client.get_node(ROOT), "")]
    seen = {ROOT}
    while waiting:
        node, way = waiting.pop()
        for reference in await node.get_references(ua.ObjectIds.HierarchicalReferences, ua.BrowseDirection.Forward):
            key = reference.NodeId.to_string()
            path = f"{way}/{reference.BrowseName.Name}"
            child = client.get_node(reference.NodeId)
            if reference.NodeClass == ua.NodeClass.Variable:
                found[path] = await child.read_data_value(raise_on_bad_status=False)
            if key not in seen and reference.NodeClass != ua.NodeClass.Method:
                seen.add(key)
                waiting.append((child, path))
    return found


async def test_what_can_be_read_is_right_or_absent(tmp_path: Path, udp_url: str, tcp_port: int) -> None:
    async with a_fleet(tmp_path, udp_url, tcp_port) as fleet, fleet.running.client(OBSERVER) as client:
        fleet.source.heard(1.5)
        await until(reader(client, "ns=2;i=1001"), lambda data: data.StatusCode.is_good())
        read = await crawled(client)
        wrong = {
            way: data
            for way, data in read.items()
            if data.StatusCode.is_good() is (data.Value is None or data.Value.Value is None)
            or (not data.StatusCode.is_good() and data.StatusCode.name not in NEVER_KNOWN)
        }
        assert not wrong, list(wrong.items())[:3]
        values = {way: data.Value.Value for way, data in read.items() if data.StatusCode.is_good()}
        own, bridge = "/Fleet server", "/bridge mobile_side"
        assert values["/Status/State"] == OPERATIONAL
        assert values["/SupportedTransportProfiles"][0].endswith("pubsub-udp-uadp")
        assert (values[f"{own}/PublisherId"], values[f"{bridge}/PublisherId"]) == (0, SPACE)
        assert read[f"{bridge}/PublisherId"].Value.VariantType == ua.VariantType.UInt16
        for connection in (own, bridge):
            assert values[f"{connection}/TransportProfileUri"].endswith("pubsub-udp-uadp")
            assert values[f"{connection}/Address/Url"] == udp_url
            assert values[f"{connection}/group-2/WriterGroupId"] == 2
            assert values[f"{connection}/group-2/KeepAliveTime"] == 200.0
        assert values[f"{bridge}/group-2/Diagnostics/LiveValues/ConfiguredDataSetWriters"] == 2  # its status is one
        assert values[f"{bridge}/group-2/speed/DataSetWriterId"] == 1001
        assert values[f"{bridge}/group-2/speed/MessageSettings/DataSetMessageContentMask"] == 0x3D
        names = [field.Name for field in values["/PublishedDataSets/bridge mobile_side/speed/DataSetMetaData"].Fields]
        assert names == ["data"]
        goal = values["/PublishedDataSets/Fleet server/goal/PublishedData"]
        assert [item.PublishedVariable.to_string() for item in goal] == ["ns=2;i=1002"]
        read_from = f"{own}/readers-mobile_side/ua_2_2_1001"
        assert (values[f"{read_from}/PublisherId"], values[f"{read_from}/WriterGroupId"]) == (SPACE, 2)
        assert values[f"{read_from}/MessageReceiveTimeout"] == 800.0
        [target] = values[f"{read_from}/SubscribedDataSet/TargetVariables"]
        assert target.TargetNodeId.to_string() == "ns=2;i=1001"
        meant = values[f"{read_from}/DataSetMetaData"].ConfigurationVersion
        said = values["/PublishedDataSets/bridge mobile_side/speed/ConfigurationVersion"]
        assert meant == said
        assert values[f"{read_from}/Diagnostics/LiveValues/MajorVersion"] == meant.MajorVersion


async def test_counters_move_and_are_reset_by_an_engineer(tmp_path: Path, udp_url: str, tcp_port: int) -> None:
    sent = f"{SERVER}.W2.Diagnostics.Counters.SentNetworkMessages"
    received = f"{SERVER}.R{SPACE}.Diagnostics.Counters.ReceivedNetworkMessages"
    of_bridge = f"{BRIDGE}.W2.Diagnostics.Counters.SentNetworkMessages"
    async with a_fleet(tmp_path, udp_url, tcp_port) as fleet, fleet.running.client(ENGINEER) as client:
        before = await value(client, sent), await value(client, received)
        await until(lambda: value(client, sent), lambda count: count > before[0] + 3)
        await until(lambda: value(client, received), lambda count: count > before[1] + 3)
        said = await value(client, of_bridge)
        await until(lambda: value(client, of_bridge), lambda count: count > said)
        total = await value(client, f"{SERVER}.W2.Diagnostics.TotalInformation")
        assert total >= before[0]
        diagnostics, reset = (
            client.get_node(f"{SERVER}.W2.Diagnostics"),
            ua.NodeId(ua.ObjectIds.PubSubDiagnosticsType_Reset),
        )
        await diagnostics.call_method(reset)
        assert await value(client, sent) < before[0] + 3
        async with fleet.running.client(OPERATOR) as other:
            with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
                await other.get_node(f"{SERVER}.W2.Diagnostics").call_method(reset)

        class Handler:
            def datachange_notification(self, node: Any, val: Any, data: Any) -> None:
                del node, data
                told.append(val)

        told: list[int] = []
        subscription: Any = await client.create_subscription(50, Handler())
        await subscription.subscribe_data_change([client.get_node(received)])
        async with asyncio.timeout(30):
            while len(told) < 3:
                await asyncio.sleep(0.05)
        assert sorted(told) == told


@pytest.mark.parametrize("key", [SPEED_WRITER, f"{BRIDGE}.W2", BRIDGE])
async def test_an_engineer_disables_what_a_bridge_sends_and_enables_it(
    tmp_path: Path, udp_url: str, tcp_port: int, key: str
) -> None:
    async with a_fleet(tmp_path, udp_url, tcp_port) as fleet, fleet.running.client(ENGINEER) as client:
        speed, state = reader(client, "ns=2;i=1001"), reader(client, f"{SPEED_WRITER}.Status.State")
        fleet.source.heard(1.5)
        await until(speed, lambda data: data.StatusCode.is_good() and data.Value.Value == 1.5)
        for user in (OBSERVER, OPERATOR):
            async with fleet.running.client(user) as other:
                with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
                    await switch(other, key, "Disable")
        with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
            await switch(client, key, "Enable")
        await switch(client, key, "Disable")
        await until(state, lambda data: data.Value.Value == (DISABLED if key == SPEED_WRITER else PAUSED))
        assert await value(client, f"{key}.Status.State") == DISABLED
        counted = reader(client, f"{BRIDGE}.W2.Diagnostics.Counters.StateDisabledByMethod")
        await until(speed, lambda data: not data.StatusCode.is_good())
        with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
            await switch(client, key, "Disable")
        fleet.source.heard(0.5)
        await asyncio.sleep(0.5)  # that nothing comes cannot be waited for
        assert (await speed()).Value.Value == 1.5
        await switch(client, key, "Enable")
        await until(speed, lambda data: data.StatusCode.is_good() and data.Value.Value == 0.5)
        await until(state, lambda data: data.StatusCode.is_good() and data.Value.Value == OPERATIONAL)
        switched = int(key == f"{BRIDGE}.W2")
        await until(counted, lambda data: data.StatusCode.is_good() and data.Value.Value == switched)
    logged = [json.loads(line) for line in (tmp_path / "state" / "audit.log").read_text().splitlines()]
    objects = [line["object"] for line in logged if line.get("event") == "call"]
    assert objects.count(f"{key}.Status") == 6


async def test_a_disabled_reader_takes_nothing_and_its_value_is_bad_at_once(
    tmp_path: Path, udp_url: str, tcp_port: int
) -> None:
    async with a_fleet(tmp_path, udp_url, tcp_port) as fleet, fleet.running.client(ENGINEER) as client:
        speed = reader(client, "ns=2;i=1001")
        fleet.source.heard(1.5)
        await until(speed, lambda data: data.StatusCode.is_good() and data.Value.Value == 1.5)
        await switch(client, SPEED_READER, "Disable")
        assert (await speed()).StatusCode.name == "BadNoCommunication"
        counted = f"{SPEED_READER}.Diagnostics.Counters.StateDisabledByMethod"
        assert await value(client, counted) == 1
        drops = reader(client, "ns=2;s=Fleet.Traffic.Drops.disabled")
        await until(drops, lambda data: data.StatusCode.is_good() and data.Value.Value > 0)
        fleet.source.heard(0.5)
        await switch(client, SPEED_READER, "Enable")
        await until(speed, lambda data: data.StatusCode.is_good() and data.Value.Value == 0.5)


async def test_a_disabled_writer_of_the_server_sends_nothing_of_what_clients_write(
    tmp_path: Path, udp_url: str, tcp_port: int
) -> None:
    async with a_fleet(tmp_path, udp_url, tcp_port) as fleet, fleet.running.client(ENGINEER) as client:
        await switch(client, GOAL_WRITER, "Disable")
        assert await value(client, f"{GOAL_WRITER}.Status.State") == DISABLED
        written = f"{SERVER}.W2.Diagnostics.LiveValues.OperationalDataSetWriters"
        configured = f"{SERVER}.W2.Diagnostics.LiveValues.ConfiguredDataSetWriters"
        assert await value(client, written) == await value(client, configured) - 1
        await switch(client, GOAL_WRITER, "Enable")
        assert await value(client, written) == await value(client, configured)


async def test_the_server_s_own_connection_is_disabled_and_enabled(tmp_path: Path, udp_url: str, tcp_port: int) -> None:
    sent = f"{SERVER}.W2.Diagnostics.Counters.SentNetworkMessages"
    async with a_fleet(tmp_path, udp_url, tcp_port) as fleet, fleet.running.client(ENGINEER) as client:
        speed = reader(client, "ns=2;i=1001")
        fleet.source.heard(1.5)
        await until(speed, lambda data: data.StatusCode.is_good() and data.Value.Value == 1.5)
        await switch(client, SERVER, "Disable")
        assert (await speed()).StatusCode.name == "BadNoCommunication"
        for key, state in ((SERVER, DISABLED), (GOAL_WRITER, PAUSED), (SPEED_READER, PAUSED)):
            assert await value(client, f"{key}.Status.State") == state
        count, dropped = await value(client, sent), reader(client, "ns=2;s=Fleet.Traffic.Drops.disabled")
        await until(dropped, lambda data: data.StatusCode.is_good() and data.Value.Value > 5)  # the bridge goes on
        assert await value(client, sent) == count
        await switch(client, SERVER, "Enable")
        await until(speed, lambda data: data.StatusCode.is_good() and data.Value.Value == 1.5)
        await until(lambda: value(client, sent), lambda now: now > count)
        paused = f"{GOAL_WRITER}.Diagnostics.Counters.StatePausedByParent"
        assert await value(client, paused) == 1


async def test_a_bridge_that_is_gone_leaves_states_that_are_not_good_and_refuses_to_be_switched(
    tmp_path: Path, udp_url: str, tcp_port: int
) -> None:
    config, source = fleet_config(udp_url, tcp_port), OneSource()
    async with serving(tmp_path, config) as running, running.client(ENGINEER) as client:
        with pytest.raises(ua.UaStatusCodeError, match="BadNodeIdUnknown"):
            await value(client, f"{BRIDGE}.Status.State")
        transport = UdpTransport(udp_url, "lo", hears_itself=False)
        bridge = asyncio.ensure_future(
            run_bridge(config, "mobile_side", source, transport, state_dir=tmp_path / "bridge")
        )
        state = reader(client, f"{SPEED_WRITER}.Status.State")
        try:
            await until(state, lambda data: data.StatusCode.is_good())
        finally:
            bridge.cancel()
            await asyncio.wait([bridge])
        await until(reader(client, "ns=2;s=1900.Online"), lambda data: data.Value.Value is False)
        with pytest.raises(ua.UaStatusCodeError, match=r"BadTimeout|BadNoCommunication"):
            await switch(client, SPEED_WRITER, "Disable")


async def test_a_bridge_that_was_told_to_be_silent_is_shown_as_such_until_it_is_gone(
    tmp_path: Path, udp_url: str, tcp_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pubsub_model, "LOOK_S", 1.0)
    monkeypatch.setattr(bridges, "PATIENCE_S", 4.0)
    config, source = fleet_config(udp_url, tcp_port), OneSource()
    async with serving(tmp_path, config) as running, running.client(ENGINEER) as client:
        transport = UdpTransport(udp_url, "lo", hears_itself=False)
        bridge = asyncio.ensure_future(
            run_bridge(config, "mobile_side", source, transport, state_dir=tmp_path / "bridge")
        )
        state = reader(client, f"{BRIDGE}.Status.State")
        online = reader(client, "ns=2;s=1900.Online")
        try:
            await until(state, lambda data: data.StatusCode.is_good())
            await until(reader(client, f"{BRIDGE}.W2.Status.State"), lambda data: data.StatusCode.is_good())
            await switch(client, f"{BRIDGE}.W2", "Disable")
            await until(online, lambda data: data.Value.Value is False)
            shown: list[Any] = []
            for _ in range(12):  # longer than it is patient without an answer
                shown += [await state(), await reader(client, f"{BRIDGE}.W2.Status.State")()]
                await asyncio.sleep(0.5)
            assert {(data.Value.Value, data.StatusCode.name) for data in shown[::2]} == {(OPERATIONAL, "Good")}
            assert {(data.Value.Value, data.StatusCode.name) for data in shown[1::2]} == {(DISABLED, "Good")}
            counted = await reader(client, f"{BRIDGE}.W2.Diagnostics.Counters.SentNetworkMessages")()
            assert counted.StatusCode.name == "BadNoCommunication"  # its status tells them, and is not sent
        finally:
            bridge.cancel()
            await asyncio.wait([bridge])
        await until(state, lambda data: data.StatusCode.name == "BadNoCommunication")
