# pyright: basic, reportMissingImports=false
from __future__ import annotations

import gzip
import http.client
import threading
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rospy", reason="needs the Python that has rospy")

import rospy.impl.tcpros
from ua_bridges.ros1.api import ApiNode, Orders
from ua_bridges.ros1.node import RosNode

from ua_fleet.errors import BridgeUnavailable


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_node_whose_server_does_not_start_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr("ua_bridges.ros1.api._Server", full)
    # A test before this one may have had a node, and ended it.
    monkeypatch.setattr(rospy.core, "_shutdown_flag", False)
    monkeypatch.setattr(rospy.core, "_preshutdown_hooks", [])
    monkeypatch.setattr(rospy.impl.tcpros, "init_tcpros", lambda: None)
    monkeypatch.setattr(rospy.impl.tcpros_base, "_tcpros_server", SimpleNamespace())
    monkeypatch.setattr(rospy.names, "_set_caller_id", lambda name: None)
    errors: list[Exception] = []
    node: Any = SimpleNamespace(name="/ua_bridge", orders=Orders())

    def start() -> None:
        try:
            RosNode._start_server(node, "http://127.0.0.1:1")
        except BridgeUnavailable as error:
            errors.append(error)

    starting = threading.Thread(target=start, daemon=True)
    starting.start()
    starting.join(5)
    assert "its server did not start" in str(errors[0])


CALL = "<?xml version='1.0' encoding='{}'?>{}<methodCall><methodName>{}</methodName><params/></methodCall>"
ENTITY = '<!DOCTYPE a [<!ENTITY a "getPid">]>'


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (CALL.format("utf-8", "", "getPid").encode(), 200),
        (CALL.format("utf-8", ENTITY, "&a;").encode(), 400),
        (CALL.format("utf-16", ENTITY, "&a;").encode("utf-16"), 400),
        (gzip.compress(CALL.format("utf-8", ENTITY, "&a;").encode()), 400),
    ],
)
def test_a_call_with_entities_is_refused_before_it_is_parsed(body: bytes, status: int) -> None:
    handler = SimpleNamespace(getPid=lambda: [1, "", 7], _ready=lambda _uri: None, _custom_dispatch_table={})
    node = ApiNode(0, handler, on_run_error=None)
    node._run_init()
    serving = threading.Thread(target=node.server.serve_forever, daemon=True)
    serving.start()
    asked = http.client.HTTPConnection("127.0.0.1", node.server.socket.getsockname()[1], timeout=5)
    headers = {"Content-Encoding": "gzip"} if body.startswith(b"\x1f\x8b") else {}
    asked.request("POST", "/", body, headers)
    assert asked.getresponse().status == status
    asked.close()
    node.server.shutdown()
    node.server.server_close()
    serving.join(5)
