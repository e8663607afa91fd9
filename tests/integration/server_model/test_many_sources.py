"""A server knows as many DataSetWriters as its fleet has."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration.server_model.harness import OBSERVER, POSE, SPEED, fleet_config, reader, serving
from tests.integration.server_model.harness import until as until_read
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.server import ground
from ua_fleet.values import BuiltinType


async def test_a_fleet_with_more_sources_than_usual_hears_all_of_them(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 150,000 sources all but 50,000 were `unknown_source`: no more DataSetWriters were known."""
    monkeypatch.setattr(ground, "LEAST_WRITERS", 1)
    config = fleet_config(udp_url, tcp_port)
    config = config.model_copy(update={"server": config.server.model_copy(update={"max_discovered_sources": 0})})
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        running.peer.announce(POSE, (make_field("x", BuiltinType.DOUBLE), make_field("frame", BuiltinType.STRING)))
        running.peer.publish(SPEED, 0.25)
        running.peer.publish(POSE, 1.5, "map")
        for node in ("ns=2;i=1001", "ns=2;s=1004.x"):
            await until_read(reader(client, node), lambda data: data.StatusCode.is_good())
