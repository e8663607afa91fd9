"""A broker in `fleet.yaml`: what is refused, with its key and a remedy, and what a process makes of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from ua_fleet.config.applications import bridge_application
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import weaknesses
from ua_fleet.config.transports import client_id_of, open_transport
from ua_fleet.errors import ConfigInvalid, TransportError
from ua_fleet.pubsub.application import MQTT_UADP
from ua_fleet.transport.mqtt.credentials import Credentials
from ua_fleet.transport.mqtt.transport import MqttTransport
from ua_fleet.transport.udp import UdpTransport

FLEET = """\
version: 1
fleet: {{name: Hall}}
pubsub:
  security: none
  url: {url}
  broker: {broker}
bridges: {{floor: {{kind: ros2, space: 2, status_id: 1}}}}
"""


def fleet(url: str = "mqtt://broker", broker: str = "{}") -> FleetConfig:
    return load_content(FLEET.format(url=url, broker=broker).encode(), "fleet.yaml", {})


@pytest.mark.parametrize(
    ("url", "broker", "line", "key", "text"),
    [
        ("mqtt://user:geheim@broker", "{}", 5, "pubsub.url", "password_file"),
        ("mqtt://broker:99999", "{}", 5, "pubsub.url", "port"),
        ("mqtt://:1883", "{}", 5, "pubsub.url", "mqtt://<host>:<port>"),
        ("tcp://broker", "{}", 5, "pubsub.url", ""),
        ("mqtt://broker", "{ca_file: ca.pem}", 6, "pubsub.broker.ca_file", "mqtts://"),
        ("mqtts://broker", "{certificate_file: c.pem}", 6, "pubsub.broker", "belong together"),
        ("mqtts://broker", "{password_file: p}", 6, "pubsub.broker", "write `user`"),
        ("mqtt://broker", "{queue: values}", 6, "pubsub.broker", "{topic}"),
        ("mqtt://a", "{nodes: [mqtt://b, opc.udp://c:4840]}", 6, "pubsub.broker.nodes", "no broker"),
        ("mqtts://a", "{nodes: [mqtts://b, mqtt://c]}", 6, "pubsub.broker.nodes[1]", "write mqtts://"),
        ("mqtt://broker", '{prefix: "#"}', 6, "pubsub.broker", "wildcard"),
        ("mqtt://broker", "{delivery: twice}", 6, "pubsub.broker.delivery", "at_least_once"),
        ("mqtt://broker", "{keep_alive_s: 0}", 6, "pubsub.broker.keep_alive_s", ""),
        ("mqtt://broker", "{pasword_file: p}", 6, "pubsub.broker.pasword_file", "password_file"),
    ],
)
def test_what_cannot_be_is_told_with_its_place(url: str, broker: str, line: int, key: str, text: str) -> None:
    with pytest.raises(ConfigInvalid) as raised:
        fleet(url, broker)
    (problem,) = raised.value.problems
    assert (problem.line, problem.key) == (line, key)
    assert text in f"{problem.message} {problem.suggestion}"
    assert "geheim" not in str(problem)


def test_a_process_speaks_over_the_broker_by_its_own_name(tmp_path: Path) -> None:
    config = fleet()
    assert isinstance(open_transport(config, tmp_path, space=2), MqttTransport)
    assert client_id_of(config, 2) == "ua-fleet-Hall-2"
    assert bridge_application(config, "floor").profile == MQTT_UADP
    assert isinstance(open_transport(fleet("opc.udp://239.1.2.3:4840"), tmp_path, space=2), UdpTransport)


@pytest.mark.parametrize(
    ("delivery", "qos"), [("best_effort", 0), ("at_most_once", 0), ("at_least_once", 1), ("exactly_once", 2)]
)
def test_the_delivery_guarantee_is_a_quality_of_service(delivery: str, qos: int) -> None:
    assert fleet(broker=f"{{delivery: {delivery}}}").pubsub.broker.delivery.qos == qos


def test_what_a_broker_lets_others_read_is_told() -> None:
    (weakness,) = weaknesses(fleet())
    assert "anyone whom the broker mqtt://broker allows to read and write" in weakness


def test_a_password_comes_from_the_first_line_of_a_file_that_only_its_owner_reads(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("geheim\nmore\n")
    secret.chmod(0o600)
    read = Credentials.read(tmp_path, has_tls=False, user="fleet", password_file="secret")
    assert (read.user, read.password, read.tls) == ("fleet", "geheim", None)
    assert "geheim" not in repr(read)


@pytest.mark.parametrize(
    ("content", "mode", "text"),
    [
        (b"geheim\n", 0o644, "chmod 600"),
        (b"\n", 0o600, "first line"),
        (b"\xff\xfe\n", 0o600, "UTF-8"),
        (None, 0o600, "no such file"),
    ],
)
def test_a_password_file_that_is_no_use_is_named_with_its_key(
    tmp_path: Path, content: bytes | None, mode: int, text: str
) -> None:
    if content is not None:
        (tmp_path / "secret").write_bytes(content)
        (tmp_path / "secret").chmod(mode)
    with pytest.raises(TransportError) as raised:
        Credentials.read(tmp_path, has_tls=False, user="fleet", password_file="secret")
    assert text in str(raised.value)
    assert "pubsub.broker.password_file" in str(raised.value)
    assert "geheim" not in str(raised.value)


def test_certificates_that_cannot_be_read_are_named_with_their_key(tmp_path: Path) -> None:
    (tmp_path / "no.pem").write_text("nothing")
    for key, files in (
        ("ca_file", {"ca_file": "no.pem"}),
        ("certificate_file", {"certificate_file": "no.pem", "key_file": "no.pem"}),
        ("ca_file", {"ca_file": "missing.pem"}),
    ):
        with pytest.raises(TransportError, match=rf"pubsub\.broker\.{key}: "):
            Credentials.read(tmp_path, has_tls=True, **files)
    with pytest.raises(TransportError, match="mqtts://"):
        Credentials.read(tmp_path, has_tls=False, ca_file="no.pem")
