from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests import system
from tests.integration.ros1.ros1_graph import Peer, Ros1Graph


@pytest.fixture
def graph(processes: system.Processes, tmp_path: Path, udp_url: str) -> Ros1Graph:
    """A ROS 1 graph of this test's own, with nothing in it yet."""
    return Ros1Graph(processes, tmp_path, udp_url)


@pytest.fixture
async def peer(udp_url: str) -> AsyncIterator[Peer]:
    """The bridge of ROS 2 domain 2, as far as space 1 can see."""
    async with Peer.at(udp_url, space=2) as started:
        yield started
