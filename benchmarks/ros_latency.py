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
import sys
import tempfile
import time
from collections.abc import Generator
from pathlib import Path

from benchmarks._ros import NODES, RUNNER, Node, median_and_p99, ros1_environment, running_master, running_node
from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, Unavailable, at_most
from tests import system

OURS, FLOOR = "ua_1_2_7", "floor"
REFERENCE = "two bridges of a few lines"
RATE_HZ = 500.0
WARM_UP = 750
"""Messages, 1.5 s: matching, caches and the branch predictor are not what is measured."""
MEASURED = 1500
FAST_HZ, FAST_COUNT = 2000.0, 20_000
GOAL_P50, GOAL_P99, FAILS_P99 = 2.0, 4.0, 8.0


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
        return self._subscriber.ages()

    def wait_until_linked(self) -> None:
        """The first messages are lost while publishers and subscribers match; wait until none is any more."""
        for topic in (OURS, FLOOR):
            deadline = time.monotonic() + 20
            while len(self.ages(topic, 100.0, 20)) < 20:
                if time.monotonic() > deadline:
                    raise Failed(f"nothing arrives on {topic}")

    def measure(self, topic: str) -> tuple[float, float]:
        """Median and 99th percentile at 500 Hz."""
        self.ages(topic, RATE_HZ, WARM_UP)
        return median_and_p99(self.ages(topic, RATE_HZ, MEASURED))


@contextlib.contextmanager
def line() -> Generator[Line]:
    """Start the master, the robots and both pairs of bridges; end them afterwards."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        domain = stack.enter_context(system.ros_domain())
        ros1 = ros1_environment(folder)
        stack.enter_context(running_master(ros1))
        # The profile for robots that ours recommends; the floor's bridge loads the one that ours loads by itself.
        profiles = system.ROOT / "bridges" / "ua_bridges" / "ros2" / "profiles"
        domain_env = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        robot_env = domain_env | {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles / "robot.xml")}
        floor_env = domain_env | {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles / "bridge.xml")}
        fleet = folder / "fleet.json"
        fleet.write_text(json.dumps(_fleet(ros1["ROS_MASTER_URI"], domain)))

        def start(*args: str | Path, env: dict[str, str]) -> Node:
            return stack.enter_context(running_node(*args, env=env))

        group, floor_port = system.free_multicast_url().removeprefix("opc.udp://").split(":")
        publisher = start(system.ROS1_PYTHON, NODES / "publisher_ros1.py", OURS, FLOOR, env=ros1)
        subscriber = start(sys.executable, NODES / "subscriber_ros2.py", OURS, FLOOR, env=robot_env)
        start(system.ROS1_PYTHON, NODES / "floor_ros1.py", FLOOR, group, floor_port, env=ros1)
        start(sys.executable, NODES / "floor_ros2.py", FLOOR, group, floor_port, env=floor_env)
        start(system.ROS1_PYTHON, RUNNER, fleet, "ros1", env=ros1)
        start(sys.executable, RUNNER, fleet, "ros2", env=dict(os.environ))
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
    lost, floor_lost = FAST_COUNT - received, FAST_COUNT - floor_received
    return [
        at_most(
            "ROS 1 to ROS 2 at 500 Hz, p50",
            our_p50,
            "us",
            reference=REFERENCE,
            reference_value=floor_p50,
            goal=GOAL_P50,
        ),
        at_most(
            "ROS 1 to ROS 2 at 500 Hz, p99",
            our_p99,
            "us",
            reference=REFERENCE,
            reference_value=floor_p99,
            goal=GOAL_P99,
            fails_beyond=FAILS_P99,
        ),
        Figure(
            "ROS 1 to ROS 2 at 2000 Hz for 10 s, lost",
            lost,
            "messages",
            REFERENCE,
            floor_lost,
            float(lost),
            0.0,
            lost == 0,
        ),
    ]
