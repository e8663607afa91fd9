"""`ua-fleet pubsub relay` and `ua-fleet up` as a user runs them: from a secured hall to a broker without security."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from tests.integration.cli.conftest import command
from tests.integration.cli.test_record import TOPIC, publishing
from tests.integration.mqtt.broker import Broker
from tests.integration.mqtt.speaking import Speaking
from tests.scraped import scrape
from tests.system import Child, Processes, clean_environment, free_multicast_url, free_tcp_port
from tests.waiting import until
from ua_fleet.config.load import load
from ua_fleet.config.security import all_groups
from ua_fleet.counters import Counters
from ua_fleet.pubsub import DataReceived, PubSubTiming, Subscriber
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire import Codec
from ua_fleet.wire.security import SecurityPolicy

pytestmark = pytest.mark.needs("mosquitto")

FLEET = """\
version: 1
pubsub:
  - {{name: hall, security: sign_and_encrypt, url: "{hall}", keys: {{source: {keys}}}}}
  - {{name: site, security: none, url: "{site}"}}
server: {{port: {port}, connections: [site]}}
bridges:
  floor: {{kind: ros2, space: 2, status_id: 1900, connections: [hall]}}
relays:
  gate:
    monitoring_port: {monitoring}
    forwards:
      - {{source: hall, target: site, origins: [floor]}}
"""


class Hall:
    """A folder with a fleet that has one relay, and its commands."""

    def __init__(self, folder: Path, broker: Broker, processes: Processes, keys: str = "files") -> None:
        self.url, self.file, self._processes = free_multicast_url(), folder / "fleet.yaml", processes
        self.monitoring = free_tcp_port()
        self.file.write_text(
            FLEET.format(hall=self.url, site=broker.url, keys=keys, port=free_tcp_port(), monitoring=self.monitoring)
        )
        if keys == "files":
            for group_id in all_groups(load(self.file, {})):
                made = KeyFile.new(group_id, SecurityPolicy.AES256_CTR, 3600.0, time.time())
                KeyFolder(folder / "keys").write(made)

    def start(self, *arguments: str) -> Child:
        folder = self.file.parent
        environment = clean_environment(UA_FLEET_CONFIG=str(self.file), XDG_STATE_HOME=str(folder / "home"))
        return self._processes.start(*command(*arguments), env=environment)

    def relay(self, *arguments: str) -> Child:
        return self.start("pubsub", "relay", "gate", *arguments)

    def change(self, old: str, new: str) -> None:
        text = self.file.read_text()
        assert old in text
        self.file.write_text(text.replace(old, new))


def ended(child: Child) -> tuple[int, list[str]]:
    """How a command ended by itself, and what it has said."""
    child.process.wait(60)
    return child.end(), child.lines


@pytest.fixture
def hall(tmp_path: Path, broker: Broker, processes: Processes) -> Hall:
    return Hall(tmp_path, broker, processes)


async def test_it_forwards_until_ctrl_c_and_tells_what_it_counts(hall: Hall, broker: Broker) -> None:
    reading = Subscriber(0, PubSubTiming(), Counters(), Codec())
    site = Speaking(broker.url, 0)
    await site.start()
    relay = hall.relay()
    await until(lambda: "ready: relay gate" in relay.lines)
    assert "relay gate (hall to site); end it with Ctrl-C" in relay.lines
    levels: list[float] = []
    taken = 0

    def read() -> list[float]:
        nonlocal taken
        for datagram in site.heard[taken:]:
            taken += 1
            events = reading.receive(datagram, time.monotonic())
            found = [event for event in events if isinstance(event, DataReceived) and event.topic == TOPIC]
            levels.extend(event.message.values[0] for event in found)
        return levels

    try:
        async with publishing(hall.file, hall.url, TOPIC) as publish:
            level = 0.0
            async with asyncio.timeout(60):
                while len(read()) < 20:
                    publish(level)
                    level += 1.0
                    await asyncio.sleep(0.02)
        assert levels == sorted(set(levels))
        counted: dict[Any, float] = await asyncio.to_thread(scrape, f"http://127.0.0.1:{hall.monitoring}")
        assert counted["ua_fleet_dataset_messages_sent_total",] >= 20
        assert counted["ua_fleet_drops_total", "not_relayed"] > 0  # an Action goes with each value
        assert counted["ua_fleet_key_remaining_seconds", "r-gate"] > 0
        assert counted["ua_fleet_key_remaining_seconds", "t-2"] > 0
        health = hall.start("healthcheck", "--at", f"127.0.0.1:{hall.monitoring}")
        assert (await asyncio.to_thread(ended, health))[0] == 0
        hall.change(f"monitoring_port: {hall.monitoring}", "monitoring_port: 0")
        second = await asyncio.to_thread(ended, hall.relay())
        assert second[0] == 1
        assert "relay gate runs already" in second[1][-1]
    finally:
        await site.transport.close()
    assert relay.end(signal.SIGINT) == 130
    assert not any("Traceback" in line for line in relay.lines)


def test_json_and_sigterm(hall: Hall) -> None:
    relay = hall.relay("--json")
    assert json.loads(relay.wait_for('{"ready"')) == {"ready": True, "relay": "gate"}
    assert relay.end(signal.SIGTERM) == 130


def test_a_broker_that_is_away_is_waited_for(hall: Hall, broker: Broker) -> None:
    broker.end()
    relay = hall.relay()
    relay.wait_for("ready: relay gate")
    relay.wait_for(f"{broker.url}")
    broker.start()
    relay.wait_for("connected to the MQTT broker")
    assert relay.end(signal.SIGINT) == 130


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("target: site", "target: sit", ":12:relays.gate.forwards[0].target: there is no connection `sit`; "),
        ("[floor]", "[flor]", ":12:relays.gate.forwards[0].origins[0]: there is no bridge `flor`; "),
        ("forwards:", "forward:", ":11:relays.gate.forward: "),
        ("target: site", "target: hall", ":12:relays.gate.forwards[0].target: leads back to where it comes from; "),
    ],
)
def test_a_bad_configuration_is_a_line_with_its_place(hall: Hall, old: str, new: str, said: str) -> None:
    hall.change(old, new)
    code, lines = ended(hall.relay())
    assert code == 2
    assert len([line for line in lines if f"{hall.file}{said}" in line]) == 1, lines
    assert not any("Traceback" in line for line in lines)


def test_what_it_cannot_begin_with_is_one_line(hall: Hall) -> None:
    code, lines = ended(hall.start("pubsub", "relay", "gat"))
    assert (code, lines[-1]) == (3, f"ua-fleet: {hall.file}: there is no relay 'gat'; relays there: gate")
    (hall.file.parent / "keys" / "r-gate.json").unlink()
    code, lines = ended(hall.relay())
    assert code == 2
    assert "r-gate" in lines[-1]
    assert not any("Traceback" in line for line in lines)


def test_up_runs_a_relay_with_the_keys_of_the_server(tmp_path: Path, broker: Broker, processes: Processes) -> None:
    hall = Hall(tmp_path, broker, processes, keys="service")
    up = hall.start("up", "gate")
    up.wait_for("relay gate has a certificate now, and the server knows it")
    up.wait_for("gate   | ready: relay gate")
    pid = up.process.pid
    children = [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    [relay] = [one for one in children if b"\0relay\0gate\0" in Path(f"/proc/{one}/cmdline").read_bytes()]
    os.kill(relay, signal.SIGKILL)
    said = up.wait_for("relay gate was ended by SIGKILL")
    assert "the others go on; to start it again, in another terminal: ua-fleet pubsub relay gate" in said
    again = hall.relay()
    again.wait_for("ready: relay gate")
    assert again.end(signal.SIGINT) == 130
    assert up.end(signal.SIGINT) == 130
    assert not any("Traceback" in line for line in up.lines)
