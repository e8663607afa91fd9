"""A fleet whose robots all have live values, and a console before it, for the benchmarks of the console.

python -m benchmarks._console_fleet FLEET_JSON     publishes the values of all robots, each once a second
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import sys
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from tests import system
from tests.console.conftest import FLEET, Console, console_of
from tests.integration.server_model.harness import ENGINEER, OBSERVER, OPERATOR
from tests.system import Child, Processes
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Counters
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType, ticks_from_unix_ns
from ua_fleet.wire import Codec

VALUES: Final = ("charge", "x", "y", "heading", "speed", "load", "temperature", "current", "torque", "distance")
UNITS: Final = ("%", "m", "m", "rad", "m/s", "kg", "°C", "A", "N.m", "m")
HALLS: Final = 10
"""Bridges, each of a space of its own."""
FIRST_SPACE: Final = 300
PERIOD_S: Final = 1.0
STEPS: Final = 50
"""Parts of a second, in each of which a part of the robots tells its values."""
PROBE: Final = 60_000
"""Id of a value of the first robot that clients write."""
SERVER: Final = system.ROOT / "tests" / "integration" / "scenarios" / "server_process.py"
PEOPLE: Final = {
    "engineer": (ENGINEER, Role.ENGINEER),
    "operator": (OPERATOR, Role.OPERATOR),
    "observer": (OBSERVER, Role.OBSERVER),
    **{f"person{n}": ((f"person{n}", f"secret-{n}"), Role.OPERATOR) for n in range(5)},
}


def robot_name(number: int) -> str:
    return f"robot{number + 1:04d}"


def fleet(robots: int, url: str, port: int) -> dict[str, Any]:
    """A fleet.yaml of so many robots with the ten values each."""
    fields = {name: {"type": "Double", "unit": unit} for name, unit in zip(VALUES, UNITS, strict=True)}
    raw: dict[str, Any] = {
        "version": 1,
        "server": {"port": port, "trust_all_clients": True},
        "pubsub": {"security": "none", "url": url, "keep_alive_s": 5, "receive_timeout_s": 30, "repeat_interval_s": 20},
        "bridges": {f"hall{hall}": {"kind": "virtual", "space": FIRST_SPACE + hall} for hall in range(HALLS)},
        "robots": {
            robot_name(number): {
                "bridge": f"hall{number % HALLS}",
                "capacities": [["mobile"], ["mobile", "grab"], ["weld"]][number % 3],
                "data": {"now": {"id": number + 1, "fields": fields, "max_age_s": 30}},
            }
            for number in range(robots)
        },
    }
    raw["robots"][robot_name(0)]["data"]["probe"] = {"id": PROBE, "type": "Int32", "origin": "server"}
    return raw


async def publish(config: FleetConfig) -> None:
    """Tell new values of every robot once a second, until this is cancelled."""
    loop = asyncio.get_running_loop()
    counters, codec = Counters(), Codec()
    transport = UdpTransport(config.pubsub.url, "lo", ttl=1)
    timing = PubSubTiming(
        config.pubsub.keep_alive_s or 5, config.pubsub.receive_timeout_s, config.pubsub.repeat_interval_s
    )
    publishers = [Publisher(FIRST_SPACE + hall, timing, counters, codec) for hall in range(HALLS)]
    members = tuple(make_field(name, BuiltinType.DOUBLE) for name in VALUES)
    chance = random.Random(1)
    robots = len(config.robots)
    last = [[chance.uniform(0, 100) for _ in VALUES] for _ in range(robots)]

    def send(datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            transport.send(datagram)

    def ticks() -> int:
        return ticks_from_unix_ns(time.time_ns())

    await transport.start(lambda datagram, sender: None)
    for number in range(robots):
        topic = Topic(FIRST_SPACE + number % HALLS, 2, number + 1)
        publisher = publishers[number % HALLS]
        send(publisher.announce(topic, topic.name, members, now=loop.time(), wall_ticks=ticks()))
        await asyncio.sleep(0.001)
    step, due = 0, loop.time()
    while True:
        for number in range(step % STEPS, robots, STEPS):
            last[number] = [value + chance.uniform(-1, 1) for value in last[number]]
            topic = Topic(FIRST_SPACE + number % HALLS, 2, number + 1)
            send(publishers[number % HALLS].publish(topic, tuple(last[number]), timestamp=ticks(), now=loop.time()))
        for publisher in publishers if step % STEPS == 0 else ():
            send(publisher.poll(loop.time(), ticks()))
        step, due = step + 1, due + PERIOD_S / STEPS
        await asyncio.sleep(max(0.0, due - loop.time()))


@dataclass
class LiveFleet:
    """A server, all of whose robots are heard, and a console."""

    console: Console
    server: Child
    endpoint: str


@contextlib.contextmanager
def live_fleet(robots: int, folder: Path) -> Generator[LiveFleet]:
    """Such a fleet while the context lasts."""
    raw = fleet(robots, system.free_multicast_url(), system.free_tcp_port())
    file = folder / "fleet.json"
    file.write_text(json.dumps(raw), encoding="utf-8")
    config = FleetConfig.model_validate(raw)
    users = UserStore(folder / config.server.state_dir / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(parents=True)
    for (name, password), role in PEOPLE.values():
        users.add(name, password, role)
    with Processes() as processes:
        environment = system.clean_environment(PYTHONPATH=str(system.ROOT))
        server = processes.start(sys.executable, SERVER, file, env=environment)
        endpoint = server.wait_for("opc.tcp://", 120).strip()
        processes.start(sys.executable, "-m", "benchmarks._console_fleet", file, env=environment)
        (folder / "console").mkdir()
        with console_of(folder / "console", {FLEET: endpoint}) as console:
            yield LiveFleet(console, server, endpoint)


if __name__ == "__main__":
    asyncio.run(publish(FleetConfig.model_validate_json(Path(sys.argv[1]).read_text(encoding="utf-8"))))
