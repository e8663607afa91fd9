"""A value that cannot be encoded is a mistake of this server: it costs its own DataValue, and no other."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.integration.server_security.harness import Door, ua

pytestmark = pytest.mark.asyncio(loop_scope="module")


class Handler:
    """What a subscription tells."""

    def __init__(self) -> None:
        self.told: asyncio.Queue[Any] = asyncio.Queue()

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        self.told.put_nowait((node.nodeid, data.monitored_item.Value))

    def event_notification(self, event: Any) -> None:
        self.told.put_nowait(event)


def _break(hardened: Door, node_id: Any, value: Any) -> None:
    hardened.server.iserver.aspace[node_id].attributes[ua.AttributeIds.Value].value = value


BROKEN = [
    ua.DataValue(ua.Variant(None, ua.VariantType.DateTime)),
    ua.DataValue(ua.Variant("text", ua.VariantType.Double)),
    ua.DataValue(ua.Variant([None], ua.VariantType.NodeId)),
    ua.DataValue(ua.Variant("\ud800", ua.VariantType.String)),
    ua.DataValue(ua.Variant(object(), ua.VariantType.ExtensionObject)),
    ua.DataValue(ua.Variant(1.0, ua.VariantType.Double), SourceTimestamp="yesterday"),
]


@pytest.mark.parametrize("value", BROKEN, ids=range(len(BROKEN)))
async def test_an_unencodable_value_is_read_as_its_status_alone(hardened: Door, value: Any) -> None:
    nodes, before = hardened.nodes, hardened.server.context.mistakes.counts["encoding"]
    whole = hardened.server.iserver.aspace[nodes.plain].attributes[ua.AttributeIds.Value].value
    _break(hardened, nodes.plain, value)
    try:
        async with hardened.connected() as client:
            wanted = [ua.ReadValueId(node, ua.AttributeIds.Value) for node in (nodes.value, nodes.plain, nodes.array)]
            results = await client.uaclient.read(ua.ReadParameters(NodesToRead=wanted))
            assert [result.StatusCode.name for result in results] == ["Good", "BadEncodingError", "Good"]
            assert results[2].Value.Value == list(range(10))
            subscription = await client.create_subscription(10, handler := Handler())
            await subscription.subscribe_data_change([client.get_node(node) for node in (nodes.plain, nodes.array)])
            async with asyncio.timeout(60):
                told = dict([await handler.told.get() for _ in range(2)])
            assert told[nodes.plain].StatusCode.name == "BadEncodingError"
            assert told[nodes.array].Value.Value == list(range(10))
    finally:
        _break(hardened, nodes.plain, whole)
    assert hardened.server.context.mistakes.counts["encoding"] == before + 2


async def test_an_unencodable_field_costs_its_event_nothing_else(hardened: Door) -> None:
    async with hardened.connected() as client:
        subscription = await client.create_subscription(10, handler := Handler())
        await subscription.subscribe_events()
        generator = await hardened.server.get_event_generator()
        event: Any = generator.event
        event.SourceName = "\ud800"
        event.data_types["SourceName"] = ua.VariantType.String
        await generator.trigger(message="a message")
        async with asyncio.timeout(60):
            told = await handler.told.get()
        assert told.Message.Text == "a message"
        assert told.SourceName.name == "BadEncodingError"


async def test_an_unencodable_reference_is_left_out(hardened: Door) -> None:
    folder = hardened.server.iserver.aspace[hardened.nodes.folder]
    broken = ua.ReferenceDescription(BrowseName=ua.QualifiedName("\ud800", 0), IsForward=True)
    folder.references.append(broken)
    try:
        async with hardened.connected() as client:
            children = await client.get_node(hardened.nodes.folder).get_children()
            assert len(children) == 30
    finally:
        folder.references.remove(broken)
