"""A broker for each test, and what subscribes there without our code."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.integration.mqtt.broker import Broker, mosquitto, nats
from tests.system import Child, Processes, missing


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    """A mosquitto that lets everybody in."""
    made = mosquitto(tmp_path / "broker")
    made.start()
    yield made
    made.end()


@pytest.fixture(params=["mosquitto", "nats"])
def any_broker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Broker]:
    """Each broker: one speaks MQTT 5, the other 3.1.1."""
    if problem := missing(request.param):
        pytest.skip(problem)
    made = {"mosquitto": mosquitto, "nats": nats}[request.param](tmp_path / "broker")
    made.start()
    yield made
    made.end()


Subscribe = Callable[..., Child]


@pytest.fixture
def subscribe(processes: Processes) -> Subscribe:
    """Starts mosquitto_sub: each message is a line with its retain flag, topic and payload in hexadecimal."""

    def subscribed(broker: Broker, *topics: str) -> Child:
        wanted = [part for topic in topics for part in ("-t", topic)]
        arguments = ["-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-V", "mqttv311", "-F", "%r %t %x"]
        return processes.start("mosquitto_sub", *arguments, *wanted, whole=True)

    return subscribed
