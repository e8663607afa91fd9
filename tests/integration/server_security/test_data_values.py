"""The times of a DataValue with their picoseconds, in the order of OPC 10000-6 5.2.2.17, which asyncua does not have.

Its client sends and reads them here as structures of their own, whose fields stand in the order of the standard.
"""

from __future__ import annotations

import asyncio
import struct
from dataclasses import make_dataclass
from datetime import UTC, datetime
from typing import Any

import pytest

from tests.integration.server_security.harness import Client, Door, send, ua
from tests.integration.server_security.test_services import read, variable, write

pytestmark = pytest.mark.asyncio(loop_scope="module")

SOURCE, SERVER = datetime(2020, 1, 2, tzinfo=UTC), datetime(2020, 1, 3, tzinfo=UTC)
ALL = 0x01 | 0x04 | 0x08 | 0x10 | 0x20
"""Value and both times with their picoseconds; no status."""


TIMES = (
    ("SourceTimestamp", ua.DateTime),
    ("SourcePicoSeconds", ua.UInt16),
    ("ServerTimestamp", ua.DateTime),
    ("ServerPicoSeconds", ua.UInt16),
)
WriteOfOne: Any = make_dataclass(
    "WriteOfOne",
    (
        ("TypeId", ua.NodeId),
        ("RequestHeader", ua.RequestHeader),
        ("Count", ua.UInt32),
        ("NodeId", ua.NodeId),
        ("AttributeId", ua.UInt32),
        ("IndexRange", ua.String),
        ("Mask", ua.Byte),
        ("Value", ua.Variant),
        *TIMES,
    ),
)
ReadOfOne: Any = make_dataclass(
    "ReadOfOne",
    (
        ("TypeId", ua.NodeId),
        ("ResponseHeader", ua.ResponseHeader),
        ("Count", ua.UInt32),
        ("Mask", ua.Byte),
        ("Value", ua.Variant),
        ("StatusCode", ua.StatusCode),
        *TIMES,
    ),
)


async def write_finely(client: Client, node_id: Any, source: int, server: int) -> str:
    known = ua.WriteRequest()
    request = WriteOfOne(
        known.TypeId, known.RequestHeader, 1, node_id, 13, None, ALL, ua.Variant(2.5), SOURCE, source, SERVER, server
    )
    return str((await send(client, request, ua.WriteResponse)).Results[0].name)


async def read_finely(client: Client, node_id: Any) -> Any:
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(node_id, ua.AttributeIds.Value)]
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    return await send(client, request, ReadOfOne)


async def test_picoseconds_are_written_and_read(hardened: Door) -> None:
    """They were Bad_WriteNotSupported."""
    node_id = await variable(hardened, "fine", 1.5)
    async with hardened.connected() as client:
        assert await write_finely(client, node_id, 30, 20) == "Good"
        told = await read_finely(client, node_id)
        assert (told.Mask, told.Value.Value) == (ALL | 0x02, 2.5)
        assert (told.SourceTimestamp, told.SourcePicoSeconds) == (SOURCE, 30)
        assert (told.ServerTimestamp, told.ServerPicoSeconds) == (SERVER, 20)
        # What is more than 99,990 ps stands for that.
        assert await write_finely(client, node_id, 10_000, 65_535) == "Good"
        told = await read_finely(client, node_id)
        assert (told.SourcePicoSeconds, told.ServerPicoSeconds) == (9_999, 9_999)


async def test_picoseconds_go_with_their_time_alone(hardened: Door) -> None:
    """Those without a time say nothing; where the server has the other time, asyncua's order is the standard's."""
    node_id = await variable(hardened, "half", 1.5)
    async with hardened.connected() as client:
        assert await write(client, node_id, ua.DataValue(ua.Variant(2.5), SourcePicoseconds=30)) == "Good"
        assert (await read(client, node_id)).SourcePicoseconds is None
        given = ua.DataValue(ua.Variant(2.5), SourceTimestamp=SOURCE, SourcePicoseconds=30)
        assert await write(client, node_id, given) == "Good"
        request = ua.ReadRequest()
        request.Parameters.NodesToRead = [ua.ReadValueId(node_id, ua.AttributeIds.Value)]
        request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Source
        (told,) = (await send(client, request, ua.ReadResponse)).Results
        assert (told.SourceTimestamp, told.SourcePicoseconds, told.ServerTimestamp) == (SOURCE, 30, None)


async def test_a_subscription_tells_them(hardened: Door) -> None:
    node_id = await variable(hardened, "told", 1.5)
    async with hardened.connected() as client:
        request = ua.CreateSubscriptionRequest()
        request.Parameters = ua.CreateSubscriptionParameters(50.0, 100, 100, 0, True, 0)
        made = await send(client, request, ua.CreateSubscriptionResponse)
        items = ua.CreateMonitoredItemsRequest()
        items.Parameters.SubscriptionId = made.Parameters.SubscriptionId
        items.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
        item = ua.MonitoredItemCreateRequest(ua.ReadValueId(node_id, ua.AttributeIds.Value))
        item.MonitoringMode = ua.MonitoringMode.Reporting
        item.RequestedParameters.QueueSize = 1
        items.Parameters.ItemsToCreate = [item]
        assert (await send(client, items, ua.CreateMonitoredItemsResponse)).Results[0].StatusCode.is_good()
        assert await write_finely(client, node_id, 30, 20) == "Good"
        wanted = struct.pack("<qHqH", ticks(SOURCE), 30, ticks(SERVER), 20)
        protocol: Any = client.uaclient.protocol
        async with asyncio.timeout(60):
            while wanted not in bytes(await protocol.send_request(ua.PublishRequest())):
                pass


def ticks(time: datetime) -> int:
    return int(ua.datetime_to_win_epoch(time))
