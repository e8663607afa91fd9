"""The driver's threads after a mistake of its own; the children that talk to the controller are played by the test."""

from __future__ import annotations

import asyncio
import subprocess
import threading
import time
from collections import defaultdict
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import pytest
from structlog.testing import capture_logs
from ua_bridges.ur import watching
from ua_bridges.ur.dashboard_tasks import DashboardTask
from ua_bridges.ur.driver import UrDriver
from ua_bridges.ur.library.child import ChildFailed, LibraryChild
from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.state import State
from ua_bridges.ur.task import Progress
from ua_bridges.ur.telemetry import Telemetry

from tests.contract.harness import Recorder
from tests.waiting import until
from ua_fleet.bridge.driver import Execution, ExecutionEnded, ExecutionForgotten
from ua_fleet.bridge.executing import Ended
from ua_fleet.config.load import load_content
from ua_fleet.errors import SkillRejected
from ua_fleet.topics import Topic

FLEET = b"""
version: 1
pubsub: {security: none}
bridges: {arm: {kind: ur, space: 300, status_id: 1, address: 127.0.0.9, retry_s: [0.01, 0.05]}}
robots:
  ur5:
    bridge: arm
    skill_status_id: 2
    data: {number: {id: 11, type: Double, path: output_double_register_12, source: {}}}
    skills: {on: {id: 20, via: {dashboard: {command: power_on}}}}
"""
NUMBER = Topic(300, 2, 11)


class Child:
    """A controller that sends a sample each 5 ms, or whose process cannot be started."""

    error: Exception | None = None

    def __init__(self, *_arguments: str) -> None:
        if self.error is not None:
            raise self.error
        self._stamp = 0.0

    def line(self, _timeout_s: float) -> list[Any]:
        time.sleep(0.005)
        self._stamp += 0.005
        return [time.monotonic(), 0, self._stamp, defaultdict(int)]

    def end(self) -> None:
        pass


@asynccontextmanager
async def watched(monkeypatch: pytest.MonkeyPatch) -> AsyncGenerator[tuple[UrDriver, Recorder]]:
    monkeypatch.setattr(watching, "LibraryChild", Child)
    driver, recorder = UrDriver(load_content(FLEET, "fleet.yaml", {}), "arm"), Recorder()
    await driver.start(recorder)
    try:
        yield driver, recorder
    finally:
        await driver.stop()


async def test_mistake_of_ours_loses_the_sources_and_the_controller_is_watched_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with capture_logs() as logs:
        async with watched(monkeypatch) as (driver, recorder):
            await until(lambda: recorder.samples(NUMBER), "a sample")

            def broken(_telemetry: Telemetry, *_: Any) -> None:
                raise KeyError("x")

            with monkeypatch.context() as mistaken:
                mistaken.setattr(Telemetry, "sampled", broken)
                await until(lambda: recorder.lost(NUMBER) == 1, "the loss")
                await until(lambda: not driver.status().connected, "the status")
                assert "a mistake of the bridge (KeyError('x'))" in driver.status().detail
                await asyncio.sleep(0.3)
            heard = len(recorder.samples(NUMBER))
            await until(lambda: len(recorder.samples(NUMBER)) > heard, "samples again")
            assert driver.status().connected
            assert not driver.status().is_over
    assert [entry["log_level"] for entry in logs].count("error") == 1, "told once, however often it happens"


async def test_process_that_cannot_be_started_is_started_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Child, "error", BlockingIOError(11, "Resource temporarily unavailable"))
    async with watched(monkeypatch) as (driver, recorder):
        await until(lambda: "temporarily unavailable" in driver.status().detail, "the reason")
        monkeypatch.setattr(Child, "error", None)
        await until(lambda: recorder.samples(NUMBER), "a sample")
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ur ")]


class TwiceOn(Child):
    """A controller that is switched off, and an hour later has been on for longer than before."""

    began: ClassVar[list[float]] = []

    def __init__(self, *_arguments: str) -> None:
        super().__init__()
        self._received_s = 5000.0 + 3600.0 * len(self.began)
        self._stamp = 10.0 * (len(self.began) + 1)
        self.began.append(self._received_s)

    def line(self, _timeout_s: float) -> list[Any]:
        if len(self.began) == 1 and self._stamp > 10.05:
            raise ChildFailed("the controller closed the connection")
        _, lost, stamp, values = super().line(0.0)
        self._received_s += 0.005
        return [self._received_s, lost, stamp, values]


async def test_time_of_a_controller_begins_anew_with_each_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TwiceOn, "began", [])
    monkeypatch.setattr(watching, "LibraryChild", TwiceOn)
    took: list[State] = []

    def sampled(_telemetry: Telemetry, state: State, _lost: int) -> None:
        took.append(state)

    monkeypatch.setattr(Telemetry, "sampled", sampled)
    driver = UrDriver(load_content(FLEET, "fleet.yaml", {}), "arm")
    await driver.start(Recorder())
    try:
        await until(lambda: len(TwiceOn.began) == 2 and took[-1].time > 20.0, "the second connection")
    finally:
        await driver.stop()
    assert took[-1].taken_s == pytest.approx(8600.0 + took[-1].time - 20.0, abs=0.01)


def test_no_place_for_a_process_is_a_failed_child(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(subprocess, "Popen", full)
    with pytest.raises(ChildFailed, match=r"cannot be started \(Resource temporarily unavailable\); see the limits"):
        LibraryChild("receiving")


def answered(*_: object, **__: object) -> None:
    """A controller that does what it is asked."""


def not_refused(*_: object) -> str:
    return ""


async def test_execution_that_cannot_be_followed_is_no_end_for_others(monkeypatch: pytest.MonkeyPatch) -> None:
    followed: list[DashboardTask] = []

    def looked(task: DashboardTask, *_: object) -> Ended:
        followed.append(task)
        if task is followed[0]:
            raise KeyError("x")
        return Ended(0)

    monkeypatch.setattr(DashboardTask, "look", looked)
    monkeypatch.setattr(CommandLink, "call", answered)
    monkeypatch.setattr("ua_bridges.ur.driver.refusal_of", not_refused)
    first, second = b"\1" * 16, b"\2" * 16
    with capture_logs() as logs:
        async with watched(monkeypatch) as (driver, recorder):
            await until(lambda: recorder.samples(NUMBER), "a sample")
            for execution_id in (first, second):
                driver.execute(Execution(execution_id, Topic(300, 2, 20), 1, ()))
            await until(lambda: ExecutionEnded(second) in recorder.events, "the end of the second")
    forgotten = [event for event in recorder.events if isinstance(event, ExecutionForgotten)]
    assert forgotten == [ExecutionForgotten(first, "a mistake of the bridge (KeyError('x')); see what the robot does")]
    assert [entry["log_level"] for entry in logs].count("error") == 1


async def test_who_asks_for_a_halt_that_there_is_no_way_for_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def under_way(*_: object) -> Progress:
        return Progress(0.0)

    monkeypatch.setattr(DashboardTask, "look", under_way)
    monkeypatch.setattr(CommandLink, "call", answered)
    monkeypatch.setattr("ua_bridges.ur.driver.refusal_of", not_refused)
    execution = Execution(b"\1" * 16, Topic(300, 2, 20), 1, ())
    async with watched(monkeypatch) as (driver, recorder):
        await until(lambda: recorder.samples(NUMBER), "a sample")
        driver.execute(execution)
        with pytest.raises(SkillRejected, match="a command to the dashboard server cannot be taken back"):
            driver.halt(execution)
