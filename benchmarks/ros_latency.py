"""ROS 1 publisher to ROS 2 subscriber, through both bridges over UDP, beside the least that two bridges can do.

Four processes each way: a rospy node, a bridge out of ROS 1, a bridge into ROS 2, an rclpy node in an EventsExecutor.
The robots are the same for both ways; each message holds the monotonic clock of its publication. The floor's bridges
know one type and one number, and pack it by themselves: rospy callback, `call_soon_threadsafe`, eight bytes to a
multicast group, `add_reader`, `publish`, with the same quality of service and Fast DDS profile as ours.
"""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Mapping
from pathlib import Path

from benchmarks.harness import FEWEST_ROUNDS, Figure, Unavailable, at_most
from tests import system

HERE = Path(__file__).parent / "ros_nodes"
OURS, FLOOR = "ua_1_2_7", "floor"
RATE_HZ = 500.0
WARM_UP = 750
"""Messages, 1.5 s: matching, caches and the branch predictor are not what is measured."""
MEASURED = 1500
FAST_HZ, FAST_COUNT = 2000.0, 20_000
GOAL_P50, GOAL_P99, FAILS_P99 = 2.0, 4.0, 8.0


class Node:
    """A process that is told what to do by lines."""

    def __init__(self, *args: str | Path, env: Mapping[str, str]) -> None:
        self._process = subprocess.Popen(
            [str(arg) for arg in args],
            env=dict(env),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        self._name = str(args[1])
        self.expect("ready")

    def read(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise Unavailable(f"{self._name} ended with code {self._process.wait()}")
        return line.strip()

    def expect(self, text: str) -> str:
        while not (line := self.read()).startswith(text):
            pass
        return line

    def tell(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def end(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.terminate()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


class Line:
    """Everything that runs while the group is measured."""

    def __init__(self, publisher: Node, subscriber: Node) -> None:
        self._publisher, self._subscriber = publisher, subscriber

    def ages(self, topic: str, rate_hz: float, count: int) -> list[float]:
        """Publish so many messages; the ages (microseconds) at which they were heard."""
        self._publisher.tell(f"{topic} {rate_hz} {count}")
        self._publisher.expect("done")
        time.sleep(0.3)  # for the last ones
        self._subscriber.tell(topic)
        ages: list[float] = json.loads(self._subscriber.read())
        return ages

    def wait_until_linked(self) -> None:
        """The first messages are lost while publishers and subscribers match; wait until none is any more."""
        for topic in (OURS, FLOOR):
            deadline = time.monotonic() + 20
            while len(self.ages(topic, 100.0, 20)) < 20:
                if time.monotonic() > deadline:
                    raise Unavailable(f"nothing arrives on {topic}")

    def measure(self, topic: str) -> tuple[float, float]:
        """Median and 99th percentile at 500 Hz."""
        self.ages(topic, RATE_HZ, WARM_UP)
        ages = sorted(self.ages(topic, RATE_HZ, MEASURED))
        return ages[len(ages) // 2], ages[len(ages) * 99 // 100]


@contextlib.contextmanager
def line() -> Generator[Line]:
    """Start the master, the robots and both pairs of bridges; end them afterwards."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        domain = stack.enter_context(system.ros_domain())
        ros1 = system.clean_environment(
            ROS_IP="127.0.0.1", ROS_LOG_DIR=str(folder), ROS_MASTER_URI=f"http://127.0.0.1:{system.free_tcp_port()}"
        )
        # The profile for robots that ours recommends; the floor's bridge loads the one that ours loads by itself.
        profiles = system.ROOT / "bridges" / "ua_bridges" / "ros2" / "profiles"
        domain_env = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        robot_env = domain_env | {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles / "robot.xml")}
        floor_env = domain_env | {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles / "bridge.xml")}
        fleet = folder / "fleet.json"
        fleet.write_text(json.dumps(_fleet(ros1["ROS_MASTER_URI"], domain)))
        port = ros1["ROS_MASTER_URI"].rpartition(":")[2]
        master = subprocess.Popen(
            ["/usr/bin/rosmaster", "--core", "-p", port, "-w", "3"],
            env=ros1,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        stack.callback(master.wait)
        stack.callback(master.terminate)

        def start(*args: str | Path, env: Mapping[str, str]) -> Node:
            node = Node(*args, env=env)
            stack.callback(node.end)
            return node

        time.sleep(0.5)
        group, floor_port = system.free_multicast_url().removeprefix("opc.udp://").split(":")
        publisher = start(system.ROS1_PYTHON, HERE / "publisher_ros1.py", OURS, FLOOR, env=ros1)
        subscriber = start(sys.executable, HERE / "subscriber_ros2.py", OURS, FLOOR, env=robot_env)
        start(system.ROS1_PYTHON, HERE / "floor_ros1.py", FLOOR, group, floor_port, env=ros1)
        start(sys.executable, HERE / "floor_ros2.py", FLOOR, group, floor_port, env=floor_env)
        runner = system.ROOT / "tests" / "integration" / "run_bridge.py"
        start(system.ROS1_PYTHON, runner, fleet, "ros1", env=ros1)
        start(sys.executable, runner, fleet, "ros2", env=dict(os.environ))
        running = Line(publisher, subscriber)
        running.wait_until_linked()
        yield running


def _fleet(master_uri: str, domain: int) -> dict[str, object]:
    return {
        "version": 1,
        "pubsub": {"security": "none", "url": system.free_multicast_url()},
        "bridges": {
            "ros1": {"kind": "ros1", "space": 1, "master_uri": master_uri},
            "ros2": {"kind": "ros2", "space": domain},
        },
    }


def figures(rounds: int) -> list[Figure]:
    for part in ("ros1", "ros2"):
        if reason := system.missing(part):
            raise Unavailable(reason)
    with line() as running:
        measured = [(running.measure(FLOOR), running.measure(OURS)) for _ in range(max(rounds, FEWEST_ROUNDS))]
        received = len(running.ages(OURS, FAST_HZ, FAST_COUNT))
        floor_received = len(running.ages(FLOOR, FAST_HZ, FAST_COUNT))
    floor_p50, floor_p99, our_p50, our_p99 = (
        statistics.median(column) for column in zip(*((*floor, *ours) for floor, ours in measured), strict=True)
    )
    reference = "two bridges of a few lines"
    lost, floor_lost = FAST_COUNT - received, FAST_COUNT - floor_received
    return [
        at_most(
            "ROS 1 to ROS 2 at 500 Hz, p50",
            our_p50,
            "us",
            reference=reference,
            reference_value=floor_p50,
            goal=GOAL_P50,
        ),
        at_most(
            "ROS 1 to ROS 2 at 500 Hz, p99",
            our_p99,
            "us",
            reference=reference,
            reference_value=floor_p99,
            goal=GOAL_P99,
            fails_beyond=FAILS_P99,
        ),
        Figure(
            "ROS 1 to ROS 2 at 2000 Hz for 10 s, lost",
            lost,
            "messages",
            reference,
            floor_lost,
            float(lost),
            0.0,
            lost == 0,
        ),
    ]
