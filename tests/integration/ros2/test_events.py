"""The events of a run in ROS 2: each once, as JSON, for the nodes that are there, and for none that comes later."""

from __future__ import annotations

import ast
import asyncio
import base64
import json
from typing import Any

import pytest

from tests.integration.ros2.conftest import Ros2Space, heard
from tests.integration.scenarios.conftest import run, run_is, watching
from tests.integration.server_model.harness import serving
from tests.system import Child
from tests.waiting import until
from ua_fleet.config.load import load_content

pytestmark = pytest.mark.needs("ros2")

TOPIC = "ua_0_2_1990"
STEPS = 20
SCENARIO = "version: 1\nname: short\ndescription: for a test\nsteps:\n" + "  - {wait: 0.001}\n" * STEPS
RUN = 1026


def events(listener: Child) -> list[dict[str, Any]]:
    """What a listener has heard, of which it prints the `repr`."""
    texts = [line.removeprefix("std_msgs.msg.String(data=").removesuffix(")") for line in heard(listener)]
    return [json.loads(ast.literal_eval(text)) for text in texts]


async def test_each_event_arrives_once_with_its_fields(ros2: Ros2Space, tcp_port: int) -> None:
    raw = {
        **ros2.fleet(),
        "server": {"port": tcp_port, "trust_all_clients": True},
        "scenarios": {"events_id": 1990},
    }
    config = load_content(json.dumps(raw).encode(), "fleet.json", {})
    (ros2.folder / "scenarios").mkdir()
    (ros2.folder / "scenarios" / "short.yaml").write_text(SCENARIO)
    ros2.bridge(scenarios={"events_id": 1990})
    listener = ros2.listener(TOPIC, "std_msgs/String")
    async with serving(ros2.folder, config) as server, server.client() as client:
        async with watching(client, RUN) as seen:
            for _ in range(2):
                run_id = await run(client, "short")
                await run_is(client, run_id, "done")
                await seen.wait_for(f"{run_id}: done")
            told = {event.EventId: event for event in seen.events}
            assert len(told) > 2 * STEPS
            await until(lambda: len(events(listener)) >= len(told), "all events in ROS 2")
        late = ros2.listener(TOPIC, "std_msgs/String", "--name", "late")
        await asyncio.sleep(1.0)  # that nothing comes cannot be waited for
        got = events(listener)
        assert [base64.b64decode(each["EventId"]) for each in got] == list(told)
        for each in got:
            event = told[base64.b64decode(each["EventId"])]
            assert (each["RunId"], each["Scenario"], each["State"]) == (event.RunId, event.Scenario, event.State)
            assert (each["Message"], each["Severity"]) == (event.Message.Text, event.Severity)
            assert each["EventType"] == event.EventType.to_string()
        assert events(late) == []
