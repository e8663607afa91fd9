"""The network between the processes of a chain, in one process: `links.py SOCKET LINKS_JSON`.

A TCP link takes connections at one port and hands them on to another one. A UDP link joins two multicast groups: each
sender of the one has a port of its own in the other, so that answers to a single address find back. Bytes stay as they
are, so what is encrypted stays so. Both pass each way until they are told:

    drop      UDP: datagrams are lost. TCP: connections are reset, and no new ones are taken
    hold      what comes waits, and goes on when the link passes again
    delay     everything takes so much longer
    jitter    UDP: up to so much longer, each datagram another time: they overtake each other
    repeat    UDP: each datagram comes again, so much later

Said as {"link": name, "mode": ..., "way": "there" | "back" | "both", "seconds": ...}, answered with the times just
before and after it was done.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import socket
import struct
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from tests.teleoperation.programs.control import serve

WAYS = {"there": ("there",), "back": ("back",), "both": ("there", "back")}
Send = Callable[[], None]


class Way:
    """One direction of a link."""

    def __init__(self) -> None:
        self.mode, self.seconds = "pass", 0.0
        self._held: list[Send] = []
        self._last = 0.0

    def set(self, mode: str, seconds: float) -> None:
        """Begin a mode; what was held goes on, before what comes now."""
        self.mode, self.seconds = mode, seconds
        held, self._held = self._held, []
        for send in held:
            send()

    def carry(self, send: Send, *, in_order: bool) -> None:
        """Have something sent as the mode says."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        if self.mode == "drop":
            return
        if self.mode == "hold":
            self._held.append(send)
            return
        wait_s = 0.0
        if self.mode == "delay":
            wait_s = self.seconds
        elif self.mode == "jitter":
            wait_s = random.uniform(0, self.seconds)
        elif self.mode == "repeat":
            loop.call_later(self.seconds, send)
        if in_order:
            self._last = max(now + wait_s, self._last)
            wait_s = self._last - now
        if wait_s > 0:
            loop.call_later(wait_s, send)
        else:
            send()


class TcpLink:
    """See the module."""

    def __init__(self, listen: int, to: int) -> None:
        self.ways = {"there": Way(), "back": Way()}
        self._listen, self._to = listen, to
        self._writers: set[asyncio.StreamWriter] = set()

    async def open(self) -> None:
        await asyncio.start_server(self._connected, "127.0.0.1", self._listen)

    def set(self, mode: str, seconds: float, way: str) -> None:
        if mode == "drop":
            way = "both"
            for writer in self._writers:
                _reset(writer)
        for name in WAYS[way]:
            self.ways[name].set(mode, seconds)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.ways["there"].mode == "drop":
            _reset(writer)
            return
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._to)
        except OSError:
            _reset(writer)
            return
        pair = {writer, far_writer}
        self._writers |= pair
        for each in pair:
            each.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        ways = self.ways
        try:
            await asyncio.gather(
                _pump(reader, far_writer, ways["there"]),
                _pump(far_reader, writer, ways["back"]),
                return_exceptions=True,
            )
        finally:
            self._writers -= pair


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, way: Way) -> None:
    def send(data: bytes) -> None:
        if not writer.is_closing():
            writer.write(data)

    with contextlib.suppress(OSError):
        while data := await reader.read(65_536):
            way.carry(partial(send, data), in_order=True)
    way.carry(writer.close, in_order=True)


def _reset(writer: asyncio.StreamWriter) -> None:
    """Close at once, and have the other end see a broken connection."""
    with contextlib.suppress(OSError):
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


Address = tuple[str, int]


class UdpLink:
    """See the module."""

    own: ClassVar[set[Address]] = set()
    """Where the links of this process send from: what these have sent is not handed on again."""

    def __init__(self, near: str, far: str) -> None:
        self.ways = {"there": Way(), "back": Way()}
        self._groups = {"there": _address(near), "back": _address(far)}
        self._ports: dict[tuple[str, Address], asyncio.DatagramTransport] = {}
        """By the way that they go, and whom they stand for at its end."""

    async def open(self) -> None:
        for way, other in (("there", "back"), ("back", "there")):
            _endpoint(_listening(self._groups[way]), _Heard(partial(self._to_group, way, other)))

    def set(self, mode: str, seconds: float, way: str) -> None:
        for name in WAYS[way]:
            self.ways[name].set(mode, seconds)

    def _to_group(self, way: str, other: str, data: bytes, sender: Address) -> None:
        if sender in self.own:
            return
        port, group = self._port(way, sender, other), self._groups[other]
        self.ways[way].carry(lambda: port.sendto(data, group), in_order=False)

    def _port(self, way: str, sender: Address, other: str) -> asyncio.DatagramTransport:
        """Where a sender speaks at the other end; what comes there goes back to it."""
        found = self._ports.get((way, sender))
        if found is None:
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            sock.bind(("127.0.0.1", 0))
            self.own.add(sock.getsockname())
            heard = _Heard(lambda data, who: self._to_one(data, who, sender, other, way))
            found = self._ports[way, sender] = _endpoint(sock, heard)
        return found

    def _to_one(self, data: bytes, who: Address, to: Address, way: str, other: str) -> None:
        port = self._port(way, who, other)
        self.ways[way].carry(lambda: port.sendto(data, to), in_order=False)


class _Heard(asyncio.DatagramProtocol):
    def __init__(self, heard: Callable[[bytes, Address], None]) -> None:
        self.datagram_received = heard  # type: ignore[assignment]


def _endpoint(sock: socket.socket, heard: _Heard) -> asyncio.DatagramTransport:
    """An endpoint at once, as nothing of it waits."""
    loop: Any = asyncio.get_running_loop()
    transport: asyncio.DatagramTransport = loop._make_datagram_transport(sock, heard)
    return transport


def _listening(group: Address) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(group)
    member = socket.inet_aton(group[0]) + socket.inet_aton("127.0.0.1")
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
    return sock


def _address(url: str) -> Address:
    host, _, port = url.removeprefix("opc.udp://").partition(":")
    return host, int(port)


async def main() -> None:
    links: dict[str, TcpLink | UdpLink] = {}
    for name, one in json.loads(Path(sys.argv[2]).read_text()).items():
        links[name] = TcpLink(one["listen"], one["to"]) if "listen" in one else UdpLink(one["near"], one["far"])
        await links[name].open()

    async def answer(said: dict[str, Any]) -> dict[str, Any]:
        before = time.monotonic()
        links[said["link"]].set(said["mode"], said.get("seconds", 0.0), said.get("way", "both"))
        return {"before": before, "after": time.monotonic()}

    await serve(sys.argv[1], answer)


asyncio.run(main())
