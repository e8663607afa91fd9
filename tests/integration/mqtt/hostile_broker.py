"""A broker that does what no broker should. It speaks MQTT 5 as far as a client needs it to begin."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from enum import Enum
from fcntl import ioctl
from termios import FIONREAD
from typing import Any
from unittest.mock import patch


class Behaviour(Enum):
    """What it does."""

    MUTE = "accepts connections and never answers"
    FORGETFUL = "lets everybody in and acknowledges nothing else"
    CLOSING = "closes the connection at each publish"
    TWICE = "delivers each message twice, and the one before it once more"
    RUBBISH = "has retained messages of its own"
    BUSY = "refuses all but one of the first subscriptions"
    GARBAGE = "sends bytes that are no MQTT"


FIRST = 7
"""Subscriptions that a busy broker refuses."""


def length(size: int) -> bytes:
    """A Variable Byte Integer."""
    out = bytearray()
    while True:
        size, part = divmod(size, 128)
        out.append(part | (0x80 if size else 0))
        if not size:
            return bytes(out)


def publish(topic: bytes, payload: bytes, *, retain: bool = False) -> bytes:
    """A PUBLISH of QoS 0."""
    body = len(topic).to_bytes(2, "big") + topic + b"\x00" + payload
    return bytes((0x30 | retain,)) + length(len(body)) + body


def publish_acknowledged(topic: bytes, payload: bytes, number: int) -> bytes:
    """A PUBLISH of QoS 1."""
    body = len(topic).to_bytes(2, "big") + topic + number.to_bytes(2, "big") + b"\x00" + payload
    return b"\x32" + length(len(body)) + body


class HostileBroker:
    """See the module."""

    def __init__(self, behaviour: Behaviour, retained: Iterable[bytes] = ()) -> None:
        self.behaviour, self._retained = behaviour, list(retained)
        self.connections = self.refused = 0
        self.received: list[tuple[str, bytes]] = []
        """Topics and payloads of what was published, over all connections."""
        self.subscriptions: list[tuple[str, int]] = []
        """Filters and their QoS, as they were asked for."""
        self._last = b""
        self._writers: list[asyncio.StreamWriter] = []
        self._subscribed: list[asyncio.StreamWriter] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self._writers.append(writer)
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            while True:
                first = (await reader.readexactly(1))[0]
                body = await reader.readexactly(await self._length(reader))
                if self.behaviour is Behaviour.MUTE:
                    continue
                if not self._answer(first, body, writer):
                    break
        writer.close()

    @property
    def unread_bytes(self) -> int:
        """What the last connection has sent and nobody has read yet."""
        found = ioctl(self._writers[-1].get_extra_info("socket").fileno(), FIONREAD, bytes(4))
        return int.from_bytes(found, sys.byteorder)

    def close(self) -> None:
        """Close all connections."""
        for writer in self._writers:
            writer.close()

    async def _length(self, reader: asyncio.StreamReader) -> int:
        size, shift = 0, 0
        while True:
            part = (await reader.readexactly(1))[0]
            size |= (part & 0x7F) << shift
            shift += 7
            if not part & 0x80:
                return size

    def _answer(self, first: int, body: bytes, writer: asyncio.StreamWriter) -> bool:
        """Whether the connection goes on."""
        kind = first >> 4
        if kind == 1:
            writer.write(b"\x20\x03\x00\x00\x00")
            if self.behaviour is Behaviour.GARBAGE:
                writer.write(b"\xff\xff\xff\xff\xff\x00")
        elif kind == 8:
            answer = body[:2] + b"\x00" + self._granted(body)
            writer.write(b"\x90" + length(len(answer)) + answer)
            if writer not in self._subscribed:  # with the first filter of a connection, whatever that is
                self._subscribed.append(writer)
                writer.writelines(self._retained)
        elif kind == 12 and self.behaviour is not Behaviour.FORGETFUL:
            writer.write(b"\xd0\x00")
        elif kind == 3:
            return self._published(first, body, writer)
        return kind != 14

    def _granted(self, body: bytes) -> bytes:
        """The reason codes of a SUBACK."""
        at, codes = 2 + 1 + body[2], bytearray()
        while at < len(body):
            end = at + 2 + int.from_bytes(body[at : at + 2], "big")
            wanted, qos = body[at + 2 : end].decode(), body[end] & 0x03
            is_refused = self.behaviour is Behaviour.BUSY and bool(self.subscriptions) and self.refused < FIRST
            self.refused += is_refused
            self.subscriptions.append((wanted, qos))
            codes.append(0x80 if is_refused else qos)
            at = end + 1
        return bytes(codes)

    def _published(self, first: int, body: bytes, writer: asyncio.StreamWriter) -> bool:
        size = int.from_bytes(body[:2], "big")
        topic, rest = body[2 : 2 + size], body[2 + size :]
        number = rest[:2]
        rest = rest[2:] if first & 0x06 else rest
        payload = rest[1 + rest[0] :]
        self.received.append((topic.decode(), payload))
        if self.behaviour is Behaviour.CLOSING:
            return False
        if self.behaviour is not Behaviour.FORGETFUL and first & 0x06:
            writer.write(b"\x40\x02" + number)
        if self.behaviour is Behaviour.TWICE:
            again = publish(topic, payload)
            for each in self._writers:
                each.write(again + again + self._last)
            self._last = again
        return True


@asynccontextmanager
async def hostile(behaviour: Behaviour, retained: Iterable[bytes] = ()) -> AsyncGenerator[tuple[HostileBroker, str]]:
    """Such a broker and its URL, while the context lasts. It has no port: connections of this loop end in it."""
    broker = HostileBroker(behaviour, retained)
    loop = asyncio.get_running_loop()
    connect = loop.create_connection
    serving: set[asyncio.Task[None]] = set()

    async def connect_here(factory: Any, *_place: Any, **_options: Any) -> Any:
        mine, theirs = socket.socketpair()
        reader = asyncio.StreamReader()
        transport, _ = await connect(lambda: asyncio.StreamReaderProtocol(reader), sock=theirs)
        made = asyncio.StreamWriter(transport, transport.get_protocol(), reader, loop)
        serving.add(asyncio.ensure_future(broker.serve(reader, made)))
        return await connect(factory, sock=mine)

    with patch.object(loop, "create_connection", connect_here):
        try:
            yield broker, "mqtt://hostile"
        finally:
            broker.close()
            for task in serving:
                task.cancel()
            await asyncio.gather(*serving, return_exceptions=True)
