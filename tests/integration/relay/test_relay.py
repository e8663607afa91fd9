"""A relay between real UDP on loopback and a real mosquitto."""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import pytest

from tests.integration.mqtt.broker import Broker
from tests.integration.relay.conftest import JSON, Apart, what_it_did
from tests.integration.security.conftest import COUNTER_ONE, COUNTER_TWO, ONE, POLICY, STATUS_ONE, TWO, heard
from tests.integration.server_model.harness import OBSERVER, reader, serving, until
from tests.system import Child, Processes
from tests.waiting import until as until_true
from ua_fleet.config.security import envelope_of
from ua_fleet.config.teleoperation import setpoint_groups
from ua_fleet.config.transports import open_transport
from ua_fleet.counters import Counters
from ua_fleet.keys.files import FileKeySource
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.topics import Topic
from ua_fleet.transport.party import Brokered, tool_party
from ua_fleet.values import BuiltinType
from ua_fleet.wire import ActionMessage, Codec, SecurityMode, encode_action, read_security
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage, Probe

pytestmark = pytest.mark.needs("mosquitto")

FIRST, SECOND = f"ns=2;i={COUNTER_ONE.id}", f"ns=2;i={COUNTER_TWO.id}"


def drops_of(client: Any, cause: str) -> Any:
    """Reads how many messages the server has dropped for a cause."""
    return reader(client, f"ns=2;s=Fleet.Traffic.Drops.{cause}")


def listening(processes: Processes, broker: Broker, *topics: str) -> Child:
    """A mosquitto_sub: each message is a line with its retain flag, topic and payload in hexadecimal."""
    wanted = [part for topic in topics for part in ("-t", topic)]
    arguments = ["-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-F", "%r %t %x"]
    return processes.start("mosquitto_sub", *arguments, *wanted, whole=True)


async def test_values_of_each_side_are_read_on_the_other_and_the_server_hears_the_broker_alone(
    apart: Apart, broker: Broker, processes: Processes
) -> None:
    listener = listening(processes, broker, COUNTER_ONE.name)
    one, two, relay = apart.bridge("one"), apart.bridge("two"), apart.relay()
    async with serving(apart.folder, apart.config) as running, running.client(OBSERVER) as client:
        first = await until(reader(client, FIRST), lambda data: data.StatusCode.is_good())
        await until(reader(client, FIRST), lambda data: data.Value.Value > first.Value.Value)
        await until(reader(client, SECOND), lambda data: data.StatusCode.is_good())
    await until_true(lambda: heard(two, COUNTER_ONE) and heard(one, COUNTER_TWO))
    await until_true(lambda: any(COUNTER_ONE.name in line for line in listener.lines))
    payload = bytes.fromhex(next(line for line in listener.lines if COUNTER_ONE.name in line).split()[2])
    assert read_security(payload).mode is SecurityMode.SIGN_AND_ENCRYPT
    for child, topic in ((two, COUNTER_ONE), (one, COUNTER_TWO)):
        numbers = heard(child, topic)
        assert numbers == sorted(set(numbers))
    did = what_it_did(relay)
    assert did["forwarded"] > 0
    assert set(did["drops"]) <= {"not_listed", "no_metadata", "retained", "broker_away"}, did
    assert one.end() == two.end() == 0


async def test_values_of_a_broker_are_read_on_a_server_that_hears_the_hall_alone(
    tmp_path: Path, udp_url: str, broker: Broker, processes: Processes
) -> None:
    apart = Apart(tmp_path, udp_url, broker.url, processes, served=("hall",))
    two, relay = apart.bridge("two"), apart.relay()
    async with serving(apart.folder, apart.config) as running, running.client(OBSERVER) as client:
        first = await until(reader(client, SECOND), lambda data: data.StatusCode.is_good())
        await until(reader(client, SECOND), lambda data: data.Value.Value > first.Value.Value)
        two.end(signal.SIGKILL)
        await until(reader(client, SECOND), lambda data: data.StatusCode.name == "BadNoCommunication")
    assert relay.end() == 0


async def test_uadp_of_the_hall_is_json_at_the_site_and_json_of_a_named_source_is_uadp_in_the_hall(
    tmp_path: Path, udp_url: str, broker: Broker, processes: Processes
) -> None:
    weather = Topic(77, 2, 3001)
    forwards: list[dict[str, Any]] = [
        {"source": "hall", "target": "site", "origins": [ONE]},
        {"source": "site", "target": "hall", "origins": [COUNTER_TWO.name, weather.name]},
    ]
    apart = Apart(tmp_path, udp_url, broker.url, processes, forwards=forwards, served=("hall",), **JSON)
    hearing = processes.start(
        "mosquitto_sub", "-h", "127.0.0.1", "-p", str(broker.port), "-F", "%r %t %p",
        "-t", COUNTER_ONE.name, "-t", f"opcua/json/metadata/{ONE}/#", "-t", f"opcua/json/status/{ONE}", whole=True,
    )  # fmt: skip
    one, two, relay = apart.bridge("one"), apart.bridge("two"), apart.relay()
    async with serving(apart.folder, apart.config) as running, running.client(OBSERVER) as client:
        await until(reader(client, SECOND), lambda data: data.StatusCode.is_good())
        metadata = {
            "MessageId": "m1",
            "MessageType": "ua-metadata",
            "PublisherId": "77",
            "DataSetWriterId": weather.id,
            "MetaData": {
                "Name": "weather",
                "Fields": [{"Name": "temperature", "BuiltInType": 11, "DataType": "i=11", "ValueRank": -1}],
                "ConfigurationVersion": {"MajorVersion": 800_000_000, "MinorVersion": 800_000_000},
            },
        }
        publish(broker, "opcua/json/metadata/77/group-2/weather", metadata, "-r")
        publish(broker, weather.name, {"temperature": 21.5})
        await until(reader(client, f"ns=2;i={weather.id}"), lambda data: data.Value.Value == 21.5)
        publish(broker, "ua_78_2_3002", {"temperature": 99.0})  # nobody has named it
    await until_true(lambda: heard(two, COUNTER_ONE))
    data = [json.loads(line.split(maxsplit=2)[2]) for line in hearing.lines if f" {COUNTER_ONE.name} " in line]
    values = [part["Payload"] for each in data for part in each["Messages"] if part.get("Payload")]
    assert all(int(next(iter(value.values()))) > 0 for value in values)
    assert values
    topics = [line.split()[1] for line in hearing.lines if line.startswith(("0 ", "1 "))]
    assert topics.index(f"opcua/json/metadata/{ONE}/group-2/counter") < topics.index(COUNTER_ONE.name)
    assert what_it_did(relay)["drops"]["not_listed"] > 0
    assert one.end() == two.end() == 0


def publish(broker: Broker, topic: str, message: Any, *options: str) -> None:
    """What `mosquitto_pub` sends."""
    command = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", *options, "-t", topic]
    subprocess.run([*command, "-m", json.dumps(message)], check=True)


class Stranger:
    """Who has keys of some groups, and sends on one connection what it likes."""

    def __init__(self, apart: Apart, number: int, space: int, *groups: str, as_on: int | None = None) -> None:
        """Be a process of a space on a connection, with the keys that it would have `as_on` another one."""
        self._groups, self._source = groups, FileKeySource(apart.keys.path, POLICY)
        as_on, state_dir = number if as_on is None else as_on, apart.folder / f"stranger-{space}"
        self._envelope = envelope_of(apart.config, space, Counters(), state_dir, number=as_on)
        self._transport = open_transport(apart.config, apart.folder, space=None, number=number)
        self.heard: list[bytes] = []
        if isinstance(self._transport, Brokered):
            party = tool_party(lambda _datagram, _sender: None)
            self._transport.speak_for(replace(party, setpoint_groups=setpoint_groups(apart.config)))

    async def __aenter__(self) -> Self:
        await self._transport.start(lambda datagram, _sender: self.heard.append(datagram))
        for group_id in self._groups:
            self._envelope.install(group_id, await self._source.fetch(group_id, 0, 1), self._now())
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._transport.close()

    def _now(self) -> float:
        return asyncio.get_running_loop().time()

    async def until_asked(self, *plain: bytes) -> None:
        """Say this again and again until the relay asks for the metadata of the last of it: all before it was heard."""
        seen = len(self.heard)

        def said() -> bool:
            for each in plain:
                self.say(each)
            return any(is_probe(each) for each in self.heard[seen:])

        await until_true(said)

    def say(self, plain: bytes) -> None:
        sealed = self._envelope.seal(plain, self._now())
        assert sealed
        for part in sealed:
            if isinstance(self._transport, Brokered):
                self._transport.send_part(part, plain)
            else:
                self._transport.send(part)


def is_probe(datagram: bytes) -> bool:
    heard = read_security(datagram)
    return heard.is_discovery and heard.mode is SecurityMode.NONE and isinstance(Codec().decode(datagram), Probe)


def value(space: int, group: int = 2) -> bytes:
    part = DataSetMessage(1, types=(int(BuiltinType.INT64),), values=(7,), sequence_number=1, timestamp=1)
    return Codec().encode(NetworkMessage(space, writer_group_id=group, messages=(part,)))


async def test_who_speaks_in_the_name_of_an_origin_at_the_target_is_not_heard_there(apart: Apart) -> None:
    async with (
        serving(apart.folder, apart.config) as running,
        running.client(OBSERVER) as client,
        Stranger(apart, 1, ONE, telemetry_group(ONE), as_on=0) as stranger,
    ):

        async def refused() -> int:
            stranger.say(value(ONE))
            return sum([(await drops_of(client, cause)()).Value.Value for cause in ("bad_signature", "unknown_token")])

        await until(refused, lambda count: count > 0)
        assert not (await reader(client, FIRST)()).StatusCode.is_good()


async def test_an_origin_that_is_not_listed_is_not_forwarded(apart: Apart) -> None:
    relay = apart.relay()
    keys = telemetry_group(0), telemetry_group(ONE)
    async with Stranger(apart, 1, 7) as listener, Stranger(apart, 0, ONE, *keys) as stranger:
        await stranger.until_asked(value(0), value(ONE))
    did = what_it_did(relay)
    assert did["drops"]["not_listed"] > 0
    assert did["drops"]["no_metadata"] > 0
    assert did["forwarded"] == 0
    assert all(map(is_probe, listener.heard))


async def test_a_relay_that_is_killed_loses_nothing_that_is_retained_and_says_metadata_before_data(
    apart: Apart, broker: Broker, processes: Processes
) -> None:
    metadata, status = f"opcua/uadp/metadata/{ONE}/#", f"opcua/uadp/status/{ONE}"
    one, relay = apart.bridge("one"), apart.relay()
    async with serving(apart.folder, apart.config) as running, running.client(OBSERVER) as client:
        first = reader(client, FIRST)
        ended = await until(first, lambda data: data.StatusCode.is_good())
        one.end()
        one = apart.bridge("one")  # says that it is Operational, as it begins
        before = await until(
            first, lambda data: data.StatusCode.is_good() and data.Value.Value > ended.Value.Value + 10
        )
        relay.end(signal.SIGKILL)
        await until(first, lambda data: data.StatusCode.name == "BadNoCommunication")
        late = listening(processes, broker, metadata, status)
        await until_true(
            lambda: {line.split("/")[2] for line in late.lines if line.startswith("1 ")} == {"metadata", "status"}
        )
        late.end()
        live = listening(processes, broker, metadata, COUNTER_ONE.name)
        await until_true(lambda: any(line.startswith("1 ") for line in live.lines))
        relay = apart.relay()
        after = await until(first, lambda data: data.StatusCode.is_good())
        assert after.Value.Value > before.Value.Value
    said = [line.split()[1] for line in live.lines if line.startswith("0 ")]
    assert said[0].startswith(f"opcua/uadp/metadata/{ONE}/")
    assert COUNTER_ONE.name in said
    assert one.end() == 0
    assert what_it_did(relay)["forwarded"] > 0


async def test_the_same_value_over_both_roads_is_one_value_and_goes_on_without_the_relay(
    tmp_path: Path, udp_url: str, broker: Broker, processes: Processes
) -> None:
    apart = Apart(tmp_path, udp_url, broker.url, processes, served=("hall", "site"))
    one, relay = apart.bridge("one"), apart.relay()
    async with serving(apart.folder, apart.config) as running, running.client(OBSERVER) as client:
        first = reader(client, FIRST)
        await until(first, lambda data: data.StatusCode.is_good())

        async def doubles() -> int:
            return sum([(await drops_of(client, cause)()).Value.Value for cause in ("duplicate", "repeated", "late")])

        await until(doubles, lambda count: count > 50)
        assert (await first()).StatusCode.is_good()
        relay.end(signal.SIGKILL)
        now = await first()
        after = await until(first, lambda data: data.Value.Value > now.Value.Value + 200)
        assert after.StatusCode.is_good()
    assert one.end() == 0


class Driven(Apart):
    """A robot in the hall is driven by hand."""

    def change(self, raw: dict[str, Any]) -> None:
        super().change(raw)
        limits = {"speed": 1.0, "acceleration": 1.0, "jerk": 1.0}
        raw["robots"]["first"]["teleoperation"] = {"data": "go", "axes": {"value": limits}, "robot_timeout_ms": 500}


@pytest.mark.parametrize("number", [0, 1])
async def test_neither_an_action_nor_a_setpoint_goes_through_a_relay(
    tmp_path: Path, udp_url: str, broker: Broker, processes: Processes, number: int
) -> None:
    forwards = [
        {"source": "hall", "target": "site", "origins": [0, ONE]},
        {"source": "site", "target": "hall", "origins": [TWO]},
    ]
    apart = Driven(tmp_path, udp_url, broker.url, processes, forwards=forwards, served=("hall",))
    origin = (ONE, TWO)[number]
    request = ActionMessage(origin, 2, 50, 1, 1, 1, True, "0.test", bytes(16), timeout_hint_ms=5000.0)
    commands = [encode_action(request)]
    if number == 0:  # the server, which drives robots, is in the hall
        commands.append(value(0, STATUS_ONE.id))
    keys = [telemetry_group(origin), command_group(origin), command_group(ONE)]
    relay = apart.relay()
    async with Stranger(apart, 1 - number, 7) as listener, Stranger(apart, number, origin, *keys) as stranger:
        await stranger.until_asked(*commands, value(origin))
    assert what_it_did(relay)["drops"]["not_relayed"] >= len(commands)
    assert all(map(is_probe, listener.heard))
