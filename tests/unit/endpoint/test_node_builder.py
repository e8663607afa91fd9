"""Nodes put straight into the address space are what clients would see of nodes from AddNodes."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

import gc
from typing import Any

import pytest

from tests.unit.nodes.model_server import types_loaded, ua
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.node_builder import ORGANIZES, TIMESTAMP_WRITE, NodeBuilder, paused_collection
from ua_fleet.errors import ServerStartError
from ua_fleet.values import QualifiedName

OBJECTS = raw_id(85)
FOLDER_TYPE = raw_id(61)
VARIABLE_TYPE = raw_id(63)
DOUBLE = raw_id(11)


def value(number: float = 1.5) -> Any:
    return ua.DataValue(ua.Variant(number, ua.VariantType.Double))


def add_parent_and_child(server: Any) -> NodeBuilder:
    builder = NodeBuilder(server.iserver.aspace)
    builder.add_object(
        raw_id("fast", 2), QualifiedName(2, "parent"), OBJECTS, FOLDER_TYPE, reference=ORGANIZES, description="text"
    )
    builder.add_variable(
        raw_id("fast.v", 2),
        QualifiedName(2, "child"),
        raw_id("fast", 2),
        VARIABLE_TYPE,
        data_type=DOUBLE,
        value=value(),
        writable=True,
    )
    return builder


async def seen(server: Any, node_id: str) -> dict[str, Any]:
    """All attributes that a client can read of a node."""
    node = server.get_node(node_id)
    shown: dict[str, Any] = {}
    for attribute in ua.AttributeIds:
        (read,) = await node.read_attributes([attribute])
        if read.StatusCode.is_good():
            shown[attribute.name] = read.Value.Value
    return shown


async def references(server: Any, node_id: str) -> list[tuple[Any, ...]]:
    """All that a client sees when it browses a node, but for the names that tell the two ways apart."""
    found = await server.get_node(node_id).get_references()
    return sorted(
        (
            ref.ReferenceTypeId.to_string(),
            ref.IsForward,
            ref.BrowseName.to_string(),
            ref.DisplayName.Text,
            int(ref.NodeClass),
            ref.TypeDefinition.to_string(),
        )
        for ref in found
    )


async def test_clients_see_the_same_as_of_nodes_from_add_nodes() -> None:
    async with types_loaded() as server:
        add_parent_and_child(server)
        parent = await server.nodes.objects.add_object("ns=2;s=slow", "2:parent", FOLDER_TYPE)
        child = await parent.add_variable("ns=2;s=slow.v", "2:child", 1.5)
        await child.set_writable()
        await server.get_node("ns=2;s=slow").write_attribute(
            ua.AttributeIds.Description, ua.DataValue(ua.Variant(ua.LocalizedText("text")))
        )
        for fast, slow in (("fast", "slow"), ("fast.v", "slow.v")):
            ours, theirs = await seen(server, f"ns=2;s={fast}"), await seen(server, f"ns=2;s={slow}")
            for shown in (ours, theirs):
                del shown["NodeId"]
            assert theirs["Description"] in (ua.LocalizedText("text"), ua.LocalizedText("child"))
            if fast == "fast.v":
                # AddNodes as asyncua's client makes it repeats the name there; the AccessLevel has unused bits.
                del ours["Description"], theirs["Description"]
                theirs.pop("ArrayDimensions", None)
                theirs.pop("MinimumSamplingInterval", None)
                # What a client may write takes its time with it here, and says so.
                for level in ("AccessLevel", "UserAccessLevel"):
                    assert ours.pop(level) == theirs.pop(level) | TIMESTAMP_WRITE
            assert ours == theirs
            assert await references(server, f"ns=2;s={fast}") == await references(server, f"ns=2;s={slow}")
        names = [ref.BrowseName.Name for ref in await server.nodes.objects.get_references()]
        assert names.count("parent") == 2


async def test_the_value_of_each_variable_is_its_own() -> None:
    async with types_loaded() as server:
        builder = add_parent_and_child(server)
        held = builder.add_variable(
            raw_id("fast.w", 2),
            QualifiedName(2, "child"),
            raw_id("fast", 2),
            VARIABLE_TYPE,
            data_type=DOUBLE,
            value=value(),
        )
        held.value = value(2.5)
        assert await server.get_node("ns=2;s=fast.v").read_value() == 1.5
        assert await server.get_node("ns=2;s=fast.w").read_value() == 2.5


async def test_an_id_is_given_once() -> None:
    async with types_loaded() as server:
        builder = add_parent_and_child(server)
        with pytest.raises(ServerStartError, match=r"two nodes would have the id ns=2;s=fast; rename"):
            builder.add_object(raw_id("fast", 2), QualifiedName(2, "x"), OBJECTS, FOLDER_TYPE)


async def test_who_watches_a_removed_node_is_told_and_nobody_else() -> None:
    async with types_loaded() as server:
        builder = add_parent_and_child(server)
        space = server.iserver.aspace
        told: list[tuple[str, str]] = []

        def watch(name: str, attribute: Any) -> None:
            async def changed(_handle: int, data: Any, _error: Any = None) -> None:
                told.append((name, data.StatusCode.name))

            space.add_datachange_callback(raw_id(name, 2), attribute, changed)

        watch("fast.v", ua.AttributeIds.Value)
        watch("fast.v", ua.AttributeIds.WriteMask)
        watch("fast", ua.AttributeIds.WriteMask)
        builder.remove(raw_id("fast.v", 2))
        assert told == [("fast.v", "BadNodeIdUnknown")] * 2
        assert await server.get_node("ns=2;s=fast").get_children() == []
        assert space.get(raw_id("fast.v", 2)) is None
        builder.remove(raw_id("fast.v", 2))


async def test_a_node_goes_with_all_below_it_but_not_what_others_have_too() -> None:
    async with types_loaded() as server:
        builder = add_parent_and_child(server)
        space = server.iserver.aspace
        builder.add_object(raw_id("other", 2), QualifiedName(2, "other"), OBJECTS, FOLDER_TYPE)
        builder.add_object(raw_id("fast.w", 2), QualifiedName(2, "below"), raw_id("fast.v", 2), FOLDER_TYPE)
        builder.add_reference(raw_id("fast.w", 2), ORGANIZES, raw_id("other", 2))
        size, before = len(space._nodes), await references(server, "i=61")
        builder.remove(raw_id("fast", 2))
        assert len(space._nodes) == size - 3
        assert [await server.get_node(node).get_children() for node in ("ns=2;s=other",)] == [[]]
        assert [ref.NodeId for ref in space[raw_id("other", 2)].references if not ref.IsForward] == [OBJECTS]
        assert "fast" not in [ref.BrowseName.Name for ref in space[OBJECTS].references]
        assert await references(server, "i=61") == before
        add_parent_and_child(server)
        assert await server.get_node("ns=2;s=fast.v").read_value() == 1.5


def test_collection_goes_on_after_building() -> None:
    assert gc.isenabled()

    def build() -> None:
        with paused_collection():
            assert not gc.isenabled()
            raise ServerStartError("no")

    with pytest.raises(ServerStartError):
        build()
    assert gc.isenabled()
    gc.unfreeze()


async def test_names_that_no_node_has_any_more_are_not_kept() -> None:
    async with types_loaded() as server:
        builder = add_parent_and_child(server)
        shared, kinds = len(builder._shared), len(builder._kinds)
        for number in range(50):
            builder.add_variable(
                raw_id("fast.other", 2),
                QualifiedName(2, f"other {number}"),
                raw_id("fast", 2),
                VARIABLE_TYPE,
                data_type=DOUBLE,
                value=value(),
                value_rank=1,
                array_length=100 + number,
                description=f"number {number}",
            )
            builder.remove(raw_id("fast.other", 2))
        assert (len(builder._shared), len(builder._kinds)) == (shared, kinds)
