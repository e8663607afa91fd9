"""The same with real drivers: a ROS 2 robot whose program can be asked, and one that only listens to a topic."""

from __future__ import annotations

import asyncio
import json
import sys
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any, Final

import pytest

from tests.integration.kills.conftest import SECURED, SERVER, Crew, agree, ended, stop
from tests.integration.kills.ledger import facts_of, keep
from tests.integration.ros2.conftest import Ros2Space
from tests.integration.scenarios.conftest import Plant, run
from tests.integration.server_model.harness import until
from tests.system import Child, Processes, clean_environment
from ua_fleet.config.schema import FleetConfig
from ua_fleet.scenario.facts import TaskAnswered, TaskAssigned, TaskOutcome, TaskOver

pytestmark = pytest.mark.needs("ros2")

RUN_BRIDGE: Final = Path(__file__).parents[1] / "run_bridge.py"
CARRIER: Final = Path(__file__).parent / "nodes" / "carrier.py"
BRIDGE: Final = "mobile"
ROBOTS: Final[dict[str, Any]] = {
    "carrier": {
        "bridge": BRIDGE,
        "skill_status_id": 1000,
        "skills": {
            "drive": {
                "id": 1010,
                "arguments": {"to": {"type": "String"}, "seconds": {"type": "Double"}},
                "results": {"distance": {"type": "Double"}},
                "timeout_s": 30.0,
            }
        },
        "data": {"go_on": {"id": 1300, "type": "Int32", "origin": "server", "initial": 1}},
    },
    "mover": {
        "bridge": BRIDGE,
        "skill_status_id": 1001,
        "skills": {
            "move": {
                "id": 1011,
                "arguments": {"speed": {"type": "Double"}},
                "timeout_s": 30.0,
                "via": {
                    "topic": {
                        "topic": "/move",
                        "type": "geometry_msgs/Twist",
                        "fields": {"speed": "linear.x"},
                        "status": {
                            "topic": "/move_state",
                            "type": "std_msgs/String",
                            "running": "data == 'moving'",
                            "done": "data == 'arrived'",
                        },
                    }
                },
            }
        },
    },
}
STEPS: Final = """
  - parallel:
      - - repeat:
            - task: drive
              skill: drive
              robot: carrier
              arguments: {to: dock, seconds: 0.5}
              retries: 3
              on_unknown: retry
          while: go_on > 0
      - - repeat:
            - {task: move, skill: move, robot: mover, arguments: {speed: 1.5}, retries: 3, on_unknown: retry}
          while: go_on > 0
"""


class RosPlant(Plant):
    """A plant with a ROS 2 bridge in place of the three cells."""

    def __init__(self, folder: Path, url: str, port: int, processes: Processes, domain: int) -> None:
        super().__init__(folder, url, port, processes, "automatic", {"receive_timeout_s": 30.0, **SECURED})
        raw = json.loads((folder / "fleet.json").read_text())
        raw |= {"bridges": {BRIDGE: {"kind": "ros2", "space": domain, "status_id": 900}}, "robots": ROBOTS}
        (folder / "fleet.json").write_text(json.dumps(raw))
        self.config = FleetConfig.model_validate(raw)
        self._own_processes = processes

    def start_ros_bridge(self) -> Child:
        environment = clean_environment(
            PYTHONUNBUFFERED="1", PYTHONPATH="bridges:.", UA_FLEET_RUNTIME_DIR=str(self.folder)
        )
        command = (sys.executable, RUN_BRIDGE, self.folder / "fleet.json", BRIDGE)
        return self._own_processes.start(*command, env=environment)


@pytest.mark.timeout(300)
async def test_a_program_is_asked_and_a_topic_leaves_it_unknown(
    tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes, ros_domain: int
) -> None:
    plant = RosPlant(tmp_path, udp_url, tcp_port, processes, ros_domain)
    await plant.prepare()
    plant.scenario("rounds", STEPS)
    robot = Ros2Space(ros_domain, udp_url, tmp_path, processes).node(str(CARRIER), ros_domain)
    random = Random(11)
    crew = Crew({SERVER: (plant.start_server, "opc.tcp://"), BRIDGE: (plant.start_ros_bridge, "ready")}, random)
    await crew.begin(SERVER, BRIDGE)

    async def moves() -> Any:
        return sum(line.startswith("told: move") for line in robot.lines)

    async with plant.client() as client:
        for name in ROBOTS:
            await until(client.get_node(f"ns=2;s=Robots.{name}.State").read_value, lambda state: state != 0)
        run_id = await run(client, "rounds")
    for victim in (BRIDGE, SERVER, BRIDGE, SERVER):
        before = await moves()
        async with plant.client() as client, asyncio.timeout(60):
            while await moves() <= before:
                await agree(client, run_id)
                await asyncio.sleep(0.05)
        await asyncio.sleep(random.uniform(0.0, 0.3))
        await crew.kill_now(victim)
    async with plant.client() as client:
        await stop(client)
        assert await ended(client, run_id) == "done"
    crew.end()

    facts = facts_of(plant.folder / plant.config.server.state_dir)
    drives = [line.split()[2] for line in robot.lines if line.startswith("told: drive")]
    of_task = {fact.step: fact.task for fact in facts if isinstance(fact, TaskAssigned)}
    asked = [fact for fact in facts if of_task.get(getattr(fact, "step", "")) != "move"]
    ledger = keep(asked, [("carrier", execution_id) for execution_id in drives])
    ends = Counter(fact.outcome for fact in facts if isinstance(fact, TaskOver) and of_task[fact.step] == "move")
    told = await moves()
    print(f"{len(crew.kills)} kills, program: {ledger}; topic: {told} told, {dict(ends)}")
    assert (ledger.doubled, ledger.lost, ledger.invented) == ([], [], [])
    assert not set(ledger.unknown).intersection(drives), "what the program was told it can be asked for"
    assert 0 < ends[TaskOutcome.UNKNOWN] <= 2, "one for each kill of the bridge while it moved"
    assert ends[TaskOutcome.DONE] <= told <= ends[TaskOutcome.DONE] + ends[TaskOutcome.UNKNOWN]
    answers = Counter(of_task[fact.step] for fact in facts if isinstance(fact, TaskAnswered))
    assert answers["move"] == ends[TaskOutcome.UNKNOWN], "what nobody can tell is not asked of the robot again unasked"
    assert answers["drive"] == len(ledger.unknown), "an order that its kill may have kept from the program is asked for"
