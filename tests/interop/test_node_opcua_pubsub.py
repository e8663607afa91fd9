"""A foreign client browses the information model of PubSub, reads it, and disables a DataSetWriter of a bridge."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.integration.connections.conftest import TwoRoads, broker, roads
from tests.integration.mqtt.broker import Broker
from tests.integration.server_model.harness import ENGINEER, OBSERVER, SPACE, reader, serving, until
from tests.integration.server_model.test_pubsub_model import a_fleet
from tests.interop.test_node_opcua import run_client
from ua_fleet.values import BuiltinType

__all__ = ["broker", "roads"]

SCRIPT = Path(__file__).parent / "pubsub.cjs"
CONNECTIONS = Path(__file__).parent / "connections.cjs"
UDP = "http://opcfoundation.org/UA-Profile/Transport/pubsub-udp-uadp"
MQTT = "http://opcfoundation.org/UA-Profile/Transport/pubsub-mqtt-uadp"
DISABLED, OPERATIONAL = 0, 2


@pytest.mark.needs("node")
async def test_a_foreign_client_reads_the_model_and_switches_a_bridge(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with a_fleet(tmp_path, udp_url, tcp_port) as fleet:
        fleet.source.heard(0.5)
        code, output, errors = await run_client(fleet.running.url, *ENGINEER, tmp_path / "pki", script=SCRIPT)
        assert code == 0, errors
        report = json.loads(output.splitlines()[-1])
        assert {"Fleet server", "bridge mobile_side", "PublishedDataSets", "Status", "Diagnostics"} < {*report["root"]}
        assert "GetSecurityKeys" not in report["root"]  # this server gives none
        assert (report["publisherId"], report["url"], report["writerId"]) == (SPACE, udp_url, 1001)
        assert report["metadata"]["name"] == "speed"
        assert report["metadata"]["fields"] == [["data", int(BuiltinType.DOUBLE)]]
        assert report["metadata"]["version"] > 0
        assert report["targets"] == ["ns=2;i=1001"]
        assert report["received"] > 0
        assert report["calls"] == ["BadInvalidState", "Good", "BadInvalidState", "Good"]
        assert report["states"] == [OPERATIONAL, OPERATIONAL, DISABLED, DISABLED, OPERATIONAL]
        code, output, errors = await run_client(fleet.running.url, *OBSERVER, tmp_path / "pki", script=SCRIPT)
        assert code == 0, errors
        assert {*json.loads(output.splitlines()[-1])["calls"]} == {"BadUserAccessDenied"}


@pytest.mark.needs("node", "mosquitto")
async def test_a_foreign_client_reads_all_connections_of_a_fleet(roads: TwoRoads, broker: Broker) -> None:
    one = roads.bridge("one")
    async with serving(roads.folder, roads.config) as running:
        async with running.client(OBSERVER) as client:
            state = reader(client, "ns=2;s=PubSub.connections.bridges.one.site.W2.1.Status.State")
            await until(state, lambda data: data.StatusCode.is_good())
        code, output, errors = await run_client(running.url, *OBSERVER, roads.folder / "pki", script=CONNECTIONS)
        assert code == 0, errors
        report = json.loads(output.splitlines()[-1])["connections"]
        assert {name: (shown["url"], shown["profile"], shown["state"]) for name, shown in report.items()} == {
            "Fleet server hall": (roads.url, UDP, OPERATIONAL),
            "Fleet server site": (broker.url, MQTT, OPERATIONAL),
            "bridge one": (roads.url, UDP, OPERATIONAL),
            "bridge one site": (broker.url, MQTT, OPERATIONAL),
        }
        for name in ("bridge one", "bridge one site"):
            assert report[name]["groups"]["group-2"]["counter"] == OPERATIONAL
        assert "ua_300_2_1" in report["Fleet server hall"]["groups"]["readers-one"]
        assert isinstance(report["Fleet server site"]["errors"], int)
    assert one.end() == 0
