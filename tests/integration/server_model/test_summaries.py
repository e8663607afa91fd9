"""`Fleet/Summaries`, as clients see it: what a list of all robots shows, through the whole server."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import pytest
from asyncua.client.client import Client
from asyncua.ua.uaerrors import BadNotWritable

from tests.integration.peer import Peer
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
from ua_fleet.fleet.summaries import PERIOD_S
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

FIELD: Final = (make_field("data", BuiltinType.DOUBLE),)
NULL: Final = datetime(1601, 1, 1, tzinfo=UTC)
FIRST: Final = "ns=2;s=Fleet.Summaries.1"
OFFLINE, IDLE = 0, 1


def robots(count: int) -> dict[str, Any]:
    return {
        f"r{number}": {"bridge": "mobile_side", "data": {"v": {"id": 1 + number, "type": "Double"}}}
        for number in range(count)
    }


@asynccontextmanager
async def driving(peer: Peer) -> AsyncGenerator[None]:
    """The rover tells its speed all the time: keep-alives alone come too seldom for the harness's short times."""
    peer.announce(SPEED, FIELD)

    async def drive() -> None:
        while True:
            peer.publish(SPEED, 0.5)
            await asyncio.sleep(0.1)

    task = asyncio.ensure_future(drive())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])


async def group(client: Client, number: int = 1) -> list[Any]:
    return list(await client.get_node(f"ns=2;s=Fleet.Summaries.{number}").read_value())


async def rover(client: Client) -> Any:
    (summary,) = await group(client)
    return summary


async def rover_is(client: Client, quality: str, state: int, timeout_s: float = 60) -> Any:
    return await until(lambda: rover(client), lambda one: (one.Quality.name, one.State) == (quality, state), timeout_s)


async def test_good_is_what_came_and_a_silent_robot_keeps_its_last_time(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    config = fleet_config(udp_url, tcp_port)
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        first = await rover(client)
        assert (first.Name, first.State, first.Quality.name) == ("rover", OFFLINE, "BadWaitingForInitialData")
        assert (first.LastUpdate, first.Bridge, first.Capacities) == (NULL, "mobile_side", ["mobile"])
        assert (first.Task, first.RunId, first.Held, first.HeldBy) == ("", "", False, "")
        assert (first.Faults, first.Fault) == (0, "")

        async with driving(running.peer):
            heard = await rover_is(client, "Good", IDLE)
            state = await reader(client, "ns=2;s=Robots.rover.State")()
            assert heard.StateSince == state.SourceTimestamp
            await until(lambda: rover(client), lambda one: one.LastUpdate != NULL)

            running.peer.mute()
            silent = await rover_is(client, "BadNoCommunication", OFFLINE)
            assert silent.LastUpdate == await client.get_node("ns=2;s=Robots.rover.LastUpdate").read_value() != NULL
            assert silent.StateSince > heard.StateSince
            running.peer.unmute()
            await rover_is(client, "Good", IDLE)
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        again = await rover(client)
        assert (again.State, again.Quality.name, again.LastUpdate) == (OFFLINE, "BadWaitingForInitialData", NULL)


async def test_faults_and_holds_are_told(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with (
        serving(tmp_path, fleet_config(udp_url, tcp_port)) as running,
        running.client(OPERATOR) as client,
        driving(running.peer),
    ):
        await rover_is(client, "Good", IDLE)
        text = ua.Variant("mobile: the drive is hot", ua.VariantType.String)
        faults = client.get_node("ns=2;s=Fleet.Faults")
        await faults.call_method("3:RaiseFault", ua.Variant("rover"), text)
        hot = "lacks mobile: the drive is hot"
        faulted = await until(lambda: rover(client), lambda one: one.Fault == hot)
        assert faulted.Faults >= 1  # it may be silent too, on a busy machine
        robot = client.get_node("ns=2;s=Robots.rover")
        await robot.call_method("3:Hold", ua.Variant("a new tyre", ua.VariantType.String))
        held = await until(lambda: rover(client), lambda one: one.Held)
        assert (held.HeldBy, held.HeldReason, held.Fault) == (OPERATOR[0], "a new tyre", hot)
        assert held.HeldSince == await client.get_node("ns=2;s=Robots.rover.HeldSince").read_value()
        await faults.call_method("3:ClearFault", ua.Variant("rover"))
        await robot.call_method("3:Release")
        await until(
            lambda: rover(client), lambda one: (one.Held, one.HeldBy, one.Faults, one.Fault) == (False, "", 0, "")
        )
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OPERATOR) as client:
        await client.get_node("ns=2;s=Robots.rover").call_method("3:Hold", ua.Variant("", ua.VariantType.String))
        await until(lambda: rover(client), lambda one: one.Held)
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OPERATOR) as client:
        assert (await rover(client)).HeldBy == OPERATOR[0]  # from the first moment after the restart


async def test_it_is_told_once_a_second_at_most_and_the_newest_always(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        told: list[Any] = []

        class Handler:
            def datachange_notification(self, node: Any, val: Any, data: Any) -> None:
                told.append(data.monitored_item.Value)

        subscription: Any = await client.create_subscription(20, Handler())
        await subscription.subscribe_data_change(client.get_node(FIRST), queuesize=100)
        running.peer.announce(SPEED, FIELD)
        for number in range(150):
            running.peer.publish(SPEED, number / 100)
            await asyncio.sleep(0.02)
        running.peer.lose(SPEED)
        last_update = reader(client, "ns=2;s=Robots.rover.LastUpdate")

        async def newest() -> Any:
            return told[-1].Value.Value[0]

        last = await until(newest, lambda one: one.Quality.name == "BadNoCommunication" and one.State == OFFLINE)
        await asyncio.sleep(1.5 * PERIOD_S)
        last = await newest()
        assert last.LastUpdate == (await last_update()).Value.Value
        times = [data.SourceTimestamp for data in told[1:]]  # the first is the one that was there
        pauses = [(later - earlier).total_seconds() for earlier, later in pairwise(times)]
        assert len(pauses) >= 2
        assert min(pauses) > 0.95 * PERIOD_S
        count = len(told)
        await asyncio.sleep(1.5 * PERIOD_S)
        assert len(told) == count  # nothing has changed
        await subscription.delete()


async def test_a_hundred_robots_are_in_a_variable_and_those_that_come_find_a_place(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(200))
    async with serving(tmp_path, config) as running, running.client(ENGINEER) as client:
        folder = client.get_node("ns=2;s=Fleet.Summaries")

        async def names() -> list[list[str]]:
            return [[one.Name for one in await node.read_value()] for node in await folder.get_children()]

        assert await names() == [[f"r{n}" for n in range(100)], [f"r{n}" for n in range(100, 200)], []]
        await register(client, "guest", {"description": "of clients"})
        await until(names, lambda found: found[2:] == [["guest"], []])
        fleet = client.get_node("ns=2;s=Fleet")
        await fleet.call_method("3:UnregisterRobot", ua.Variant("guest"))
        await until(names, lambda found: found[2:] == [[], []])


async def register(client: Client, name: str, definition: Mapping[str, Any]) -> None:
    text = [ua.Variant(one) for one in (name, "mobile_side")]
    more = [ua.Variant([], ua.VariantType.String, is_array=True), ua.Variant(""), ua.Variant(str(dict(definition)))]
    *_, status, message = await client.get_node("ns=2;s=Fleet").call_method("3:RegisterRobot", *text, *more)
    assert status == 0, message


async def test_its_structure_is_described(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        node = client.get_node(FIRST)
        assert (await node.read_data_type()).to_string() == "ns=3;i=3002"
        assert await node.read_value_rank() == 1
        data_type = client.get_node("ns=3;i=3002")
        definition: Any = await data_type.read_data_type_definition()
        assert definition.DefaultEncodingId.to_string() == "ns=3;i=5002"
        (field,) = [one for one in definition.Fields if one.Name == "Capacities"]
        assert (field.ValueRank, field.ArrayDimensions) == (1, [0])
        (encoding,) = await data_type.get_referenced_nodes(refs=ua.ObjectIds.HasEncoding)
        assert (await encoding.read_browse_name()).to_string() == "0:Default Binary"
        assert encoding.nodeid == definition.DefaultEncodingId
        wanted = ua.ReadValueId(NodeId=node.nodeid, AttributeId=ua.AttributeIds.Value)
        wanted.IndexRange = "0"
        wanted.DataEncoding = ua.QualifiedName("Default Binary", 0)
        (part,) = await client.uaclient.read(ua.ReadParameters(NodesToRead=[wanted]))
        assert part.Value is not None
        assert [one.Name for one in part.Value.Value] == ["rover"]
        with pytest.raises(BadNotWritable):
            await node.write_value(ua.Variant([], ua.VariantType.ExtensionObject, is_array=True))
