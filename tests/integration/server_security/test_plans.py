"""A request that is served from its bytes gets the answer that asyncua's decoder and encoder would lead to."""

from __future__ import annotations

import asyncio
import dataclasses
import random
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_security.harness import Client, Door, Identities, binary, door, ua
from tests.integration.server_security.test_mutations import mutated
from ua_fleet.endpoint.node_builder import NodeBuilder
from ua_fleet.endpoint.services import encoding

pytestmark = pytest.mark.asyncio(loop_scope="module")

COUNT = 150
_TIME_AND_HANDLE = slice(4, 16)


class Paths:
    """The same request by both ways."""

    def __init__(self, hardened: Door, client: Client) -> None:
        self._table = hardened.server._services.table  # type: ignore[union-attr]
        self._client = client
        self._plans = dict(self._table)

    async def compare(self, name: str, body: bytes) -> bytes:
        """The answer, which is the same by both ways, and when the plan knows the bytes already."""
        kind = encoding(name)
        self._table[kind] = dataclasses.replace(self._plans[kind], plan=None)
        expected = await self._answer(body)
        self._table[kind] = self._plans[kind]
        for _ in range(2):
            assert await self._answer(body) == expected
        return expected

    async def _answer(self, body: bytes) -> bytes:
        protocol = self._client.uaclient.protocol
        protocol._request_id += 1
        waiting: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        protocol._callbackmap[protocol._request_id] = waiting
        protocol.transport.write(protocol._connection.message_to_binary(body, request_id=protocol._request_id))
        data = bytearray(bytes(await asyncio.wait_for(waiting, 30)))
        data[_TIME_AND_HANDLE] = bytes(12)
        return bytes(data)

    def encoded(self, request: Any) -> tuple[bytes, int]:
        """A request, and where its parameters begin."""
        self._client.uaclient.protocol._setup_request_header(request.RequestHeader, 1)
        return binary.struct_to_binary(request), 4 + len(binary.struct_to_binary(request.RequestHeader))


def _targets(hardened: Door) -> list[Any]:
    nodes = hardened.nodes
    own = [nodes.value, nodes.plain, nodes.hidden, nodes.array, nodes.text, nodes.folder, *nodes.methods.values()]
    standard = [ua.NodeId(number) for number in (84, 85, 86, 58, 2004, 2254, 2255, 11715, 7617)]
    return [*own, *standard, ua.NodeId("unknown", 2), ua.NodeId(), ua.NodeId(nodes.value.Identifier, 9)]


def _read(rng: random.Random, targets: list[Any]) -> Any:
    request = ua.ReadRequest()
    request.Parameters.MaxAge = rng.choice((0.0, 0.0, 500.0, -1.0, float("nan")))
    request.Parameters.TimestampsToReturn = rng.choice((0, 1, 2, 2, 3, 4))
    for _ in range(rng.choice((0, 1, 1, 5, 20))):
        wanted = ua.ReadValueId(rng.choice(targets), rng.choice((13, 13, 13, rng.randrange(28))))
        wanted.IndexRange = rng.choice((None, None, None, "", "1:3", "9", "x", "100"))
        if rng.random() < 0.1:
            wanted.DataEncoding = rng.choice((ua.QualifiedName("Default Binary", 0), ua.QualifiedName("", 0)))
        request.Parameters.NodesToRead.append(wanted)
    return request


def _browse(rng: random.Random, targets: list[Any]) -> Any:
    request = ua.BrowseRequest()
    request.Parameters.RequestedMaxReferencesPerNode = rng.choice((0, 0, 1_000, 2))
    types = [ua.NodeId(), ua.NodeId(33), ua.NodeId(35), ua.NodeId(47), ua.NodeId(84), ua.NodeId(4_444)]
    for _ in range(rng.choice((0, 1, 1, 4))):
        wanted = ua.BrowseDescription(
            rng.choice(targets), rng.choice((0, 0, 1, 2, 3)), rng.choice(types), rng.random() < 0.7
        )
        wanted.NodeClassMask, wanted.ResultMask = rng.choice((0, 0, 1, 2, 4, 255)), rng.choice((63, 63, 0, 9, 255))
        request.Parameters.NodesToBrowse.append(wanted)
    return request


@pytest.mark.parametrize("user", ["olga", "oscar"])
async def test_reads_are_answered_alike_by_both_ways(tmp_path: Path, identities: Identities, user: str) -> None:
    rng = random.Random(17)
    async with door(tmp_path, identities) as hardened, hardened.connected(user) as client:
        paths, targets = Paths(hardened, client), _targets(hardened)
        seen: set[bytes] = set()
        for _ in range(COUNT):
            body, start = paths.encoded(_read(rng, targets))
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
            seen.add(await paths.compare("Read", body))
        assert len(seen) > COUNT // 5


async def test_browses_are_answered_alike_by_both_ways(tmp_path: Path, identities: Identities) -> None:
    rng = random.Random(18)
    # Continuation points are random: there are none here, but where a wish of two references leaves a rest.
    async with door(tmp_path, identities) as hardened, hardened.connected("olga") as client:
        paths, targets = Paths(hardened, client), _targets(hardened)
        seen: set[bytes] = set()
        for _ in range(COUNT):
            request = _browse(rng, targets)
            if request.Parameters.RequestedMaxReferencesPerNode == 2:
                request.Parameters.RequestedMaxReferencesPerNode = 0
            body, start = paths.encoded(request)
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
                if int.from_bytes(body[start + 14 : start + 18], "little") not in (0, 1_000):
                    continue
            seen.add(await paths.compare("Browse", body))
        assert len(seen) > COUNT // 5


async def test_what_has_changed_is_read_and_browsed_as_it_is_now(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        space, nodes = hardened.server.iserver.aspace, hardened.nodes
        node, folder = client.get_node(nodes.value), client.get_node(nodes.folder)
        for value in (2.5, 3.5):
            await node.write_value(value)
            assert [await node.read_value() for _ in range(2)] == [value, value]
        before = await folder.get_children()
        assert await folder.get_children() == before
        index = nodes.folder.NamespaceIndex
        await hardened.server.get_node(nodes.folder).add_variable(ua.NodeId("late", index), "late", 1)
        late = client.get_node(ua.NodeId("late", index))
        assert len(await folder.get_children()) == len(before) + 1
        assert [await late.read_value() for _ in range(2)] == [1, 1]
        NodeBuilder(space).remove(late.nodeid)
        assert await folder.get_children() == before
        with pytest.raises(ua.UaStatusCodeError, match="BadNodeIdUnknown"):
            await late.read_value()
        held = space[nodes.value].attributes[ua.AttributeIds.AccessLevel]
        held.value = ua.DataValue(ua.Variant(0, ua.VariantType.Byte))
        with pytest.raises(ua.UaStatusCodeError, match="BadNotReadable"):
            await node.read_value()
