# pyright: basic, reportMissingModuleSource=false
"""The simulated controller against ur-rtde, a client that is not ours: its four interfaces, its own control program."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest

from tests.integration.ur.conftest import wait_until
from tests.ur_controller import UrController

pytestmark = pytest.mark.needs("ur")

UPRIGHT = [0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0]
SAMPLE_BYTES = 12
READY = [0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0]


@pytest.fixture
def receive(controller: UrController) -> Iterator[Any]:
    from rtde_receive import RTDEReceiveInterface

    client = RTDEReceiveInterface(controller.host)
    yield client
    client.disconnect()


@pytest.fixture
def control(controller: UrController) -> Iterator[Any]:
    from rtde_control import RTDEControlInterface

    client = RTDEControlInterface(controller.host)
    yield client
    client.disconnect()


def test_receive_client_sees_the_state(receive: Any, controller: UrController) -> None:
    assert receive.getActualQ() == pytest.approx(UPRIGHT)
    assert receive.getActualTCPPose() == pytest.approx(controller.state()["pose"])
    assert (receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()) == (7, 1, 1)
    controller.do("digital_input", bit=2, on=True)
    controller.do("analog_input", place=1, value=2.5)
    wait_until(lambda: receive.getStandardAnalogInput1() == 2.5, "the input")
    assert receive.getDigitalInState(2)
    controller.do("protective_stop")
    wait_until(receive.isProtectiveStopped, "the protective stop")
    controller.do("emergency_stop")
    wait_until(lambda: receive.getRobotMode() == 3, "the emergency stop")
    assert receive.isEmergencyStopped()


@pytest.mark.parametrize(("frequency", "samples"), [(500.0, 700), (10.0, 8)])
def test_every_cycle_of_2_ms_is_sent(controller: UrController, frequency: float, samples: int) -> None:
    """A plain socket as the client: 500 samples a second, none left out, none twice; another one wants 10."""
    with socket.create_connection((controller.host, 30004), 5) as connection:
        names, began = b"timestamp", time.monotonic()
        for kind, payload in ((b"V", b"\x00\x02"), (b"O", struct.pack(">d", frequency) + names), (b"S", b"")):
            connection.sendall(struct.pack(">H", 3 + len(payload)) + kind + payload)
        data = b""
        while len(data) < samples * SAMPLE_BYTES:
            data += connection.recv(65536)
        # The answers before the samples have bytes, too.
        assert time.monotonic() - began > 0.9 * (samples - 3) / frequency, "more than it wanted"
    times: list[float] = []
    while len(data) >= 3:
        (size,) = struct.unpack_from(">H", data)
        if data[2:3] == b"U" and len(data) >= size:
            times.append(struct.unpack_from(">d", data, 4)[0])
        data = data[size:]
    assert len(times) >= samples - 3
    steps = [after - before for before, after in pairwise(times)]
    assert steps == pytest.approx([1 / frequency] * len(steps), abs=1e-6)


def test_moves_of_the_control_client_take_their_time_and_arrive(control: Any, receive: Any) -> None:
    began = time.monotonic()
    assert control.moveJ(READY, 3.0, 6.0)
    assert 0.9 < time.monotonic() - began < 2.5
    wait_until(lambda: receive.getActualQ() == pytest.approx(READY), "the joints")
    pose = receive.getActualTCPPose()
    pose[2] -= 0.05
    assert control.moveL(pose, 0.25, 1.2)
    wait_until(lambda: receive.getActualTCPPose()[:3] == pytest.approx(pose[:3], abs=1e-6), "the pose")
    assert control.getInverseKinematics(pose) == pytest.approx(receive.getActualQ(), abs=1e-4)
    assert control.isSteady()


def test_asynchronous_move_tells_of_itself_and_is_stopped(control: Any, receive: Any) -> None:
    assert control.moveJ([3.0, *UPRIGHT[1:]], 1.0, 2.0, True)
    wait_until(lambda: receive.getActualQd()[0] > 0.5, "the move")
    assert control.getAsyncOperationProgressEx().isAsyncOperationRunning()
    control.stopJ(5.0)
    wait_until(lambda: receive.getActualQd() == [0.0] * 6, "the stop")
    assert not control.getAsyncOperationProgressEx().isAsyncOperationRunning()
    assert 0.05 < receive.getActualQ()[0] < 2.0


def test_path_and_scripts_of_the_control_client_run(control: Any, controller: UrController) -> None:
    assert control.moveJ([[0.2, *UPRIGHT[1:], 2.0, 4.0, 0.0], [0.0, *UPRIGHT[1:], 2.0, 4.0, 0.0]])
    assert control.sendCustomScriptFunction("hello", "set_standard_digital_out(1, True)\nsleep(0.05)\n")
    assert controller.state()["digital_outputs"] == 2
    assert control.isProgramRunning()


def test_control_client_survives_a_protective_stop(control: Any, controller: UrController) -> None:
    from dashboard_client import DashboardClient

    assert control.moveJ([1.0, *UPRIGHT[1:]], 1.0, 2.0, True)
    controller.do("protective_stop", reason="bumped")
    wait_until(lambda: not control.isProgramRunning(), "the pause")
    dashboard = DashboardClient(controller.host)
    dashboard.connect(2000)
    with pytest.raises(RuntimeError, match="Cannot unlock protective stop"):
        dashboard.unlockProtectiveStop()
    time.sleep(0.35)
    dashboard.unlockProtectiveStop()
    dashboard.disconnect()
    assert control.reuploadScript()
    wait_until(control.isProgramRunning, "the control program")
    assert control.moveJ(UPRIGHT, 2.0, 4.0)


def test_inputs_and_outputs_of_the_io_client(receive: Any, controller: UrController) -> None:
    from rtde_io import RTDEIOInterface

    client = RTDEIOInterface(controller.host)
    try:
        assert client.setStandardDigitalOut(3, True)
        assert client.setConfigurableDigitalOut(1, True)
        assert client.setToolDigitalOut(0, True)
        assert client.setSpeedSlider(0.25)
        assert client.setAnalogOutputVoltage(0, 0.5)
        wait_until(lambda: receive.getStandardAnalogOutput0() == 5.0, "the analogue output")
        assert receive.getActualDigitalOutputBits() == 1 << 3 | 1 << 9 | 1 << 16
        assert receive.getTargetSpeedFraction() == 0.25
    finally:
        client.disconnect()


def test_dashboard_client_takes_the_robot_from_off_to_a_running_program(controller: UrController) -> None:
    from dashboard_client import DashboardClient

    client = DashboardClient(controller.host)
    client.connect(2000)
    client.powerOff()
    assert client.robotmode() == "Robotmode: POWER_OFF"
    client.powerOn()
    wait_until(lambda: client.robotmode() == "Robotmode: IDLE", "the power")
    client.brakeRelease()
    wait_until(lambda: client.robotmode() == "Robotmode: RUNNING", "the brakes")
    with pytest.raises(RuntimeError, match="File not found"):
        client.loadURP("nothing.urp")
    client.loadURP("pick.urp")
    client.play()
    assert client.running()
    wait_until(lambda: controller.state()["digital_outputs"] == 32, "the program")
    client.pause()
    client.play()
    client.stop()
    assert not client.running()
    client.popup("take the part")
    assert controller.state()["popup"] == "take the part"
    client.closePopup()
    assert controller.state()["popup"] is None
    assert client.isInRemoteControl()
    controller.do("remote_control", on=False)
    assert not client.isInRemoteControl()
    with pytest.raises(RuntimeError, match="play"):
        client.play()
    client.disconnect()


def test_control_client_is_refused_in_local_control(controller: UrController) -> None:
    from rtde_control import RTDEControlInterface

    controller.do("remote_control", on=False)
    with pytest.raises(RuntimeError, match="remote control"):
        RTDEControlInterface(controller.host)


def test_client_that_sends_rubbish_harms_nobody(receive: Any, controller: UrController) -> None:
    for port in (29999, 30001, 30002, 30003, 30004, 30005):
        with socket.create_connection((controller.host, port), 5) as connection:
            connection.sendall(b"\x00\x01\xff" * 30_000)
    before = receive.getTimestamp()
    wait_until(lambda: receive.getTimestamp() > before + 0.1, "the next samples")
    assert controller.state()["robot_mode"] == "RUNNING"
