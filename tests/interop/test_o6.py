"""Publishers of o6 (open62541), without metadata: a node where `sources` states their fields, else a reason or text."""

from __future__ import annotations

import json
import socket
import sys
from pathlib import Path

import pytest

from tests.attacks.harness import AttackedServer, Attacker, ua
from tests.integration.mqtt.broker import mosquitto
from tests.system import Processes, clean_environment, free_tcp_port, o6_python
from tests.waiting import until

PUBLISHER = Path(__file__).parent / "o6_publisher.py"
JSON_PUBLISHER = Path(__file__).parent / "o6_json_publisher.py"
STATED: list[tuple[str, int | str, int, int]] = [
    ("UInt16", 2234, 100, 62_541),
    ("UInt32", 123_456, 77, 9),
    ("UInt64", 1 << 40, 1, 1),
    ("Byte", 7, 65_535, 2),
    ("String", "press-7", 5, 3),
]
"""Type of PublisherId, PublisherId, WriterGroupId and DataSetWriterId."""
UNSTATED = ("UInt16", 300, 2, 5001)
NO_ADDRESS = ("UInt32", 99_999, 2, 5002)


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def read(client: Attacker, *node_ids: object) -> list[tuple[str, object]]:
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(node_id, ua.AttributeIds.Value) for node_id in node_ids]
    answer = client.call(request, ua.ReadResponse)
    return [(each.StatusCode.name, each.Value.Value if each.Value is not None else None) for each in answer.Results]


@pytest.mark.needs("o6")
async def test_publishers_without_metadata(tmp_path: Path, processes: Processes) -> None:
    port, url = free_tcp_port(), f"opc.udp://127.0.0.1:{free_udp_port()}"
    data = {f"v{number}": {"id": 1001 + number, "type": "Double"} for number in range(len(STATED))}
    sources = {
        f"s{number}": {
            "publisher_id": publisher_id,
            "publisher_id_type": kind,
            "writer_group_id": group_id,
            "data_set_writer_id": writer_id,
            "robot": "press",
            "data": f"v{number}",
            "fields": {"counter": {"type": "Double"}},
        }
        for number, (kind, publisher_id, group_id, writer_id) in enumerate(STATED)
    }
    config = {
        "version": 1,
        "server": {"port": port, "allow_none_security": True, "allow_anonymous": True, "unknown_sources": "create"},
        "pubsub": {"security": "none", "url": url, "interface": "127.0.0.1"},
        "monitoring": {"enabled": False},
        "bridges": {"floor": {"kind": "ros2", "space": 2, "status_id": 1900}},
        "robots": {"press": {"bridge": "floor", "data": data}},
        "sources": sources,
    }
    (tmp_path / "fleet.yaml").write_text(json.dumps(config))
    environment = clean_environment(PYTHONUNBUFFERED="1")
    serve = (sys.executable, "-m", "ua_fleet.cli", "serve", "-c", str(tmp_path / "fleet.yaml"))
    process = processes.start(*serve, env=environment)
    process.wait_for("ready: ", 60)
    wanted = json.dumps([*STATED, UNSTATED, NO_ADDRESS])
    publisher = processes.start(o6_python(), PUBLISHER, url, str(free_tcp_port()), wanted, env=environment)
    publisher.wait_for("publishing", 120)

    server = AttackedServer(tmp_path, port, process)
    with server.logged_in() as client:
        nodes = [ua.NodeId(1001 + number, 2) for number in range(len(STATED))]

        def good() -> bool:
            results = read(client, *nodes)
            return all(name == "Good" and isinstance(value, float) and value > 3 for name, value in results)

        await until(good, "a value of each publisher", 60)
        before = read(client, *nodes)
        await until(lambda: all(a[1] != b[1] for a, b in zip(before, read(client, *nodes), strict=True)))

        reason = ua.NodeId(f"Fleet.Discovered.Quarantine.ua_{UNSTATED[1]}_2_{UNSTATED[3]}.Reason", 2)
        await until(lambda: read(client, reason)[0][0] == "Good", "the source that is not stated", 60)
        assert "announces no metadata; state its fields in `sources`" in str(read(client, reason)[0][1])
        assert read(client, ua.NodeId(UNSTATED[3], 2))[0][0] == "BadNodeIdUnknown"
    await until(lambda: f"PublisherId '{NO_ADDRESS[1]}' (UInt32)" in server.log, "the one that has no address")


VARIANT, DATA_VALUE = 0, 3
"""DataSetFieldContentMasks: with neither, and with StatusCode and SourceTimestamp (OPC 10000-14 table 36)."""


@pytest.mark.needs("o6")
@pytest.mark.needs("mosquitto")
async def test_json_key_frames_over_a_broker(tmp_path: Path, processes: Processes) -> None:
    """In the form of edition 1.05.04: {"UaType", "Value"}, as open62541 writes it."""
    port, broker = free_tcp_port(), mosquitto(tmp_path / "broker")
    ids = {"variant": 1001, "data_value": 1002}
    config = {
        "version": 1,
        "server": {"port": port, "allow_none_security": True, "allow_anonymous": True, "unknown_sources": "create"},
        "pubsub": {"security": "broker", "encoding": "json", "url": broker.url},
        "monitoring": {"enabled": False},
        "bridges": {"floor": {"kind": "ros2", "space": 2, "status_id": 1900}},
        "robots": {
            "press": {
                "bridge": "floor",
                "data": {name: {"id": number, "type": "Double"} for name, number in ids.items()},
            }
        },
        "sources": {
            name: {
                "publisher_id": publisher_id,
                "data_set_writer_id": 62_541,
                "robot": "press",
                "data": name,
                "fields": {"counter": {"type": "Double"}},
            }
            for name, publisher_id in (("variant", 2234), ("data_value", 2235))
        },
    }
    (tmp_path / "fleet.yaml").write_text(json.dumps(config))
    environment = clean_environment(PYTHONUNBUFFERED="1")
    broker.start()
    try:
        serve = (sys.executable, "-m", "ua_fleet.cli", "serve", "-c", str(tmp_path / "fleet.yaml"))
        process = processes.start(*serve, env=environment)
        process.wait_for("ready: ", 60)
        wanted = [
            (2234, "opcua/json/data/2234/group", 62_541, VARIANT),
            (2235, "opcua/json/data/2235/group", 62_541, DATA_VALUE),
            (301, "ua_301_2_5003", 5003, VARIANT),
        ]
        publisher = processes.start(
            o6_python(), JSON_PUBLISHER, str(broker.port), str(free_tcp_port()), json.dumps(wanted), env=environment
        )
        publisher.wait_for("publishing", 120)
        server = AttackedServer(tmp_path, port, process)
        with server.logged_in() as client:
            nodes = [ua.NodeId(1001, 2), ua.NodeId(1002, 2)]

            def good() -> bool:
                results = read(client, *nodes)
                return all(name == "Good" and isinstance(value, float) and value > 3 for name, value in results)

            await until(good, "a value of each publisher", 30)
            before = read(client, *nodes)
            await until(lambda: all(a[1] != b[1] for a, b in zip(before, read(client, *nodes), strict=True)))

            # Nobody states what the third one sends, so it is shown as it came.
            text = ua.NodeId(5003, 2)
            await until(lambda: read(client, text)[0][0] == "Good", "the source that is not stated", 60)
            shown = json.loads(str(read(client, text)[0][1]))
            assert shown["counter"]["UaType"] == 11
            assert shown["counter"]["Value"] > 0.0
    finally:
        broker.end()
