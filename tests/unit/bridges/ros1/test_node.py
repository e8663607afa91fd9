# pyright: basic, reportMissingImports=false
from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy", reason="needs the Python that has rospy")

from ua_bridges.ros1.node import is_up


@pytest.fixture
def link() -> Iterator[SimpleNamespace]:
    """A link as rospy has it, with the robot at its other end."""
    with socket.create_server(("127.0.0.1", 0)) as robot, socket.create_connection(robot.getsockname()) as connected:
        accepted, _ = robot.accept()
        with closing(accepted):
            yield SimpleNamespace(header={"callerid": "/robot"}, socket=connected, done=False)


def test_link_is_up_from_its_handshake_until_its_end(link: SimpleNamespace) -> None:
    assert is_up(link)
    link.done = True
    assert not is_up(link)
    link.done, link.header = False, None
    assert not is_up(link)


def test_link_that_was_lost_is_not_up_while_it_is_made_anew(link: SimpleNamespace) -> None:
    """rospy keeps the header, and sets the next socket before anybody has answered on it."""
    link.socket = None
    assert not is_up(link)
    with socket.socket() as waiting:
        link.socket = waiting
        assert not is_up(link)
