"""TLS to a broker: its certificate is checked, and ours is shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration.mqtt.broker import Broker, mosquitto
from tests.integration.mqtt.certificates import authority, certificate
from tests.integration.mqtt.speaking import Speaking
from tests.unit.pubsub.security.securing import data
from tests.waiting import until
from ua_fleet.transport.mqtt.credentials import Credentials

pytestmark = pytest.mark.needs("mosquitto")


def broker_of(folder: Path) -> Broker:
    """A mosquitto that wants to see a certificate of the authority."""
    certificates = [f"cafile {folder}/ca.pem", f"certfile {folder}/broker.pem", f"keyfile {folder}/broker.key"]
    return mosquitto(folder / "broker", *certificates, "require_certificate true", "allow_anonymous true")


async def test_certificates_of_both_sides_are_checked(tmp_path: Path) -> None:
    authority(tmp_path, "ca")
    authority(tmp_path, "other")
    certificate(tmp_path, "broker", "ca")
    certificate(tmp_path, "fleet", "ca")
    broker = broker_of(tmp_path)
    broker.start()
    url = broker.url.replace("mqtt://", "mqtts://")
    ours = {"certificate_file": "fleet.pem", "key_file": "fleet.key"}
    right = Credentials.read(tmp_path, has_tls=True, ca_file="ca.pem", **ours)
    one, two = Speaking(url, 1, right), Speaking(url, 2, right)
    stranger = Speaking(url, 3, Credentials.read(tmp_path, has_tls=True, ca_file="other.pem", **ours))
    nobody = Speaking(url, 4, Credentials.read(tmp_path, has_tls=True, ca_file="ca.pem"))
    try:
        await one.start()
        await two.start()
        one.transport.send(data("a", 1))
        await until(lambda: two.heard == [data("a", 1)])
        await stranger.start(wait=False)
        await until(lambda: "certificate verify failed" in stranger.transport.stats.problem.lower())
        await nobody.start(wait=False)
        await until(lambda: "not connected yet" not in nobody.transport.stats.problem)
        assert nobody.transport.stats.problem
        assert nobody.transport.stats.sent == 0
    finally:
        for each in (one, two, stranger, nobody):
            await each.transport.close()
        broker.end()
