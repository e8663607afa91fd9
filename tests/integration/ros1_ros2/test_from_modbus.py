"""The registers of a PLC as messages for stock rospy and rclpy nodes, each process by itself."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.contract.modbus import PlcProcess
from tests.integration.ros1.ros1_graph import Ros1Graph
from tests.integration.ros2.conftest import Ros2Space, heard
from tests.system import ROS1_PYTHON, Processes, clean_environment, free_tcp_port
from tests.waiting import until

pytestmark = pytest.mark.needs("ros1", "ros2")

RUN_BRIDGE = Path(__file__).parent.parent / "run_bridge.py"
NAMED, UNNAMED = "ua_300_2_1911", "ua_300_2_1912"


def fleet(domain: int, udp_url: str, master: str, plc: int) -> dict[str, Any]:
    fields = {"voltage": {"type": "Float"}, "power_supply_status": {"type": "UInt16"}}
    registers = {
        "voltage": {"table": "holding", "address": 0, "type": "uint16", "scale": 0.25},
        "power_supply_status": {"table": "holding", "address": 1, "type": "uint16"},
    }
    source = {"fields": fields, "source": {"registers": registers}}
    return {
        "version": 1,
        "pubsub": {"security": "none", "url": udp_url, "interface": "lo"},
        "bridges": {
            "hall": {
                "kind": "modbus",
                "space": 300,
                "status_id": 1,
                "poll_s": 0.1,
                "devices": {"plc": {"host": "127.0.0.1", "port": plc}},
            },
            "cell": {"kind": "ros1", "space": 1, "master_uri": master, "status_id": 2},
            "floor": {"kind": "ros2", "space": domain, "status_id": 3},
        },
        "robots": {
            "truck": {
                "bridge": "hall",
                "data": {
                    "battery": {"id": 1911, "ros_type": "sensor_msgs/BatteryState", **source},
                    "supply": {"id": 1912, **source},
                },
            }
        },
    }


async def test_several_registers_arrive_in_both_as_the_type_that_is_named_and_as_json(
    processes: Processes, tmp_path: Path, udp_url: str, ros_domain: int
) -> None:
    folders = {name: tmp_path / name for name in ("ros1", "ros2")}
    for folder in folders.values():
        folder.mkdir()
    ros1 = Ros1Graph(processes, folders["ros1"], udp_url)
    ros2 = Ros2Space(ros_domain, udp_url, folders["ros2"], processes)
    port = free_tcp_port()
    plc = PlcProcess("--port", str(port))
    try:
        plc.do("put", table="holding", address=0, type="uint16", values=[50, 3])
        ros1.master()
        path = tmp_path / "fleet.json"
        path.write_text(json.dumps(fleet(ros_domain, udp_url, ros1.uri, port)))
        here = clean_environment(PYTHONUNBUFFERED="1", PYTHONPATH="bridges:.", UA_FLEET_RUNTIME_DIR=str(tmp_path))
        for name, python, env in (
            ("cell", ROS1_PYTHON, ros1.env),
            ("floor", sys.executable, here),
            ("hall", sys.executable, here),
        ):
            processes.start(python, RUN_BRIDGE, path, name, env=env).wait_for("ready")
        named = [
            ros1.listener(f"/{NAMED}", "sensor_msgs/BatteryState", "--name", "named"),
            ros2.listener(NAMED, "sensor_msgs/BatteryState", "--transient-local"),
        ]
        unnamed = [
            ros1.listener(f"/{UNNAMED}", "std_msgs/String", "--name", "unnamed"),
            ros2.listener(UNNAMED, "std_msgs/String", "--transient-local"),
        ]
        await asyncio.sleep(1)
        started = time.time()
        plc.do("put", table="holding", address=0, type="uint16", values=[51, 4])
        for listener in (*named, *unnamed):
            await until(lambda: any("12.75" in text for text in heard(listener)), "the registers' values")  # noqa: B023 - waited for within the turn
        for listener in named:
            last = next(text for text in heard(listener) if "12.75" in text)
            assert "power_supply_status=4" in last or "power_supply_status: 4" in last
            sec = int(last.replace("=", ": ").split("sec")[1].lstrip("s: ").split(",")[0].split()[0])
            assert abs(sec - started) < 30
        for listener in unnamed:
            last = next(text for text in heard(listener) if "12.75" in text).replace("\\", "")
            content = last[last.index("{") : last.rindex("}") + 1]
            assert json.loads(content) == {"voltage": 12.75, "power_supply_status": 4}
    finally:
        plc.end()
