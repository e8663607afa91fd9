"""The fleet as clients browse it."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.fleet.fleet_of import fleet_config
from tests.unit.nodes.model_server import children, fleet_built, types_loaded, ua
from ua_fleet.config.nodes import fleet_model
from ua_fleet.fleet import DataSetModel, FieldModel, SourceQuarantined
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.nodes.projection import Projection
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, NodeId

ROBOTS: dict[str, Any] = {
    "rover": {
        "bridge": "mobile",
        "description": "A rover",
        "capacities": ["mobile", "grab"],
        "data": {
            "speed": {"id": 1001, "type": "Double", "unit": "m/s", "range": [-2, 2], "description": "How fast"},
            "height": {"id": 1002, "type": "Float", "unit": "m"},
            "charge": {"id": 1003, "type": "Int32", "range": [0, 100]},
            "ranges": {"id": 1004, "type": "Float", "array": True},
            "goal": {"id": 1005, "type": "Double", "origin": "server", "initial": 0.5},
            "pose": {"id": 1006, "fields": {"x": {"type": "Double"}, "frame": {"type": "String"}}},
        },
    },
    "arm": {
        "bridge": "mobile",
        "capacities": ["grab"],
        "skill_status_id": 1502,
        "skills": {"turn": {"id": 1500, "arguments": {"angle": {"type": "Double"}}}},
    },
}


async def type_definition(server: Any, node_id: str) -> str:
    return str((await server.get_node(node_id).read_type_definition()).to_string())


async def test_the_fleet_can_be_browsed_from_objects() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        assert (await children(server, "i=85"))["2:Fleet"] == "ns=2;s=Fleet"
        assert set(await children(server, "ns=2;s=Fleet")) == {
            "3:Robots",
            "3:Bridges",
            "3:Capabilities",
            "3:Discovered",
            "3:Traffic",
        }
        assert set(await children(server, "ns=2;s=Fleet.Robots.G00")) == {"2:rover", "2:arm"}
        assert set(await children(server, "ns=2;s=Robots.rover.Data")) == {
            f"2:{name}" for name in ROBOTS["rover"]["data"]
        }
        assert await children(server, "ns=2;i=1006") == {
            "3:Topic": "ns=2;s=Topics.1006",
            "3:MaxAge": "ns=2;s=MaxAge.1006",
            "2:x": "ns=2;s=1006.x",
            "2:frame": "ns=2;s=1006.frame",
        }


async def test_instances_have_every_member_that_their_types_demand() -> None:
    async with fleet_built(ROBOTS) as (server, _):

        async def demanded(type_id: Any) -> dict[str, Any]:
            node = server.get_node(type_id)
            members: dict[str, Any] = {}
            for parent in await node.get_referenced_nodes(ua.ObjectIds.HasSubtype, ua.BrowseDirection.Inverse):
                members |= await demanded(parent.nodeid)
            for child in await node.get_children():
                rules = await child.get_referenced_nodes(ua.ObjectIds.HasModellingRule)
                if [rule.nodeid.Identifier for rule in rules] == [78]:
                    members[(await child.read_browse_name()).to_string()] = child
            return members

        async def check(node: Any, type_id: Any) -> int:
            present = {(await child.read_browse_name()).to_string(): child for child in await node.get_children()}
            members = await demanded(type_id)
            assert members.keys() <= present.keys(), node
            for name, declared in members.items():
                made = present[name]
                assert await made.read_node_class() == await declared.read_node_class()
                assert await made.read_type_definition() == await declared.read_type_definition()
                if await made.read_node_class() == ua.NodeClass.Variable:
                    assert await made.read_data_type() == await declared.read_data_type()
                    assert await made.read_value_rank() == await declared.read_value_rank()
            return len(members)

        async def walk(node: Any) -> int:
            checked = 0
            for child in await node.get_children():
                if await child.read_node_class() == ua.NodeClass.Object:
                    type_id = await child.read_type_definition()
                    if type_id.NamespaceIndex == 3:
                        checked += await check(child, type_id)
                    checked += await walk(child)
            return checked

        assert await check(server.get_node("ns=2;s=Fleet"), ua.NodeId(1009, 3)) == 5
        assert await walk(server.get_node("ns=2;s=Fleet")) > 30


@pytest.mark.parametrize(
    ("identifier", "type_id"), [(1001, 17570), (1002, 17497), (1003, 2368), (1004, 63), (1005, 63)]
)
async def test_units_and_ranges_make_analog_types(identifier: int, type_id: int) -> None:
    async with fleet_built(ROBOTS) as (server, _):
        assert await type_definition(server, f"ns=2;i={identifier}") == f"i={type_id}"


async def test_units_and_ranges_can_be_read() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        span = await server.get_node("ns=2;s=1001.EURange").read_value()
        assert (span.Low, span.High) == (-2, 2)
        unit = await server.get_node("ns=2;s=1001.EngineeringUnits").read_value()
        assert (unit.DisplayName.Text, unit.UnitId) == ("m/s", 5067859)
        assert (await server.get_node("ns=2;i=1001").read_description()).Text == "How fast"


async def test_only_data_of_the_server_can_be_written() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        for identifier, access in ((1001, 1), (1005, 3 | 64)):  # a client may give the time, too
            for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
                data = await server.get_node(f"ns=2;i={identifier}").read_attribute(attribute)
                assert data.Value.Value == access
            assert not (
                await server.get_node(f"ns=2;i={identifier}").read_attribute(ua.AttributeIds.Historizing)
            ).Value.Value


async def test_nodes_wait_for_their_first_data_or_have_the_initial_value() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        for node_id in ("ns=2;i=1001", "ns=2;s=1006.frame", "ns=2;s=1900.Connected"):
            data = await server.get_node(node_id).read_data_value(raise_on_bad_status=False)
            assert data.StatusCode.name == "BadWaitingForInitialData"
        data = await server.get_node("ns=2;i=1005").read_data_value()
        assert data.Value.Value == 0.5
        assert data.SourceTimestamp is not None


async def test_arrays_say_that_they_are() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        node = server.get_node("ns=2;i=1004")
        assert (await node.read_value_rank(), await node.read_array_dimensions()) == (1, [0])
        assert (await node.read_data_type()).Identifier == 10


async def test_capacities_lead_to_capabilities_and_back() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        assert await server.get_node("ns=2;s=Robots.rover.Capacities").read_value() == ["mobile", "grab"]
        provides = ua.NodeId(4001, 3)
        found = await server.get_node("ns=2;s=Robots.rover").get_referenced_nodes(provides)
        assert [node.nodeid.to_string() for node in found] == [
            "ns=2;s=Fleet.Capabilities.mobile",
            "ns=2;s=Fleet.Capabilities.grab",
        ]
        back = await server.get_node("ns=2;s=Fleet.Capabilities.grab").get_referenced_nodes(
            provides, ua.BrowseDirection.Inverse
        )
        assert [node.nodeid.to_string() for node in back] == ["ns=2;s=Robots.rover", "ns=2;s=Robots.arm"]


async def test_no_folder_has_more_than_a_hundred_children() -> None:
    robots: dict[str, Any] = {f"R{number}": {"bridge": "mobile", "data": {}} for number in range(201)}
    robots["R0"]["data"] = {f"d{number}": {"id": number + 1, "type": "Double"} for number in range(150)}
    async with fleet_built(robots) as (server, _):
        assert list(await children(server, "ns=2;s=Fleet.Robots")) == ["2:G00", "2:G01", "2:G02"]
        assert len(await children(server, "ns=2;s=Fleet.Robots.G01")) == 100
        assert len(await children(server, "ns=2;s=Fleet.Robots.G02")) == 1
        assert list(await children(server, "ns=2;s=Robots.R0.Data")) == ["2:G00", "2:G01"]
        assert len(await children(server, "ns=2;s=Robots.R0.Data.G01")) == 50


async def test_a_robot_may_have_any_name() -> None:
    robots: dict[str, Any] = {name: {"bridge": "mobile", "data": {}} for name in ("Fleet", "Robots", "G00", "State")}
    async with fleet_built(robots) as (server, _):
        assert set(await children(server, "ns=2;s=Fleet.Robots.G00")) == {f"2:{name}" for name in robots}


def discovered(*names: str) -> DataSetModel:
    topic = Topic(5, 2, 700)
    fields = tuple(FieldModel(NodeId(2, f"700.{name}"), name, int(BuiltinType.DOUBLE)) for name in names)
    if len(fields) == 1:
        fields = (FieldModel(NodeId(2, 700), names[0], int(BuiltinType.DOUBLE)),)
    return DataSetModel(topic, "/odom", fields, is_single=len(fields) == 1)


async def test_a_source_that_was_not_known_comes_and_goes() -> None:
    async with fleet_built(ROBOTS) as (server, nodes):
        before = set(nodes.values)
        for data_set in (discovered("x"), discovered("x", "y"), discovered("x", "Topic"), discovered("Topic")):
            nodes.add_source(data_set)
            assert "2:ua_5_2_700" in await children(server, "ns=2;s=Fleet.Discovered.Sources.G00")
            assert {field.key for field in data_set.fields} <= nodes.values.keys()
            nodes.remove_source(data_set)
            assert await children(server, "ns=2;s=Fleet.Discovered.Sources.G00") == {}
            assert set(nodes.values) == before


async def test_a_quarantined_source_is_listed_by_topic_and_type() -> None:
    async with fleet_built(ROBOTS) as (server, nodes):
        nodes.add_quarantined(SourceQuarantined(Topic(5, 2, 700), "/odom", "nav_msgs/Odometry", "unknown"))
        listed = await children(server, "ns=2;s=Fleet.Discovered.Quarantine.G00")
        assert list(listed) == ["2:ua_5_2_700"]
        node_id = "ns=2;s=Fleet.Discovered.Quarantine.ua_5_2_700"
        assert await server.get_node(f"{node_id}.MessageType").read_value() == "nav_msgs/Odometry"
        assert await server.get_node(f"{node_id}.Reason").read_value() == "unknown"
        assert (await server.get_node(node_id).read_display_name()).Text == "/odom"


async def everything(server: Any, node_id: str) -> list[str]:
    found = [node_id]
    for child in await server.get_node(node_id).get_children():
        found += await everything(server, child.nodeid.to_string())
    return sorted(found)


async def test_a_robot_comes_and_goes_and_leaves_nothing_behind() -> None:
    late = fleet_model(
        fleet_config(
            {
                "late": {
                    "bridge": "mobile",
                    "capacities": ["grab", "paint"],
                    "skill_status_id": 1602,
                    "data": {"tilt": {"id": 1601, "type": "Double", "unit": "deg", "range": [0, 9]}},
                    "skills": {"spray": {"id": 1600, "arguments": {"seconds": {"type": "Double"}}}},
                }
            }
        )
    ).robots[0]
    async with fleet_built(ROBOTS) as (server, nodes):
        space = server.iserver.aspace
        before, size, values = await everything(server, "ns=2;s=Fleet"), len(space._nodes), len(nodes.values)
        halt = len(space[ua.NodeId(71004, 3)].references)
        for _ in range(2):
            nodes.add_robot(late)
            assert "ns=2;s=Fleet.Capabilities.paint" in await everything(server, "ns=2;s=Fleet")
            assert await type_definition(server, "ns=2;i=1600") == "ns=3;i=1010"
            assert NodeId(2, 1601) in nodes.values
            nodes.remove_robot(late)
            assert await everything(server, "ns=2;s=Fleet") == before
            assert (len(space._nodes), len(nodes.values)) == (size, values)
            assert len(space[ua.NodeId(71004, 3)].references) == halt
            grab = space[ua.NodeId("Fleet.Capabilities.grab", 2)].references
            assert not any(reference.BrowseName.Name == "late" for reference in grab)


async def test_a_place_in_a_group_is_given_again() -> None:
    robots = {f"r{number:03d}": {"bridge": "mobile"} for number in range(101)}
    models = fleet_model(fleet_config(robots)).robots
    async with fleet_built(robots) as (server, nodes):
        assert set(await children(server, "ns=2;s=Fleet.Robots")) == {"2:G00", "2:G01"}
        nodes.remove_robot(models[5])
        nodes.add_robot(models[5])
        assert "2:r005" in await children(server, "ns=2;s=Fleet.Robots.G00")
        assert set(await children(server, "ns=2;s=Fleet.Robots.G01")) == {"2:r100"}


async def test_a_maximum_age_has_its_node_in_the_namespace_of_its_source_and_is_found_by_its_id() -> None:
    data = {"speed": {"id": 1001, "type": "Double", "max_age_s": 2.5}}
    robots = {"rover": {"bridge": "mobile", "data": data}, "other": {"bridge": "mobile", "namespace": 4, "data": data}}
    async with types_loaded() as server:
        space = server.iserver.aspace
        nodes = FleetNodes(space, fleet_model(fleet_config(robots)))
        nodes.build()
        assert not [node for node in space.keys() if str(node.Identifier).startswith("MaxAge.")]  # noqa: SIM118
        for name in ("ns=2;s=MaxAge.1001", "ns=4;s=MaxAge.1001"):
            assert await server.get_node(name).read_value() == 2500.0
            assert await type_definition(server, name) == "i=68"
        for unknown in ("MaxAge.1002", "MaxAge.01001", "MaxAge.", "MaxAge.²", "MaxAge." + "9" * 5000):
            assert not nodes._parts.has(ua.NodeId(unknown, 4))


async def test_a_maximum_age_that_was_never_wanted_takes_a_new_value() -> None:
    async with fleet_built(ROBOTS) as (server, nodes):
        projection = Projection(nodes)
        key = NodeId(2, "MaxAge.1001")
        projection.put(ValueChanged(key, int(BuiltinType.DOUBLE), 3000.0, 0, None, False))
        assert await server.get_node("ns=2;s=MaxAge.1001").read_value() == 3000.0
