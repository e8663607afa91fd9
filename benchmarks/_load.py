"""The processes of the benchmark `ros_load`: two graphs of one version of ROS, and what stands between them."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks._keys import write_keys
from benchmarks._ros import NODES, RUNNER, Node, ros1_environment, running_master, running_node
from benchmarks.harness import Failed
from benchmarks.ros_nodes.load_streams import KEY_VARIABLE
from tests import system
from ua_fleet.config.load import load

__all__ = ["NAMES", "STREAMS", "Line", "Load", "line"]

STREAMS = ("imu", "image", "scan", "cloud")
TYPES = {"imu": "Imu", "image": "Image", "scan": "LaserScan", "cloud": "PointCloud2"}
NAMES = {
    "imu": "Imu, 200 Hz",
    "image": "1 MB Image, 10 Hz",
    "scan": "LaserScan of 1,000, 20 Hz",
    "cloud": "2 MB PointCloud2, 5 Hz",
    "together": "all together",
}
LINK_S = 40.0
Place = tuple[str, str]
"""Multicast group and port."""
SETTLE_S, IDLE_S = 13.0, 10.0
"""Bridges look less often at a graph that has been quiet for 10 s."""
DRAIN_S = 0.7
"""After the last message of a measurement, so that it arrives before the next one begins."""
SKILL_IDS, STATUS_ID = {"ros2": 1010, "ros1": 1020}, 1030
BUSY = "while True: pass"


class Load(NamedTuple):
    """What was measured of one load."""

    cpu_ms: float
    """Milliseconds of CPU that both bridges took for a second of the streams, user and system."""
    near_ms: float
    """Of the bridge at the publisher alone."""
    arrived: float
    """The smallest part of any stream that arrived."""
    age_p99_s: float
    """The highest of any stream."""


def cpu_ns(pid: int) -> int:
    """What all threads of a process have run; `utime + stime` of /proc counts in steps of 10 ms."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            total += int((task / "schedstat").read_text().split()[0])
    return total


def _threads(pid: int) -> list[int]:
    return [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]


class Line:
    """Everything that runs while one version of ROS is measured."""

    def __init__(
        self,
        topics: dict[str, dict[str, str]],
        publisher: Node,
        subscriber: Node,
        bridges: dict[str, list[int]],
        requestor: Callable[[], contextlib.AbstractContextManager[Node]],
    ) -> None:
        self.requestor = requestor
        """Starts who asks for skills."""
        self._topics, self._publisher, self._subscriber, self._bridges = topics, publisher, subscriber, bridges
        self.idle_ms = (0.0, 0.0)
        """Milliseconds of CPU that each of our bridges takes in a second in which nothing was published yet."""

    @property
    def near(self) -> int:
        """The process of our bridge at the publisher."""
        return self._bridges["mirrored"][0]

    def begin(self, way: str, streams: Iterable[str], seconds: float) -> None:
        """Publish from now on; `end` waits for the end."""
        topics = " ".join(f"{stream}={self._topics[way][stream]}" for stream in streams)
        self._publisher.tell(f"{seconds} {topics}")

    def end(self) -> dict[str, int]:
        """How many were published."""
        sent: dict[str, int] = json.loads(self._publisher.expect("done").removeprefix("done "))
        return sent

    def measure(self, way: str, streams: tuple[str, ...], seconds: float) -> Load:
        """Publish these streams for so long."""
        self._subscriber.tell("")
        self._subscriber.read()
        pids = self._bridges[way]
        before = [cpu_ns(pid) for pid in pids]
        self.begin(way, streams, seconds)
        sent = self.end()
        time.sleep(DRAIN_S)
        used = [(cpu_ns(pid) - was) / 1e6 / seconds for pid, was in zip(pids, before, strict=True)]
        arrived, age = 1.0, 0.0
        if way != "mapped":
            arrived, age = self._arrivals(way, sent)
        return Load(sum(used), used[0], arrived, age)

    def _arrivals(self, way: str, sent: dict[str, int]) -> tuple[float, float]:
        self._subscriber.tell("")
        ages: dict[str, list[float]] = json.loads(self._subscriber.read())
        parts, oldest = [1.0], 0.0
        for stream, count in sent.items():
            heard = sorted(ages.get(self._topics[way][stream], []))
            parts.append(len(heard) / count)
            if heard:
                oldest = max(oldest, heard[len(heard) * 99 // 100])
        return min(parts), oldest

    def skills(self, client: Node, count: int, pause_s: float, *, is_busy: bool = False) -> list[tuple[float, float]]:
        """Ask for a skill so often; milliseconds until each was accepted, and until its end was told.

        With `is_busy` a loop of nothing competes with the near bridge for one core, at the same nice value.
        """
        cores = os.sched_getaffinity(self.near)
        busy: subprocess.Popen[bytes] | None = None
        if is_busy:
            busy = subprocess.Popen([sys.executable, "-c", BUSY])
            for pid in (*_threads(self.near), busy.pid):
                os.sched_setaffinity(pid, {min(cores)})
        try:
            client.tell(f"{count} {pause_s}")
            times: list[tuple[float, float]] = json.loads(client.read())
            return times
        finally:
            if busy is not None:
                busy.kill()
                busy.wait()
                for pid in _threads(self.near):
                    os.sched_setaffinity(pid, cores)

    def _idle(self, seconds: float) -> tuple[float, float]:
        pids = self._bridges["mirrored"]
        before = [cpu_ns(pid) for pid in pids]
        time.sleep(seconds)
        near, far = [(cpu_ns(pid) - was) / 1e6 / seconds for pid, was in zip(pids, before, strict=True)]
        return near, far

    def wait_until_linked(self) -> None:
        """The first messages are lost while publishers and subscribers match. Before the first one it is idle."""
        time.sleep(SETTLE_S)
        self.idle_ms = self._idle(IDLE_S)
        for way in ("floor", "mirrored"):
            deadline = time.monotonic() + LINK_S
            while (found := self.measure(way, STREAMS, 0.5)).arrived < 0.9:
                if time.monotonic() > deadline:
                    raise Failed(f"{way}: {found.arrived:.0%} of a stream arrives")
        self.measure("mapped", STREAMS, 1.0)


@contextlib.contextmanager
def line(ros: str, *, security: str = "none") -> Generator[Line]:
    """Start the graphs, the robots and both pairs of bridges of `ros1` or `ros2`; end them afterwards.

    With `security`, which the bridges of ROS 2 alone take here, the floor encrypts and signs too.
    """
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))

        def start(*args: str | Path, env: dict[str, str]) -> Node:
            return stack.enter_context(running_node(*args, env=env | {"PYTHONPATH": str(system.ROOT)}))

        group, port = system.free_multicast_url().removeprefix("opc.udp://").split(":")
        url = system.free_multicast_url()
        make = _ros1 if ros == "ros1" else _ros2
        pubsub: dict[str, Any] = {"security": security, "url": url}
        if security != "none":
            pubsub["keys"] = {"source": "files"}
        yield make(stack, folder, start, (group, port), pubsub)


def _ros2(stack: contextlib.ExitStack, folder: Path, start: Any, floor: Place, pubsub: dict[str, Any]) -> Line:
    near, far = stack.enter_context(system.ros_domain()), stack.enter_context(system.ros_domain())
    profiles = system.ROOT / "bridges" / "ua_bridges" / "ros2" / "profiles"

    def env(domain: int, profile: str) -> dict[str, str]:
        return os.environ | {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles / f"{profile}.xml"),
        }

    topics = _topics(near)
    bridges = {"near": {"kind": "ros2", "space": near, "requestors": [0]}, "far": {"kind": "ros2", "space": far}}
    fleet = _written(folder / "fleet.json", pubsub, bridges, SKILL_IDS["ros2"])
    keyed: dict[str, str] = {}
    if pubsub["security"] != "none":
        write_keys(folder, load(fleet, {}, allow_missing_ids=True))
        keyed[KEY_VARIABLE] = secrets.token_hex(64)
    python = sys.executable
    publisher = start(python, NODES / "load_publisher_ros2.py", *_pairs(topics), env=env(near, "robot"))
    subscriber = start(
        python, NODES / "load_subscriber_ros2.py", *_pairs(topics, "floor", "mirrored"), env=env(far, "robot")
    )
    script = NODES / "load_floor_ros2.py"
    ends = (("out", near), ("in", far))
    floors = [
        start(python, script, way, *floor, *_pairs(topics, "floor"), env=env(one, "bridge") | keyed)
        for way, one in ends
    ]
    ours = [start(python, RUNNER, fleet, name, env=dict(os.environ)) for name in bridges]
    start(python, NODES / "starter_ros2.py", str(near), env=env(near, "robot"))
    requestor = partial(_requestor, fleet, near, SKILL_IDS["ros2"])
    running = Line(topics, publisher, subscriber, _pids(floors, ours), requestor)
    running.wait_until_linked()
    return running


def _ros1(stack: contextlib.ExitStack, folder: Path, start: Any, floor: Place, pubsub: dict[str, Any]) -> Line:
    (folder / "near").mkdir()
    (folder / "far").mkdir()
    near, far = ros1_environment(folder / "near"), ros1_environment(folder / "far")
    for env in (near, far):
        stack.enter_context(running_master(env))
    topics = _topics(1)
    fleets = {
        name: _written(folder / name / "fleet.json", pubsub, {name: _ros1_bridge(env)}, SKILL_IDS["ros1"])
        for name, env in (("near", near), ("far", far))
    }
    python = system.ROS1_PYTHON
    publisher = start(python, NODES / "load_publisher_ros1.py", *_pairs(topics), env=near)
    subscriber = start(python, NODES / "load_subscriber_ros1.py", *_pairs(topics, "floor", "mirrored"), env=far)
    script = NODES / "load_floor_ros1.py"
    ends = (("out", near), ("in", far))
    floors = [start(python, script, way, *floor, *_pairs(topics, "floor"), env=env) for way, env in ends]
    ours = [
        start(python, RUNNER, fleets["near"], "near", env=near),
        start(python, NODES / "load_bridge.py", fleets["far"], "far", "2", env=far),
    ]
    start(python, NODES / "starter_ros1.py", env=near)
    requestor = partial(_requestor, fleets["near"], 1, SKILL_IDS["ros1"])
    running = Line(topics, publisher, subscriber, _pids(floors, ours), requestor)
    running.wait_until_linked()
    return running


def _requestor(fleet: Path, space: int, skill_id: int) -> contextlib.AbstractContextManager[Node]:
    """A process of its own, there only while it asks: it hears all streams, which the floor's processes do without."""
    module = [sys.executable, "-m", "benchmarks._load_client"]
    env = os.environ | {"PYTHONPATH": str(system.ROOT)}
    return running_node(*module, fleet, str(space), str(skill_id), str(STATUS_ID), env=env)


def _ros1_bridge(env: dict[str, str]) -> dict[str, Any]:
    return {"kind": "ros1", "space": 1, "master_uri": env["ROS_MASTER_URI"], "requestors": [0]}


def _pids(floors: list[Node], ours: list[Node]) -> dict[str, list[int]]:
    own = [node.pid for node in ours]
    return {"floor": [node.pid for node in floors], "mirrored": own, "mapped": own[:1]}


def _topics(space: int) -> dict[str, dict[str, str]]:
    return {
        "floor": {stream: f"/floor/{stream}" for stream in STREAMS},
        "mirrored": {stream: f"/ua_{space}_2_{number}" for number, stream in enumerate(STREAMS, 1)},
        "mapped": {stream: f"/robot/{stream}" for stream in STREAMS},
    }


def _pairs(topics: dict[str, dict[str, str]], *ways: str) -> list[str]:
    return [f"{stream}={topic}" for way in ways or topics for stream, topic in topics[way].items()]


def _written(path: Path, pubsub: dict[str, Any], bridges: dict[str, Any], skill_id: int) -> Path:
    """A fleet whose robot behind the first bridge has the streams as data of its own, too."""
    first = next(iter(bridges))
    double, vector = {"type": "Double"}, ("x", "y", "z")
    fields: dict[str, dict[str, Any]] = {
        "imu": {
            **{f"orientation.{axis}": double for axis in (*vector, "w")},
            **{f"{part}.{axis}": double for part in ("angular_velocity", "linear_acceleration") for axis in vector},
        },
        "scan": {"angle_min": double, "angle_increment": double, "ranges": {"type": "Float", "array": True}},
        "image": {"height": {"type": "UInt32"}, "width": {"type": "UInt32"}, "data": {"type": "ByteString"}},
        "cloud": {"width": {"type": "UInt32"}, "point_step": {"type": "UInt32"}, "data": {"type": "ByteString"}},
    }
    data = {
        stream: {
            "id": 100 + number,
            "fields": {name.replace(".", "_"): {**field, "path": name} for name, field in fields[stream].items()},
            "source": {"topic": f"/robot/{stream}", "type": f"sensor_msgs/{TYPES[stream]}"},
        }
        for number, stream in enumerate(STREAMS)
    }
    skills = {"go": {"id": skill_id, "arguments": {"to": double}, "timeout_s": 10, "limits": {"requests_at_once": 50}}}
    robot = {"bridge": first, "skill_status_id": STATUS_ID, "skills": skills, "data": data}
    fleet = {"version": 1, "pubsub": pubsub, "bridges": bridges, "robots": {"rover": robot}}
    path.write_text(json.dumps(fleet))
    return path
