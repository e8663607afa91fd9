"""Floods of OpenSecureChannel, which cost their maker nothing and the server the use of its private key."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.attacks.handshakes import client_certificate, encrypted_blocks, open_frame
from tests.attacks.harness import VICTIM, AttackedServer, attacked, binary, ua

MANY_BLOCKS = 200
"""52 KB, which took 0.15 s to decrypt, twice."""


@pytest.fixture
def server(tmp_path: Path) -> Iterator[AttackedServer]:
    with attacked(tmp_path, trust_all_clients=True) as running:
        yield running


def handshakes(server: AttackedServer, count: int, *, blocks: int, address: str = "127.0.0.1") -> int:
    """So many at the same time, with a message of so many encrypted blocks; how many were let begin."""
    certificate = (server.folder / "state/certificates/own/server.der").read_bytes()
    said = binary.uatcp_to_binary(ua.MessageType.Hello, ua.Hello(0, 65_536, 65_536, 0, 0, "opc.tcp://x"))
    said += open_frame(certificate, encrypted_blocks(certificate, blocks), client_certificate())
    begun = 0
    with contextlib.ExitStack() as stack:
        opened: list[socket.socket] = []
        for _ in range(count):
            with contextlib.suppress(ConnectionError):
                made = socket.create_connection(("127.0.0.1", server.port), 30, source_address=(address, 0))
                opened.append(stack.enter_context(made))
                made.sendall(said)
        for each in opened:
            with contextlib.suppress(ConnectionError):
                begun += each.recv(3) == b"ACK"
                while each.recv(4_096):
                    pass
    return begun


def test_a_long_handshake_is_refused_before_it_is_decrypted(server: AttackedServer) -> None:
    """Twenty at once kept the victim waiting for 2.3 s."""
    with server.harm() as harm:
        for _ in range(3):
            handshakes(server, 20, blocks=MANY_BLOCKS)
    harm.check()


def test_an_address_has_a_budget_of_computing_time(tmp_path: Path) -> None:
    """There was none: as many as it asked for."""
    over = time.monotonic() + 60
    with attacked(tmp_path, trust_all_clients=True) as server:
        with server.harm() as harm:
            while handshakes(server, 20, blocks=12):
                assert time.monotonic() < over, "it goes on for ever"
            with server.logged_in("olga", VICTIM):
                pass
        harm.check()
    kinds = [line["of"] for line in server.audit() if line["event"] == "omitted"]
    assert any(of.get("connection BadTcpServerTooBusy") for of in kinds)
