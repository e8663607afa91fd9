"""A foreign client reads the events of the past: page by page, filtered, the latest first."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import ENGINEER, OBSERVER, SPEED, fleet_config, serving
from tests.integration.server_model.test_alarms import ACKNOWLEDGE, ALARM, robots, say, text, watching
from tests.interop.test_node_opcua import run_client
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

SCRIPT = Path(__file__).parent / "event_history.cjs"


@pytest.mark.needs("node")
async def test_a_foreign_client_reads_events(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(), history={})
    begin = datetime.now(UTC) - timedelta(seconds=1)
    async with serving(tmp_path, config) as running:
        async with running.client() as client, watching(client) as watched:
            running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
            await say(running, client, 1.2)
            active = await watched.next(ActiveState_Id=True)
            await client.get_node(ALARM).call_method(ACKNOWLEDGE, active["EventId"], text("seen"))
            seen = await watched.next(AckedState_Id=True)
        times = [begin.isoformat(), datetime.now(UTC).isoformat()]  # all that is read is over
        reports: list[dict[str, Any]] = []
        for user in (OBSERVER, ENGINEER):
            code, output, errors = await run_client(running.url, *user, tmp_path / "pki", *times, script=SCRIPT)
            assert code == 0, errors
            reports.append(json.loads(output.splitlines()[-1]))
    observed, engineered = reports
    assert observed["notifier"] == 5
    alarms = observed["alarms"]["events"]
    told = [event for event in alarms if event["EventId"] in (active["EventId"].hex(), seen["EventId"].hex())]
    assert [event["EventId"] for event in told] == [active["EventId"].hex(), seen["EventId"].hex()]
    assert [(event["ActiveState.Id"], event["AckedState.Id"]) for event in told] == [(True, False), (True, True)]
    assert alarms[0]["Message"] == "rover.speed: 1.2 m/s is above 1 m/s"
    assert observed["backward"]["events"] == alarms[::-1]
    whole = observed["all"]
    assert (whole["status"], whole["pages"]) == ("Good", (len(whole["events"]) + 1) // 2)
    assert [event for event in whole["events"] if event["EventType"] == "ns=0;i=9482"] == alarms
    assert (observed["audit"]["status"], observed["audit"]["events"]) == ("GoodNoData", [])
    assert {"Session/ActivateSession", "Attribute/Call"} <= {
        event["SourceName"] for event in engineered["audit"]["events"]
    }
