"""The standard's own nodes in less memory: clients see the same."""

from __future__ import annotations

import sys
from typing import Any

from asyncua.server.server import Server

from ua_fleet.server.standard_nodes import forget_makers, share_attributes


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
    share_attributes(space)
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
