"""A fleet in two places: bridge `one` is on a multicast group, bridge `two` on a broker, and a relay is between."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.mqtt.broker import Broker
from tests.integration.mqtt.conftest import broker
from tests.integration.security.conftest import ONE, TWO, Site
from tests.system import Child, Processes

__all__ = ["broker"]

PROGRAM = Path(__file__).parent / "relay_process.py"
JSON: dict[str, Any] = {"security": "broker", "encoding": "json"}


class Apart(Site):
    """See the module. `served` names the connections of the server, and `site` is what the broker's one has."""

    def __init__(
        self,
        folder: Path,
        url: str,
        broker_url: str,
        processes: Processes,
        *,
        served: tuple[str, ...] = ("site",),
        forwards: list[dict[str, Any]] | None = None,
        **site: Any,
    ) -> None:
        self._broker_url, self._site, self._served = broker_url, site, served
        self._forwards = forwards or [
            {"source": "hall", "target": "site", "origins": [ONE]},
            {"source": "site", "target": "hall", "origins": [TWO]},
        ]
        super().__init__(folder, url, processes)

    def change(self, raw: dict[str, Any]) -> None:
        site = {"name": "site", **raw["pubsub"], "url": self._broker_url, **self._site}
        raw["pubsub"] = [{"name": "hall", **raw["pubsub"]}, site]
        raw["bridges"]["one"]["connections"] = ["hall"]
        raw["bridges"]["two"]["connections"] = ["site"]
        raw["server"]["connections"] = list(self._served)
        raw["relays"] = {"gate": {"forwards": self._forwards}}

    def relay(self, *, wait: bool = True) -> Child:
        """Start the relay; with `wait` it is ready when this returns."""
        child = self._processes.fork(PROGRAM, self.folder / "fleet.json", "gate")
        if wait:
            child.wait_for("ready")
        return child


def what_it_did(relay: Child) -> dict[str, Any]:
    """End a relay, and read what it says of itself."""
    assert relay.end() == 0
    told: dict[str, Any] = json.loads(relay.wait_for('"event": "ends"'))
    return told


@pytest.fixture
def apart(tmp_path: Path, udp_url: str, broker: Broker, processes: Processes) -> Apart:
    return Apart(tmp_path, udp_url, broker.url, processes)
