"""The information model of PubSub asks bridges for what it does not know of them."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any

from asyncua.server.server import Server

from tests.standard_space import quick_start
from ua_fleet.counters import Counters
from ua_fleet.endpoint.standard_model import fill_pubsub, remove_unsupported
from ua_fleet.operation.pubsub.bridges import AnnouncedConnection
from ua_fleet.pubsub import Publisher, PubSubTiming
from ua_fleet.pubsub.events import AnnouncementReceived
from ua_fleet.server.pubsub_model import PubSubModel
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ConnectionsAnnouncement
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, ProbeKind

METADATA = DataSetMetaData("SwitchPubSub", (), ConfigurationVersion(1, 1))


def nothing(*_: Any) -> None:
    """Takes whatever it is given."""


def the_same(node: Any) -> Any:
    return node


async def a_model(wanted: list[tuple[int, ProbeKind, float]]) -> PubSubModel:
    """Of a server with the bridge 3, which is not heard."""
    with quick_start():
        made: Any = Server()
        await made.init()
    space = made.iserver.aspace
    remove_unsupported(space, key_service=False)
    fill_pubsub(space, key_service=False)
    server: Any = SimpleNamespace(
        iserver=made.iserver,
        context=SimpleNamespace(housekeeping=[], waiting_methods=set()),
        get_node=the_same,
        link_method=nothing,
        require_role=nothing,
    )

    def want(space: int, kind: ProbeKind, now: float) -> None:
        wanted.append((space, kind, now))

    received: Counter[int] = Counter()
    subscriber = SimpleNamespace(writers={}, received_messages=received, want=want)
    facts: Any = SimpleNamespace(
        publisher=Publisher(0, PubSubTiming(), Counters(), Codec()),
        subscriber=subscriber,
        publishers={3: "line"},
        problems=lambda: [""],
        address="".format,
    )
    requests: Any = SimpleNamespace(announced=nothing)
    return PubSubModel(
        server,
        2,
        facts,
        {"line": 3},
        status_topics={},
        requests=requests,
        is_heard=lambda _name: False,
        hear=lambda _events: None,
        send=lambda _datagram: None,
        clock=lambda: 50.0,
        wall_ticks=lambda: 0,
    )


async def test_a_bridge_that_only_announces_its_actions_is_asked_for_its_connection() -> None:
    wanted: list[tuple[int, ProbeKind, float]] = []
    model = await a_model(wanted)
    for space in (3, 4):
        announcement = ActionMetaDataAnnouncement(space, 1, 0, 1001, (), METADATA, METADATA)
        model.follow(AnnouncementReceived(announcement))
    assert wanted == [(3, ProbeKind.PUBSUB_CONNECTIONS, 50.0)]
    connection = Publisher(3, PubSubTiming(), Counters(), Codec()).configuration()
    model.follow(AnnouncementReceived(ConnectionsAnnouncement(3, 1, 0, (connection,))))
    bridge: AnnouncedConnection = model.bridges[3]
    assert bridge.is_announced
    model.follow(AnnouncementReceived(ActionMetaDataAnnouncement(3, 1, 0, 1001, (), METADATA, METADATA)))
    assert len(wanted) == 1
