"""From a key that is pressed in a browser to the callback of the robot that is driven, beside a bare WebSocket.

The whole product as it is run, by its command line: console, server and a bridge into ROS 2, PubSub signed and
encrypted, OPC UA too. The browser's part is a process that speaks the console's WebSocket. It holds a key, which is a
setpoint each 40 ms, and now and then presses another one, which is a setpoint at once; the press arrives with the first
speed at the robot that is another one. The floor is a WebSocket whose numbers an rclpy publisher sends on to the same
robot: no login, no lease, no limit of acceleration, no period.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

from benchmarks._keys import write_keys
from benchmarks._ros import NODES, Node, median_and_p99, running_node
from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, Unavailable, at_most, shown
from tests import system
from ua_fleet.config.load import load
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore

USER, PASSWORD = "operator", "benchmark-1"
PRESSES = 50
"""Of each way in a round."""
PERIOD_MS = 20
"""How often the bridge writes to the robot, by default."""
REFERENCE = "bare WebSocket to rclpy"
MOST_P50_US, MOST_P99_US = 40_000.0, 100_000.0
NOT_MET_S = 1.0

Noted = Sequence[tuple[float, float]]


def arrivals(presses: Noted, speeds: Noted) -> list[float]:
    """Seconds from each press to the first speed that is another one than the robot had; both in order of time."""
    found: list[float] = []
    left = iter(speeds)
    at, speed = next(left, (0.0, 0.0))
    for pressed, wished in presses:
        had = speed
        while at <= pressed:
            had = speed
            at, speed = next(left, (float("inf"), had))
        while speed == had and at < pressed + NOT_MET_S:
            at, speed = next(left, (float("inf"), had))
        if at >= pressed + NOT_MET_S or (speed > had) != (wished > had):
            raise Failed(f"a press for a speed of {wished:g} did not come to the robot, which has {speed:g}")
        found.append(at - pressed)
    return found


class Line:
    """Everything that runs while the group is measured."""

    def __init__(self, browser: Node, robot: Node) -> None:
        self._browser, self._robot = browser, robot

    def ages(self, way: str, topic: str) -> list[float]:
        """Microseconds from each press to the robot."""
        self._robot.tell(topic)
        self._robot.read()
        self._browser.tell(f"{way} {PRESSES}")
        presses: list[tuple[float, float]] = json.loads(self._browser.read())
        self._robot.tell(topic)
        return [age * 1e6 for age in arrivals(presses, json.loads(self._robot.read()))]


def fleet_of(domain: int, port: int) -> dict[str, Any]:
    axis = {"speed": 0.5, "acceleration": 2.0, "jerk": 40.0}
    fields = {"linear": {"type": "Double", "path": "linear.x"}, "angular": {"type": "Double", "path": "angular.z"}}
    sink = {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
    teleoperation = {
        "id": 1003,
        "acquire_id": 1004,
        "renew_id": 1005,
        "release_id": 1006,
        "data": "cmd_vel",
        "axes": {"linear": axis, "angular": axis},
        "deadman_ms": 1000,
        "robot_timeout_ms": 1000,
        "period_ms": PERIOD_MS,
    }
    return {
        "version": 1,
        "server": {"port": port, "trust_all_clients": True},
        "pubsub": {
            "security": "sign_and_encrypt",
            "url": system.free_multicast_url(),
            "interface": "lo",
            "keys": {"source": "files"},
        },
        "bridges": {"floor": {"kind": "ros2", "space": domain, "status_id": 1001}},
        "robots": {
            "carrier": {
                "bridge": "floor",
                "data": {"cmd_vel": {"id": 1002, "origin": "server", "fields": fields, "sink": sink}},
                "teleoperation": teleoperation,
            }
        },
    }


def write_fleet(path: Path, domain: int, port: int) -> FleetConfig:
    """Write the file of the fleet; what it says."""
    path.write_text(json.dumps(fleet_of(domain, port)))
    return load(path, {})


@contextlib.contextmanager
def line() -> Generator[Line]:
    """Start robot, floor, bridge, server, console and browser; end them afterwards."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=system.ROOT)))
        domain = stack.enter_context(system.ros_domain())
        ports = {name: system.free_tcp_port() for name in ("server", "console", "floor")}
        profiles = system.ROOT / "bridges" / "ua_bridges" / "ros2" / "profiles"
        env = os.environ | {"PYTHONPATH": ".:bridges"}
        ros2 = env | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        robot_env = ros2 | {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles / "robot.xml")}
        floor_env = ros2 | {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles / "bridge.xml")}
        fleet = folder / "fleet.yaml"
        config = write_fleet(fleet, domain, ports["server"])
        write_keys(folder, config)
        users = UserStore(folder / config.server.state_dir / USERS_FILE)
        users.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        users.add(USER, PASSWORD, Role.OPERATOR)

        def start(*args: str | Path, env: dict[str, str] = env) -> Node:
            return stack.enter_context(running_node(sys.executable, *args, env=env))

        robot = start(NODES / "driven_ros2.py", "/cmd_vel", "/bare", env=robot_env)
        start(NODES / "driving_floor_ros2.py", "/bare", str(ports["floor"]), env=floor_env)
        start("-m", "ua_fleet.cli", "bridge", "floor", "-c", fleet)
        url = start("-m", "ua_fleet.cli", "serve", "-c", fleet).ready.removeprefix("ready: ")
        console = {
            "listen": f"127.0.0.1:{ports['console']}",
            "fleets": {"floor": {"endpoint": url}},
            "state_dir": str(folder / "console"),
        }
        settings = folder / "console.json"
        settings.write_text(json.dumps(console))
        start("-m", "ua_fleet.cli", "console", "--config", settings)
        browser = start(
            "-m",
            "benchmarks.ros_nodes.pressing_client",
            json.dumps(
                {
                    "console": f"http://127.0.0.1:{ports['console']}",
                    "floor": ports["floor"],
                    "user": USER,
                    "password": PASSWORD,
                }
            ),
        )
        yield Line(browser, robot)


def figures(rounds: int) -> list[Figure]:
    if reason := system.missing("ros2"):
        raise Unavailable(reason)
    floor: list[float] = []
    ours: list[float] = []
    with line() as running:
        for _ in range(max(rounds, FEWEST_ROUNDS)):
            floor += running.ages("floor", "/bare")
            ours += running.ages("ours", "/cmd_vel")
    (floor_p50, floor_p99), (p50, p99) = median_and_p99(floor), median_and_p99(ours)
    what = "key press to the robot's callback"
    return [
        shown(f"{what}, p50", p50, "us", reference=REFERENCE, reference_value=floor_p50),
        shown(f"{what}, p99", p99, "us", reference=REFERENCE, reference_value=floor_p99),
        at_most(f"{what}, p50, at most", p50, "us", reference="the limit", reference_value=MOST_P50_US, goal=1.0),
        at_most(f"{what}, p99, at most", p99, "us", reference="the limit", reference_value=MOST_P99_US, goal=1.0),
    ]
