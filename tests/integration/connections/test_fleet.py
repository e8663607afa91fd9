"""A server and bridges over real UDP on loopback and a real mosquitto at once."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.integration.connections.conftest import TwoRoads
from tests.integration.mqtt.broker import Broker
from tests.integration.security.conftest import COUNTER_ONE, COUNTER_TWO, heard
from tests.integration.server_model.harness import OBSERVER, reader, serving, until
from tests.system import Processes
from tests.waiting import until as until_true

pytestmark = pytest.mark.needs("mosquitto")

FIRST, SECOND = f"ns=2;i={COUNTER_ONE.id}", f"ns=2;i={COUNTER_TWO.id}"


async def test_values_come_by_both_and_go_on_when_either_is_cut(roads: TwoRoads, broker: Broker) -> None:
    one, two = roads.bridge("one"), roads.bridge("two")
    async with serving(roads.folder, roads.config) as running, running.client(OBSERVER) as client:
        first, second = reader(client, FIRST), reader(client, SECOND)
        before = await until(first, lambda data: data.StatusCode.is_good())
        await until(second, lambda data: data.StatusCode.is_good())
        await until_true(lambda: heard(two, COUNTER_ONE) and heard(one, COUNTER_TWO))
        broker.end(signal.SIGKILL)
        # The bridge that is on the broker alone falls silent; the other one does not, though the broker told nothing.
        await until(second, lambda data: data.StatusCode.name == "BadNoCommunication")
        after = await until(first, lambda data: data.StatusCode.is_good() and data.Value.Value > before.Value.Value)
        assert after.StatusCode.is_good()
        broker.start()
        await until(second, lambda data: data.StatusCode.is_good())
    assert one.end() == two.end() == 0


async def test_each_value_is_handed_on_once_though_it_comes_twice(roads: TwoRoads) -> None:
    one, two = roads.bridge("one"), roads.bridge("two")
    await until_true(lambda: len(heard(two, COUNTER_ONE)) > 100 and len(heard(one, COUNTER_TWO)) > 100)
    assert one.end() == two.end() == 0
    for child, topic in ((two, COUNTER_ONE), (one, COUNTER_TWO)):
        numbers = heard(child, topic)
        assert numbers == sorted(set(numbers))
    assert heard(one, COUNTER_ONE) == heard(two, COUNTER_TWO) == []


async def test_a_bridge_that_is_killed_is_bad_when_no_connection_has_it_any_more(roads: TwoRoads) -> None:
    one = roads.bridge("one")
    async with serving(roads.folder, roads.config) as running, running.client(OBSERVER) as client:
        first = reader(client, FIRST)
        await until(first, lambda data: data.StatusCode.is_good())
        one.end(signal.SIGKILL)
        await until(first, lambda data: data.StatusCode.name == "BadNoCommunication")
        roads.bridge("one", wait=False)  # to wait for it would keep the server waiting, too
        await until(first, lambda data: data.StatusCode.is_good())


async def test_one_connection_may_be_secured_and_the_other_one_not(
    tmp_path: Path, udp_url: str, broker: Broker, processes: Processes
) -> None:
    roads = TwoRoads(tmp_path, udp_url, broker.url, processes, security="none")
    one, two = roads.bridge("one"), roads.bridge("two")
    async with serving(roads.folder, roads.config) as running, running.client(OBSERVER) as client:
        await until(reader(client, FIRST), lambda data: data.StatusCode.is_good())
        await until(reader(client, SECOND), lambda data: data.StatusCode.is_good())
    assert one.end() == two.end() == 0
