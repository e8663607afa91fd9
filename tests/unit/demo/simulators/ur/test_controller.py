from __future__ import annotations

import math
import struct

import pytest
from ua_bridges.ur.modes import RobotMode, RobotStatus, SafetyMode, SafetyStatus
from ua_demo.simulators.ur.controller import Controller, Refused, Settings
from ua_demo.simulators.ur.dashboard import Dashboard
from ua_demo.simulators.ur.functions import functions_of
from ua_demo.simulators.ur.kinematics import MODELS
from ua_demo.simulators.ur.packets import REALTIME_BYTES, log_message, realtime_packet, robot_state, version_message
from ua_demo.simulators.ur.provoking import Provoking

PROGRAMS = {
    "wave.urp": "def wave():\n  while True:\n    movej([1,-1,0,0,0,0])\n    movej([0,-1,0,0,0,0])\n  end\nend\n",
    "broken.urp": "def broken():\n  movej(\nend\n",
}


def controller(*, ready: bool = True) -> Controller:
    made = Controller(
        Settings(MODELS["ur5e"], boot_s=0.1, brake_s=0.05, unlock_after_s=0.2, programs=PROGRAMS), functions_of
    )
    if ready:
        made.start_up()
    return made


def step(controller: Controller, seconds: float) -> None:
    for _ in range(round(seconds / 0.002)):
        controller.step()


def logged(controller: Controller, kind: str) -> list[str]:
    return [line.text for line in controller.log if line.kind == kind]


def test_power_takes_its_time() -> None:
    robot = controller(ready=False)
    assert robot.robot_mode.name == "POWER_OFF"
    robot.power_on()
    assert robot.robot_mode.name == "BOOTING"
    step(robot, 0.11)
    assert robot.robot_mode.name == "IDLE"
    robot.release_brakes()
    step(robot, 0.06)
    assert robot.robot_mode.name == "RUNNING"
    assert robot.status_bits == RobotStatus.POWER_ON


def test_brake_release_gives_power_first() -> None:
    robot = controller(ready=False)
    robot.release_brakes()
    step(robot, 0.2)
    assert robot.robot_mode.name == "RUNNING"


def test_script_runs_and_ends() -> None:
    robot = controller()
    robot.start_script('def p():\n  textmsg("on ", 1)\n  set_standard_digital_out(2, True)\n  sleep(0.1)\nend\n')
    step(robot, 0.05)
    assert (robot.runtime.name, robot.program_name) == ("PLAYING", "p")
    assert robot.status_bits & RobotStatus.PROGRAM_RUNNING
    step(robot, 0.1)
    assert robot.runtime.name == "STOPPED"
    assert robot.digital_outputs == 4
    assert logged(robot, "message") == ["on 1"]


def test_script_moves_the_arm_for_as_long_as_it_takes() -> None:
    robot = controller()
    robot.start_script("def p():\n  movej([0.5, -1.5708, 0, -1.5708, 0, 0], a=1.0, v=0.5)\nend\n")
    step(robot, 1.4)
    assert robot.runtime.name == "PLAYING"
    step(robot, 0.15)
    assert robot.runtime.name == "STOPPED"
    assert robot.arm.q[0] == 0.5


def test_another_script_takes_the_place_and_the_arm_brakes() -> None:
    robot = controller()
    robot.start_script(PROGRAMS["wave.urp"])
    step(robot, 0.5)
    robot.start_script("def q():\n  sleep(1)\nend\n")
    step(robot, 0.6)
    assert robot.program_name == "q"
    assert robot.arm.is_steady


def test_secondary_program_runs_beside() -> None:
    robot = controller()
    robot.start_script(PROGRAMS["wave.urp"])
    robot.start_script("sec s():\n  set_standard_digital_out(0, True)\nend\n")
    step(robot, 0.1)
    assert robot.program_name == "wave"
    assert robot.digital_outputs == 1


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("def p():\n  movej(\nend\n", "syntax error"),
        ("def p():\n  textmsg(x)\nend\n", "no variable x"),
        ("def p():\n  movec(1, 2)\nend\n", "no function movec"),
        ("def p():\n  movej([0, 0, 0])\nend\n", "six numbers"),
        ("def p():\n  movej([9, 0, 0, 0, 0, 0])\nend\n", "limits"),
        ("def p():\n  set_standard_digital_out(8, True)\nend\n", "0 to 7"),
        ("def p():\n  write_output_integer_register(48, 1)\nend\n", "0 to 47"),
        ("def p():\n  movej([0, 0, 0, 0, 0, 0], a=0)\nend\n", "a number of"),
        ("def p():\n  sleep(-1)\nend\n", "a number of"),
    ],
)
def test_mistake_in_a_script_is_logged_with_its_line(source: str, said: str) -> None:
    robot = controller()
    robot.start_script(source)
    step(robot, 0.02)
    assert robot.runtime.name == "STOPPED"
    (exception,) = [line for line in robot.log if line.kind == "exception"]
    assert said in exception.text
    assert exception.line > 0


def test_script_is_not_started_without_power() -> None:
    robot = controller(ready=False)
    robot.start_script(PROGRAMS["wave.urp"])
    assert robot.runtime.name == "STOPPED"
    assert "POWER_OFF" in logged(robot, "exception")[0]


def test_protective_stop_pauses_and_the_program_finishes_its_move_afterwards() -> None:
    robot = controller()
    robot.start_script("def p():\n  movej([0.5, -1.5708, 0, -1.5708, 0, 0], a=1.0, v=0.5)\nend\n")
    step(robot, 0.7)
    robot.stop_for_safety(SafetyMode.PROTECTIVE_STOP, "bumped")
    step(robot, 0.1)
    assert robot.runtime.name == "PAUSED"
    assert robot.safety_bits == SafetyStatus.PROTECTIVE_STOPPED | SafetyStatus.STOPPED_DUE_TO_SAFETY
    assert robot.arm.is_steady
    with pytest.raises(Refused, match="Cannot unlock"):
        robot.unlock_protective_stop()
    with pytest.raises(Refused, match="PROTECTIVE_STOP"):
        robot.play()
    step(robot, 0.2)
    robot.unlock_protective_stop()
    robot.play()
    step(robot, 1.5)
    assert robot.runtime.name == "STOPPED"
    assert robot.arm.q[0] == pytest.approx(0.5)


def test_emergency_stop_takes_the_power() -> None:
    robot = controller()
    robot.start_script(PROGRAMS["wave.urp"])
    step(robot, 0.3)
    robot.stop_for_safety(SafetyMode.ROBOT_EMERGENCY_STOP, "the button")
    assert (robot.robot_mode.name, robot.runtime.name) == ("POWER_OFF", "STOPPED")
    assert robot.safety_bits & SafetyStatus.EMERGENCY_STOPPED
    with pytest.raises(Refused):
        robot.power_on()
    robot.reset_safety()
    robot.power_on()
    assert robot.robot_mode.name == "BOOTING"


def test_move_into_a_singularity_is_a_protective_stop() -> None:
    robot = controller()
    robot.start_script("def p():\n  x = get_actual_tcp_pose()\n  x[2] = x[2] + 1\n  movel(x)\nend\n")
    step(robot, 0.1)
    assert robot.safety_mode.name == "PROTECTIVE_STOP"
    assert "out of reach" in robot.safety_reason


def test_speed_slider_slows_moves_down() -> None:
    robot = controller()
    robot.speed_slider = 0.5
    robot.start_script("def p():\n  movej([0.5, -1.5708, 0, -1.5708, 0, 0], a=1.0, v=0.5)\nend\n")
    step(robot, 2.8)
    assert robot.is_playing
    assert robot.speed_scaling == 0.5
    step(robot, 0.4)
    assert robot.arm.q[0] == 0.5


def test_pause_and_play() -> None:
    robot = controller()
    robot.load("wave.urp")
    robot.play()
    step(robot, 0.3)
    robot.pause_program()
    step(robot, 0.5)
    assert robot.arm.qd == [0.0] * 6
    robot.play()
    step(robot, 0.2)
    assert any(robot.arm.qd)
    robot.stop_program("over")
    step(robot, 1.0)
    assert robot.arm.qd == [0.0] * 6


def test_watchdog_stops_a_program_whose_client_is_silent() -> None:
    robot = controller()
    robot.start_script('def p():\n  rtde_set_watchdog("input_int_register_0", 10, "stop")\n  sleep(9)\nend\n')
    for _ in range(10):
        step(robot, 0.05)
        robot.touched("input_int_register_0")
    assert robot.is_playing
    step(robot, 0.2)
    assert robot.runtime.name == "STOPPED"


def test_forward_and_inverse_kinematics_of_scripts_agree() -> None:
    robot = controller()
    robot.start_script(
        "def p():\n  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  x = get_forward_kin([0.3, -1, 1, -1, -1, 0])\n"
        "  q = get_inverse_kin(x, [0.3, -1, 1, -1, -1, 0.1])\n  n = 0\n"
        "  while n < 6:\n    write_output_float_register(n, q[n])\n    n = n + 1\n  end\nend\n"
    )
    step(robot, 0.05)
    assert robot.outputs.doubles[:6] == pytest.approx([0.3, -1, 1, -1, -1, 0], abs=1e-6)


def test_dashboard_answers_as_e_series_do() -> None:
    robot = controller(ready=False)
    dashboard = Dashboard(robot)
    talk = [
        ("robotmode", "Robotmode: POWER_OFF"),
        ("play", "Failed to execute: play"),
        ("power on", "Powering on"),
        ("brake release", "Brake releasing"),
        ("get loaded program", "No program loaded"),
        ("load nothing.urp", "File not found: nothing.urp"),
        ("load wave.urp", "Loading program: wave.urp"),
        ("get loaded program", "Loaded program: /programs/wave.urp"),
        ("popup take the part", "showing popup"),
        ("is in remote control", "true"),
        ("programState", "STOPPED wave.urp"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("fly", 'could not understand: "fly"'),
    ]
    assert [dashboard.answer(asked) for asked, _ in talk] == [answer for _, answer in talk]
    assert robot.popup == "take the part"
    step(robot, 0.3)
    assert dashboard.answer("play") == "Starting program"
    assert dashboard.answer("programState") == "PLAYING wave.urp"
    assert dashboard.answer("running") == "Program running: true"
    assert dashboard.answer("pause") == "Pausing program"
    assert dashboard.answer("stop") == "Stopped"
    assert dashboard.answer("load broken.urp") == "Loading program: broken.urp"
    assert dashboard.answer("play") == "Failed to execute: play"


def test_dashboard_does_nothing_in_local_control() -> None:
    robot = controller()
    robot.remote_control = False
    dashboard = Dashboard(robot)
    assert dashboard.answer("power off").startswith("Failed to execute: power off")
    assert robot.robot_mode.name == "RUNNING"
    assert dashboard.answer("robotmode") == "Robotmode: RUNNING"


def test_dashboard_takes_lines_however_they_come() -> None:
    dashboard = Dashboard(controller())
    assert dashboard.receive(b"robot") == b""
    assert dashboard.receive(b"mode\nrunning\n") == b"Robotmode: RUNNING\nProgram running: false\n"
    with pytest.raises(ValueError, match="more than"):
        dashboard.receive(b"x" * 5000)


def test_realtime_packet_has_its_fields_where_clients_look() -> None:
    robot = controller()
    step(robot, 0.01)
    packet = realtime_packet(robot)
    assert len(packet) == REALTIME_BYTES == struct.unpack_from(">i", packet)[0]
    assert struct.unpack_from(">d", packet, 4)[0] == pytest.approx(0.01)
    assert struct.unpack_from(">6d", packet, 252) == pytest.approx(robot.arm.q)
    assert struct.unpack_from(">6d", packet, 444) == pytest.approx(robot.arm.tcp_pose())
    assert struct.unpack_from(">d", packet, 756)[0] == RobotMode.RUNNING
    assert struct.unpack_from(">d", packet, 812)[0] == SafetyMode.NORMAL


def test_robot_state_has_its_parts() -> None:
    robot = controller()
    data = robot_state(robot)
    size, kind = struct.unpack_from(">iB", data)
    assert (size, kind) == (len(data), 16)
    found, at = dict[int, bytes](), 5
    while at < len(data):
        size, part = struct.unpack_from(">iB", data, at)
        found[part] = data[at + 5 : at + size]
        at += size
    assert sorted(found) == [0, 1, 3, 4]
    assert len(found[1]) == 6 * 41
    joints = [struct.unpack_from(">d", found[1], 41 * joint)[0] for joint in range(6)]
    assert joints == pytest.approx([0, -math.pi / 2, 0, -math.pi / 2, 0, 0])
    assert struct.unpack_from(">6d", found[4]) == pytest.approx(robot.arm.tcp_pose())


def test_messages_have_their_sizes() -> None:
    robot = controller()
    robot.start_script("def p():\n  fly()\nend\n")
    step(robot, 0.01)
    for data in (version_message(robot), log_message(robot.log[-1])):
        assert struct.unpack_from(">iB", data) == (len(data), 20)


def test_provoking_says_what_it_cannot_do() -> None:
    robot = controller()
    provoking = Provoking(robot, lambda: None, lambda on, port: None)
    assert provoking.answer('{"do": "digital_input", "bit": 3, "on": true}') == '{"done": true}'
    assert robot.digital_inputs == 8
    for line in ("x", "[]", "{}", '{"do": "fly"}', '{"do": "digital_input", "bit": 99, "on": true}', '{"do": []}'):
        assert "error" in provoking.answer(line)
