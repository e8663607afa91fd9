"""Data, clients' writes and skills of a robot whose ids are of another namespace, through a whole server."""

from __future__ import annotations

from pathlib import Path

from tests.integration.server_model.harness import SPACE, fleet_config, reader, serving, until
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

FIELD = (make_field("data", BuiltinType.DOUBLE),)
ROBOTS = {
    "near": {"bridge": "mobile_side", "data": {"speed": {"id": 1001, "type": "Double"}}},
    "far": {
        "bridge": "mobile_side",
        "namespace": 5,
        "skill_status_id": 1500,
        "skills": {"go": {"id": 1501, "timeout_s": 5, "arguments": {"metres": {"type": "Double", "unit": "m"}}}},
        "data": {
            "speed": {"id": 1002, "type": "Double", "unit": "m/s", "range": [-2, 2]},
            "pose": {"id": 1004, "fields": {"x": {"type": "Double"}, "frame": {"type": "String"}}},
            # The id of the other robot's data: another namespace, and another space, since the server publishes it.
            "goal": {"id": 1001, "type": "Double", "origin": "server", "range": [0, 1]},
        },
    },
}


async def test_a_robot_of_another_namespace_is_read_written_and_browsed(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    config = fleet_config(
        udp_url, tcp_port, robots=ROBOTS, namespaces=("urn:hall-2", "urn:hall-3"), unknown_sources="create"
    )
    async with serving(tmp_path, config) as running, running.client() as client:
        assert (await client.get_namespace_array())[2:] == [
            "urn:ua-fleet:fleet",
            "http://ua-fleet.org/UA/",
            "urn:hall-2",
            "urn:hall-3",
        ]
        near, far = Topic(SPACE, 2, 1001), Topic(SPACE, 5, 1002)
        for topic, value in ((near, 0.25), (far, 0.5)):
            running.peer.announce(topic, FIELD)
            running.peer.publish(topic, value)
            await until(reader(client, f"ns={topic.ns};i={topic.id}"), lambda data: data.StatusCode.is_good())
        assert await client.get_node("ns=2;i=1001").read_value() == 0.25
        assert await client.get_node("ns=5;i=1002").read_value() == 0.5
        await until(reader(client, "ns=2;s=Robots.far.State"), lambda data: data.Value.Value == 1)

        # BrowseNames are in the fleet's namespace, so paths are as ever.
        path = ["0:Objects", "2:Fleet", "3:Robots", "2:G00", "2:far", "3:Data", "2:speed", "0:EURange"]
        found = await client.nodes.root.get_child(path)
        assert found.nodeid.to_string() == "ns=5;s=1002.EURange"
        assert await client.get_node("ns=5;s=Topics.1004").read_value() == f"ua_{SPACE}_5_1004"
        assert (await client.get_node("ns=5;i=1501").read_browse_name()).to_string() == "2:go"
        assert (await client.get_node("ns=5;s=1501.Timeout").read_value()) == 5000

        goal = client.get_node("ns=5;i=1001")
        await goal.write_value(0.75)
        await running.peer.until(lambda: running.peer.messages(Topic(0, 5, 1001)))
        assert running.peer.messages(Topic(0, 5, 1001))[-1].values == (0.75,)

        # What no file names gets nodes in each namespace that there is, and none in others.
        for ns in (4, 6):
            running.peer.announce(Topic(SPACE, ns, 3000 + ns), FIELD)
            running.peer.publish(Topic(SPACE, ns, 3000 + ns), 1.0)
        await until(reader(client, "ns=4;i=3004"), lambda data: data.StatusCode.is_good())
        reason = await client.get_node(f"ns=2;s=Fleet.Discovered.Quarantine.ua_{SPACE}_6_3006.Reason").read_value()
        assert reason == "its namespace index is none of the fleet's (2, 4, 5)"
