from __future__ import annotations

import socket
from collections.abc import Generator
from contextlib import ExitStack

import pytest
from ua_bridges.ur.link import CommandLink

from tests.ur_controller import free_loopback
from ua_fleet.errors import RobotOffline


@pytest.fixture
def deaf_host() -> Generator[str]:
    """Its port 30002 is behind a firewall, as it seems: the first packet of a connection is never answered."""
    host = free_loopback()
    with ExitStack() as stack:
        listener = stack.enter_context(socket.create_server((host, 30002), backlog=0))
        while True:
            try:
                stack.enter_context(socket.create_connection(listener.getsockname(), 0.1))
            except TimeoutError:
                break
        yield host


def test_program_that_could_not_be_sent_is_told_with_the_port(deaf_host: str) -> None:
    with pytest.raises(RobotOffline, match="port 30002: timed out; see that"):
        CommandLink(deaf_host, 0.2).send_script("def p():\nend\n")
