"""Clients' writes on their way to the robots, through the whole server."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.integration.peer import Peer
from tests.integration.server_model.harness import (
    GOAL,
    OBSERVER,
    VELOCITY,
    fleet_config,
    reader,
    serving,
    ua,
    until,
)
from ua_fleet.topics import LoopVerdict, Side
from ua_fleet.values import StatusCode, datetime_from_ticks

DOUBLE = ua.VariantType.Double


def valued(**options: Any) -> Any:
    """A value with a status or a time that a client gives it."""
    return ua.DataValue(ua.Variant(0.5, DOUBLE), **options)


async def write(client: Any, *writes: tuple[str, Any]) -> list[str]:
    """Write Variants in one request; the names of the StatusCodes."""
    nodes = [client.get_node(node_id) for node_id, _ in writes]
    values = [value if isinstance(value, ua.DataValue) else ua.DataValue(value) for _, value in writes]
    results = await client.write_values(nodes, values, raise_on_partial_error=False)
    return [str(result.name) for result in results]


async def test_a_write_is_published_with_the_nodes_time(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        peer = running.peer
        await peer.until(lambda: peer.good(GOAL) == [(0.0,)])
        assert await write(client, ("ns=2;i=1002", ua.Variant(0.5, DOUBLE))) == ["Good"]
        await peer.until(lambda: peer.good(GOAL)[-1] == (0.5,))
        node = await reader(client, "ns=2;i=1002")()
        assert node.Value.Value == 0.5
        timestamp = peer.messages(GOAL)[-1].timestamp
        assert timestamp is not None
        assert node.SourceTimestamp == datetime_from_ticks(timestamp)


async def test_the_time_that_a_client_gives_is_the_nodes_and_is_published(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    """It was Good, and dropped."""
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        peer = running.peer
        await peer.until(lambda: peer.good(GOAL) == [(0.0,)])
        level = await client.get_node("ns=2;i=1002").get_user_access_level()
        assert ua.AccessLevel.TimestampWrite in level, "else it were Bad_WriteNotSupported (OPC 10000-4 5.11.4)"
        assert ua.AccessLevel.StatusWrite not in level
        given = datetime.now(UTC)
        assert await write(client, ("ns=2;i=1002", valued(SourceTimestamp=given))) == ["Good"]
        await peer.until(lambda: peer.good(GOAL)[-1] == (0.5,))
        assert (await reader(client, "ns=2;i=1002")()).SourceTimestamp == given
        assert datetime_from_ticks(peer.messages(GOAL)[-1].timestamp or 0) == given
        assert await write(client, ("ns=2;i=1002", valued(SourceTimestamp=given))) == ["BadWriteNotSupported"]
        # The fields of one DataSet are published together, so they may have the same time.
        async with running.client(OBSERVER) as observer:
            assert await observer.get_node("ns=2;i=1002").get_user_access_level() == {ua.AccessLevel.CurrentRead}
        same = [valued(SourceTimestamp=datetime.now(UTC))] * 2
        fields = zip(("ns=2;s=1003.linear.x", "ns=2;s=1003.angular.z"), same, strict=True)
        assert await write(client, *fields) == ["Good", "Good"]


async def test_both_fields_of_one_request_are_published_once(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        peer = running.peer
        one, two = ua.Variant(0.1, DOUBLE), ua.Variant(0.2, DOUBLE)
        assert await write(client, ("ns=2;s=1003.linear.x", one), ("ns=2;s=1003.angular.z", two)) == ["Good"] * 2
        await peer.until(lambda: peer.good(VELOCITY))
        assert peer.good(VELOCITY) == [(0.1, 0.2)]
        assert peer.properties(VELOCITY)["RosType"] == "geometry_msgs/Twist"
        await write(client, ("ns=2;s=1003.linear.x", two))
        await peer.until(lambda: len(peer.good(VELOCITY)) == 2)
        assert peer.good(VELOCITY)[-1] == (0.2, 0.2)


async def test_fields_of_one_request_are_published_once_also_where_it_takes_several_turns(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first was published alone, and the second was refused then, since its time was that of the publication."""
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        peer = running.peer
        monkeypatch.setattr("ua_fleet.endpoint.turns.TURN_S", -1.0)  # a turn for each operation
        same = valued(SourceTimestamp=datetime.now(UTC))
        fields = ("ns=2;s=1003.linear.x", same), ("ns=2;s=1003.angular.z", same)
        assert await write(client, *fields) == ["Good", "Good"]
        await peer.until(lambda: peer.good(VELOCITY))
        assert peer.good(VELOCITY) == [(0.5, 0.5)]


async def test_a_field_that_was_never_written_is_bad_in_the_publication(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        peer = running.peer
        await write(client, ("ns=2;s=1003.linear.x", ua.Variant(0.1, DOUBLE)))
        await peer.until(lambda: peer.messages(VELOCITY))
        assert peer.messages(VELOCITY)[0].values == (0.1, StatusCode.BAD_WAITING_FOR_INITIAL_DATA)


async def test_every_write_of_a_request_is_published(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        peer = running.peer
        await peer.until(lambda: peer.good(GOAL))
        values = [0.1, 0.2, 0.1, 0.3]
        await write(client, *(("ns=2;i=1002", ua.Variant(value, DOUBLE)) for value in values))
        await peer.until(lambda: len(peer.good(GOAL)) >= 5)
        assert [value for (value,) in peer.good(GOAL)[1:]] == values
        stamps = [message.timestamp or 0 for message in peer.messages(GOAL)]
        assert stamps == sorted(set(stamps))


@pytest.mark.parametrize(
    ("node_id", "value", "expected"),
    [
        ("ns=2;i=1002", ua.Variant(1.5, DOUBLE), "BadOutOfRange"),
        ("ns=2;i=1002", ua.Variant(math.nan, DOUBLE), "BadOutOfRange"),
        ("ns=2;i=1002", ua.Variant(1, ua.VariantType.Int32), "BadTypeMismatch"),
        ("ns=2;i=1002", ua.Variant([0.5], DOUBLE), "BadTypeMismatch"),
        ("ns=2;i=1002", ua.Variant(), "BadTypeMismatch"),
        ("ns=2;i=1001", ua.Variant(0.5, DOUBLE), "BadNotWritable"),
        ("ns=2;s=Robots.rover.State", ua.Variant(1, ua.VariantType.Int32), "BadNotWritable"),
        ("ns=2;i=1002", valued(StatusCode=ua.StatusCode(0x4000_0000)), "BadWriteNotSupported"),
        ("ns=2;i=1002", valued(StatusCode=ua.StatusCode(0x0000_0400)), "BadWriteNotSupported"),
        ("ns=2;i=1002", valued(ServerTimestamp=datetime.now(UTC)), "BadWriteNotSupported"),
        ("ns=2;i=1002", valued(SourceTimestamp=datetime.now(UTC), SourcePicoseconds=1), "BadWriteNotSupported"),
        ("ns=2;i=1002", valued(SourceTimestamp=datetime(2001, 1, 1, tzinfo=UTC)), "BadWriteNotSupported"),
        ("ns=2;i=1002", valued(SourceTimestamp=datetime(2101, 1, 1, tzinfo=UTC)), "BadWriteNotSupported"),
    ],
    ids=[
        *("range", "nan", "type", "array", "null", "robots", "state"),
        *("uncertain", "good_bits", "server_time", "picoseconds", "past", "future"),
    ],
)
async def test_what_may_not_be_written_is_refused_and_not_published(
    node_id: str, value: Any, expected: str, udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        peer = running.peer
        await peer.until(lambda: peer.good(GOAL))
        before = (await reader(client, node_id)()).Value
        assert await write(client, (node_id, value)) == [expected]
        assert await write(client, ("ns=2;i=1002", ua.Variant(0.25, DOUBLE))) == ["Good"]
        await peer.until(lambda: peer.good(GOAL)[-1] == (0.25,))
        assert peer.good(GOAL) == [(0.0,), (0.25,)]
        if node_id != "ns=2;i=1002":
            assert (await reader(client, node_id)()).Value == before


async def test_an_observer_may_not_write(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client(OBSERVER) as client:
        assert await write(client, ("ns=2;i=1002", ua.Variant(0.5, DOUBLE))) == ["BadUserAccessDenied"]


async def test_a_bridge_that_comes_late_gets_the_last_value(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        await write(client, ("ns=2;i=1002", ua.Variant(0.75, DOUBLE)))
        async with Peer.at(udp_url, 3) as late:
            await late.until(lambda: late.good(GOAL) == [(0.75,)])


async def test_the_server_hears_itself_and_drops_it(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client() as client:
        await write(client, ("ns=2;i=1002", ua.Variant(0.75, DOUBLE)))
        drops = reader(client, "ns=2;s=Fleet.Traffic.Drops.loop")
        await until(drops, lambda data: data.Value.Value >= 1)
        assert (await reader(client, "ns=2;s=Fleet.Traffic.Looped")()).Value.Value == 0


def no_rule(side: Side, _origin: int, _own_space: int, _own_publication: bool) -> LoopVerdict:
    return LoopVerdict.TO_SPACE if side is Side.PUBSUB else LoopVerdict.TO_PUBSUB


async def test_without_the_loop_rule_deliveries_are_counted_as_looped(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    config = fleet_config(udp_url, tcp_port)
    async with serving(tmp_path, config, rule=no_rule) as running, running.client() as client:
        await write(client, ("ns=2;i=1002", ua.Variant(0.75, DOUBLE)))
        looped = reader(client, "ns=2;s=Fleet.Traffic.Looped")
        await until(looped, lambda data: data.Value.Value >= 1)


def has(peer: Peer, value: float) -> bool:
    return (value,) in peer.good(GOAL)


async def test_a_restarted_server_goes_on(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port)
    async with Peer.at(udp_url, 3) as peer:
        for value in (0.25, 0.75):
            async with serving(tmp_path, config) as running, running.client() as client:
                assert await write(client, ("ns=2;i=1002", ua.Variant(value, DOUBLE))) == ["Good"]
                await peer.until(partial(has, peer, value))
        stamps = [message.timestamp or 0 for message in peer.messages(GOAL)]
        assert stamps == sorted(set(stamps))
