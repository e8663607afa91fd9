"""From the call of a skill's Start by an OPC UA client to the start of the robot's own code, beside a service of ROS.

The whole product as it is run, by its command line: the server, a bridge into ROS 2 and one into ROS 1, PubSub signed
and encrypted, the journals on the disk; an encrypted session of the typed client. The robots are programs that note the
monotonic clock as the first thing that they do: in a function with the decorator, or in the callback of the topic that
`fleet.yaml` names. The floor is a service of the same robot, called from its own graph by a program of a few lines: no
fleet, no user, no record of what was asked for. The next call is made when the execution's end has been told.

And from the begin of a task of a run to the begin of the next one: the robot tells its end, the server decides, records
and asks.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks._keys import write_keys
from benchmarks._ros import NODES, Node, median_and_p99, ros1_environment, running_master, running_node
from benchmarks.harness import FEWEST_ROUNDS, OTHER, Failed, Figure, Unavailable, beside, shown
from tests import system
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore

USER, PASSWORD = "operator", "benchmark-1"
CALLS, PAUSE_S = 25, 0.02
"""Of each way in a round."""


class Way(NamedTuple):
    """One skill, and the graph of its robot."""

    name: str
    skill: str
    ros: str


WAYS = (
    Way("ROS 2, a function with the decorator", "rover.go", "ros2"),
    Way("ROS 2, a topic of fleet.yaml", "rover.push", "ros2"),
    Way("ROS 1, a function with the decorator", "arm.go", "ros1"),
)
REFERENCES = {"ros2": "bare service of ROS 2", "ros1": "bare service of ROS 1"}


TASKS = 20
"""Of a run, one after the other."""
RUN = "next task of a run in ROS 2"
SCENARIO = f"""\
version: 1
name: tasks
steps:
  - repeat: [{{task: go, skill: go, robot: rover, arguments: {{to: 0.5}}}}]
    times: {TASKS}
"""


class Line:
    """Everything that runs while the group is measured."""

    def __init__(self, client: Node, robots: dict[str, Node], callers: dict[str, Node]) -> None:
        self._client, self._robots, self._callers = client, robots, callers

    def ours(self, way: Way) -> list[float]:
        """Microseconds from each call of Start to the robot's code."""
        return self._ages(self._client, f"{way.skill} ", self._robots[way.ros])

    def floor(self, ros: str) -> list[float]:
        """The same of a bare service."""
        return self._ages(self._callers[ros], "", self._robots[ros])

    def tasks(self) -> list[float]:
        """Microseconds from the begin of each task of a run to the begin of the next; the robot needs none itself."""
        robot = self._robots["ros2"]
        robot.tell("taken")
        robot.read()
        self._client.tell("run tasks")
        state = json.loads(self._client.read())
        robot.tell("taken")
        began: list[float] = json.loads(robot.read())
        if (state, len(began)) != ("done", TASKS):
            raise Failed(f"a run of {TASKS} tasks is {state}, and the robot began {len(began)} times")
        return [(later - earlier) * 1e6 for earlier, later in itertools.pairwise(began)]

    def _ages(self, caller: Node, what: str, robot: Node) -> list[float]:
        robot.tell("taken")
        robot.read()
        caller.tell(f"{what}{CALLS} {PAUSE_S}")
        called: list[float] = json.loads(caller.read())
        robot.tell("taken")
        began: list[float] = json.loads(robot.read())
        if len(began) != CALLS:
            raise Failed(f"{what or 'a bare service'}: {CALLS} calls, and the robot began {len(began)} times")
        return [(start - call) * 1e6 for call, start in zip(called, began, strict=True)]


def fleet_of(master_uri: str, domain: int) -> dict[str, Any]:
    limits, arguments = {"requests_at_once": 50}, {"to": {"type": "Double", "range": [0, 1]}}
    skill: dict[str, Any] = {"arguments": arguments, "timeout_s": 10}
    push = {"topic": {"topic": "/push", "type": "std_msgs/Float64", "fields": {"to": "data"}}}
    return {
        "version": 1,
        "server": {"port": system.free_tcp_port(), "trust_all_clients": True},
        "pubsub": {
            "security": "sign_and_encrypt",
            "url": system.free_multicast_url(),
            "interface": "lo",
            "keys": {"source": "files"},
        },
        "bridges": {
            "floor": {"kind": "ros2", "space": domain, "status_id": 900},
            "cell": {"kind": "ros1", "space": 1, "status_id": 901, "master_uri": master_uri},
        },
        "robots": {
            "rover": {
                "bridge": "floor",
                "skill_status_id": 902,
                "skills": {"go": {"id": 1010, "limits": limits, **skill}, "push": {"id": 1011, "via": push, **skill}},
            },
            "arm": {
                "bridge": "cell",
                "skill_status_id": 903,
                "skills": {"go": {"id": 1020, "limits": limits, **skill}},
            },
        },
    }


@contextlib.contextmanager
def line(root: Path = system.ROOT) -> Generator[Line]:
    """Start the masters, robots, and bridges and server of a clone; end them afterwards."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=system.ROOT)))
        domain = stack.enter_context(system.ros_domain())
        ros1 = ros1_environment(folder)
        stack.enter_context(running_master(ros1))
        profiles = system.ROOT / "bridges" / "ua_bridges" / "ros2" / "profiles"
        env = os.environ | {"PYTHONPATH": ".:bridges"}
        ros2 = env | {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles / "robot.xml"),
        }
        raw = fleet_of(ros1["ROS_MASTER_URI"], domain)
        fleet = folder / "fleet.yaml"
        fleet.write_text(json.dumps(raw))
        provide(folder, raw)

        def start(*args: str | Path, env: dict[str, str] = env, cwd: Path = system.ROOT) -> Node:
            return stack.enter_context(running_node(*args, env=env, cwd=cwd))

        def product(venv: str, *args: str | Path, env: dict[str, str] = env) -> Node:
            return start(root / venv / "bin" / "python", "-m", "ua_fleet.cli", *args, "-c", fleet, env=env, cwd=root)

        robots = {
            "ros2": start(sys.executable, NODES / "starter_ros2.py", str(domain), env=ros2),
            "ros1": start(system.ROS1_PYTHON, NODES / "starter_ros1.py", env=ros1),
        }
        callers = {
            "ros2": start(sys.executable, NODES / "caller_ros2.py", env=ros2),
            "ros1": start(system.ROS1_PYTHON, NODES / "caller_ros1.py", env=ros1),
        }
        product(".venv", "bridge", "floor")
        product(".venv-ros1", "bridge", "cell", env=ros1)
        url = product(".venv", "serve").ready.removeprefix("ready: ")
        skills = [way.skill for way in WAYS]
        module = "benchmarks.ros_nodes.starting_client"
        client = start(sys.executable, "-m", module, url, folder / "identity", *skills)
        yield Line(client, robots, callers)


def provide(folder: Path, raw: dict[str, Any]) -> None:
    """The keys of the fleet, the user, and the scenario."""
    config = FleetConfig.model_validate({**raw, "bridges": _plain(raw["bridges"])})
    write_keys(folder, config)
    users = UserStore(folder / config.server.state_dir / USERS_FILE)
    users.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    scenarios = folder / config.scenarios.folder
    scenarios.mkdir()
    (scenarios / "tasks.yaml").write_text(SCENARIO)
    users.add(USER, PASSWORD, Role.OPERATOR, replace_existing=False)


def _plain(bridges: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What the core knows of bridges; each kind's own keys are for its process."""
    known = ("kind", "space", "status_id")
    return {name: {key: value for key, value in one.items() if key in known} for name, one in bridges.items()}


def figures(rounds: int) -> list[Figure]:
    for part in ("ros1", "ros2"):
        if reason := system.missing(part):
            raise Unavailable(reason)
    with contextlib.ExitStack() as stack:
        clones = [system.ROOT, *filter(None, [beside()])]
        lines = [stack.enter_context(line(root)) for root in clones]
        floor: dict[Way, list[float]] = {way: [] for way in WAYS}
        of_clones: list[dict[Way, list[float]]] = [{way: [] for way in WAYS} for _ in lines]
        tasks: list[list[float]] = [[] for _ in lines]
        for _ in range(max(rounds, FEWEST_ROUNDS)):
            for way in WAYS:
                floor[way] += lines[0].floor(way.ros)
                for running, of_clone in zip(lines, of_clones, strict=True):
                    of_clone[way] += running.ours(way)
            for running, of_run in zip(lines, tasks, strict=True):
                of_run += running.tasks()
    return [*_starts(floor, of_clones), *_runs(floor[WAYS[0]], tasks)]


def _runs(floor: list[float], tasks: list[list[float]]) -> list[Figure]:
    (p50, p99), (floor_p50, floor_p99) = median_and_p99(tasks[0]), median_and_p99(floor)
    reference = REFERENCES["ros2"]
    rows = [
        shown(f"{RUN}, p50", p50, "us", reference=reference, reference_value=floor_p50),
        shown(f"{RUN}, p99", p99, "us", reference=reference, reference_value=floor_p99),
    ]
    for other in tasks[1:]:
        before, _ = median_and_p99(other)
        rows.append(shown(f"{RUN}, p50, beside", p50, "us", reference=OTHER, reference_value=before))
    return rows


def _starts(floor: dict[Way, list[float]], of_clones: list[dict[Way, list[float]]]) -> list[Figure]:
    ours, *others = of_clones
    rows: list[Figure] = []
    for way in WAYS:
        floor_p50, floor_p99 = median_and_p99(floor[way])
        p50, p99 = median_and_p99(ours[way])
        reference = REFERENCES[way.ros]
        rows.append(shown(f"Start to {way.name}, p50", p50, "us", reference=reference, reference_value=floor_p50))
        rows.append(shown(f"Start to {way.name}, p99", p99, "us", reference=reference, reference_value=floor_p99))
        for other in others:
            before, _ = median_and_p99(other[way])
            rows.append(shown(f"Start to {way.name}, p50, beside", p50, "us", reference=OTHER, reference_value=before))
    return rows
