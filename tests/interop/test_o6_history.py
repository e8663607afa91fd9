"""A client of o6 (open62541) reads history: raw in pages, averages, and alarms that are over."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tests.integration.server_model.harness import OBSERVER, SPEED, fleet_config, serving
from tests.integration.server_model.test_alarms import robots, say, watching
from tests.integration.server_model.test_history import LONG, SPEED_NODE, moment, stored
from tests.interop.test_o6_alarms import run_o6
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

CLIENT = Path(__file__).parent / "o6_history.py"


@pytest.mark.needs("o6")
async def test_a_client_of_o6_reads_values_and_aggregates(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    stored(tmp_path, *range(4_500))
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, history={"days": LONG})) as running:
        async with running.client(OBSERVER):
            pass  # makes the certificate
        times = (moment(0).isoformat(), moment(4_500).isoformat())
        report = json.loads(await run_o6(CLIENT, running.url, tmp_path, OBSERVER, SPEED_NODE, *times))
    assert report["raw"] == [float(second) for second in range(4_500)]
    assert report["average"] == [9.5 + 20 * number for number in range(225)]
    assert report["maximum"] == [19.0 + 20 * number for number in range(225)]
    assert report["events"] == []


@pytest.mark.needs("o6")
async def test_a_client_of_o6_reads_events(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    begin = datetime.now(UTC)
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={})
    async with serving(tmp_path, config) as running:
        async with running.client() as client, watching(client) as watched:
            running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
            await say(running, client, 1.2)
            active = await watched.next(ActiveState_Id=True)
            await say(running, client, 0.5)
            over = await watched.next(ActiveState_Id=False)
        times = (begin.isoformat(), datetime.now(UTC).isoformat())
        report = json.loads(await run_o6(CLIENT, running.url, tmp_path, OBSERVER, SPEED_NODE, *times))
    found = [(is_active, event_id) for _, is_active, event_id in report["events"]]
    wanted = [(True, active["EventId"].hex()), (False, over["EventId"].hex())]
    assert [each for each in found if each in wanted] == wanted
