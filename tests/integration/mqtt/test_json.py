"""A server and its bridges over JSON, read and written by mosquitto_sub and mosquitto_pub."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.integration.mqtt.broker import Broker, nats
from tests.integration.security.conftest import COUNTER_ONE, COUNTER_TWO, ONE, Site, heard
from tests.integration.server_model.harness import OBSERVER, reader, serving
from tests.integration.server_model.harness import until as until_read
from tests.system import Child, Processes
from tests.waiting import until
from ua_fleet.wire.discovered import PubSubState

pytestmark = pytest.mark.needs("mosquitto")

NODE = f"ns=2;i={COUNTER_ONE.id}"
JSON: dict[str, Any] = {"security": "broker", "encoding": "json"}
FOREIGN = "ua_77_2_3001"
FOREIGN_NODE = "ns=2;i=3001"


@pytest.fixture
def site(tmp_path: Path, broker: Broker, processes: Processes) -> Site:
    made = Site(tmp_path, broker.url, processes)
    made.write_fleet(**JSON)
    return made


class Hearing:
    """A mosquitto_sub: the retain flags, topics and messages that it has printed."""

    def __init__(self, child: Child) -> None:
        self.child = child

    @property
    def all(self) -> list[tuple[bool, str, Any]]:
        found: list[tuple[bool, str, Any]] = []
        for line in list(self.child.lines):
            flag, _, rest = line.partition(" ")
            topic, _, text = rest.partition(" ")
            if flag in ("0", "1") and text:
                found.append((flag == "1", topic, json.loads(text)))
        return found

    def on(self, topic: str) -> list[Any]:
        return [message for _, its, message in self.all if its == topic]


@pytest.fixture
def hear(broker: Broker, processes: Processes) -> Any:
    def hearing(*topics: str) -> Hearing:
        wanted = [part for topic in topics for part in ("-t", topic)]
        arguments = ["-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-F", "%r %t %p"]
        return Hearing(processes.start("mosquitto_sub", *arguments, *wanted, whole=True))

    return hearing


def publish(broker: Broker, topic: str, message: Any, *options: str) -> None:
    """What `mosquitto_pub` sends."""
    text = message if isinstance(message, str) else json.dumps(message)
    command = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", *options, "-t", topic, "-m", text]
    subprocess.run(command, check=True)


@pytest.mark.parametrize("form", ["compact", "verbose", "raw"])
async def test_a_value_reaches_its_node_the_other_bridge_and_a_foreign_subscriber(
    site: Site, hear: Any, form: str
) -> None:
    site.write_fleet(**JSON, json_form=form)
    hearing = hear(COUNTER_ONE.name, "opcua/json/#")
    one, two = site.bridge("one"), site.bridge("two")
    async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
        first = await until_read(reader(client, NODE), lambda data: data.StatusCode.is_good())
        await until_read(reader(client, NODE), lambda data: data.Value.Value > first.Value.Value)
    await until(lambda: heard(two, COUNTER_ONE))
    (part,) = hearing.on(COUNTER_ONE.name)[-1]["Messages"]
    value = part["Payload"]
    (value,) = value.values()
    assert int(value["Value"] if form == "compact" else value) > 0
    kinds = {topic.split("/")[2] for _, topic, _ in hearing.all if topic.startswith("opcua/")}
    assert {"application", "connection", "metadata", "status"} <= kinds
    assert one.end() == two.end() == 0


async def test_a_bridge_that_is_killed_leaves_the_retained_error_and_bad_nodes(site: Site, hear: Any) -> None:
    site.write_fleet(**JSON, keep_alive_s=1.0, receive_timeout_s=30.0)
    topic = f"opcua/json/status/{ONE}"
    hearing = hear(topic)
    one = site.bridge("one")
    async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
        read = reader(client, NODE)
        await until_read(read, lambda data: data.StatusCode.is_good())
        assert hearing.on(topic)[-1]["Status"] == PubSubState.OPERATIONAL
        one.end(signal.SIGKILL)
        await until_read(read, lambda data: data.StatusCode.name == "BadNoCommunication")
        await until(lambda: hearing.on(topic)[-1]["Status"] == PubSubState.ERROR)
        late = hear(topic)
        await until(lambda: late.all)
        ((is_retained, _, status),) = late.all
        assert is_retained
        assert (status["MessageType"], status["PublisherId"]) == ("ua-status", str(ONE))
        assert (status["IsCyclic"], status["Status"]) == (False, PubSubState.ERROR)
        again = site.bridge("one")
        await until_read(read, lambda data: data.StatusCode.is_good())
    assert again.end() == 0


async def test_plain_json_of_a_foreign_publisher_is_bridged_without_configuration(
    site: Site, broker: Broker, hear: Any
) -> None:
    two = site.bridge("two")
    async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
        publish(broker, FOREIGN, {"temperature": 21.5, "site": "hall 2"})
        read = reader(client, FOREIGN_NODE)
        text = await until_read(read, lambda data: data.StatusCode.is_good())
        assert json.loads(text.Value.Value) == {"temperature": 21.5, "site": "hall 2"}
        metadata = {
            "MessageId": "m1",
            "MessageType": "ua-metadata",
            "PublisherId": "77",
            "DataSetWriterId": 3001,
            "MetaData": {
                "Name": "weather",
                "Fields": [{"Name": "temperature", "BuiltInType": 11, "DataType": "i=11", "ValueRank": -1}],
                "ConfigurationVersion": {"MajorVersion": 800_000_000, "MinorVersion": 800_000_000},
            },
        }
        publish(broker, "opcua/json/metadata/77/group-2/weather", metadata, "-r")
        typed = await until_read(read, lambda data: data.Value.Value == 21.5)
        assert typed.StatusCode.is_good()
        messages = [{"DataSetWriterId": 3001, "Payload": {"temperature": 22.5}}]
        message = {"MessageId": "m2", "MessageType": "ua-data", "PublisherId": "77", "Messages": messages}
        publish(broker, FOREIGN, message)
        await until_read(read, lambda data: data.Value.Value == 22.5)
        other = {"PublisherId": "78", "DataSetWriterId": 3001, "Payload": {"temperature": 99.0}}
        publish(broker, FOREIGN, other)
        publish(broker, FOREIGN, {"temperature": 23.5})
        await until_read(read, lambda data: data.Value.Value == 23.5)
    await until(lambda: any(line.startswith(f"heard {FOREIGN} ") for line in two.lines))
    assert two.end() == 0


@pytest.mark.needs("nats")
async def test_values_over_mqtt_3_1_1_where_a_process_hears_itself(tmp_path: Path, processes: Processes) -> None:
    broker = nats(tmp_path / "nats")
    broker.start()
    try:
        site = Site(tmp_path, broker.url, processes)
        site.write_fleet(**JSON)
        site.bridge("one")
        two = site.bridge("two")
        async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
            await until_read(reader(client, NODE), lambda data: data.StatusCode.is_good())
        await until(lambda: heard(two, COUNTER_ONE))
        assert not heard(two, COUNTER_TWO), "it publishes nothing of its own into its space"
    finally:
        broker.end()
