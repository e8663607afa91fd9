"""A TCP robot that runs in a process of its own, and the driver beside it."""

from __future__ import annotations

import sys
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from ua_bridges.tcp.driver import TcpDriver

from tests.contract.harness import Recorder
from tests.system import Child, Processes, clean_environment
from ua_fleet.bridge.driver import Execution
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig

FILE = """\
version: 1
pubsub: {{security: none}}
bridges:
  cell:
    kind: tcp
    space: 300
    status_id: 1
    {links}
  side: {{kind: tcp, space: 301, status_id: 2, interpreter: {{connect: "127.0.0.1:9"}}}}
robots:
  oven: {{bridge: side, data: {{temperature: {{id: 90, type: Double}}}}}}
  machine:
    bridge: cell
    skill_status_id: 1902
    data:
      position: {position}
      speed: {speed}
    skills:
      work:
        id: 1900
        timeout_s: 20
        arguments: {{work: {{type: String}}, seconds: {{type: Double}}}}
        results: {{done: {{type: String}}, seconds: {{type: Double}}}}
        {via}
"""
POSITION = "{id: 10, fields: {x: {type: Double}, y: {type: Double}}%s}"
SPEED = "{id: 11, type: Double, origin: server%s}"
DIRECT_VIA = """via:
          direct: {command: "WORK {work} {seconds}\\n", done: "DONE {done} {seconds}", failed: "ERROR {message}"}"""


def interpreter_fleet(link: str) -> FleetConfig:
    """A fleet whose machine is reached through a program on it."""
    whole = FILE.format(
        links=f"interpreter: {{{link}}}\n    answers: [oven.temperature]",
        position=POSITION % "",
        speed=SPEED % "",
        via="",
    )
    return load_content(whole.encode(), "fleet.yaml", {})


def direct_fleet(address: str) -> FleetConfig:
    """A fleet whose machine takes commands in a language of its own."""
    source = ', source: {direct: {line: "POS {x} {y}", ask: "POS?\\n", period_s: 0.2}}'
    sink = ', sink: {direct: {command: "SPEED {value:.2f}\\n"}}'
    links = f'direct: {{connect: "{address}"}}'
    whole = FILE.format(links=links, position=POSITION % source, speed=SPEED % sink, via=DIRECT_VIA)
    return load_content(whole.encode(), "fleet.yaml", {})


class Running:
    """A started driver, and what it has told."""

    def __init__(self, driver: TcpDriver, recorder: Recorder) -> None:
        self.driver, self.recorder = driver, recorder

    def begin(self, work: str, seconds: float, execution_id: bytes) -> Execution:
        """Begin work."""
        execution = Execution(execution_id, self.driver.skills()[0].topic, 1, (work, seconds), 20.0)
        self.driver.execute(execution)
        return execution

    def facts(self, kind: type[Any]) -> list[Any]:
        """What was told, of one kind."""
        return [event for event in list(self.recorder.events) if isinstance(event, kind)]


@asynccontextmanager
async def running(config: FleetConfig) -> AsyncGenerator[Running]:
    """A driver, while the context lasts."""
    driver, recorder = TcpDriver(config, "cell"), Recorder()
    await driver.start(recorder)
    try:
        yield Running(driver, recorder)
    finally:
        await driver.stop()


StartRobot = Callable[..., Child]


@pytest.fixture
def start_robot(processes: Processes) -> StartRobot:
    """Starts the simulated robot with options, and waits until it is ready."""

    def start(*options: str | Path) -> Child:
        robot = processes.start(
            sys.executable,
            "-u",
            "-m",
            "ua_demo.simulators.tcp",
            *options,
            env=clean_environment(PYTHONPATH="demo"),
        )
        robot.wait_for("ready")
        return robot

    return start
