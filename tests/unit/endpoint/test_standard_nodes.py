"""The standard's own nodes in less memory: clients see the same."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from asyncua.server.server import Server

from tests.standard_space import quick_start
from ua_fleet.config.schema import ServerConfig
from ua_fleet.endpoint.hardened_server import create_server
from ua_fleet.endpoint.node_builder import nodes_of
from ua_fleet.endpoint.standard_nodes import forget_makers, share_attributes
from ua_fleet.nodes.nodeset import load_types


async def test_what_nodes_have_in_common_is_one_object_and_reads_the_same() -> None:
    server: Any = Server()
    await server.init()
    space = server.iserver.aspace

    def seen() -> dict[Any, Any]:
        return {
            (node_id, attribute): space.read_attribute_value(node_id, attribute)
            for node_id in space.keys()  # noqa: SIM118 - an AddressSpace is no mapping
            for attribute in space[node_id].attributes
        }

    def objects() -> int:
        return len({id(held) for node_id in space.keys() for held in space[node_id].attributes.values()})  # noqa: SIM118

    before, many = seen(), objects()
    share_attributes(nodes_of(space))
    assert seen() == before
    assert objects() < many / 2
    name = server.get_node("i=2261")  # ProductUri: a Value is a node's own
    await name.write_value("urn:another")
    after = seen()
    assert [key for key in before if after[key] != before[key]] == [(name.nodeid, 13)]

    forget_makers()
    assert not [name for name in sys.modules if name.startswith("asyncua.server.standard_address_space.")]
    another: Any = Server()
    await another.init()
    assert len(another.iserver.aspace.keys()) == len(space.keys())


async def test_a_quick_start_gives_a_server_of_tests_the_same_nodes_for_itself(tmp_path: Path) -> None:
    async def made() -> Any:
        server: Any = await create_server(ServerConfig(port=0), tmp_path, application_uri="urn:the-server")
        await load_types(server, "urn:the-fleet", 2)
        server.context.audit.close()
        return server

    def seen(server: Any) -> dict[Any, Any]:
        nodes: dict[Any, Any] = {}
        for node_id, node in server.iserver.aspace._nodes.items():
            attributes = {number: held.value and held.value.Value for number, held in node.attributes.items()}
            nodes[node_id] = attributes, list(node.references)
        return nodes

    whole = await made()
    servers: list[Any] = []
    for _ in range(3):  # the first of a process is the one that is copied
        with quick_start():
            servers.append(await made())
    expected = seen(whole)
    before = seen(servers[2])
    assert before.keys() == expected.keys()
    other = {node_id.Identifier for node_id in before if before[node_id] != expected[node_id]}
    assert other <= {2256, 2257, 2260, 2266}  # ServerStatus, StartTime, BuildInfo, BuildDate: they tell the time
    await servers[1].get_node("i=2261").write_value("urn:another")
    await servers[1].nodes.objects.add_object(2, "mine")
    assert seen(servers[2]) == before
