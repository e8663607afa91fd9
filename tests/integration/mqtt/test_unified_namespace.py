"""A server's Unified Namespace at real brokers, read by mosquitto_sub."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.integration.mqtt.broker import Broker, mosquitto
from tests.integration.mqtt.certificates import authority, certificate
from tests.integration.server_model.harness import (
    ENGINEER,
    GOAL,
    OBSERVER,
    OPERATOR,
    ROBOTS,
    SPACE,
    SPEED,
    reader,
    serving,
    ua,
)
from tests.integration.server_model.harness import until as until_read
from tests.system import Child, Processes
from tests.waiting import until
from ua_fleet.client import ClientIdentity, FleetClient, NamespaceStatus, RobotClient, fleet_status
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

pytestmark = pytest.mark.needs("mosquitto")

AT = "plant/Fleet/rover/"
SERVER = "plant/Fleet/_server"
FIELD = (make_field("data", int(BuiltinType.DOUBLE)),)
LOAD = Topic(SPACE, 2, 1101)
PROGRAM = Path(__file__).parent.parent / "run_server.py"


def fleet(udp_url: str, port: int, url: str, **section: Any) -> FleetConfig:
    """The fleet of the server's tests, with a Unified Namespace."""
    raw: dict[str, Any] = {
        "version": 1,
        "server": {"port": port, "trust_all_clients": True},
        "pubsub": {"security": "none", "url": udp_url, "keep_alive_s": 0.2, "receive_timeout_s": 0.8},
        "bridges": {"mobile_side": {"kind": "ros2", "space": SPEED.space, "status_id": 1900}},
        "robots": ROBOTS,
        "unified_namespace": {"url": url, "site": "plant", "rate_hz": 50.0, **section},
    }
    return load_content(json.dumps(raw).encode(), "fleet.json", {})


class Subscriber:
    """A mosquitto_sub: retain flag, Message Expiry Interval, topic and text of each message."""

    def __init__(self, child: Child) -> None:
        self.child = child

    @property
    def all(self) -> list[tuple[bool, str, str, str]]:
        lines = [line.split(" ", 3) for line in list(self.child.lines) if line[:2] in ("0 ", "1 ")]
        return [(flag == "1", expiry, topic, text) for flag, expiry, topic, text in lines]

    def texts(self, topic: str) -> list[str]:
        return [text for _, _, its, text in self.all if its == topic]

    def last(self, topic: str) -> str:
        return next(reversed(self.texts(topic)), "")


Subscribe = Callable[..., Subscriber]


@pytest.fixture
def subscribe(processes: Processes) -> Subscribe:
    def subscribed(broker: Broker, *options: str) -> Subscriber:
        arguments = ["-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", *(options or ("-V", "mqttv5"))]
        started = processes.start("mosquitto_sub", *arguments, "-t", "plant/#", "-F", "%r %E %t %p", whole=True)
        return Subscriber(started)

    return subscribed


async def looked_at(subscriber: Subscriber, topic: str) -> str:
    """What stands on a topic once something does that is known."""
    await until(lambda: subscriber.last(topic) not in ("", "null"))
    return subscriber.last(topic)


def publish(broker: Broker, topic: str, text: str) -> None:
    command = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-r", "-t", topic, "-m", text]
    subprocess.run(command, check=True)


async def test_a_value_its_silence_and_its_return_for_who_is_there_and_who_comes_late(
    udp_url: str, tcp_port: int, tmp_path: Path, broker: Broker, subscribe: Subscribe
) -> None:
    config = fleet(udp_url, tcp_port, broker.url, payload="value")
    early = subscribe(broker)
    async with serving(tmp_path, config) as running:
        await until(lambda: early.last(AT + "pose.frame") == "null", "what is not known yet")
        running.peer.announce(SPEED, FIELD)
        running.peer.publish(SPEED, 1.5)
        await until(lambda: early.last(AT + "speed") == "1.5")
        await until(lambda: early.last(AT + "_state") == '"idle"')
        running.peer.mute()
        await until(lambda: early.last(AT + "speed") == "null", "the end of the value")
        await until(lambda: early.last(AT + "_state") == '"offline"')
        late = subscribe(broker)
        await until(lambda: (True, "null") in [(kept, text) for kept, _, its, text in late.all if its == AT + "speed"])
        running.peer.unmute()
        running.peer.publish(SPEED, 0.5)
        await until(lambda: late.last(AT + "speed") == "0.5")
        assert late.last(SERVER) == '"online"'
    await until(lambda: late.last(SERVER) == '"offline"')
    await until(lambda: late.last(AT + "speed") == "null", "the end of the server")


async def test_objects_have_the_robots_time_and_quality_and_expire(
    udp_url: str, tcp_port: int, tmp_path: Path, broker: Broker, subscribe: Subscribe
) -> None:
    early = subscribe(broker)
    async with serving(tmp_path, fleet(udp_url, tcp_port, broker.url)) as running, running.client(OBSERVER) as client:
        running.peer.announce(SPEED, FIELD)
        running.peer.publish(SPEED, 1.5)
        shown = await until_read(reader(client, f"ns=2;i={SPEED.id}"), lambda data: data.StatusCode.is_good())
        await until(lambda: '"Good"' in early.last(AT + "speed"))
        message = json.loads(early.last(AT + "speed"))
        assert (message["value"], message["quality"]) == (1.5, "Good")
        assert message["time"].startswith(f"{shown.SourceTimestamp:%Y-%m-%dT%H:%M:%S.%f}".rstrip("0"))
        expiry = {its: expiry for _, expiry, its, _ in early.all}
        assert 170 <= int(expiry[AT + "speed"]) <= 180
        running.peer.mute()
        await until(lambda: "BadNoCommunication" in early.last(AT + "speed"))
        assert json.loads(early.last(AT + "speed")) == message | {"value": None, "quality": "BadNoCommunication"}


async def test_what_somebody_writes_there_moves_nothing_and_is_replaced(
    udp_url: str, tcp_port: int, tmp_path: Path, broker: Broker, subscribe: Subscribe
) -> None:
    early = subscribe(broker)
    config = fleet(udp_url, tcp_port, broker.url, payload="value")
    async with serving(tmp_path, config) as running, running.client(OPERATOR) as client:
        goal = client.get_node(f"ns=2;i={GOAL.id}")
        await until(lambda: early.last(AT + "goal") == "0.0")
        publish(broker, AT + "goal", "0.75")
        publish(broker, SERVER, '"offline"')
        await until(lambda: early.last(AT + "goal") == "0.75")
        await goal.write_value(ua.DataValue(ua.Variant(0.25, ua.VariantType.Double)))
        await until(lambda: early.last(AT + "goal") == "0.25")
        assert 0.75 not in [values[0] for values in running.peer.good(GOAL)]
        assert await goal.read_value() == 0.25


async def test_what_an_earlier_life_left_is_replaced_at_the_start(
    udp_url: str, tcp_port: int, tmp_path: Path, broker: Broker, subscribe: Subscribe
) -> None:
    publish(broker, AT + "speed", "99.0")
    async with serving(tmp_path, fleet(udp_url, tcp_port, broker.url, payload="value")):
        early = subscribe(broker)
        await until(lambda: early.last(AT + "speed") == "null")


async def test_a_server_that_is_killed_is_offline_by_its_will(
    udp_url: str, tcp_port: int, tmp_path: Path, broker: Broker, subscribe: Subscribe, processes: Processes
) -> None:
    config = fleet(udp_url, tcp_port, broker.url)
    path = tmp_path / "fleet.json"
    path.write_text(config.model_dump_json(exclude_unset=True))
    early = subscribe(broker)
    server = processes.start(sys.executable, PROGRAM, path)
    server.wait_for("opc.tcp://")
    await until(lambda: '"online"' in early.last(SERVER))
    server.end(signal.SIGKILL)
    await until(lambda: '"offline"' in early.last(SERVER))
    late = subscribe(broker)
    await until(lambda: late.all)
    assert json.loads(late.last(SERVER)) == {"value": "offline", "time": None, "quality": "Good"}


async def test_a_broker_that_is_killed_gets_everything_anew_and_status_and_metrics_tell_of_it(
    udp_url: str, tcp_port: int, tmp_path: Path, broker: Broker, subscribe: Subscribe
) -> None:
    config = fleet(udp_url, tcp_port, broker.url, payload="value")
    node = "ns=2;s=Fleet.UnifiedNamespace."
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        running.peer.announce(SPEED, FIELD)
        await until_read(reader(client, node + "Connected"), lambda data: data.Value.Value is True)
        assert (await reader(client, node + "Topics")()).Value.Value == 9
        await until_read(reader(client, node + "Published"), lambda data: data.Value.Value >= 10)
        broker.end(signal.SIGKILL)
        await until_read(reader(client, node + "Connected"), lambda data: data.Value.Value is False)
        detail = await reader(client, node + "Detail")()
        assert broker.url in detail.Value.Value
        number = 0.0
        away = reader(client, node + "Drops.broker_away")
        while (await away()).Value.Value < 3:
            number = (number + 0.1) % 2
            running.peer.publish(SPEED, number)
            await until_read(reader(client, f"ns=2;i={SPEED.id}"), lambda data: data.Value is not None)
        running.peer.publish(SPEED, 1.75)
        broker.start()
        late = subscribe(broker)
        await until(lambda: late.last(AT + "speed") == "1.75")
        await until(lambda: late.last(AT + "pose.frame") == "null")
        await until_read(reader(client, node + "Waiting"), lambda data: data.Value.Value == 0)


@pytest.mark.parametrize("form", ["value", "object"])
async def test_at_each_kind_of_broker(
    udp_url: str, tcp_port: int, tmp_path: Path, any_broker: Broker, subscribe: Subscribe, form: str
) -> None:
    async with serving(tmp_path, fleet(udp_url, tcp_port, any_broker.url, payload=form)) as running:
        early = subscribe(any_broker, "-V", "mqttv311")
        running.peer.announce(SPEED, FIELD)
        running.peer.publish(SPEED, 1.5)
        await until(lambda: "1.5" in early.last(AT + "speed"))
    await until(lambda: "offline" in early.last(SERVER))
    await until(lambda: "null" in early.last(AT + "speed"))


async def test_with_tls_a_certificate_and_a_broker_that_lets_the_server_alone_write(
    udp_url: str, tcp_port: int, tmp_path: Path, subscribe: Subscribe
) -> None:
    authority(tmp_path, "ca")
    certificate(tmp_path, "broker", "ca")
    certificate(tmp_path, "fleet", "ca")
    (tmp_path / "acl").write_text("user fleet\ntopic write plant/Fleet/#\ntopic read plant/#\n")
    certificates = [f"cafile {tmp_path}/ca.pem", f"certfile {tmp_path}/broker.pem", f"keyfile {tmp_path}/broker.key"]
    rights = ["require_certificate true", "use_identity_as_username true", f"acl_file {tmp_path}/acl"]
    broker = mosquitto(tmp_path / "mosquitto", *certificates, *rights)
    broker.start()
    ours = {"certificate_file": "fleet.pem", "key_file": "fleet.key", "ca_file": "ca.pem"}
    url = broker.url.replace("mqtt://", "mqtts://")
    try:
        async with serving(tmp_path, fleet(udp_url, tcp_port, url, broker=ours)) as running:
            tls = [f"--{name}" for name in ("cafile", "cert", "key")]
            files = [str(tmp_path / name) for name in ("ca.pem", "fleet.pem", "fleet.key")]
            early = subscribe(broker, *[part for pair in zip(tls, files, strict=True) for part in pair])
            running.peer.announce(SPEED, FIELD)
            running.peer.publish(SPEED, 1.5)
            await until(lambda: '"value":1.5' in early.last(AT + "speed"))
    finally:
        broker.end()


async def test_a_server_starts_and_ends_without_its_broker(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet(udp_url, tcp_port, "mqtt://127.0.0.1:1")
    async with serving(tmp_path, config) as running, running.client(OBSERVER) as client:
        detail = reader(client, "ns=2;s=Fleet.UnifiedNamespace.Detail")
        await until_read(detail, lambda data: "mqtt://127.0.0.1:1" in data.Value.Value)
        assert not (await reader(client, "ns=2;s=Fleet.UnifiedNamespace.Connected")()).Value.Value


async def test_a_robot_that_is_registered_and_removed_and_what_status_tells(
    udp_url: str, tcp_port: int, tmp_path: Path, broker: Broker, subscribe: Subscribe
) -> None:
    early = subscribe(broker)
    cart = {"bridge": "mobile_side", "data": {"load": {"id": 1101, "type": "Double", "unit": "kg"}}}
    load = "plant/Fleet/cart/load"
    async with serving(tmp_path, fleet(udp_url, tcp_port, broker.url, payload="value")) as running:
        identity = ClientIdentity(tmp_path / "identity")
        async with FleetClient.connect(
            running.url, user=ENGINEER[0], password=ENGINEER[1], identity=identity
        ) as client:
            robots = RobotClient(client)
            await robots.register("cart", cart, bridge="mobile_side")
            await until(lambda: early.texts(load) == ["null"], "the topic of a new robot")

            async def look() -> NamespaceStatus:
                status = (await fleet_status(client)).namespace
                assert status is not None
                return status

            status = await until_read(look, lambda status: status.connected and status.published >= 13)
            assert (status.detail, status.topics) == (broker.url, 13)
            assert await looked_at(early, "plant/Fleet/cart/_state") == '"offline"'
            running.peer.announce(LOAD, FIELD)
            running.peer.publish(LOAD, 12.5)
            await until(lambda: early.last(load) == "12.5")
            await robots.unregister("cart")
            await until(lambda: early.texts(load)[-1] == "", "the end of its topics")
            late = subscribe(broker)
            await until(lambda: late.last(SERVER))
            assert not [topic for _, _, topic, _ in late.all if topic.startswith("plant/Fleet/cart/")]
