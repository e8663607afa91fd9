"""A ROS 1 node that is ended as soon as it is there."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

import threading
import time

import pytest

pytest.importorskip("rospy", reason="needs the Python that has rospy")

from ua_bridges.ros1 import api
from ua_bridges.ros1.node import RosNode


def test_a_node_whose_server_is_slow_to_begin_can_be_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = api.ApiNode._run_init

    def begin_slowly(node: api.ApiNode) -> None:
        begin(node)
        time.sleep(0.3)

    monkeypatch.setattr(api.ApiNode, "_run_init", begin_slowly)
    node = RosNode("slow_to_begin", "http://127.0.0.1:1", "127.0.0.1")
    ending = threading.Thread(target=node.close, daemon=True)
    ending.start()
    ending.join(10)
    assert not ending.is_alive()
    assert not node.is_reachable
