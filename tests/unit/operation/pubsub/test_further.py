"""What is shown of the further connections of a process: what they are, the first one's states, and no switches."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from ua_fleet.counters import Counters
from ua_fleet.operation.pubsub.bridges import MOST_CONNECTIONS, AnnouncedConnection
from ua_fleet.operation.pubsub.connections import Resets, ServerConnection
from ua_fleet.operation.pubsub.further import FurtherConnection, key_of_further
from ua_fleet.operation.pubsub.told import ToldDiagnostics
from ua_fleet.pubsub import Publisher, PubSubTiming, make_field
from ua_fleet.pubsub.application import MQTT_UADP, UDP_UADP, Application, describe
from ua_fleet.pubsub.components import CONNECTION, writer, writer_group
from ua_fleet.pubsub.group_figures import FIGURES_FIELD, GroupFigures, packed
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ConnectionsAnnouncement, PubSubState
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    Probe,
    ProbeKind,
    PublisherIdType,
)

WALL = 134_000_000_000_000_000
FIELDS = (make_field("level", BuiltinType.DOUBLE),)
CODEC = Codec()
GROUP, WRITER = writer_group(2), writer(2, 1001)


def on_two(space: int, name: str) -> Publisher:
    """The publisher of a process that is on a multicast group and on a broker, with one DataSetWriter."""
    whole = Application(describe(f"urn:{name}", name), is_brokered=True, is_also_grouped=True)
    hall = replace(whole, url="opc.udp://239.0.0.1:4840", connection_name="hall")
    site = replace(whole, url="mqtt://broker:1883", connection_name="site", security_mode=3, data_group=f"t-{space}")
    publisher = Publisher(space, PubSubTiming(), Counters(), CODEC, replace(hall, further=(site,)))
    publisher.announce(Topic(space, 2, 1001), "level", FIELDS, now=100.0, wall_ticks=WALL)
    return publisher


class Server:
    """A server on both, with what it shows of its second connection."""

    def __init__(self) -> None:
        self.problems = ["", ""]
        self.publisher = on_two(0, "server")
        facts: Any = SimpleNamespace(
            publisher=self.publisher,
            subscriber=SimpleNamespace(received_messages=Counter[int]()),
            publishers={},
            problems=lambda: self.problems,
            address="{}/{}".format,
        )
        self.first = ServerConnection(facts, Resets())
        self.site = FurtherConnection(self.first, "site", 1)

    def value(self, shown: Any, way: str, component: Any = CONNECTION) -> Any:
        found = shown.describe(component).values[way]
        return found.now()[0] if hasattr(found, "now") else found


class Bridge:
    """A bridge on both, as it has announced itself."""

    def __init__(self) -> None:
        self.is_heard = True
        self.publisher = on_two(3, "bridge b")
        self.status = RemoteWriter(Topic(3, 2, 1900), 0.0, Counters())
        self.told = ToldDiagnostics(
            "PubSub.bridges.b", lambda: self.status, lambda: self.is_heard, "{}".format, Resets()
        )
        self.first = AnnouncedConnection(
            "b",
            3,
            metadata=self.publisher.metadata,
            is_heard=lambda: self.is_heard,
            told=self.told,
            status=Topic(3, 2, 1900),
        )
        self.site = FurtherConnection(self.first, "site", 1)

    def say(self, *figures: GroupFigures) -> None:
        """Have its status tell this."""
        field = make_field(FIGURES_FIELD, BuiltinType.UINT32, array=True)
        self.status.metadata = DataSetMetaData("status", (field,), ConfigurationVersion(1, 1))
        self.status.last_frame = DataSetMessage(1900, values=(packed(figures),))

    def ask(self) -> None:
        kind = ProbeKind.PUBSUB_CONNECTIONS
        probe = Probe(3, PublisherIdType.UINT16, kind, include_writer_groups=True, include_data_set_writers=True)
        for datagram in [*self.publisher.answer(probe, 102.0), *self.publisher.poll(104.0, WALL)]:
            message: Any = CODEC.decode(datagram)
            if isinstance(message, ConnectionsAnnouncement):
                self.first.heard(message, 0.0)


def test_a_further_connection_of_the_server_has_its_own_address_profile_and_security() -> None:
    server = Server()
    assert server.site.key == key_of_further("PubSub.server", "site") == "PubSub.connections.server.site"
    for shown, name, url, profile in (
        (server.first, "server hall", "opc.udp://239.0.0.1:4840", UDP_UADP),
        (server.site, "server site", "mqtt://broker:1883", MQTT_UADP),
    ):
        part = shown.connection()
        assert part is not None
        assert part.name == name
        assert server.value(shown, "Address.Url") == url
        assert server.value(shown, "TransportProfileUri") == profile
    assert [each.name for each in server.site.groups().values()] == ["group-2"]
    assert [each.name for each in server.site.members(GROUP).values()] == ["level"]
    assert server.value(server.site, "SecurityMode", GROUP) == 3
    assert server.value(server.site, "SecurityGroupId", GROUP) == "t-0"
    assert "SecurityGroupId" not in server.first.describe(GROUP).values
    assert server.value(server.site, "DataSetWriterId", WRITER) == 1001
    assert not server.site.has_data_sets
    assert server.site.data_sets() == {}


def test_each_connection_of_the_server_has_its_own_errors_and_counts_them_anew_after_a_reset() -> None:
    server = Server()
    server.first.look()
    server.problems = ["", "mqtt://broker:1883: away"]
    server.first.look()
    error, back = "Diagnostics.Counters.StateError", "Diagnostics.Counters.StateOperationalFromError"
    assert server.value(server.site, "Status.State") == PubSubState.ERROR
    assert server.value(server.first, "Status.State") == PubSubState.OPERATIONAL
    assert (server.value(server.site, error), server.value(server.first, error)) == (1, 0)
    assert server.site.has_failed()
    server.problems = ["", ""]
    server.first.look()
    assert server.value(server.site, "Status.State") == PubSubState.OPERATIONAL
    assert server.value(server.site, back) == 1
    assert server.site.reset(CONNECTION)
    assert (server.value(server.site, error), server.value(server.site, back)) == (0, 0)
    assert not server.site.has_failed()
    assert not server.site.reset(GROUP)
    assert server.value(server.site, "Diagnostics.LiveValues.ResolvedAddress") == "0/1"


def test_what_is_switched_is_so_on_all_and_only_the_first_one_can_be_switched() -> None:
    server = Server()
    server.publisher.begin(now=100.0, wall_ticks=WALL)
    for component, group_state, writer_state in (
        (GROUP, PubSubState.DISABLED, PubSubState.PAUSED),
        (WRITER, PubSubState.OPERATIONAL, PubSubState.DISABLED),
    ):
        server.publisher.switches.disable(component, timestamp=WALL, now=101.0)
        assert server.value(server.site, "Status.State", GROUP) == group_state
        assert server.value(server.site, "Status.State", WRITER) == writer_state
        server.publisher.switches.enable(component, now=102.0)
    for component in (CONNECTION, GROUP, WRITER):
        assert server.first.describe(component).methods
        assert not server.site.describe(component).methods


def test_a_further_connection_of_a_bridge_is_what_it_has_announced() -> None:
    bridge = Bridge()
    assert bridge.site.connection() is None
    assert bridge.site.groups() == {}
    bridge.ask()
    part = bridge.site.connection()
    assert part is not None
    assert part.name == "bridge b site"
    assert bridge.site.describe(CONNECTION).values["Address.Url"] == "mqtt://broker:1883"
    assert [each.name for each in bridge.site.members(GROUP).values()] == ["level"]
    state = bridge.site.describe(WRITER).values["Status.State"]
    assert state.now() == (PubSubState.OPERATIONAL, 0)
    bridge.is_heard = False
    assert state.now() == (PubSubState.OPERATIONAL, StatusCode.BAD_NO_COMMUNICATION)
    assert not [way for way in bridge.site.describe(CONNECTION).values if way.startswith("Diagnostics")]
    assert not bridge.site.reset(CONNECTION)
    assert not bridge.site.has_failed()
    bridge.first.forget()
    assert bridge.site.connection() is None


def test_so_many_connections_of_a_bridge_are_kept() -> None:
    bridge = Bridge()
    made = bridge.publisher.configuration(1)
    bridge.first.heard(ConnectionsAnnouncement(3, 1, 0, (made,) * 500), 0.0)
    assert bridge.first.further(MOST_CONNECTIONS - 1) is not None
    assert bridge.first.further(MOST_CONNECTIONS) is None


def test_each_connection_of_a_bridge_is_in_the_state_that_the_bridge_tells() -> None:
    bridge = Bridge()
    bridge.ask()
    before = bridge.site.connection()
    assert "Diagnostics.Counters.StateError" not in bridge.site.describe(CONNECTION).values  # it has told nothing yet
    bridge.say(GroupFigures(0), GroupFigures(0, connection=1, errors=3, from_error=2, has_problem=1))
    assert bridge.site.connection() != before  # so that its Object is made again, with Diagnostics
    hall, site = [shown.describe(CONNECTION).values for shown in (bridge.first, bridge.site)]
    assert (hall["Status.State"].now(), site["Status.State"].now()) == (
        (PubSubState.OPERATIONAL, 0),
        (PubSubState.ERROR, 0),
    )
    counted = [each["Diagnostics.Counters.StateError"].now() for each in (hall, site)]
    assert counted == [(0, 0), (3, 0)]
    assert site["Diagnostics.Counters.StateOperationalFromError"].now() == (2, 0)
    assert site["Diagnostics.LiveValues.ResolvedAddress"].now() == ("1", 0)
    assert not bridge.site.has_failed()  # what a bridge counts is no error of the server
    assert bridge.site.reset(CONNECTION)
    assert not bridge.site.reset(GROUP)
    assert [each["Diagnostics.Counters.StateError"].now() for each in (hall, site)] == [(0, 0), (0, 0)]
    bridge.say(GroupFigures(0), GroupFigures(0, connection=1, errors=4, from_error=4))
    assert site["Status.State"].now() == (PubSubState.OPERATIONAL, 0)
    assert site["Diagnostics.Counters.StateError"].now() == (1, 0)
    bridge.is_heard = False
    bridge.say(GroupFigures(0, has_problem=1), GroupFigures(0, connection=1))
    assert hall["Status.State"].now() == (PubSubState.OPERATIONAL, StatusCode.BAD_NO_COMMUNICATION)


def test_a_connection_that_is_switched_off_is_disabled_also_where_its_transport_fails() -> None:
    bridge = Bridge()
    bridge.ask()
    bridge.say(GroupFigures(0), GroupFigures(0, connection=1, has_problem=1))
    bridge.first.switched(CONNECTION, is_enabled=False)
    assert bridge.site.describe(CONNECTION).values["Status.State"].now().value == PubSubState.DISABLED
