"""The example of docs/plugged.md, run as it stands there, on a pty and a D-Bus of its own."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
from ua_bridges.plugged.driver import PluggedDriver

from tests.contract.harness import Recorder
from tests.integration.plugged.conftest import BusDaemon
from tests.plugged_device import PtyDevice
from tests.system import Processes, clean_environment
from tests.unit.docs.pages import ROOT, blocks
from tests.waiting import until
from ua_fleet.bridge.driver import Execution, ExecutionEnded
from ua_fleet.config.load import load_content
from ua_fleet.topics import Topic

PAGE = ROOT / "docs" / "plugged.md"


def block(language: str) -> str:
    return next(found.text for found in blocks(language) if found.page == PAGE)


def firmware(device: PtyDevice, line: str) -> None:
    if line == "T?":
        device.say("T=21.5\n")
    elif line.startswith("BEEP"):
        device.say("OK\n")


@pytest.mark.needs("dbus")
async def test_the_fleet_and_the_program_of_the_page(tmp_path: Path, bus: BusDaemon, processes: Processes) -> None:
    load_content(block("yaml").encode(), "fleet.yaml", {})
    match = 'match: {subsystem: tty, vendor: "2341", product: "0043"}'
    text = block("yaml").replace(match, f"path: {tmp_path / 'box'}")
    text = text.replace("bus: system", f'bus: "{bus.address}"')
    environment = clean_environment(DBUS_SYSTEM_BUS_ADDRESS=bus.address)
    processes.start(sys.executable, "-c", block("python"), env=environment)
    driver, recorder = PluggedDriver(load_content(text.encode(), "fleet.yaml", {}), "rover_pc"), Recorder()
    await driver.start(recorder)
    try:
        with PtyDevice(tmp_path / "box", firmware) as box:
            for skill, values in ((1004, ()), (1005, (200,))):
                driver.execute(Execution(skill.to_bytes(16, "big"), Topic(302, 2, skill), 1, values, 10.0))
            driver.want(frozenset([Topic(302, 2, 1002)]))
            await until(lambda: any(e.values == (0.25,) for e in recorder.samples(Topic(302, 2, 1002))), "the gas")

            def ended() -> list[Any]:
                return [event for event in list(recorder.events) if isinstance(event, ExecutionEnded)]

            await until(lambda: len(ended()) == 2, "both skills")
            assert {event.values for event in ended()} == {(21.5,), ()}
            assert "BEEP 200" in box.heard
    finally:
        await driver.stop()
