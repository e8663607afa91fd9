"""Skills of a bridge on two connections: asked for by either, answered by the same, and done once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.integration.actions.conftest import Cell, work
from tests.integration.actions.requesting import requesting
from tests.integration.mqtt.broker import Broker
from tests.system import Processes
from ua_fleet.config.transports import open_transport
from ua_fleet.skill.executions import OutcomeKind
from ua_fleet.transport.base import Transport

pytestmark = pytest.mark.needs("mosquitto")


class CellOnTwo(Cell):
    """Its bridge is on a multicast group, the first connection, and on a broker."""

    def __init__(self, folder: Path, url: str, broker_url: str, processes: Processes) -> None:
        self._broker_url = broker_url
        super().__init__(folder, url, processes, "sign_and_encrypt")

    def change(self, raw: dict[str, Any]) -> None:
        raw["pubsub"] = [
            {"name": "hall", **raw["pubsub"]},
            {"name": "site", **raw["pubsub"], "url": self._broker_url},
        ]
        raw["bridges"]["cell"]["connections"] = ["hall", "site"]

    def transport(self, number: int) -> Transport:
        """That of a requestor which is on one connection alone."""
        return open_transport(self.config, self.folder, space=0, number=number)


@pytest.fixture
def cell(tmp_path: Path, udp_url: str, broker: Broker, processes: Processes) -> CellOnTwo:
    return CellOnTwo(tmp_path, udp_url, broker.url, processes)


async def test_a_skill_is_answered_by_the_connection_by_which_it_was_asked_for(cell: CellOnTwo) -> None:
    cell.bridge()
    for number, name in enumerate(("by the hall", "by the site")):
        async with cell.requestor(transport=cell.transport(number)) as requestor:
            assert (await work(requestor, name, 0.0)).kind is OutcomeKind.ACCEPTED
    assert cell.told() == ["by the hall", "by the site"]


async def test_what_was_asked_for_by_one_and_again_by_the_other_is_done_once(cell: CellOnTwo) -> None:
    cell.bridge()
    execution_id = bytes(range(16))
    for number in range(2):
        folder = cell.folder / f"requestor of connection {number}"  # each with a journal of its own: it asks
        folder.mkdir()
        async with requesting(cell.config, folder, transport=cell.transport(number)) as requestor:
            outcome = await work(requestor, "weld", 0.0, execution_id=execution_id)
            assert outcome.kind is OutcomeKind.ACCEPTED
    assert cell.told() == ["weld"]
