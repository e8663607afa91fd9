"""The information model of PubSub asks bridges for what it does not know of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

from asyncua.server.server import Server

from tests.standard_space import quick_start
from ua_fleet.counters import Counters
from ua_fleet.endpoint.standard_model import fill_pubsub, remove_unsupported
from ua_fleet.operation.pubsub.bridges import AnnouncedConnection
from ua_fleet.pubsub import Publisher, PubSubTiming
from ua_fleet.pubsub.components import Components
from ua_fleet.pubsub.events import AnnouncementReceived
from ua_fleet.server.pubsub_model import PubSubModel
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ConnectionsAnnouncement, PubSubState
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, ProbeKind

METADATA = DataSetMetaData("SwitchPubSub", (), ConfigurationVersion(1, 1))


def nothing(*_: Any) -> None:
    """Takes whatever it is given."""


def no_group(_space: int) -> None:
    """Nothing is secured."""


def the_same(node: Any) -> Any:
    return node


async def a_model(wanted: list[tuple[int, ProbeKind, float]], clock: Sequence[float] = (50.0,)) -> PubSubModel:
    """Of a server with the bridge 3, which is not heard; the time is the first of `clock`."""
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
    subscriber = SimpleNamespace(
        writers={}, received_messages=received, refused_messages=received, want=want, components=Components()
    )
    facts: Any = SimpleNamespace(
        publisher=Publisher(0, PubSubTiming(), Counters(), Codec()),
        subscriber=subscriber,
        publishers={3: "line"},
        problems=lambda: [""],
        address="".format,
        security_mode=1,
        security_group=no_group,
    )
    commands = SimpleNamespace(poll=nothing)
    requests: Any = SimpleNamespace(announced=nothing, commands=commands)
    return PubSubModel(
        server,
        2,
        facts,
        {"line": 3},
        status_topics={"line": Topic(3, 2, 1900)},
        requests=requests,
        is_heard=lambda _name: False,
        hear=lambda _events: None,
        send=lambda _datagram: None,
        clock=lambda: clock[0],
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


async def test_a_bridge_whose_status_is_disabled_is_asked_whether_it_is_there() -> None:
    wanted: list[tuple[int, ProbeKind, float]] = []
    clock = [50.0]
    model = await a_model(wanted, clock)
    publisher = Publisher(3, PubSubTiming(), Counters(), Codec())
    publisher.announce(Topic(3, 2, 1900), "status", (), now=clock[0], wall_ticks=0)
    model.follow(AnnouncementReceived(ConnectionsAnnouncement(3, 1, 0, (publisher.configuration(),))))
    for clock[0] in range(51, 80):
        model.poll(clock[0])
    assert wanted == []  # silent, and nobody has told it to be
    publisher.switches.disable(("W", 2), timestamp=0, now=clock[0])
    model.follow(AnnouncementReceived(ConnectionsAnnouncement(3, 1, 0, (publisher.configuration(),))))
    for clock[0] in range(80, 101):
        model.poll(clock[0])
    assert wanted == [(3, ProbeKind.PUBSUB_CONNECTIONS, at) for at in (80, 90, 100)]
    state = model.bridges[3].describe(()).values["Status.State"]
    assert state.now() == (PubSubState.OPERATIONAL, 0)
    model.poll(106.0)
    assert state.now() == (PubSubState.OPERATIONAL, StatusCode.BAD_NO_COMMUNICATION)
