"""A relay whose keys come from the key service of the server, while they change."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.integration.key_service.harness import ROTATE
from tests.integration.key_service.test_traffic import Plant, more
from tests.integration.mqtt.broker import Broker
from tests.integration.relay.conftest import Apart, what_it_did
from tests.integration.security.conftest import COUNTER_ONE, COUNTER_TWO, heard, holes
from tests.system import Processes
from tests.waiting import until
from ua_fleet.config.security import all_groups
from ua_fleet.server.mutual_trust import introduce_bridge

pytestmark = pytest.mark.needs("mosquitto")


class FromService(Apart):
    """Keys last two seconds, and come from the server, which is on the broker."""

    def change(self, raw: dict[str, Any]) -> None:
        raw["pubsub"]["keys"] = {"source": "service", "lifetime_s": 2.0, "future_keys": 8}
        super().change(raw)


async def test_keys_change_while_it_forwards_and_nothing_is_lost_or_doubled(
    tmp_path: Path, udp_url: str, broker: Broker, processes: Processes
) -> None:
    apart = FromService(tmp_path, udp_url, broker.url, processes)
    plant = Plant(apart)
    await plant.introduce()
    await introduce_bridge(apart.config, apart.folder, "gate")
    async with plant.server():
        one, two = await plant.bridge("one"), await plant.bridge("two")
        relay = apart.relay(wait=False)
        await until(lambda: "ready" in relay.lines)
        await more(two, COUNTER_ONE)
        await more(one, COUNTER_TWO)
        # Three lifetimes, and keys that become current before their time.
        async with plant.engineer() as engineer:
            for _ in range(3):
                await more(two, COUNTER_ONE, 150)
                for group in all_groups(apart.config):
                    await engineer.call(f"ns=2;s=SecurityGroups.{group}", ROTATE)
            await more(two, COUNTER_ONE, 250)
            await more(one, COUNTER_TWO, 50)
        assert holes(heard(two, COUNTER_ONE)) == []
        assert holes(heard(one, COUNTER_TWO)) == []
    did = what_it_did(relay)
    assert did["forwarded"] >= len(heard(two, COUNTER_ONE)) + len(heard(one, COUNTER_TWO))
    refused = {"bad_signature", "unknown_token", "replayed", "not_its_connection", "not_secured"}
    assert not refused & set(did["drops"]), did
    assert one.end() == two.end() == 0
