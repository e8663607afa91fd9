"""Mistakes of ours in each loop of a whole server: what they cost is one item, and everybody can see them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import ROBOTS, SPACE, SPEED, fleet_config, reader, serving, until
from ua_fleet.endpoint.expiry import CertificateWatch
from ua_fleet.fleet.coalesce import Coalescer
from ua_fleet.fleet.state import FleetState
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.operation.robots.offers import ClientOffers
from ua_fleet.operation.robots.roster import RobotRegistry
from ua_fleet.operation.runs.robot_news import RobotNews
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.server.core import ServerCore
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import BuiltinType

DATA = (make_field("data", BuiltinType.DOUBLE),)
BROKEN_DATA = (make_field("broken", BuiltinType.DOUBLE),)
BROKEN = 666.0


def is_servers(part: Any) -> bool:
    """Whether a part is the server's, and not the test's own peer's."""
    return bool(part._own_space == SERVER_SPACE)


class Broken(Exception):
    """What was injected."""


def breaks(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, when: Callable[..., bool]) -> None:
    """Let a method raise, where `when` says so of its arguments."""
    whole = getattr(owner, name)

    def broken(*arguments: Any, **named: Any) -> Any:
        if when(*arguments, **named):
            raise Broken(f"{owner.__name__}.{name}")
        return whole(*arguments, **named)

    monkeypatch.setattr(owner, name, broken)


def always(*_: Any) -> bool:
    return True


def is_broken_datagram(own: Any, datagram: bytes, *_: Any, **__: Any) -> bool:
    return is_servers(own) and b"broken" in datagram


def is_broken_message(_own: Any, event: Any, _wall: int) -> bool:
    return isinstance(event, DataReceived) and event.message.values[:1] == (BROKEN,)


def is_broken_change(_own: Any, change: Any, *_: Any) -> bool:
    return bool(change.value == BROKEN)


LOOPS: dict[str, tuple[str, Any, str, Callable[..., bool]]] = {
    "datagrams": ("datagrams", Subscriber, "receive", is_broken_datagram),
    "messages": ("messages", FleetState, "apply", is_broken_message),
    "values": ("changes", Coalescer, "offer", is_broken_change),
    "scenario values": ("changes", RobotNews, "value_changed", is_broken_change),
    "nodes": ("projection", FleetNodes, "add_source", always),
    "every second": ("each second", FleetState, "tick", always),
    "announced robots": ("announced robots", RobotRegistry, "tick", always),
    "scenario timer": ("scenarios", ScenarioService, "poll", always),
    "its deadline": ("scenarios", ScenarioService, "next_deadline", always),
    "a clock": ("CertificateWatch", CertificateWatch, "poll", always),
    "another clock": ("ClientOffers", ClientOffers, "poll", always),
    "keep-alives": ("publisher", ServerCore, "_poll_publisher", always),
}


@pytest.mark.parametrize("which", LOOPS)
async def test_a_mistake_costs_one_item(
    which: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, udp_url: str, tcp_port: int
) -> None:
    loop, owner, name, when = LOOPS[which]
    breaks(monkeypatch, owner, name, when)
    config = fleet_config(udp_url, tcp_port, unknown_sources="create")
    async with serving(tmp_path, config) as running, running.client() as client:
        running.peer.announce(Topic(SPACE, 2, 777), BROKEN_DATA)
        running.peer.announce(SPEED, DATA)
        for value in (BROKEN, 0.5):
            running.peer.publish(SPEED, value)
        data = await until(reader(client, "ns=2;i=1001"), lambda data: data.Value.Value == 0.5)
        assert data.StatusCode.is_good()
        count = await until(reader(client, "ns=2;s=Server.Mistakes"), lambda data: (data.Value.Value or 0) >= 1)
        assert count.StatusCode.is_good()
        last = await client.get_node("ns=2;s=Server.LastMistake").read_value()
        assert last.startswith(f"{loop}: Broken: ")
        status = await client.get_node("ns=0;i=2256").get_children()
        assert {"ns=2;s=Server.Mistakes", "ns=2;s=Server.LastMistake"} <= {node.nodeid.to_string() for node in status}
        running.peer.publish(SPEED, 1.5)
        await until(reader(client, "ns=2;i=1001"), lambda data: data.Value.Value == 1.5)


async def test_a_source_with_a_skills_id_is_a_conflict_and_the_server_goes_on(
    tmp_path: Path, udp_url: str, tcp_port: int
) -> None:
    rover = {**ROBOTS["rover"], "skill_status_id": 1800, "skills": {"wave": {"id": 1700, "timeout_s": 5}}}
    config = fleet_config(udp_url, tcp_port, robots={"rover": rover}, unknown_sources="create")
    async with serving(tmp_path, config) as running, running.client() as client:
        running.peer.announce(Topic(SPACE, 2, 1700), DATA)
        running.peer.publish(Topic(SPACE, 2, 1700), 1.0)
        await until(reader(client, "ns=2;s=Fleet.Traffic.Drops.conflict"), lambda data: (data.Value.Value or 0) >= 1)
        running.peer.announce(SPEED, DATA)
        running.peer.publish(SPEED, 0.5)
        await until(reader(client, "ns=2;i=1001"), lambda data: data.Value.Value == 0.5)
        assert await client.get_node("ns=2;s=Server.Mistakes").read_value() == 0
