"""Robots that use what others have, each in a space of its own (TalkRoBots 3.2): nobody in between but the bridges."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Generator
from typing import Final

import pytest
from ua_demo.talkrobots.setting import ROBOTS

from tests.contract.modbus import PlcProcess
from tests.integration.modbus_server.conftest import WORDS, Panel
from tests.integration.robot_to_robot.conftest import PASSWORD, USER, Hall, done
from tests.integration.ros2.conftest import Ros2Space, heard
from tests.system import clean_environment, free_tcp_port
from tests.ur_controller import UrController
from tests.waiting import until
from ua_fleet.modbus.words import CommandState

REGISTER: Final = "input_double_register_18"
PICK: Final = """\
write_output_float_register(12, read_input_float_register(18))
if read_input_float_register(18) > {limit}:
  movej([0.35, -1.57, 0, -1.57, 0, 0], t=0.3)
else:
  movej([-0.35, -1.57, 0, -1.57, 0, 0], t=0.3)
end
"""
TAKE_OFF, LAND = 1, 2


@pytest.mark.needs("ros2", "ur")
async def test_an_arm_decides_by_the_thermometer_of_a_ros2_robot(hall: Hall, ros_domain: int) -> None:
    """UR3 asks the Pioneer's temperature sensor: left if it is warm, otherwise right."""
    controller = UrController(hall.processes)
    controller.start()
    controller.do("record", input=REGISTER)
    hall.write(
        {
            "pioneer_pc": {"kind": "ros2", "space": ros_domain, "status_id": 1},
            "ur3_cell": {
                "kind": "ur",
                "space": 300,
                "status_id": 2,
                "address": controller.host,
                "mirrors": {"pioneer.temperature": {"output": "input_double_register[18]"}},
            },
        },
        {
            "pioneer": {
                "bridge": "pioneer_pc",
                "data": {
                    "temperature": {
                        "id": 10,
                        "type": "Double",
                        "path": "temperature",
                        "source": {"topic": "/temperature", "type": "sensor_msgs/Temperature"},
                    }
                },
            },
            "ur3": {
                "bridge": "ur3_cell",
                "skill_status_id": 20,
                "skills": {
                    "pick": {
                        "id": 21,
                        "arguments": {"limit": {"type": "Double"}},
                        "results": {"temperature": {"type": "Double"}},
                        "timeout_s": 20,
                        "via": {"script": {"body": PICK, "results": {"temperature": {"place": 12}}}},
                    }
                },
            },
        },
    )
    hall.start("pioneer_pc", "ur3_cell", server=True)
    space = Ros2Space(ros_domain, "", hall.folder, hall.processes)
    async with hall.client() as client:
        for degrees, side in ((23.5, 0.35), (17.25, -0.35)):
            thermometer = space.talker("/temperature", "sensor_msgs/Temperature", {"temperature": degrees})
            await until(lambda: controller.do("recorded", input=REGISTER)["recorded"][-1:] == [degrees], "the value")  # noqa: B023 - waited for within the turn
            assert await done(client, "ur3", "pick", limit=20.0) == {"temperature": degrees}
            assert controller.state()["q"][0] == pytest.approx(side, abs=0.001)
            thermometer.end()


@pytest.mark.needs("mbpoll")
async def test_a_plc_has_a_drone_fly(hall: Hall) -> None:
    """The PLC speaks Modbus alone, and the drone reads one field after the other from a socket."""
    port, drone_port = free_tcp_port(), free_tcp_port()
    skill = {"needs": ["fly"], "timeout_s": 20}
    hall.write(
        {
            "drone_cell": {
                "kind": "tcp",
                "space": 300,
                "status_id": 1,
                "interpreter": {"connect": f"127.0.0.1:{drone_port}"},
            }
        },
        {
            "drone": {
                "bridge": "drone_cell",
                "capacities": ["fly"],
                "skill_status_id": 20,
                "skills": {"take_off": {"id": 21, **skill}, "land": {"id": 22, **skill}},
                "data": {"flying_state": {"id": 10, "type": "String"}},
            }
        },
        modbus={
            "port": port,
            "writers": ["127.0.0.1"],
            "robots": ["drone"],
            "values": {"drone.flying_state": {"table": "input", "address": 100, "length": 8}},
            "commands": {
                "take_off": {"code": TAKE_OFF, "robot": "drone", "skill": "take_off"},
                "land": {"code": LAND, "robot": "drone", "skill": "land"},
            },
        },
    )
    drone = hall.processes.start(
        *(sys.executable, ROBOTS / "drone.py", "--port", str(drone_port), "--speed", "20"), env=clean_environment()
    )
    drone.wait_for("is ready")
    hall.start("drone_cell", server=True)
    password = hall.folder / "plc.pw"
    password.touch(mode=0o600)
    password.write_text(PASSWORD)
    password.chmod(0o600)
    hall.cli("modbus", "serve", "-e", hall.endpoint, "-u", USER, "--password-file", password).wait_for("ready")
    plc = Panel(port)

    async def flying_state() -> str:
        words = await plc.read("input", 100, 8)
        return b"".join(word.to_bytes(2, "big") for word in words).rstrip(b"\0").decode()

    async def reaches(state: str) -> None:
        async with asyncio.timeout(60):
            while await flying_state() != state:
                await asyncio.sleep(0.05)

    await plc.until(lambda words: words[0] == 1, "connected")
    await reaches("landed")
    async with asyncio.timeout(60):  # refused until the server hears the drone
        while await plc.ended(await plc.command(TAKE_OFF)) is not CommandState.DONE:
            await asyncio.sleep(0.1)
    await reaches("hovering")
    number = await plc.command(LAND)
    assert await plc.ended(number) is CommandState.DONE
    assert await plc.read("input", WORDS["answer"]) == [number]
    await reaches("landed")


@pytest.fixture
def plc_port() -> int:
    """Of the simulated PLC."""
    return free_tcp_port()


@pytest.fixture
def plc(plc_port: int) -> Generator[PlcProcess]:
    """A PLC."""
    started = PlcProcess("--port", str(plc_port))
    yield started
    started.end()


def put(plc: PlcProcess, value: int) -> None:
    plc.do("put", table="holding", address=20, type="int32", values=[value])


@pytest.mark.needs("ros2")
async def test_a_ros2_robot_reads_a_plcs_register(hall: Hall, ros_domain: int, plc: PlcProcess, plc_port: int) -> None:
    """It subscribes to the topic of the register, in its own domain and with a type that it has."""
    put(plc, 1200)
    hall.write(
        {
            "press_plc": {
                "kind": "modbus",
                "space": 300,
                "status_id": 1,
                "poll_s": 0.1,
                "devices": {"plc": {"host": "127.0.0.1", "port": plc_port}},
            },
            "carrier_pc": {"kind": "ros2", "space": ros_domain, "status_id": 2},
        },
        {
            "press": {
                "bridge": "press_plc",
                "data": {
                    "position": {
                        "id": 10,
                        "type": "Int32",
                        "unit": "mm",
                        "source": {"at": {"table": "holding", "address": 20, "type": "int32"}},
                    }
                },
            },
            "carrier": {"bridge": "carrier_pc"},
        },
    )
    hall.start("carrier_pc", "press_plc", server=False)
    domain = Ros2Space(ros_domain, "", hall.folder, hall.processes)
    robot = domain.listener("/ua_300_2_10", "std_msgs/Int32", "--transient-local")  # the value may be there before it
    await until(lambda: "1200" in "".join(heard(robot)[-1:]), "the value")
    put(plc, -35)
    await until(lambda: "-35" in "".join(heard(robot)[-1:]), "the new value")
