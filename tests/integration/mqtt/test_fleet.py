"""A server and its bridges over a broker."""

from __future__ import annotations

import asyncio
import json
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from tests.integration.mqtt.broker import Broker
from tests.integration.mqtt.conftest import Subscribe
from tests.integration.security.conftest import COUNTER_ONE, ONE, Site, heard
from tests.integration.server_model.harness import OBSERVER, reader, serving
from tests.integration.server_model.harness import until as until_read
from tests.system import Processes
from tests.waiting import until
from ua_fleet.config.schema import FleetConfig
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.wire import Codec, read_security
from ua_fleet.wire.discovered import PubSubState, StatusAnnouncement

pytestmark = pytest.mark.needs("mosquitto")

NODE = f"ns=2;i={COUNTER_ONE.id}"
TIMEOUT_S = 30.0
SLOW: dict[str, Any] = {"keep_alive_s": 1.0, "receive_timeout_s": TIMEOUT_S}
"""With these a source that falls silent is noticed after half a minute, if nothing else says so."""


@pytest.fixture
def site(tmp_path: Path, broker: Broker, processes: Processes) -> Site:
    return Site(tmp_path, broker.url, processes)


async def test_a_value_reaches_its_node_and_the_other_bridge_signed_and_encrypted(site: Site) -> None:
    one, two = site.bridge("one"), site.bridge("two")
    async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
        first = await until_read(reader(client, NODE), lambda data: data.StatusCode.is_good())
        await until_read(reader(client, NODE), lambda data: data.Value.Value > first.Value.Value)
    await until(lambda: heard(two, COUNTER_ONE))
    assert one.end() == two.end() == 0


@pytest.mark.parametrize("security", ["none", "sign_and_encrypt"])
async def test_a_bridge_with_another_publisher_id_reaches_its_node(site: Site, security: str) -> None:
    path = site.write_fleet(security=security)
    raw = json.loads(path.read_text())
    raw["bridges"]["one"]["publisher_id"] = "hall 1"
    path.write_text(json.dumps(raw))
    site.config = FleetConfig.model_validate(raw)
    one = site.bridge("one")
    async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
        await until_read(reader(client, NODE), lambda data: data.StatusCode.is_good())
    assert one.end() == 0


async def test_a_bridge_that_is_killed_is_bad_at_once_by_its_will_and_good_when_it_is_back(site: Site) -> None:
    site.write_fleet(**SLOW)
    one = site.bridge("one")
    async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
        read = reader(client, NODE)
        await until_read(read, lambda data: data.StatusCode.is_good())
        one.end(signal.SIGKILL)
        killed = time.monotonic()
        await until_read(read, lambda data: data.StatusCode.name == "BadNoCommunication")
        assert time.monotonic() - killed < TIMEOUT_S
        site.bridge("one")
        await until_read(read, lambda data: data.StatusCode.is_good())


async def test_a_foreign_subscriber_sees_the_retained_error_of_a_killed_bridge(
    site: Site, broker: Broker, subscribe: Subscribe
) -> None:
    site.write_fleet(security="none")
    one = site.bridge("one")
    topic = f"opcua/uadp/status/{ONE}"

    def state(line: str) -> tuple[bool, int]:
        status = Codec().decode(bytes.fromhex(line.split()[2]))
        assert isinstance(status, StatusAnnouncement)
        return status.is_cyclic, status.state

    hearing = subscribe(broker, topic)
    assert state(hearing.wait_for(topic)) == (False, PubSubState.OPERATIONAL)
    one.end(signal.SIGKILL)
    await until(lambda: any(state(line)[1] == PubSubState.ERROR for line in hearing.lines))
    late = subscribe(broker, topic)
    line = late.wait_for(topic)
    assert line.startswith("1 "), "the broker retains it"
    assert state(line) == (False, PubSubState.ERROR)
    two = site.bridge("one")
    await until(lambda: state(late.lines[-1]) == (False, PubSubState.OPERATIONAL))
    assert two.end() == 0
    last = subscribe(broker, topic)
    assert state(last.wait_for(topic)) == (False, PubSubState.DISABLED)


async def test_a_broker_that_is_killed_and_comes_back(site: Site, broker: Broker) -> None:
    site.bridge("one")
    async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
        read = reader(client, NODE)
        first = await until_read(read, lambda data: data.StatusCode.is_good())
        broker.end(signal.SIGKILL)
        await until_read(read, lambda data: data.StatusCode.name == "BadNoCommunication")
        broker.start()
        # What the broker had not acknowledged comes once more, before what was read since.
        await until_read(read, lambda data: data.StatusCode.is_good() and data.Value.Value > first.Value.Value)


async def test_what_is_retained_is_secured_anew_with_each_key(site: Site, broker: Broker, subscribe: Subscribe) -> None:
    site.bridge("one")
    everything = "opcua/uadp/#"
    before = subscribe(broker, everything)
    await until(lambda: len(retained(before.lines)) >= 4)
    old = {read_security(payload).token_id for payload in retained(before.lines).values()}
    site.rotate(telemetry_group(ONE), 0.5)

    def renewed() -> bool:
        late = retained(before.lines)
        return all(read_security(payload).token_id not in old for payload in late.values())

    await until(renewed)
    await asyncio.sleep(0)
    late = subscribe(broker, everything)
    await until(lambda: len(retained(late.lines)) >= 4)
    assert not {read_security(payload).token_id for payload in retained(late.lines).values()} & old


def retained(lines: list[str]) -> dict[str, bytes]:
    """The last message of each topic that a broker retains, other than probes and what answers them."""
    parts = [line.split() for line in lines if line.count(" ") == 2]
    kept = {topic: bytes.fromhex(payload) for _, topic, payload in parts}
    return {topic: payload for topic, payload in kept.items() if topic.split("/")[2] not in ("probe", "answer")}
