"""What the containers of the testbeds run, as processes of this machine: prepared volumes, and a conductor."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from ua_demo.brokered import setting as brokered
from ua_demo.processes import free_loopback_address
from ua_demo.ros_environment import ros2_environment
from ua_demo.talkrobots.setting import ACTORS, Actor, Kind
from ua_demo.testbed.broker import CONFIGURATION
from ua_demo.testbed.plan import BROKER, BROKER_PORT, TESTBEDS

from tests.integration.mqtt.broker import Broker
from tests.system import ROS1_PYTHON, Child, Processes, clean_environment, free_multicast_url, free_tcp_port, ros_domain

UR_PORTS = (29999, *range(30001, 30006))
WAIT_S = 60
"""For what takes seconds, on a machine that is busy."""
MEMBERS_OF_JSON = {"tasks", "fault", "messages", "bytes", "paper"}


class Testbed:
    """A prepared testbed on loopback: the values of fleet.yaml that name containers are given by the environment."""

    __test__ = False

    def __init__(self, processes: Processes, folder: Path, name: str, speed: float) -> None:
        self.processes, self.folder, self.name, self.speed = processes, folder, name, speed
        port = free_tcp_port()
        self.endpoint = f"opc.tcp://127.0.0.1:{port}/ua_fleet"
        self.environment = clean_environment(
            UA_FLEET_CONFIG=str(folder / "fleet" / "fleet.yaml"),
            UA_FLEET_SPEED=f"{speed:g}",
            UA_FLEET_RESILIENCE="automatic",
            UA_FLEET_ENDPOINT=self.endpoint,
            UA_FLEET__SERVER__HOST="127.0.0.1",
            UA_FLEET__SERVER__PORT=str(port),
            UA_FLEET__MONITORING__PORT="0",
        )
        if not TESTBEDS[name].has_broker:  # the environment reaches into no list
            self.environment |= {
                "UA_FLEET__PUBSUB__INTERFACE": "lo",
                "UA_FLEET__PUBSUB__URL": free_multicast_url(),
                "UA_FLEET__PUBSUB__KEYS__ENDPOINT": self.endpoint,
            }

    def place(self, bridge: str, **values: object) -> None:
        """Give keys of a bridge another value."""
        prefix = f"UA_FLEET__BRIDGES__{bridge.upper()}__"
        self.environment |= {prefix + key.upper(): str(value) for key, value in values.items()}

    def ua_fleet(self, *words: str, python: Path = Path(sys.executable), process: str = "") -> Child:
        environment = {**self.environment, **TESTBEDS[self.name].environment(process)}
        return self.processes.start(python, "-m", "ua_fleet.cli", *words, env=environment)

    def prepare(self) -> None:
        job = self.ua_fleet("testbed", "prepare", self.name, "--folder", str(self.folder))
        assert job.process.wait(WAIT_S) == 0, job.lines

    def traffic(self, name: str) -> tuple[str, str]:
        return ("--traffic-log", str(self.folder / "traffic" / f"{name}.jsonl"))

    def server(self) -> Child:
        server = self.ua_fleet("serve", *self.traffic("server"), process="server")
        server.wait_for("ready: ", timeout_s=WAIT_S)
        return server

    def conductor(self) -> Child:
        return self.ua_fleet("testbed", "run", self.name, "--folder", str(self.folder), process="operator")

    @property
    def result(self) -> Path:
        return self.folder / "operator" / "result.json"

    def wait_for_result(self, conductor: Child, timeout_s: float) -> dict[str, Any]:
        deadline = time.monotonic() + timeout_s
        while not self.result.exists():
            assert time.monotonic() < deadline, "\n".join(conductor.lines)
            time.sleep(0.05)
        report: dict[str, Any] = json.loads(self.result.read_text())
        return report


@contextmanager
def nine_tasks(processes: Processes, folder: Path) -> Generator[Testbed]:
    """All processes of the testbed talkrobots but its conductor."""
    testbed = Testbed(processes, folder, "talkrobots", speed=20)
    with ExitStack() as held:
        spaces = {"ridgeback": 1} | {f"pioneer_{number}": held.enter_context(ros_domain()) for number in (1, 2)}
        master = free_tcp_port()
        places = {
            "ur3": free_loopback_address(UR_PORTS),
            "drone": str(free_tcp_port()),
            "conveyor": str(free_tcp_port()),
            "temperature_sensor": str(folder / "thermometer"),
        }
        testbed.place("ridgeback_bridge", master_uri=f"http://127.0.0.1:{master}", host_ip="127.0.0.1")
        for number in (1, 2):
            testbed.place(f"pioneer_{number}_bridge", space=spaces[f"pioneer_{number}"], discovery="localhost")
        testbed.place("ur3_bridge", address=places["ur3"])
        testbed.place("drone_bridge", interpreter__connect=f"127.0.0.1:{places['drone']}")
        testbed.place("conveyor_bridge", devices__plc__host="127.0.0.1", devices__plc__port=places["conveyor"])
        testbed.place("temperature_sensor_bridge", devices__thermometer__path=places["temperature_sensor"])
        testbed.prepare()
        processes.start("rosmaster", "--core", "-p", str(master), "-w", "3")

        def simulate(actor: Actor) -> None:
            place, space = places.get(actor.name, ""), spaces.get(actor.name, 0)
            host = place if actor.kind is Kind.UR else "127.0.0.1"
            added = {
                "UA_FLEET_EVENTS": str(folder / "events" / f"{actor.name}.events"),
                "UA_FLEET_HEARTBEAT": str(folder / f"{actor.name}.heartbeat"),
            }
            if actor.kind is Kind.ROS1:
                added |= {"ROS_MASTER_URI": f"http://127.0.0.1:{master}", "ROS_IP": "127.0.0.1"}
            elif actor.kind is Kind.ROS2:
                added |= ros2_environment(space, "LOCALHOST")
            python = ROS1_PYTHON if actor.kind is Kind.ROS1 else sys.executable
            arguments = actor.arguments(space=space, host=host, place=place, speed=testbed.speed)
            processes.start(python, *arguments, env={**testbed.environment, **added})

        for actor in ACTORS:
            python = ROS1_PYTHON if actor.kind is Kind.ROS1 else Path(sys.executable)
            testbed.ua_fleet("bridge", actor.bridge, *testbed.traffic(actor.bridge), python=python)
            simulate(actor)
        yield testbed


@pytest.mark.needs("ros1", "ros2", "ur")
def test_a_conductor_that_sees_the_server_alone_has_the_nine_tasks_done_once(
    processes: Processes, tmp_path: Path
) -> None:
    with nine_tasks(processes, tmp_path) as testbed:
        conductor = testbed.conductor()
        conductor.wait_for("without the server: the server at", timeout_s=WAIT_S)
        server = testbed.server()
        report = testbed.wait_for_result(conductor, 90)
        assert report.keys() == MEMBERS_OF_JSON
        assert len(report["tasks"]) == 9
        assert {row["state"] for row in report["tasks"]} == {"done"}
        assert (report["fault"]["robot"], report["fault"]["replacement"]) == ("ridgeback", "pioneer_1")
        assert report["messages"]["request"] >= 22, "what all processes have written down"
        conductor.wait_for("what Eq. 12 counts", timeout_s=WAIT_S)
        hearts = {path.stem: time.time() - path.stat().st_mtime for path in tmp_path.glob("*.heartbeat")}
        assert hearts.keys() == {actor.name for actor in ACTORS if actor.kind not in (Kind.PLC, Kind.UR)}
        assert max(hearts.values()) < 10

        server.end(signal.SIGKILL)
        conductor.wait_for("without the server: the connection to", timeout_s=WAIT_S)
        testbed.server()
        conductor.wait_for("the server is back", timeout_s=WAIT_S)
        assert [line.partition(":")[0] for line in conductor.lines].count("without the server") == 2

        conductor.end()
        written = testbed.result.stat().st_mtime_ns
        again = testbed.conductor()
        again.wait_for("it has run before", timeout_s=WAIT_S)
        again.wait_for("the fleet is complete", timeout_s=WAIT_S)
        time.sleep(1)
        assert not any("fetch" in line for line in again.lines)
        assert testbed.result.stat().st_mtime_ns == written


def reporter(folder: Path, started_at: float, speed: float) -> Callable[..., None]:
    """Has a robot report something at one of the line's seconds, in the file that its container has for it."""

    def report(line_s: float, who: str, what: str, **details: object) -> None:
        event = {"t": started_at + line_s / speed, "who": who, "what": what, **details}
        with (folder / "events" / f"{who}.events").open("a") as file:
            file.write(json.dumps(event) + "\n")

    return report


def test_a_line_that_goes_on_without_the_server_is_followed_from_what_robots_report(
    processes: Processes, tmp_path: Path
) -> None:
    testbed = Testbed(processes, tmp_path, "pal", speed=10)
    testbed.prepare()
    server, conductor = testbed.server(), testbed.conductor()
    report = reporter(tmp_path, time.time() - 10, 10)
    report(0, "ned", "starts", covers=4)
    conductor.wait_for("0.00 s  ned starts", timeout_s=WAIT_S)
    for number in (1, 2):
        report(10 * number, "ned", "places a cover", carrier="conveyor", count=number)
        report(10 * number + 4, "human", "takes a cover", carrier="conveyor", boxes=number)
    server.end(signal.SIGKILL)
    conductor.wait_for("without the server: ", timeout_s=WAIT_S)
    for number in (1, 2):
        report(40 * number, "ned", "places a cover", carrier="turtlebot3", count=number)
        report(40 * number + 19, "human", "takes a cover", carrier="turtlebot3", boxes=number + 2)
    testbed.server()
    covers = testbed.wait_for_result(conductor, WAIT_S)["covers"]
    assert [cover["carrier"] for cover in covers] == ["conveyor", "conveyor", "turtlebot3", "turtlebot3"]
    assert [cover["delivered_s"] for cover in covers] == pytest.approx([14, 24, 59, 99], abs=0.01)

    # The arm is started again: that is another run, which the next conductor tells, and not the one before.
    conductor.end()
    again = testbed.conductor()
    again.wait_for("it has run before", timeout_s=WAIT_S)
    reporter(tmp_path, time.time() + 0.1, 10)(0, "ned", "starts", covers=4)
    again.wait_for("0.00 s  ned starts", timeout_s=WAIT_S)
    assert not any("takes a cover" in line for line in again.lines)


@contextmanager
def two_halls(processes: Processes, folder: Path) -> Generator[Testbed]:
    """All processes of the testbed brokered but its conductor, with its broker on loopback."""
    testbed = Testbed(processes, folder, "brokered", speed=20)
    testbed.prepare()
    ports = {name: free_tcp_port() for name in (BROKER, *brokered.ACTORS)}
    file = folder / "fleet" / "fleet.yaml"
    text = file.read_text()
    for there, here in {
        "interface: 10.214.84.0/26": "interface: lo",
        "opc.udp://224.0.2.14:4840": free_multicast_url(),
        f"mqtts://{BROKER}:{BROKER_PORT}": f"mqtts://localhost:{ports[BROKER]}",
        f"host: belt, port: {brokered.BELT_PORT}": f"host: 127.0.0.1, port: {ports['belt']}",
        f"quadcopter:{brokered.QUADCOPTER_PORT}": f"127.0.0.1:{ports['quadcopter']}",
    }.items():
        assert there in text
        text = text.replace(there, here)
    file.write_text(text)
    settings = (folder / BROKER / CONFIGURATION).read_text()
    (folder / "own.conf").write_text(
        settings.replace(f"listener {BROKER_PORT}", f"listener {ports[BROKER]} 127.0.0.1")
        + ("user root\n" if os.geteuid() == 0 else "")
    )
    broker = Broker(["mosquitto", "-c", folder / "own.conf"], ports[BROKER], folder / "mosquitto.log")
    broker.start()
    try:
        for name, actor in brokered.ACTORS.items():
            arguments = actor.arguments(space=0, host="127.0.0.1", place=str(ports[name]), speed=testbed.speed)
            processes.start(sys.executable, *arguments, env=testbed.environment)
        for bridge in TESTBEDS["brokered"].bridges:
            testbed.ua_fleet("bridge", bridge, *testbed.traffic(bridge), process=bridge)
        yield testbed
    finally:
        broker.end()


@pytest.mark.needs("mosquitto")
def test_flights_behind_a_broker_that_the_job_has_made(processes: Processes, tmp_path: Path) -> None:
    with two_halls(processes, tmp_path) as testbed:
        testbed.server()
        conductor = testbed.conductor()
        report = testbed.wait_for_result(conductor, 90)
        assert {row["task"]: (row["robot"], row["state"]) for row in report["tasks"]} == {
            "take_off": ("quadcopter", "done"),
            "forth": ("belt", "done"),
            "land": ("quadcopter", "done"),
            "back": ("belt", "done"),
        }
        conductor.wait_for("4 of 4 tasks were done in ", timeout_s=WAIT_S)
        said = (tmp_path / "mosquitto.log").read_text()
        assert "u'server'" in said
        assert "u'yard_side'" in said
        assert "hall_side" not in said, "it is not at the broker"
