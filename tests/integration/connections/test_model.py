"""The information model of PubSub (OPC 10000-14 clause 9) of a fleet over a multicast group and a broker."""

from __future__ import annotations

import signal
from typing import Any, Final

import pytest

from tests.integration.connections.conftest import TwoRoads
from tests.integration.mqtt.broker import Broker
from tests.integration.security.conftest import COUNTER_ONE, ONE, TWO
from tests.integration.server_model.harness import ENGINEER, OBSERVER, OPERATOR, reader, serving, ua, until
from tests.integration.server_model.test_pubsub_model import (
    DISABLED,
    NEVER_KNOWN,
    OPERATIONAL,
    crawled,
    switch,
    value,
)

pytestmark = pytest.mark.needs("mosquitto")

ERROR: Final = 3
SERVER: Final = "ns=2;s=PubSub.server"
SERVER_SITE: Final = "ns=2;s=PubSub.connections.server.site"
ONE_HALL: Final = "ns=2;s=PubSub.bridges.one"
ONE_SITE: Final = "ns=2;s=PubSub.connections.bridges.one.site"
TWO_SITE: Final = "ns=2;s=PubSub.bridges.two"
UDP: Final = "http://opcfoundation.org/UA-Profile/Transport/pubsub-udp-uadp"
MQTT: Final = "http://opcfoundation.org/UA-Profile/Transport/pubsub-mqtt-uadp"
RESET: Final = ua.NodeId(ua.ObjectIds.PubSubDiagnosticsType_Reset)


def is_known(data: Any) -> bool:
    return bool(data.StatusCode.is_good())


async def test_each_connection_of_each_process_is_shown_as_it_is(roads: TwoRoads, broker: Broker) -> None:
    one, two = roads.bridge("one"), roads.bridge("two")
    async with serving(roads.folder, roads.config) as running, running.client(OBSERVER) as client:
        for key in (f"{ONE_SITE}.W2.1", f"{TWO_SITE}.W2.2", f"{SERVER}.R{ONE}.2.1"):
            await until(reader(client, f"{key}.Status.State"), is_known)
        expected = {
            "Fleet server hall": (0, UDP, roads.url),
            "Fleet server site": (0, MQTT, broker.url),
            "bridge one": (ONE, UDP, roads.url),
            "bridge one site": (ONE, MQTT, broker.url),
            "bridge two": (TWO, MQTT, broker.url),
        }
        read = await crawled(client)
        wrong = {
            way: data
            for way, data in read.items()
            if data.StatusCode.is_good() is (data.Value is None or data.Value.Value is None)
            or (not data.StatusCode.is_good() and data.StatusCode.name not in NEVER_KNOWN)
        }
        assert not wrong, list(wrong.items())[:3]
        values = {way: data.Value.Value for way, data in read.items() if data.StatusCode.is_good()}
        for name, (publisher_id, profile, url) in expected.items():
            assert values[f"/{name}/PublisherId"] == publisher_id
            assert values[f"/{name}/TransportProfileUri"] == profile
            assert values[f"/{name}/Address/Url"] == url
            assert values[f"/{name}/Status/State"] == OPERATIONAL
        assert {way.split("/")[1] for way in values if way.endswith("/TransportProfileUri")} == set(expected)
        for name in ("bridge one", "bridge one site"):
            assert values[f"/{name}/group-2/WriterGroupId"] == 2
            assert values[f"/{name}/group-2/counter/DataSetWriterId"] == COUNTER_ONE.id
            assert values[f"/{name}/group-2/counter/Status/State"] == OPERATIONAL
        # What each connection counts itself.
        assert values["/Fleet server hall/Diagnostics/LiveValues/ResolvedAddress"] in roads.url
        assert values["/Fleet server site/Diagnostics/LiveValues/ResolvedAddress"] == "127.0.0.1"
        assert values["/Fleet server hall/readers-one/Diagnostics/Counters/ReceivedNetworkMessages"] > 0
        # What is of the process stands at its first connection, once.
        assert not [way for way in read if way.startswith("/Fleet server site/readers-")]
        data_sets = {way.split("/")[2] for way in read if way.startswith("/PublishedDataSets/")}
        assert data_sets == {"bridge one", "bridge two"}
    assert one.end() == two.end() == 0


async def test_a_broker_that_is_away_is_the_error_of_its_connection_alone(roads: TwoRoads, broker: Broker) -> None:
    hall, site = f"{SERVER}.Diagnostics.Counters", f"{SERVER_SITE}.Diagnostics.Counters"
    back = f"{site}.StateOperationalFromError"
    async with serving(roads.folder, roads.config) as running, running.client(ENGINEER) as client:
        state = reader(client, f"{SERVER_SITE}.Status.State")
        await until(state, lambda data: data.Value.Value == OPERATIONAL)
        failed = await value(client, f"{site}.StateError")  # the broker may have come to the server's start too late
        await until(lambda: value(client, back), lambda count: count == failed)
        broker.end()
        await until(state, lambda data: data.Value.Value == ERROR)
        await until(lambda: value(client, f"{site}.StateError"), lambda count: count == failed + 1)
        assert await value(client, f"{SERVER_SITE}.Diagnostics.TotalError") == failed + 1
        assert await value(client, f"{SERVER}.Status.State") == OPERATIONAL
        assert await value(client, f"{hall}.StateError") == 0
        broker.start()
        await until(state, lambda data: data.Value.Value == OPERATIONAL)
        await until(lambda: value(client, back), lambda count: count == failed + 1)
        async with running.client(OPERATOR) as other:
            with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
                await other.get_node(f"{SERVER_SITE}.Diagnostics").call_method(RESET)
        await client.get_node(f"{SERVER_SITE}.Diagnostics").call_method(RESET)
        assert (await value(client, f"{site}.StateError"), await value(client, back)) == (0, 0)


async def test_a_bridge_tells_which_of_its_connections_works(roads: TwoRoads, broker: Broker) -> None:
    one, two = roads.bridge("one"), roads.bridge("two")
    counters = "Diagnostics.Counters"
    async with serving(roads.folder, roads.config) as running, running.client(ENGINEER) as client:
        hall, site = reader(client, f"{ONE_HALL}.Status.State"), reader(client, f"{ONE_SITE}.Status.State")
        for state in (hall, site):
            await until(state, lambda data: is_known(data) and data.Value.Value == OPERATIONAL)
        errors, back = f"{ONE_SITE}.{counters}.StateError", f"{ONE_SITE}.{counters}.StateOperationalFromError"
        failed = (await until(reader(client, errors), is_known)).Value.Value
        assert await value(client, f"{ONE_SITE}.Diagnostics.LiveValues.ResolvedAddress") == "127.0.0.1"
        broker.end()
        await until(site, lambda data: is_known(data) and data.Value.Value == ERROR)
        await until(reader(client, errors), lambda data: is_known(data) and data.Value.Value == failed + 1)
        data = await hall()
        assert (data.Value.Value, data.StatusCode.name) == (OPERATIONAL, "Good")
        assert await value(client, f"{ONE_HALL}.{counters}.StateError") == 0
        # Nothing is heard of one that is on the broker alone.
        await until(
            reader(client, f"{TWO_SITE}.Status.State"), lambda data: data.StatusCode.name == "BadNoCommunication"
        )
        broker.start()
        await until(site, lambda data: is_known(data) and data.Value.Value == OPERATIONAL)
        await until(reader(client, back), lambda data: is_known(data) and data.Value.Value == failed + 1)
        await client.get_node(f"{ONE_SITE}.Diagnostics").call_method(RESET)
        assert (await value(client, errors), await value(client, back)) == (0, 0)
        await until(reader(client, f"{TWO_SITE}.Status.State"), is_known)
    assert one.end() == two.end() == 0


async def test_what_is_switched_at_the_first_connection_is_so_on_all(roads: TwoRoads) -> None:
    one = roads.bridge("one")
    async with serving(roads.folder, roads.config) as running, running.client(ENGINEER) as client:
        state = reader(client, f"{ONE_SITE}.W2.1.Status.State")
        counter = reader(client, f"ns=2;i={COUNTER_ONE.id}")
        await until(state, lambda data: is_known(data) and data.Value.Value == OPERATIONAL)
        await until(counter, is_known)
        for key in (SERVER_SITE, ONE_SITE, f"{ONE_SITE}.W2", f"{ONE_SITE}.W2.1"):
            with pytest.raises(ua.UaStatusCodeError, match="BadMethodInvalid"):
                await switch(client, key, "Disable")
        await switch(client, f"{ONE_HALL}.W2.1", "Disable")
        await until(counter, lambda data: not is_known(data))
        await until(state, lambda data: is_known(data) and data.Value.Value == DISABLED)
        await switch(client, f"{ONE_HALL}.W2.1", "Enable")
        await until(counter, is_known)
        await until(state, lambda data: is_known(data) and data.Value.Value == OPERATIONAL)
    assert one.end() == 0


async def test_a_bridge_that_is_away_has_states_that_are_not_good_on_all_its_connections(roads: TwoRoads) -> None:
    one = roads.bridge("one")
    async with serving(roads.folder, roads.config) as running, running.client(OBSERVER) as client:
        state = reader(client, f"{ONE_SITE}.Status.State")
        await until(state, is_known)
        one.end(signal.SIGKILL)
        await until(state, lambda data: data.StatusCode.name == "BadNoCommunication")
