"""A fleet over a multicast group and a broker: bridge `one` is on both, bridge `two` on the broker alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.integration.mqtt.broker import Broker
from tests.integration.mqtt.conftest import broker
from tests.integration.security.conftest import Site
from tests.system import Processes

__all__ = ["broker"]


class TwoRoads(Site):
    """See the module."""

    def __init__(self, folder: Path, url: str, broker_url: str, processes: Processes, **site: Any) -> None:
        self._broker_url, self._site = broker_url, site
        super().__init__(folder, url, processes)

    def change(self, raw: dict[str, Any]) -> None:
        hall = {"name": "hall", **raw["pubsub"]}
        site = {"name": "site", **raw["pubsub"], "url": self._broker_url, **self._site}
        raw["pubsub"] = [hall, site]
        raw["bridges"]["one"]["connections"] = ["hall", "site"]
        raw["bridges"]["two"]["connections"] = ["site"]


@pytest.fixture
def roads(tmp_path: Path, udp_url: str, broker: Broker, processes: Processes) -> TwoRoads:
    return TwoRoads(tmp_path, udp_url, broker.url, processes)
