# pyright: basic, reportMissingImports=false
from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest
from structlog.testing import capture_logs

pytest.importorskip("rospy", reason="needs the Python that has rospy")

from ua_bridges.ros1.api import Doorman, Orders
from ua_bridges.ros1.master import SystemState
from ua_bridges.ros1.watch import Watch

from tests.waiting import until


class Master:
    """A master that has nothing to say."""

    uri = "http://127.0.0.1:1"

    def system_state(self) -> SystemState:
        return SystemState({}, {}, {})

    def node_uri(self, _name: str) -> None:
        pass

    def unregister(self, *_: object) -> None:
        pass

    def close(self) -> None:
        pass


async def test_watch_whose_node_cannot_be_reached_is_over() -> None:
    node = SimpleNamespace(name="/ua_bridge", uri="", orders=Orders(), is_reachable=True, doorman=Doorman(None))
    nothing: Any = None
    watch = Watch(
        1,
        cast("Any", node),
        cast("Any", Master()),
        nothing,
        asyncio.get_running_loop(),
        {},
        [],
        nothing,
        nothing,
        {},
        nothing,
    )
    watch.start()
    with capture_logs() as logs:
        await until(lambda: watch.status.connected, "the connection")
        node.is_reachable = False
        await until(lambda: not watch.status.connected, "the end")
    assert watch.status.is_over
    assert "the server of the ROS 1 node has ended" in watch.status.detail
    assert [entry["log_level"] for entry in logs] == ["error"]
    await asyncio.to_thread(watch.leave)
