# pyright: basic, reportMissingImports=false
from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rospy", reason="needs the Python that has rospy")

import rosgraph.xmlrpc
import rospy.impl.tcpros
from ua_bridges.ros1.node import RosNode, is_up

from ua_fleet.errors import BridgeUnavailable


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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_node_whose_server_does_not_start_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(rosgraph.xmlrpc, "ThreadingXMLRPCServer", full)
    # A test before this one may have had a node, and ended it.
    monkeypatch.setattr(rospy.core, "_shutdown_flag", False)
    monkeypatch.setattr(rospy.core, "_preshutdown_hooks", [])
    monkeypatch.setattr(rospy.impl.tcpros, "init_tcpros", lambda: None)
    monkeypatch.setattr(rospy.names, "_set_caller_id", lambda name: None)
    errors: list[Exception] = []
    node: Any = SimpleNamespace(name="/ua_bridge")

    def start() -> None:
        try:
            RosNode._start_server(node, "http://127.0.0.1:1")
        except BridgeUnavailable as error:
            errors.append(error)

    starting = threading.Thread(target=start, daemon=True)
    starting.start()
    starting.join(5)
    assert "its server did not start" in str(errors[0])
