"""An arm that is driven by hand, over ur-rtde and a simulated controller, whose joints are looked at each 10 ms."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import pytest

from tests.integration.teleoperation.driving import WAIT_S, Driver, driving
from tests.system import Child, Processes, clean_environment
from tests.ur_controller import UrController, dashboard
from ua_fleet.config.load import load
from ua_fleet.config.schema import FleetConfig
from ua_fleet.skill.executions import OutcomeKind
from ua_fleet.teleoperation import State
from ua_fleet.topics import Topic

pytestmark = pytest.mark.needs("ur")

PROGRAM: Final = Path(__file__).parents[1] / "run_bridge.py"
DEADMAN_S, ROBOT_TIMEOUT_S, PERIOD_S, SPEED = 0.3, 0.4, 0.02, 0.4
STOP_S: Final = 1.0 / 20 + SPEED / 2.0 + 2.0 / 20
SLACK_S: Final = 0.3
"""For looking, and for processes that share two cores with other tests."""
LIMITS: Final = {"speed": SPEED, "acceleration": 1.0, "deceleration": 2.0, "jerk": 20.0}
ARM: Final[dict[str, Any]] = {
    "bridge": "cell",
    "skill_status_id": 1009,
    "data": {
        "jog": {
            "id": 1002,
            "origin": "server",
            "fields": {name: {"type": "Double", "path": path} for name, path in (("turn", "base"), ("tip", "wrist1"))},
            "sink": {"output": "joint_speed"},
        }
    },
    "skills": {
        "home": {"id": 1010, "via": {"move_j": {"joints": [0, -1.57, 0, -1.57, 0, 0], "speed": 2, "acceleration": 4}}}
    },
    "teleoperation": {
        "id": 1003,
        "acquire_id": 1004,
        "renew_id": 1005,
        "release_id": 1006,
        "data": "jog",
        "axes": {"turn": LIMITS, "tip": LIMITS},
        "deadman_ms": round(DEADMAN_S * 1000),
        "robot_timeout_ms": round(ROBOT_TIMEOUT_S * 1000),
        "period_ms": round(PERIOD_S * 1000),
    },
}


class Look:
    """The angle of the base over the time, in a thread."""

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self.angles: list[tuple[float, float, float]] = []
        """The time here, the angle, and the controller's own time, which goes slower on a busy machine."""
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._over.wait(0.01):
            state = self._controller.state()
            self.angles.append((time.monotonic(), state["q"][0], state["time"]))

    def end(self) -> None:
        self._over.set()
        self._thread.join()

    def moved_last(self, since: float = 0.0) -> float:
        """When the base was last seen in motion."""
        moved = [after[0] for before, after in pairwise(self.angles) if abs(after[1] - before[1]) > 1e-5]
        return max([at for at in moved if at >= since], default=0.0)

    def controllers_time(self, at: float) -> float:
        """The controller's own time at a time here."""
        return max([own for looked, _, own in self.angles if looked <= at], default=0.0)

    def speed(self) -> float:
        """In the last 20 looks, rad/s by the controller's time."""
        (_, start, first), (_, end, last) = self.angles[-20], self.angles[-1]
        return (end - start) / max(last - first, 1e-3)


class Cell:
    """A controller with its bridge."""

    def __init__(self, controller: UrController, look: Look, config: FleetConfig, folder: Path, bridge: Child) -> None:
        self.controller, self.look, self.config, self.folder, self.bridge = controller, look, config, folder, bridge


@pytest.fixture
def cell(
    request: pytest.FixtureRequest, controller: UrController, tmp_path: Path, udp_url: str, processes: Processes
) -> Iterator[Cell]:
    """`param`: the deceleration of its axes, where a test wants another one."""
    path = tmp_path / "fleet.json"
    limits = {**LIMITS, "deceleration": getattr(request, "param", LIMITS["deceleration"])}
    driven = {**ARM["teleoperation"], "axes": {"turn": limits, "tip": limits}}
    raw = {
        "version": 1,
        "pubsub": {"security": "none", "url": udp_url},
        "bridges": {"cell": {"kind": "ur", "space": 300, "status_id": 1001, "address": controller.host}},
        "robots": {"arm": {**ARM, "teleoperation": driven}},
    }
    path.write_text(json.dumps(raw))
    environment = clean_environment(PYTHONUNBUFFERED="1", PYTHONPATH=os.pathsep.join(("bridges", ".")))
    bridge = processes.start(sys.executable, PROGRAM, path, "cell", env=environment)
    bridge.wait_for("ready")
    look = Look(controller)
    try:
        yield Cell(controller, look, load(path, {}), tmp_path, bridge)
    finally:
        look.end()


async def turning(cell: Cell, anna: Driver) -> None:
    """Drive until the arm turns with its full speed."""
    await anna.acquired()
    await anna.drive(0.2, 0.0)
    async with asyncio.timeout(WAIT_S):
        while cell.look.speed() < 0.9 * SPEED:
            await anna.drive(0.1, SPEED)
    assert anna.status is not None
    assert anna.status.lease == anna.lease


async def stopped(cell: Cell) -> None:
    """Wait until the control program has been stopped."""
    async with asyncio.timeout(WAIT_S):
        while cell.controller.state()["runtime"] != "STOPPED":
            await asyncio.sleep(0.02)


async def test_an_arm_is_driven_and_released_and_works_again(cell: Cell) -> None:
    async with driving(cell.config, cell.folder, "anna") as (anna,):
        for wait_s in (0.0, 1.0):  # while its control program still runs, and after that
            await turning(cell, anna)
            last = await anna.drive(0.1, SPEED)
            await anna.until(lambda status: status.state is State.IDLE)
            await asyncio.sleep(wait_s)
            stood, since = map(cell.look.controllers_time, (cell.look.moved_last(), last))
            assert stood - since < DEADMAN_S + PERIOD_S + STOP_S + SLACK_S
            async with asyncio.timeout(WAIT_S):
                while (await anna.requestor.invoke(Topic(300, 2, 1010), (), WAIT_S)).kind is not OutcomeKind.ACCEPTED:
                    await asyncio.sleep(0.05)
            async with asyncio.timeout(WAIT_S):
                while abs(cell.controller.state()["q"][0]) > 0.01:
                    await asyncio.sleep(0.02)
            await asyncio.sleep(0.5)


async def test_a_frozen_bridge_leaves_the_arm_to_the_controllers_watchdog(cell: Cell) -> None:
    async with driving(cell.config, cell.folder, "anna") as (anna,):
        await turning(cell, anna)
        os.killpg(cell.bridge.process.pid, signal.SIGSTOP)
        frozen = time.monotonic()
        await stopped(cell)
        await asyncio.sleep(0.3)
        moved_last = cell.look.controllers_time(cell.look.moved_last(frozen))
        assert moved_last - cell.look.controllers_time(frozen) < ROBOT_TIMEOUT_S + SLACK_S
        os.killpg(cell.bridge.process.pid, signal.SIGCONT)
        thawed = time.monotonic()
        await anna.drive(0.5, SPEED)
        status = await anna.until(lambda status: status.lease == 0)
        assert "the bridge stood still" in status.last_end
        assert cell.look.moved_last(thawed) == 0.0
        await anna.until(lambda status: status.state is State.IDLE)
        await asyncio.sleep(0.5)
        await turning(cell, anna)


async def test_a_protective_stop_ends_the_lease_and_what_it_is_said_with(cell: Cell) -> None:
    async with driving(cell.config, cell.folder, "anna") as (anna,):
        await turning(cell, anna)
        await asyncio.to_thread(cell.controller.do, "protective_stop", reason="bumped")
        status = await anna.until(lambda status: status.lease == 0)
        # A speed may have been refused before the state showed why.
        told = ("protective stop: see why, then unlock it", "the controller does not take speeds; see the robot's log")
        assert status.last_end in [f"anna: {one}" for one in told]
        async with asyncio.timeout(WAIT_S):
            while "protective stop" not in (refused := await anna.acquire()).report.message:
                assert refused.kind is OutcomeKind.REFUSED
        assert refused.kind is OutcomeKind.REFUSED
        # What the stop has paused is the bridge's own program: nobody lets it go on, and the arm is driven again.
        await stopped(cell)
        async with asyncio.timeout(WAIT_S):
            while cell.controller.state()["safety_mode"] == "PROTECTIVE_STOP":  # it is not unlocked at once
                await asyncio.to_thread(dashboard, cell.controller.host, "unlock protective stop")
        await turning(cell, anna)


async def test_who_switches_to_local_control_has_the_arm(cell: Cell) -> None:
    async with driving(cell.config, cell.folder, "anna") as (anna,):
        await turning(cell, anna)
        await asyncio.to_thread(cell.controller.do, "remote_control", on=False)
        async with asyncio.timeout(WAIT_S):
            while anna.status is not None and anna.status.lease:
                await anna.drive(0.1, SPEED)
        assert anna.status is not None
        assert "local control" in anna.status.last_end
        await stopped(cell)


@pytest.mark.parametrize("cell", [0.02], indirect=True)
async def test_a_stop_that_goes_on_does_not_move_an_arm_that_has_stopped(cell: Cell) -> None:
    """It was stopped by its controller; who acquires it soon begins at rest, whatever of the ramp is left."""
    async with driving(cell.config, cell.folder, "anna") as (anna,):
        await turning(cell, anna)
        await asyncio.to_thread(dashboard, cell.controller.host, "stop")
        await anna.until(lambda status: status.lease == 0)
        await stopped(cell)
        async with asyncio.timeout(WAIT_S):
            while (at_rest := time.monotonic()) < cell.look.moved_last() + 0.3:
                await asyncio.sleep(0.02)
        await anna.acquired()
        status = await anna.until(lambda status: status.state is State.STOPPING)
        assert status.values[0] > 0.1, "the ramp was over before the arm could be driven again"
        for _ in range(10):
            await anna.drive(0.1, 0.0)
        assert anna.status is not None
        assert anna.status.lease == anna.lease
        assert cell.look.moved_last(at_rest) == 0.0


async def test_an_arm_that_nobody_drives_is_left_and_one_with_a_program_is_not_given_out(cell: Cell) -> None:
    async with driving(cell.config, cell.folder, "anna") as (anna,):
        refused = await anna.acquire()
        assert refused.report.message == (
            "arm cannot be driven: its control program is being started; acquire it again in a moment"
        )
        async with asyncio.timeout(WAIT_S):
            while cell.controller.state()["runtime"] != "PLAYING":
                await asyncio.sleep(0.02)
        await stopped(cell)
        await asyncio.to_thread(dashboard, cell.controller.host, "load slow.urp", "play")
        async with asyncio.timeout(WAIT_S):
            while cell.controller.state()["runtime"] != "PLAYING":
                await asyncio.sleep(0.02)
            while "another program runs on the controller" not in (refused := await anna.acquire()).report.message:
                assert refused.kind is OutcomeKind.REFUSED
                await asyncio.sleep(0.1)
