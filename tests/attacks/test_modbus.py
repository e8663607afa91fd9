"""A hostile or broken Modbus device costs itself, over TLS and without; an honest neighbour is read all the time."""

from __future__ import annotations

import socket
import ssl
import struct
import time
from pathlib import Path
from typing import Any

import pytest

from tests.attacks.servers import Serve, endless, goes_on, hostile, silent
from tests.integration.modbus.conftest import Bench, Device, Start, device, holding, of, start
from tests.integration.modbus.test_lines import certificate
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

__all__ = ["device", "start"]

HONEST = Topic(300, 2, 11)
BLOCK = b"\x00\x01\x00\x00\x00\xff\x01\x03" * 8192


def read_request(link: socket.socket) -> bytes:
    """The header of the next request."""
    header = link.recv(12, socket.MSG_WAITALL) if not isinstance(link, ssl.SSLSocket) else link.recv(12)
    if not header:
        raise ConnectionResetError
    return header[:7]


def answer(link: socket.socket, content: bytes, length: int | None = None) -> None:
    """Answer each request with that."""
    while True:
        number, _, _, unit = struct.unpack(">HHHB", read_request(link))
        link.sendall(struct.pack(">HHHB", number, 0, len(content) + 1 if length is None else length, unit) + content)


def drip(link: socket.socket) -> None:
    """A byte of the answer now and then, which never ends."""
    header = read_request(link)
    link.sendall(header[:4] + b"\x00\xff\x01\x03\xf0")
    while True:
        link.sendall(b"\x00")
        time.sleep(0.05)


def unasked(link: socket.socket) -> None:
    """Right answers to questions that nobody asked, as fast as can be."""
    frames = b"".join(struct.pack(">HHHBBBH", number, 0, 5, 1, 3, 2, 7) for number in range(4096))
    while True:
        link.sendall(frames)


def vanishing(link: socket.socket) -> None:
    """Go after the first request."""
    read_request(link)


KINDS: dict[str, Serve] = {
    "silent": silent,
    "endless": endless(BLOCK),
    "unasked": unasked,
    "dripping": drip,
    "vanishing": vanishing,
    "a_length_of_65535": lambda link: answer(link, b"\x03\x02\x00\x01", 65535),
    "a_length_of_0": lambda link: answer(link, b"\x03\x02\x00\x01", 0),
    "a_count_that_is_a_lie": lambda link: answer(link, b"\x03\xff\x00\x01"),
    "nothing_inside": lambda link: answer(link, b""),
    "another_function": lambda link: answer(link, b"\x2b\x0e\x01\x01\x00\x00\xff" + b"\x00\xff" * 100),
    "an_exception_without_a_code": lambda link: answer(link, b"\x83"),
}
PUT_ASIDE = {
    "endless": "more than 65536 bytes",
    "unasked": "more than 65536 bytes",
    "a_count_that_is_a_lie": "cannot be decoded",
}
"""Who says what no device should, and why it is let go of."""


async def beside_an_honest_one(device: Device, start: Start, port: int, **more: Any) -> Bench:
    """A bridge with a hostile device at a port, whose register has the id 10, and an honest one."""
    return await start(
        {"bad": {**of(device, **more), "port": port}, "good": of(device)},
        {"bad": holding("bad", 10), "good": holding("good", HONEST.id, 2)},
    )


# asyncio leaves a transport unclosed whose TLS handshake was cut off.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tls", [True, False], ids=["tls", "tcp"])
async def test_a_device_that_misbehaves_costs_itself(
    device: Device, start: Start, tmp_path: Path, kind: str, tls: bool
) -> None:
    certificate(tmp_path, "plc")
    context = None
    more: dict[str, Any] = {}
    if tls:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tmp_path / "plc.pem", tmp_path / "plc.key")
        more = {"tls": {"ca": "plc.pem"}}
    with hostile(KINDS[kind], context) as port:
        bench = await beside_an_honest_one(device, start, port, **more)
        await goes_on(bench.recorder, HONEST, 2.0)
        if kind in PUT_ASIDE:
            # It is tried again now and then, and is put aside anew.
            await until(lambda: PUT_ASIDE[kind] in bench.driver.status().aside.get("bad", ""), "the reason")
            assert bench.recorder.dropped(Drop.MISBEHAVED)
        if kind != "a_length_of_65535":
            assert not any(isinstance(value, int) for values in bench.all_values(10) for value in values)


@pytest.mark.parametrize("kind", ["silent", "endless"])
async def test_a_port_that_speaks_no_tls_costs_itself(device: Device, start: Start, tmp_path: Path, kind: str) -> None:
    certificate(tmp_path, "plc")
    with hostile(KINDS[kind], None) as port:
        bench = await beside_an_honest_one(device, start, port, tls={"ca": "plc.pem"})
        await goes_on(bench.recorder, HONEST, 2.0)
        assert "bad (127.0.0.1" in bench.driver.status().detail
        assert "look at its power" in bench.driver.status().detail
