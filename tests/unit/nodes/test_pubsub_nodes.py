"""The Objects of PubSub's information model: as their types declare them, made when wanted, and not all kept."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from asyncua.server.server import Server

from tests.standard_space import quick_start
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.live import LiveValue
from ua_fleet.endpoint.node_builder import NodeBuilder
from ua_fleet.endpoint.stack import AttributeIds, ObjectIds, ns0
from ua_fleet.endpoint.standard_model import fill_pubsub, remove_unsupported
from ua_fleet.errors import ServerStartError
from ua_fleet.nodes.declared_nodes import DeclaredNodes
from ua_fleet.nodes.pubsub_nodes import PubSubNodes
from ua_fleet.operation.pubsub.bridges import AnnouncedConnection
from ua_fleet.operation.pubsub.description import Description
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.components import Component, writer
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, QualifiedName, Variant
from ua_fleet.wire.discovered import (
    ConnectionsAnnouncement,
    DataSetWriter,
    KeyValuePair,
    NetworkAddressUrl,
    PubSubConnection,
    UadpDataSetWriterMessage,
    UadpWriterGroupMessage,
    WriterConfigurationAnnouncement,
    WriterGroup,
)
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData

NS = 2
NOT_FOUND = 0x803E_0000
METADATA = DataSetMetaData("level", (make_field("level", BuiltinType.DOUBLE),), ConfigurationVersion(7, 8))


def announced(writers: int) -> ConnectionsAnnouncement:
    made = [
        DataSetWriter(f"w{number}", True, number, message_settings=UadpDataSetWriterMessage(0x3D))
        for number in range(1, writers + 1)
    ]
    group = WriterGroup(
        "group-2", True, writer_group_id=2, message_settings=UadpWriterGroupMessage(), data_set_writers=tuple(made)
    )
    connection = PubSubConnection(
        "bridge b",
        True,
        Variant(int(BuiltinType.UINT16), 3),
        "profile",
        NetworkAddressUrl("lo", "opc.udp://x"),
        writer_groups=(group,),
    )
    return ConnectionsAnnouncement(3, 1, 0, (connection,))


async def a_space() -> Any:
    with quick_start():
        server: Any = Server()
        await server.init()
        await server.register_namespace("urn:test:fleet")
    space = server.iserver.aspace
    remove_unsupported(space, key_service=False)
    fill_pubsub(space, key_service=False)
    return space


class Shown:
    """The nodes of one bridge."""

    def __init__(self, space: Any, writers: int, most_open: int = 5) -> None:
        self.space = space
        self.known = AnnouncedConnection("b", 3, metadata=lambda topic: METADATA, is_heard=lambda: True)
        self.known.heard(announced(writers), 0.0)
        self.nodes = PubSubNodes(space, NodeBuilder(space), NS, [self.known], most_open=most_open)
        self.nodes.refresh()

    def has_made(self, key: str) -> bool:
        """Whether a node is made, without having it made."""
        return any(key == made for made in self.made_keys())

    def value(self, key: str) -> Any:
        return self.space.read_attribute_value(raw_id(key, NS), AttributeIds.Value)

    def made(self) -> int:
        return len(self.made_keys())

    def made_keys(self) -> list[str]:
        """The string ids of the nodes that are made."""
        nodes: Any = self.space.keys()
        return [str(each.Identifier) for each in nodes if str(each.Identifier).startswith("PubSub.")]


def below(space: Any, top: Any) -> Iterator[tuple[str, Any]]:
    for reference in space[top].references:
        if reference.IsForward and reference.NodeId.NamespaceIndex == NS:
            yield str(reference.BrowseName.Name), reference
            yield from below(space, reference.NodeId)


async def test_an_object_has_what_its_type_declares_with_its_types_and_references() -> None:
    shown = Shown(await a_space(), 1)
    connection = raw_id("PubSub.bridges.b", NS)
    [root] = [each for each in shown.space[ns0(ObjectIds.PublishSubscribe)].references if each.NodeId == connection]
    assert root.ReferenceTypeId == ns0(ObjectIds.HasPubSubConnection)
    members = dict(below(shown.space, connection))
    assert {"PublisherId", "TransportProfileUri", "Selections", "ConnectionProperties", "Address", "Url", "Status"} < (
        members.keys()
    )
    assert "AddWriterGroup" not in members
    assert "Diagnostics" not in members  # a bridge that says nothing of it
    assert members["group-2"].ReferenceTypeId == ns0(ObjectIds.HasWriterGroup)
    assert members["w1"].ReferenceTypeId == ns0(ObjectIds.HasDataSetWriter)
    assert members["w1"].TypeDefinition == ns0(ObjectIds.DataSetWriterType)
    status = shown.space[raw_id("PubSub.bridges.b.W2.1.Status", NS)]
    methods = [each.BrowseName.Name for each in status.references if each.NodeId.NamespaceIndex == 0 and each.IsForward]
    assert {"Enable", "Disable"} < {*methods}
    assert shown.value("PubSub.bridges.b.PublisherId").Value.VariantType.name == "UInt16"
    assert shown.value("PubSub.bridges.b.W2.1.MessageSettings.DataSetMessageContentMask").Value.Value == 0x3D


async def test_a_mandatory_value_that_nothing_says_is_no_node_without_a_value() -> None:
    space = await a_space()
    declared = DeclaredNodes(space, NodeBuilder(space), NS)
    declared.add_object("PubSub.x", "x", ns0(ObjectIds.PublishSubscribe), "DataSetWriterType", "HasComponent")
    with pytest.raises(ServerStartError, match=r"DataSetWriterType\.DataSetWriterId is mandatory"):
        declared.add_members("PubSub.x", Description("DataSetWriterType", {}))


async def test_nothing_is_made_of_thousands_of_writers_until_it_is_wanted_and_then_little() -> None:
    shown = Shown(await a_space(), 3000)
    assert shown.made() < 60
    key = "PubSub.bridges.b.W2.1234"
    assert shown.value(f"{key}.DataSetWriterId").Value.Value == 1234  # read by its NodeId, never browsed
    assert shown.made() < 3200
    for number in range(1, 50):
        assert shown.value(f"PubSub.bridges.b.W2.{number}.Status.State").Value.Value == 2
    assert shown.nodes.open == 5
    assert shown.made() < 3300
    assert not shown.has_made(f"{key}.DataSetWriterId")
    assert shown.value(f"{key}.DataSetWriterId").Value.Value == 1234  # made once more


def with_property(value: Variant) -> ConnectionsAnnouncement:
    announcement = announced(1)
    [connection] = announcement.connections
    pairs = (KeyValuePair(QualifiedName(0, "new"), value), KeyValuePair(QualifiedName(0, "old"), Variant(6, 5)))
    return announcement._replace(connections=(connection._replace(properties=pairs),))


async def test_a_property_of_a_type_that_does_not_exist_is_left_out() -> None:
    shown = Shown(await a_space(), 1)
    shown.known.heard(with_property(Variant(26, b"x")), 0.0)
    shown.nodes.refresh()
    assert len(shown.value("PubSub.bridges.b.ConnectionProperties").Value.Value) == 1


async def test_a_connection_that_cannot_be_shown_stops_no_other_and_is_shown_later() -> None:
    class Broken(AnnouncedConnection):
        is_broken = True

        def describe(self, component: Component) -> Description:
            if self.is_broken and component:
                raise ValueError("no such type")
            return super().describe(component)

    space = await a_space()
    broken = Broken("a", 4, metadata=lambda topic: METADATA, is_heard=lambda: True)
    known = AnnouncedConnection("b", 3, metadata=lambda topic: METADATA, is_heard=lambda: True)
    nodes = PubSubNodes(space, NodeBuilder(space), NS, [broken, known])
    for connection in (broken, known):
        connection.heard(announced(1), 0.0)
    for _ in range(2):
        with pytest.raises(ValueError, match="no such type"):
            nodes.refresh()
        assert raw_id("PubSub.bridges.b.W2", NS) in space.keys()  # noqa: SIM118 has it made otherwise
        assert raw_id("PubSub.bridges.a", NS) not in space.keys()  # noqa: SIM118
    broken.is_broken = False
    nodes.refresh()
    assert raw_id("PubSub.bridges.a.W2", NS) in space.keys()  # noqa: SIM118


async def test_what_somebody_watches_stays() -> None:
    shown = Shown(await a_space(), 30)
    key = "PubSub.bridges.b.W2.7.Status.State"
    told: list[Any] = []

    async def callback(handle: int, value: Any) -> None:
        del handle
        told.append(value.Value.Value)

    _, handle = shown.space.add_datachange_callback(raw_id(key, NS), AttributeIds.Value, callback)
    for number in range(8, 30):
        shown.value(f"PubSub.bridges.b.W2.{number}.Status.State")
    assert shown.has_made(key)
    shown.known.switched(writer(2, 7), is_enabled=False)
    await shown.nodes.tell()
    await shown.nodes.tell()
    assert told == [0]  # once for each change
    shown.space.delete_datachange_callback(handle)
    for number in range(8, 30):
        shown.value(f"PubSub.bridges.b.W2.{number}.Status.State")
    assert not shown.has_made(key)


async def test_however_many_are_watched_few_are_looked_at_when_one_more_is_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def callback(handle: int, value: Any) -> None:
        """Nobody looks."""

    looked: list[object] = []

    def is_watched(live: Any) -> bool:
        looked.append(live)
        return bool(live.datachange_callbacks)

    shown = Shown(await a_space(), 90)
    keys = [f"PubSub.bridges.b.W2.{number}.Status.State" for number in range(1, 61)]
    for key in keys:
        shown.space.add_datachange_callback(raw_id(key, NS), AttributeIds.Value, callback)
    monkeypatch.setattr(LiveValue, "is_watched", property(is_watched))
    most = 0
    for number in range(61, 91):
        looked.clear()
        shown.value(f"PubSub.bridges.b.W2.{number}.Status.State")
        most = max(most, len(looked))
    assert 0 < most <= 8
    assert all(map(shown.has_made, keys))
    assert shown.nodes.open < 60 + 15  # those that nobody watches are found all the same


async def test_writers_that_come_and_go_are_seen_by_who_has_browsed() -> None:
    shown = Shown(await a_space(), 3)
    group = raw_id("PubSub.bridges.b.W2", NS)

    def names() -> set[str]:
        return {
            name for name, each in below(shown.space, group) if each.ReferenceTypeId == ns0(ObjectIds.HasDataSetWriter)
        }

    assert names() == {"w1", "w2", "w3"}
    settings = WriterGroup("group-2", True, writer_group_id=2, message_settings=UadpWriterGroupMessage())
    new = settings._replace(data_set_writers=(DataSetWriter("new", True, 9),))
    shown.known.heard(WriterConfigurationAnnouncement(3, 1, 0, (9, 2), new, (0, NOT_FOUND)), 0.0)
    shown.nodes.refresh()
    assert names() == {"w1", "w3", "new"}
    assert not shown.has_made("PubSub.bridges.b.W2.2.Status.State")
    shown.known.forget()
    shown.nodes.refresh()
    assert shown.made() == 0
    assert shown.nodes.open == 0


async def test_a_data_set_refers_to_its_writer() -> None:
    shown = Shown(await a_space(), 2)
    list(below(shown.space, raw_id("PubSub.bridges.b", NS)))
    data_set = shown.space[raw_id("PubSub.bridges.b.D.2.1", NS)]
    to_writer = [each for each in data_set.references if each.ReferenceTypeId == ns0(ObjectIds.DataSetToWriter)]
    assert [each.NodeId for each in to_writer] == [raw_id("PubSub.bridges.b.W2.1", NS)]


@pytest.mark.parametrize(
    "key",
    ["PubSub.", "PubSub.bridges.b.W2.9999.x", "PubSub.x", f"PubSub.{'.' * 250}", "PubSub.bridges.b.W2." + "1." * 99],
)
async def test_an_id_that_a_stranger_makes_up_is_no_node_and_makes_none(key: str) -> None:
    shown = Shown(await a_space(), 3)
    assert raw_id(key, NS) not in shown.space
    assert shown.made() < 80


async def test_the_component_of_a_status_is_found_again() -> None:
    shown = Shown(await a_space(), 1)
    found = shown.nodes.component(raw_id("PubSub.bridges.b.W2.1.Status", NS), "Status")
    assert found == (shown.known, writer(2, 1))
    assert Topic(3, 2, 1) in shown.known.data_sets()
    for other in ("PubSub.bridges.b.D.2.1.Status", "PubSub.bridges.c.W2.Status", "PubSub.bridges.b.W2.x.Status"):
        assert shown.nodes.component(raw_id(other, NS), "Status") is None
    assert shown.nodes.component(ns0(ObjectIds.PubSubStatusType), "Status") is None
