"""What a client may send before anybody knows who it is, how much of it, and how long it may take."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_security.harness import Client, Door, Identities, Raw, Stock, bad, binary, door, send, ua
from tests.waiting import until

pytestmark = pytest.mark.asyncio(loop_scope="module")

CHUNK = 65_536


async def opened(raw: Raw) -> int:
    """Say Hello and open a channel without security; its id."""
    raw.hello()
    assert (await raw.answer())[:3] == b"ACK"
    raw.open_channel()
    answer = await raw.answer()
    assert answer[:3] == b"OPN"
    return int.from_bytes(answer[8:12], "little")


async def test_announced_size_is_refused_at_once(hardened: Door) -> None:
    """Stock asyncua buffers all of a message of announced 805 MB, with a copy for each arrival, before it looks."""
    async with Raw.open(hardened.server.port) as raw:
        raw.write(b"HELF" + (805_000_000).to_bytes(4, "little"))
        assert (await raw.answer())[:4] == b"ERRF"
        assert await raw.closed()
    async with Raw.open(hardened.server.port) as raw:
        await opened(raw)
        raw.write(b"MSGF" + (CHUNK + 1).to_bytes(4, "little"))
        assert (await raw.answer())[:4] == b"ERRF"
        assert await raw.closed()


async def test_announced_size_is_buffered_stock(plain: Stock) -> None:
    """The hole: megabytes of a message that is announced too large are taken and kept."""
    async with Raw.open(plain.port) as raw:
        raw.write(b"HELF" + (805_000_000).to_bytes(4, "little") + bytes(2_000_000))
        await raw.writer.drain()
        assert not await raw.closed(0.3)
        assert plain.server.bserver is not None
        clients: list[Any] = list(plain.server.bserver.clients)
        await until(lambda: max(len(client._buffer) for client in clients) > 1_000_000, "the megabytes")


@pytest.mark.parametrize("head", [b"HELF\x08\x00\x00\x00", b"HELF\x00\x00\x00\x00", b"MSGF\x0c\x00\x00\x00"])
async def test_sizes_without_a_body(hardened: Door, head: bytes) -> None:
    async with Raw.open(hardened.server.port) as raw:
        raw.write(head)
        assert await raw.closed()


@pytest.mark.parametrize("first", [b"GET / HTTP/1.1\r\n\r\n", b"ACKF" + bytes(8), b"MSGX" + bytes(8), b"\xff" * 20])
async def test_what_is_no_opc_ua(hardened: Door, first: bytes) -> None:
    async with Raw.open(hardened.server.port) as raw:
        raw.write(first)
        assert await raw.closed()


async def test_messages_before_hello_or_channel(hardened: Door) -> None:
    """Stock asyncua answers requests that come before Hello and OpenSecureChannel."""
    request = binary.struct_to_binary(ua.GetEndpointsRequest())
    async with Raw.open(hardened.server.port) as raw:
        raw.open_channel()
        assert (await raw.answer())[:3] == b"ERR"
        assert await raw.closed()
    async with Raw.open(hardened.server.port) as raw:
        raw.hello()
        await raw.answer()
        raw.write(Raw.chunk(b"MSG", b"F", request, sequence=1))
        assert (await raw.answer())[:3] == b"ERR"
        assert await raw.closed()


async def test_chunks_are_counted_together(hardened: Door) -> None:
    """Stock asyncua keeps 100 MB of chunks for each connection that has not authenticated."""
    async with Raw.open(hardened.server.port) as raw:
        channel = await opened(raw)
        for number in range(40):
            raw.write(Raw.chunk(b"MSG", b"C", bytes(8_000), sequence=2 + number, channel=channel))
        answer = await raw.answer()
        assert answer[:3] == b"ERR"
        assert await raw.closed()


async def test_many_small_chunks(hardened: Door) -> None:
    async with Raw.open(hardened.server.port) as raw:
        channel = await opened(raw)
        for number in range(200):
            raw.write(Raw.chunk(b"MSG", b"C", b"x", sequence=2 + number, channel=channel))
        assert (await raw.answer())[:3] == b"ERR"
        assert await raw.closed()


async def test_chunks_are_kept_stock(plain: Stock) -> None:
    async with Raw.open(plain.port) as raw:
        raw.hello()
        await raw.answer()
        raw.open_channel()
        channel = int.from_bytes((await raw.answer())[8:12], "little")
        for number in range(200):
            raw.write(Raw.chunk(b"MSG", b"C", bytes(60_000), sequence=2 + number, channel=channel))
            await raw.writer.drain()
        assert not await raw.closed(0.3)
        assert plain.server.bserver is not None
        processors: list[Any] = [client.processor for client in plain.server.bserver.clients]
        assert max(processor._connection._incoming_size for processor in processors) > 10_000_000


async def test_requests_before_authentication_are_counted(hardened: Door) -> None:
    """Many small frames in one buffer are answered in order, up to a number that no honest client needs."""
    request = binary.struct_to_binary(ua.GetEndpointsRequest())
    async with Raw.open(hardened.server.port) as raw:
        channel = await opened(raw)
        for number in range(101):
            raw.write(Raw.chunk(b"MSG", b"F", request, sequence=2 + number, channel=channel, request=2 + number))
        for _ in range(100):
            assert (await raw.answer())[:3] == b"MSG"
        assert (await raw.answer())[:3] == b"ERR", "more than 100 requests are no discovery"


async def test_hello_with_tiny_buffers(hardened: Door) -> None:
    """A client that takes 1-byte chunks would make every response a flood of them."""
    async with Raw.open(hardened.server.port) as raw:
        raw.hello(buffers=64)
        assert (await raw.answer())[:3] == b"ERR"
        assert await raw.closed()


async def test_random_bytes_end_the_connection_only(hardened: Door) -> None:
    """Whatever a channel carries, the connection ends with an error, and the server goes on."""
    import random

    rng = random.Random(7)
    for _ in range(60):
        async with Raw.open(hardened.server.port) as raw:
            channel = await opened(raw)
            body = rng.randbytes(rng.randint(0, 200))
            raw.write(Raw.chunk(b"MSG", b"F", body, sequence=2, channel=channel))
            answer = await raw.answer()
            assert answer[:3] in {b"ERR", b"MSG"}
    async with hardened.connected() as client:
        assert await client.get_node(hardened.nodes.plain).read_value() == 7.0


async def test_slow_clients_are_cut_off_at_every_step(tmp_path: Path, identities: Identities) -> None:
    """Stock asyncua waits 30 s for ActivateSession, and for nothing else."""
    async with door(tmp_path, identities, limits={"handshake_s": 0.2}) as short:
        async with Raw.open(short.server.port) as silent, Raw.open(short.server.port) as drip:

            async def dribble() -> None:
                for byte in b"HELF\x40\x00\x00\x00" + bytes(40):
                    drip.write(bytes([byte]))
                    await asyncio.sleep(0.05)

            dribbling = asyncio.create_task(dribble())
            assert await silent.closed()
            assert await drip.closed()
            dribbling.cancel()
        async with Raw.open(short.server.port) as raw:
            channel = await opened(raw)
            request = binary.struct_to_binary(ua.GetEndpointsRequest())

            async def keep_asking() -> None:
                for number in range(90):
                    raw.write(
                        Raw.chunk(b"MSG", b"F", request, sequence=2 + number, channel=channel, request=2 + number)
                    )
                    await asyncio.sleep(0.02)

            asking = asyncio.create_task(keep_asking())
            assert await raw.closed(), "discovery requests buy no time"
            asking.cancel()
        client = await short.client()
        await client.connect_sessionless()
        await client.create_session()
        await asyncio.sleep(0.5)
        assert await bad(client.activate_session("oscar", "operate-1")) == "closed"
        await client._cancel_task(client._renew_channel_task)
        assert short.server.statistics.handshake_timeouts == 4
        async with short.connected() as good:
            await asyncio.sleep(0.3)
            assert await good.get_node(short.nodes.plain).read_value() == 7.0


async def test_waiting_connections_make_room_for_users(tmp_path: Path, identities: Identities) -> None:
    """Connections that never authenticate cannot keep others out; authenticated ones are never cut off for it."""
    async with door(tmp_path, identities, max_connections=4, limits={"connections": 4}) as small:
        async with small.connected() as user:
            raws = [Raw.open(small.server.port) for _ in range(8)]
            opened_now = [await raw.__aenter__() for raw in raws]
            assert await opened_now[0].closed()
            async with small.connected("olga") as other:
                assert await other.get_node(small.nodes.plain).read_value() == 7.0
                assert await user.get_node(small.nodes.plain).read_value() == 7.0
            for raw in raws:
                await raw.__aexit__(None, None, None)
        assert small.server.statistics.connections_evicted >= 6
        clients: list[Client] = []
        for _ in range(4):
            clients.append(await small.client())
            await clients[-1].connect()
        fifth = await small.client()
        assert await bad(fifth.connect()) == "closed"
        assert small.server.statistics.connections_refused == 1
        for client in clients:
            await client.disconnect()


async def test_sessions_are_counted(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities, limits={"sessions": 1}) as one, one.connected():
        second = await one.client("olga")
        assert await bad(second.connect()) == "BadTooManySessions"


async def test_large_requests_of_users_have_a_limit(tmp_path: Path, identities: Identities) -> None:
    """After authentication a request may have `max_message_bytes`, and no byte more."""
    async with door(tmp_path, identities, limits={"message_bytes": 300_000}) as small:
        async with small.connected() as client:
            node = client.get_node(small.nodes.text)
            assert await bad(node.write_value("x" * 200_000)) == "BadNotWritable"
            assert await bad(node.write_value("x" * 400_000)) in {"closed", "BadRequestTooLarge"}
        async with small.connected() as client:
            assert await client.get_node(small.nodes.plain).read_value() == 7.0


async def test_clients_that_do_not_read_are_cut_off(tmp_path: Path, identities: Identities) -> None:
    """Responses that nobody takes stop the requests, and then end the connection."""
    async with door(tmp_path, identities, limits={"stalled_s": 0.2}) as short:
        big = await short.server.nodes.objects.add_variable(ua.NodeId("big", 2), "big", "x" * 1_000_000)
        client = await short.client()
        await client.connect()
        protocol: Any = client.uaclient.protocol
        protocol.transport.pause_reading()
        request = ua.ReadRequest()
        wanted = ua.ReadValueId(big.nodeid, ua.AttributeIds.Value)
        request.Parameters.NodesToRead = [wanted] * 3
        request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
        answers = [asyncio.ensure_future(send(client, request, ua.ReadResponse)) for _ in range(20)]
        server: Any = short.server
        await until(lambda: not server._listener._connections, "the end of the connection")
        protocol.transport.abort()
        await asyncio.gather(*answers, return_exceptions=True)
        for task in (client._stale_watchdog_task, client._supervisor_task, client._renew_channel_task):
            await client._cancel_task(task)
