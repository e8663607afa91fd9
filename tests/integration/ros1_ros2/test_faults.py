"""Robots in rospy and rclpy that announce their own faults, as alarms of a server behind both bridges."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from tests import system
from tests.integration.ros1.ros1_graph import STATUS, Ros1Graph
from tests.integration.ros2.conftest import STATUS_ID, Ros2Space
from tests.integration.scenarios.conftest import Called, call, watching
from tests.integration.server_model.harness import reader, serving, ua, until
from ua_fleet.config.schema import FleetConfig
from ua_fleet.fleet.model import RobotState
from ua_fleet.nodes.nodeset import TypeId
from ua_fleet.topics import Topic

pytestmark = pytest.mark.needs("ros1", "ros2")

ARM, CARRIER = 1301, 1302
PROGRAM = Path(__file__).parent / "faulty.py"


class Cells:
    """A rospy robot and an rclpy robot, each behind a bridge; the configuration of their server."""

    def __init__(self, processes: system.Processes, folder: Path, udp_url: str, domain: int, port: int) -> None:
        for name in ("ros1", "ros2"):
            (folder / name).mkdir()
        self._processes = processes
        self.ros1 = Ros1Graph(processes, folder / "ros1", udp_url)
        self.ros2 = Ros2Space(domain, udp_url, folder / "ros2", processes)
        self.ros1.master()
        self.ros1.bridge()
        self.ros2.bridge()
        self.config = FleetConfig.model_validate(
            {
                "version": 1,
                "server": {"port": port, "trust_all_clients": True},
                "pubsub": {"security": "none", "url": udp_url, "receive_timeout_s": 3},
                "bridges": {
                    "ros1": {"kind": "ros1", "space": 1, "status_id": STATUS.id},
                    "mobile": {"kind": "ros2", "space": domain, "status_id": STATUS_ID},
                },
                "robots": {
                    "arm": {"bridge": "ros1", "fault_id": ARM},
                    "carrier": {"bridge": "mobile", "fault_id": CARRIER, "capacities": ["mobile", "grab"]},
                },
            }
        )

    def robot(self, name: str) -> system.Child:
        """Start a robot's program."""
        if name == "arm":
            python, environment = str(system.ROS1_PYTHON), self.ros1.env
            command: tuple[str, ...] = ("ros1", "1", str(ARM))
        else:
            python, environment = sys.executable, self.ros2.environment()
            command = ("ros2", str(self.ros2.domain), str(CARRIER), "mobile")
        child = self._processes.start(python, PROGRAM, *command, env=environment)
        child.wait_for("ready")
        return child


@pytest.fixture
def cells(processes: system.Processes, tmp_path: Path, udp_url: str, ros_domain: int, tcp_port: int) -> Cells:
    return Cells(processes, tmp_path, udp_url, ros_domain, tcp_port)


async def test_what_robots_announce_are_alarms_until_they_are_repaired(cells: Cells, tmp_path: Path) -> None:
    robots = {"arm": cells.robot("arm"), "carrier": cells.robot("carrier")}
    ids = {"arm": Topic(1, 2, ARM), "carrier": Topic(cells.ros2.domain, 2, CARRIER)}
    robots["arm"].process.send_signal(signal.SIGUSR1)  # before anybody listens: it is latched
    async with (
        serving(tmp_path, cells.config) as server,
        server.client() as client,
        watching(client, TypeId.FAULT_ALARM) as seen,
    ):
        # The server may have heard of it before this client came: an alarm view asks for what is active.
        told = ua.Variant("motor overheated", ua.VariantType.String)
        await until(reader(client, f"ns=2;i={ARM}"), lambda read: read.Value == told, timeout_s=60)
        number = ua.Variant(seen.subscription_id, ua.VariantType.UInt32)
        await client.get_node("i=2782").call_method(ua.NodeId(3875, 0), number)
        event = await seen.wait_for("arm: motor overheated")
        assert (event.ConditionName, event.Severity, event.Retain) == ("arm.announced", 800, True)

        robots["carrier"].process.send_signal(signal.SIGUSR1)
        partial = await seen.wait_for("carrier lacks mobile: motor overheated")
        assert (partial.Reason, list(partial.Capacities)) == ("motor overheated", ["mobile"])
        state = await client.get_node("ns=2;s=Robots.carrier.State").read_value()
        assert state != RobotState.FAULTED, "it can still grab"
        state_of_arm = reader(client, "ns=2;s=Robots.arm.State")  # offline until its bridge is heard
        await until(state_of_arm, lambda read: read.Value is not None and read.Value.Value == RobotState.FAULTED)
        robots["carrier"].process.send_signal(signal.SIGUSR2)
        over = await seen.wait_for("carrier: over: motor overheated")
        assert over.ConditionName == "carrier.announced"
        said = [message.values for message in server.peer.messages(ids["carrier"])]
        assert said.count(("",)) >= 1
        timestamps = {message.timestamp for message in server.peer.messages(ids["carrier"])}
        assert len(timestamps) == 2, "a message for the fault and one for its end; the others are repeats"

        async def clear() -> Called:
            return await call(client, "Faults", "ClearFault", "arm")

        refused = await clear()
        assert (refused.status, "announced (motor overheated)" in refused.message) == (3, True), refused.message
        robots["arm"].end(signal.SIGKILL)

        async def is_cleared() -> Any:
            return (await clear()).status == 0

        assert await until(is_cleared, lambda cleared: cleared, timeout_s=60)
        await seen.wait_for("arm: over: motor overheated")
