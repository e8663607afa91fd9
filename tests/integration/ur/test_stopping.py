"""Halts and stops that the controller does not take at once, or of which its state tells late."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from tests.integration.ur.test_driver import ROBOT, Started, bad, children, good, started
from tests.ur_controller import UrController, dashboard
from tests.waiting import until
from ua_fleet.bridge import Execution, ExecutionEnded
from ua_fleet.errors import RobotBusy
from ua_fleet.values import StatusCode

pytestmark = pytest.mark.needs("ur")

STANDS_RAD = 0.05
"""An arm that slows down turns by less."""


def turned(controller: UrController) -> float:
    angle: float = controller.state()["q"][0]
    return angle


async def shows(controller: UrController, runtime: str) -> None:
    await until(lambda: controller.state()["runtime"] == runtime, runtime, 20)


async def assert_nothing_goes_on(controller: UrController, *before: str) -> None:
    """Somebody lets whatever is paused go on."""
    at = turned(controller)
    with contextlib.suppress(OSError):
        await asyncio.to_thread(dashboard, controller.host, *before, "play")
    await asyncio.sleep(1.5)
    assert abs(turned(controller) - at) < STANDS_RAD


async def paused(controller: UrController) -> None:
    await asyncio.to_thread(dashboard, controller.host, "pause")
    await shows(controller, "PAUSED")
    await asyncio.sleep(0.3)  # the bridge is shown it as well


async def sweeping_alone(controller: UrController, one: Started) -> Execution:
    """A script moves the arm, and the dashboard server, which alone can stop it, is silent."""
    execution = one.begin("sweep")
    await until(lambda: turned(controller) > 0.05, "the sweep")
    controller.do("silence", on=True, port="dashboard")
    return execution


async def test_a_move_that_a_person_has_paused_is_halted(controller: UrController) -> None:
    """A paused program does not hear that it is to slow down: it is stopped."""
    async with started(controller.host) as one:
        execution = one.begin("turn", 2.0, 0.5)
        await one.moves(execution)
        await paused(controller)
        one.driver.halt(execution)
        bad(await one.end(execution), StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT)
        await shows(controller, "STOPPED")
        await assert_nothing_goes_on(controller)


async def test_a_move_whose_time_is_over_while_it_is_paused_goes_on_no_more(
    controller: UrController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ROBOT["skills"]["turn"], "timeout_s", 2.0)
    async with started(controller.host) as one:
        execution = one.begin("turn", 2.0, 0.5)
        await one.moves(execution)
        await paused(controller)
        bad(await one.end(execution), StatusCode.BAD_TIMEOUT)
        await shows(controller, "STOPPED")
        await assert_nothing_goes_on(controller)


async def test_a_halt_is_told_again_until_the_dashboard_server_takes_it(controller: UrController) -> None:
    async with started(controller.host) as one:
        execution = await sweeping_alone(controller, one)
        with capture_logs() as log:
            one.driver.halt(execution)
            await until(lambda: any("told again" in each["event"] for each in log), "the first try", 10)
        controller.do("silence", on=False, port="dashboard")
        bad(await one.end(execution), StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT)
        assert turned(controller) < 2.4, "it went to its end, 2.5"


async def test_a_script_whose_time_is_over_is_stopped_once_the_controller_listens(
    controller: UrController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ROBOT["skills"]["sweep"], "timeout_s", 1.5)
    async with started(controller.host) as one:
        execution = await sweeping_alone(controller, one)
        bad(await one.end(execution), StatusCode.BAD_TIMEOUT)
        with pytest.raises(RobotBusy, match="has not stopped yet"):
            one.begin("turn", 1.0, 1.0)
        controller.do("silence", on=False, port="dashboard")
        await shows(controller, "STOPPED")
        assert turned(controller) < 2.4, "it went to its end, 2.5"


async def test_what_a_safety_stop_pauses_is_stopped_once_the_dashboard_server_is_back(controller: UrController) -> None:
    async with started(controller.host) as one:
        execution = await sweeping_alone(controller, one)
        with capture_logs() as log:
            controller.do("protective_stop", reason="bumped")
            bad(await one.end(execution), StatusCode.BAD_OUT_OF_SERVICE)
            await until(lambda: any("still paused" in each["event"] for each in log), "the first try", 10)
        assert controller.state()["runtime"] == "PAUSED"
        controller.do("silence", on=False, port="dashboard")
        await shows(controller, "STOPPED")
        await assert_nothing_goes_on(controller, "unlock protective stop", "close safety popup")


@contextmanager
def late_state() -> Generator[None]:
    """What the controller says of itself waits for a moment, as in a lost packet's place."""
    (reader,) = [pid for pid in children() if "receiving" in Path(f"/proc/{pid}/cmdline").read_text()]
    os.kill(reader, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):  # ended, since it said nothing for too long
            os.kill(reader, signal.SIGCONT)


@pytest.mark.parametrize("name", ["sweep", "turn"])
async def test_a_motion_that_the_state_does_not_show_yet_is_stopped(controller: UrController, name: str) -> None:
    async with started(controller.host, answer_timeout_s=4) as one:
        with late_state():
            work = one.begin("sweep") if name == "sweep" else one.begin("turn", 2.5, 0.4)
            await until(lambda: turned(controller) > 0.02, "the motion")
            at = turned(controller)
            stop = one.begin("stop")
            await until(
                lambda: one.facts(stop) or controller.state()["runtime"] != "PLAYING" or turned(controller) > 2, ""
            )
        good(await one.end(stop))
        assert turned(controller) - at < 0.5, "the arm stands once `stop` is done"
        at = turned(controller)
        await asyncio.sleep(1)
        assert abs(turned(controller) - at) < STANDS_RAD
        assert isinstance(await one.end(work), ExecutionEnded)


async def test_a_program_that_the_state_does_not_show_yet_keeps_its_place(controller: UrController) -> None:
    """Before it sends a script the bridge asks whether anything runs, as it does before a move."""
    async with started(controller.host, answer_timeout_s=4) as one:
        with late_state(), socket.create_connection((controller.host, 30002), 5) as connection:
            connection.sendall(b"def theirs():\n  sleep(60)\nend\n")
            await until(lambda: controller.state()["program"] == "theirs", "the program")
            work = one.begin("measure", "mine", 0.1)
            await until(lambda: one.facts(work), "the refusal", 10)
        bad(await one.end(work), StatusCode.BAD_UNEXPECTED_ERROR)
        assert controller.state()["program"] == "theirs"
