"""The same request by a service's plan and by asyncua's decoder and encoder."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import Callable, Generator
from typing import Any
from unittest import mock

from tests.integration.server_security.harness import Client, Door, binary, ua
from ua_fleet.endpoint import decoding
from ua_fleet.endpoint.services import encoding

_TIME_AND_HANDLE = slice(4, 16)


class Paths:
    """The same request by both ways."""

    def __init__(self, hardened: Door, client: Client) -> None:
        self._table = hardened.server._services.table  # type: ignore[union-attr]
        self._client = client
        self._plans = dict(self._table)

    async def compare(self, name: str, body: bytes, left: Callable[[], Any] = lambda: None) -> bytes:
        """The answer, which is the same by both ways, and when the plan knows the bytes already.

        So is what `left` says that a request has left behind.
        """
        with self.without_plan(name):
            expected = await self.answer(body), left()
        for _ in range(2):
            assert (await self.answer(body), left()) == expected
        return expected[0]

    @contextlib.contextmanager
    def without_plan(self, name: str) -> Generator[None]:
        """Meanwhile asyncua decodes all requests of a service."""
        kind = encoding(name)
        self._table[kind] = dataclasses.replace(self._plans[kind], plan=None)
        nothing: dict[Any, Any] = {}
        with mock.patch.object(decoding, "PLAIN", nothing):
            yield
        self._table[kind] = self._plans[kind]

    async def answer(self, body: bytes) -> bytes:
        """The answer to a request, without its time and handle."""
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


def targets_of(hardened: Door) -> list[Any]:
    """Nodes of all kinds, and some that are not there."""
    nodes = hardened.nodes
    own = [nodes.value, nodes.plain, nodes.hidden, nodes.array, nodes.text, nodes.folder, *nodes.methods.values()]
    standard = [ua.NodeId(number) for number in (84, 85, 86, 58, 2004, 2254, 2255, 11715, 7617)]
    return [*own, *standard, ua.NodeId("unknown", 2), ua.NodeId(), ua.NodeId(nodes.value.Identifier, 9)]
