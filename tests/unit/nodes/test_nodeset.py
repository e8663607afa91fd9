"""The nodeset: its ids never change, and it loads strictly."""

from __future__ import annotations

import csv
import re
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from asyncua.server.server import Server

from tests.standard_space import quick_start
from ua_fleet.errors import ServerStartError
from ua_fleet.fleet import RobotState
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId, load_types, nodeset_file
from ua_fleet.topics import TYPES_URI

NS = {"n": "http://opcfoundation.org/UA/2011/03/UANodeSet.xsd"}


def listed() -> dict[int, tuple[str, str]]:
    lines = nodeset_file("UaFleet.NodeIds.csv").read_text(encoding="utf-8").splitlines()
    return {int(number): (name, node_class) for name, number, node_class in csv.reader(lines)}


def nodes() -> dict[int, ET.Element]:
    root = ET.fromstring(nodeset_file("UaFleet.NodeSet2.xml").read_text(encoding="utf-8"))
    found = [node for node in root if "NodeId" in node.attrib]
    ids = [int(re.fullmatch(r"ns=1;i=(\d+)", node.attrib["NodeId"]).group(1)) for node in found]  # type: ignore[union-attr]  # the pattern matches or the test fails
    assert len(set(ids)) == len(ids)
    return dict(zip(ids, found, strict=True))


def test_the_list_of_ids_is_that_of_the_nodeset() -> None:
    in_nodeset = {number: node.tag.rpartition("}UA")[2] for number, node in nodes().items()}
    assert {number: node_class for number, (_, node_class) in listed().items()} == in_nodeset


def test_names_in_the_list_end_in_the_browse_names() -> None:
    names = listed()
    for number, node in nodes().items():
        browse_name = node.attrib["BrowseName"].removeprefix("1:").replace(" ", "")
        if not browse_name.startswith("http"):
            assert browse_name.strip("<>") in names[number][0].removesuffix("_Placeholder").split("_")


def test_ids_that_were_given_stay() -> None:
    """Types cannot change their ids once clients know them."""
    names = {name: number for number, (name, _) in listed().items()}
    assert {
        "DataSetType": 1001,
        "SensorType": 1002,
        "CapabilityType": 1003,
        "RobotType": 1004,
        "TrafficType": 1005,
        "BridgeType": 1006,
        "QuarantinedSourceType": 1007,
        "DiscoveredType": 1008,
        "FleetType": 1009,
        "SkillType": 1010,
        "SkillTransitionEventType": 1011,
        "ScenariosType": 1020,
        "RunType": 1021,
        "DecisionType": 1022,
        "ResilienceType": 1023,
        "FaultsType": 1024,
        "FaultAlarmType": 1025,
        "RunEventType": 1026,
        "StepEventType": 1027,
        "DecisionEventType": 1028,
        "OffersType": 1029,
        "SkillRequestEventType": 1030,
        "RobotStateEnumeration": 3001,
        "RobotSummaryDataType": 3002,
        "RobotSummaryDataType_Encoding_DefaultBinary": 5002,
        "ProvidesCapability": 4001,
    }.items() <= names.items()
    assert {kind.value for kind in TypeId} <= listed().keys()


def test_the_states_of_a_robot_are_those_of_the_code() -> None:
    fields = nodes()[TypeId.ROBOT_STATE].findall("n:Definition/n:Field", NS)
    in_nodeset = {field.attrib["Name"].upper(): int(field.attrib["Value"]) for field in fields}
    assert in_nodeset == {state.name: state.value for state in RobotState}


def test_every_reference_leads_to_a_node_of_this_or_the_base_namespace() -> None:
    known = nodes()
    for node in known.values():
        for reference in node.findall("n:References/n:Reference", NS):
            own = re.fullmatch(r"ns=1;i=(\d+)", reference.text or "")
            assert (own is not None and int(own[1]) in known) or re.fullmatch(r"i=\d+", reference.text or "")


async def test_it_loads_strictly_at_its_index() -> None:
    server: Any = Server()
    await server.init()
    try:
        await load_types(server, "urn:ua-fleet:fleet", 2)
        assert (await server.get_namespace_array())[2:] == ["urn:ua-fleet:fleet", TYPES_URI]
        for number in nodes():
            node = server.get_node(f"ns={TYPES_INDEX};i={number}")
            assert (await node.read_browse_name()).Name
        metadata = await server.nodes.namespaces.get_children()
        assert len(metadata) == 2
    finally:
        await server.stop()


@pytest.mark.parametrize("uri", ["http://opcfoundation.org/UA/", "urn:freeopcua:python:server", TYPES_URI])
async def test_another_index_than_the_topics_carry_is_refused(uri: str) -> None:
    with quick_start():
        server: Any = Server()
        await server.init()
    try:
        with pytest.raises(ServerStartError, match=r"would have the index \d, not \d; give it another name"):
            await load_types(server, uri, 2)
    finally:
        await server.stop()
