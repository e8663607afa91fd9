"""Robots' data on its way to OPC UA clients, through the whole server."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from tests.integration.server_model.harness import (
    OBSERVER,
    POSE,
    SPACE,
    SPEED,
    STATUS,
    fleet_config,
    reader,
    serving,
    until,
)
from ua_fleet.config.schema import UnknownSources
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage

DOUBLE = BuiltinType.DOUBLE
STRING = BuiltinType.STRING
FIELD = (make_field("data", DOUBLE),)
UNKNOWN = Topic(SPACE, 2, 700)


def status(data: Any) -> str:
    return str(data.StatusCode.name)


async def test_data_reaches_a_client_and_silence_makes_it_bad_until_it_returns(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        peer, speed = running.peer, reader(client, "ns=2;i=1001")
        assert status(await speed()) == "BadWaitingForInitialData"
        state = reader(client, "ns=2;s=Robots.rover.State")
        assert (await state()).Value.Value == 0

        peer.announce(SPEED, FIELD)
        peer.publish(SPEED, 0.5)
        heard = await until(speed, lambda data: status(data) == "Good")
        assert heard.Value.Value == 0.5
        assert heard.SourceTimestamp is not None
        await until(state, lambda data: data.Value.Value == 1)

        # Only keep-alives come now: the value stays good, with its own time.
        await asyncio.sleep(1.2)
        kept = await speed()
        assert (status(kept), kept.SourceTimestamp) == ("Good", heard.SourceTimestamp)

        peer.mute()
        silent = await until(speed, lambda data: status(data) == "BadNoCommunication")
        assert (silent.Value.Value, silent.SourceTimestamp) == (0.5, heard.SourceTimestamp)
        await until(state, lambda data: data.Value.Value == 0)

        peer.unmute()
        back = await until(speed, lambda data: status(data) == "Good")
        assert (back.Value.Value, back.SourceTimestamp) == (0.5, heard.SourceTimestamp)
        await until(state, lambda data: data.Value.Value == 1)


async def test_a_source_that_ends_says_so_at_once(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        peer, speed = running.peer, reader(client, "ns=2;i=1001")
        peer.announce(SPEED, FIELD)
        peer.publish(SPEED, 0.5)
        await until(speed, lambda data: status(data) == "Good")
        peer.lose(SPEED)
        lost = await until(
            speed, lambda data: status(data) == "BadNoCommunication", timeout_s=2
        )  # and not when it would be silent, after 3 s
        assert lost.Value.Value == 0.5
        peer.publish(SPEED, 0.75)
        assert (await until(speed, lambda data: status(data) == "Good")).Value.Value == 0.75


async def test_what_does_not_fit_is_bad_and_the_rest_goes_on(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        peer = running.peer
        peer.announce(SPEED, (make_field("data", STRING),))
        peer.publish(SPEED, "fast")
        peer.announce(POSE, (make_field("frame", STRING), make_field("x", DOUBLE)))
        peer.publish(POSE, "map", 1.5)
        await until(reader(client, "ns=2;i=1001"), lambda data: status(data) == "BadTypeMismatch")
        x = await until(reader(client, "ns=2;s=1004.x"), lambda data: status(data) == "Good")
        assert x.Value.Value == 1.5
        drops = reader(client, "ns=2;s=Fleet.Traffic.Drops.conversion")
        await until(drops, lambda data: data.Value.Value == 1)


async def test_a_subscription_gets_the_first_and_the_last_of_a_burst(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        peer = running.peer
        told: list[Any] = []

        class Handler:
            def datachange_notification(self, node: Any, val: Any, data: Any) -> None:
                told.append(data.monitored_item.Value)

        subscription: Any = await client.create_subscription(20, Handler())
        await subscription.subscribe_data_change(client.get_node("ns=2;i=1001"), queuesize=100)
        peer.announce(SPEED, FIELD)
        for number in range(100):
            peer.publish(SPEED, number / 100)
        last = await until(reader(client, "ns=2;i=1001"), lambda data: data.Value.Value == 0.99)

        async def newest() -> Any:
            return told[-1] if told else None

        await until(newest, lambda data: data is not None and data.Value.Value == 0.99)
        good = [data.Value.Value for data in told if status(data) == "Good"]
        assert good[0] == 0.0
        assert len(good) < 10
        assert told[-1].SourceTimestamp == last.SourceTimestamp
        await subscription.delete()


async def test_a_bridges_status_is_its_object(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        peer = running.peer
        online = reader(client, "ns=2;s=1900.Online")
        await until(online, lambda data: status(data) == "Good" and data.Value.Value is False)
        uint64 = BuiltinType.UINT64
        peer.announce(
            STATUS,
            (
                make_field("Connected", BuiltinType.BOOLEAN),
                make_field("MessagesIn", uint64),
                make_field("Drops.loop", uint64),
            ),
        )
        peer.publish(STATUS, True, 12, 3)
        await until(online, lambda data: data.Value.Value is True)
        await until(reader(client, "ns=2;s=1900.MessagesIn"), lambda data: data.Value.Value == 12)
        assert (await reader(client, "ns=2;s=1900.Drops.loop")()).Value.Value == 3
        await until(reader(client, "ns=2;s=1900.LastSeen"), lambda data: status(data) == "Good")
        peer.mute()
        await until(online, lambda data: data.Value.Value is False)
        assert status(await reader(client, "ns=2;s=1900.Connected")()) == "BadNoCommunication"


async def test_unknown_sources_get_nodes_where_that_is_the_policy(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, unknown_sources=UnknownSources.CREATE)
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        peer = running.peer
        peer.announce(UNKNOWN, (make_field("x", DOUBLE), make_field("y", DOUBLE)))
        peer.publish(UNKNOWN, 1.0, 2.0)
        y = await until(reader(client, "ns=2;s=700.y"), lambda data: status(data) == "Good")
        assert y.Value.Value == 2.0
        group = client.get_node("ns=2;s=Fleet.Discovered.Sources.G00")
        assert [node.nodeid.to_string() for node in await group.get_children()] == ["ns=2;i=700"]


async def test_unknown_sources_are_listed_where_they_are_quarantined(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        peer = running.peer
        peer.announce(UNKNOWN, (make_field("x", DOUBLE, properties={"RosType": "std_msgs/Float64"}),))
        peer.publish(UNKNOWN, 1.0)
        listed = reader(client, f"ns=2;s=Fleet.Discovered.Quarantine.{UNKNOWN.name}.MessageType")
        assert (await until(listed, lambda data: status(data) == "Good")).Value.Value == "std_msgs/Float64"
        assert status(await reader(client, "ns=2;i=700")()) == "BadNodeIdUnknown"
        drops = reader(client, "ns=2;s=Fleet.Traffic.Drops.unknown_source")
        await until(drops, lambda data: data.Value.Value >= 1)


async def test_a_source_that_announces_no_metadata_is_listed_with_the_reason(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        part = DataSetMessage(UNKNOWN.id, types=(int(DOUBLE),), values=(1.0,))
        listed = reader(client, f"ns=2;s=Fleet.Discovered.Quarantine.{UNKNOWN.name}.Reason")

        async def said() -> Any:
            running.peer.send(Codec().encode(NetworkMessage(SPACE, writer_group_id=2, messages=(part,))))
            return await listed()

        reason = await until(said, lambda data: status(data) == "Good")
        assert reason.Value.Value == "it announces no metadata; state its fields in `sources` of fleet.yaml"
        age = await client.get_node("ns=2;i=1001").get_child("3:MaxAge")
        assert await age.read_value() == 0.0


async def test_a_second_claimant_never_overwrites(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    from tests.integration.peer import Peer

    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        speed = reader(client, "ns=2;i=1001")
        running.peer.announce(SPEED, FIELD)
        running.peer.publish(SPEED, 0.5)
        await until(speed, lambda data: status(data) == "Good")
        async with Peer.at(udp_url, 7) as other:
            claimed = SPEED._replace(space=7)
            other.announce(claimed, FIELD)
            other.publish(claimed, 1.25)
            drops = reader(client, "ns=2;s=Fleet.Traffic.Drops.conflict")
            await until(drops, lambda data: data.Value.Value >= 1)
        assert (await speed()).Value.Value == 0.5


async def test_garbage_is_counted_and_nothing_else_happens(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        for datagram in (b"", b"\xff" * 100, b"\x01", bytes(1400)):
            running.peer.send(datagram)
        drops = reader(client, "ns=2;s=Fleet.Traffic.Drops.malformed")
        await until(drops, lambda data: data.Value.Value >= 3)
        running.peer.announce(SPEED, FIELD)
        running.peer.publish(SPEED, 0.5)
        await until(reader(client, "ns=2;i=1001"), lambda data: status(data) == "Good")
