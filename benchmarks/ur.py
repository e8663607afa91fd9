"""A Universal Robots controller at 500 samples a second: how many reach the bridge, and how old a value is at the node.

The controller is the simulated one, another process. The peer is a bare socket that speaks RTDE: it sees every sample
that is sent. ur-rtde keeps the last sample only, so the bridge has to look in time; it does so with real-time priority
where the machine allows it. Ages are those of a register that holds the clock of the moment when it was written: at the
node of the product's server, and at the bare socket.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import statistics
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

from ua_bridges.ur.driver import UrDriver

from benchmarks._ros import Node, median_and_p99
from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, Unavailable, at_most, shown
from tests import system
from tests.ur_controller import UrController
from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead
from ua_fleet.config.load import load_content

MEASURED_S = 3.0
WARM_UP_S = 1.0
WRITES = 150
RATE_HZ = 500.0
GOAL = 1.01
NODE_ID = "ns=2;i=7"
PEER = "bare RTDE socket"


def fleet(host: str, priority: int, url: str = "opc.udp://239.1.2.3:4840", port: int = 4840) -> dict[str, Any]:
    bridge = {"kind": "ur", "space": 300, "status_id": 900, "address": host}
    register = {"id": 7, "type": "Double", "path": "output_double_register_12"}
    return {
        "version": 1,
        "pubsub": {"security": "none", "url": url},
        "server": {"port": port, "allow_none_security": True, "allow_anonymous": True, "analog_rate_hz": 10_000},
        "bridges": {"arm": bridge | ({"real_time_priority": priority} if priority else {})},
        "robots": {
            "ur5": {
                "bridge": "arm",
                "data": {
                    "register": register | {"source": {"max_rate_hz": 500, "only_changes": True}},
                    "joints": {
                        "id": 8,
                        "type": "Double",
                        "array": True,
                        "path": "actual_q",
                        "source": {"max_rate_hz": 500},
                    },
                },
            }
        },
    }


class BareClient:
    """A socket that reads one variable 500 times a second."""

    def __init__(self, host: str, variable: bytes) -> None:
        self._socket = socket.create_connection((host, 30004), 5)
        for kind, payload in ((b"V", b"\x00\x02"), (b"O", struct.pack(">d", RATE_HZ) + variable), (b"S", b"")):
            self._socket.sendall(struct.pack(">H", 3 + len(payload)) + kind + payload)
        self._rest = b""
        self.values: list[tuple[float, float]] = []
        """Each with the monotonic time at which it was read."""
        self._stopping = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stopping and (data := self._socket.recv(65536)):
            now = time.monotonic()
            self._rest += data
            while len(self._rest) >= 3 and len(self._rest) >= (size := struct.unpack_from(">H", self._rest)[0]):
                if self._rest[2:3] == b"U":
                    self.values.append((now, struct.unpack_from(">d", self._rest, 4)[0]))
                self._rest = self._rest[size:]

    def end(self) -> list[tuple[float, float]]:
        self._stopping = True
        self._thread.join()
        self._socket.close()
        return self.values


class Counting:
    """An inlet that counts."""

    def __init__(self) -> None:
        self.samples = self.lost = 0

    def put(self, event: DriverEvent) -> None:
        if isinstance(event, SampleRead) and event.topic.id == 8:
            self.samples += 1
        elif isinstance(event, Dropped):
            self.lost += event.count


async def handed_on(host: str, priority: int) -> tuple[float, float]:
    """Samples a second that the driver hands on, and how many of 10,000 it loses."""
    driver = UrDriver(load_content(json.dumps(fleet(host, priority)).encode(), "fleet.json", {}), "arm")
    inlet = Counting()
    await driver.start(inlet)
    try:
        while not driver.status().connected:  # noqa: ASYNC110 -- a driver says it in its status
            await asyncio.sleep(0.01)
        await asyncio.sleep(WARM_UP_S)
        samples, lost, began = inlet.samples, inlet.lost, time.monotonic()
        await asyncio.sleep(MEASURED_S)
        took = time.monotonic() - began
        samples, lost = inlet.samples - samples, inlet.lost - lost
    finally:
        await driver.stop()
    return samples / took, 10_000 * lost / max(samples + lost, 1)


def sent(host: str) -> float:
    """Samples a second that the bare socket reads."""
    client = BareClient(host, b"timestamp")
    time.sleep(WARM_UP_S + MEASURED_S)
    read = client.end()
    measured = [now for now, _ in read if now >= read[0][0] + WARM_UP_S]
    return (len(measured) - 1) / (measured[-1] - measured[0])


@contextlib.contextmanager
def node_of_the_server(host: str, priority: int) -> Generator[Node]:
    """Server and bridge, as processes."""
    with tempfile.TemporaryDirectory() as folder, system.Processes() as processes:
        path = Path(folder) / "fleet.yaml"
        config = fleet(host, priority, system.free_multicast_url(), system.free_tcp_port())
        path.write_text(json.dumps(config))
        server = Node(
            *(sys.executable, "-m", "benchmarks.ros_nodes.server_ours", path, NODE_ID),
            env=os.environ | {"PYTHONPATH": ".:bridges"},
        )
        try:
            command = (sys.executable, "-m", "ua_fleet.cli", "bridge", "arm")
            processes.start(*command, env=system.clean_environment(UA_FLEET_CONFIG=str(path))).wait_for("ready")
            yield server
        finally:
            server.end()


def ages_at(server: Node, controller: UrController) -> tuple[list[float], list[float]]:
    """Ages in us at the node, and at the bare socket, of the same values."""
    bare = BareClient(controller.host, b"output_double_register_12")
    with socket.create_connection((controller.host, 30005), 5) as connection, connection.makefile("rw") as lines:
        for _ in range(WRITES):
            lines.write(json.dumps({"do": "output_registers", "first": 12, "values": [time.monotonic()]}) + "\n")
            lines.flush()
            lines.readline()
            time.sleep(0.01)
    time.sleep(0.3)
    first: dict[float, float] = {}
    for now, value in bare.end():
        first.setdefault(value, now)
    server.tell("ages")
    return server.ages(), [(now - value) * 1e6 for value, now in first.items() if value > 0]


def figures(rounds: int) -> list[Figure]:
    if reason := system.missing("ur"):
        raise Unavailable(reason)
    priority = _priority()
    again = range(max(rounds, FEWEST_ROUNDS))
    with system.Processes() as processes:
        controller = UrController(processes)
        controller.start()
        host = controller.host
        counted = [(asyncio.run(handed_on(host, priority)), sent(host)) for _ in again]
        with node_of_the_server(host, priority) as server:
            _wait_for_values(server, controller)
            measured = [[median_and_p99(ages) for ages in ages_at(server, controller)] for _ in again]
    ours, bare = statistics.median(each[0] for each, _ in counted), statistics.median(each for _, each in counted)
    lost = statistics.median(each[1] for each, _ in counted)
    rows = [
        at_most(
            "500 Hz: time for each sample that is handed on",
            1e6 / ours,
            "us",
            reference=PEER,
            reference_value=1e6 / bare,
            goal=GOAL,
        ),
        shown("500 Hz: lost of 10,000 samples", lost, "samples", reference=f"{PEER}, sent", reference_value=10_000),
    ]
    for column, part in enumerate(("p50", "p99")):
        node, floor = (statistics.median(each[place][column] for each in measured) for place in (0, 1))
        rows.append(shown(f"age at the node, {part}", node, "us", reference=PEER, reference_value=floor))
    return rows


def _priority() -> int:
    """The priority that the machine allows."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except OSError:
        return 0
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return 10


def _wait_for_values(server: Node, controller: UrController) -> None:
    deadline = time.monotonic() + 20
    while not all(ages_at(server, controller)):
        if time.monotonic() > deadline:
            raise Failed("no value of the controller arrives at the node")
