"""A device on a serial port that misbehaves, and one that is driven."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.plugged.conftest import Bridge, started
from tests.plugged_device import PtyDevice
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.values import StatusCode

FLEET = r"""
version: 1
pubsub: {security: none}
bridges:
  pc: {kind: plugged, space: 300, status_id: 1, devices: {box: {path: PATH}}}
robots:
  rover_pc:
    bridge: pc
    skill_status_id: 1902
    data:
      tag: {id: 10, type: String, source: {device: box, line: "TAG {value}"}}
      level: {id: 11, type: Double, source: {device: box, line: "{value}"}}
    skills:
      beep:
        id: 20
        arguments: {ms: {type: Int32}}
        results: {loud: {type: Double}}
        timeout_s: 0.5
        via: {device: box, command: "BEEP {ms}\n", done: "BEEPED {loud}", failed: "ERR {message}", halt: "HUSH\n"}
      hush: {id: 21, via: {device: box, command: "HUSH\n"}}
"""


def beeper(device: PtyDevice, line: str) -> None:
    if line == "BEEP 1":
        device.say("BEEPED 0.5\n")
    elif line == "BEEP 2":
        device.say("ERR no battery\n")


@pytest.fixture
def box(tmp_path: Path) -> Iterator[PtyDevice]:
    with PtyDevice(tmp_path / "box", beeper) as device:
        yield device


def fleet(tmp_path: Path) -> str:
    return FLEET.replace("PATH", str(tmp_path / "box"))


async def listening(bridge: Bridge, box: PtyDevice) -> None:
    await bridge.found(10)
    bridge.want(10, 11)
    await asyncio.to_thread(box.wait_for_reader)


async def test_half_lines_and_rubbish_are_no_values(tmp_path: Path, box: PtyDevice) -> None:
    async with started(fleet(tmp_path)) as bridge:
        await bridge.found(10)
        box.say("12")
        await asyncio.sleep(0.2)
        bridge.want(10, 11)
        await asyncio.sleep(0.2)
        box.say("34.5\n")  # the end of a line whose beginning nobody read
        box.say("TAG a\n")
        await until(lambda: bridge.values(10) == ["a"], "the whole line")
        assert bridge.values(11) == []
        box.say("\0\xff nothing that is known\n")
        await until(lambda: bridge.recorder.dropped(Drop.UNASKED) == 1, "the rubbish")
        box.say("7" * 3000)
        box.say("7" * 3000)
        await until(lambda: bridge.recorder.dropped(Drop.MALFORMED) == 1, "the line without end")
        box.say("\nTAG b\n")
        await until(lambda: bridge.values(10) == ["a", "b"], "the next line")
        box.say("3.")
        box.unplug()
        await until(lambda: bridge.recorder.lost(bridge.topic(11)) == 1, "the loss")
        assert bridge.values(11) == []


async def test_a_device_that_floods_is_read_and_others_go_on(tmp_path: Path, box: PtyDevice) -> None:
    async with started(fleet(tmp_path)) as bridge:
        await listening(bridge, box)
        ended, said = threading.Event(), 0

        def flood() -> None:
            nonlocal said
            while not ended.is_set():
                box.say("TAG x\n" * 500)
                said += 500

        flooding = threading.Thread(target=flood)
        flooding.start()
        turns, began_s = 0, time.monotonic()
        try:
            while said <= 100_000 or turns < 100 or time.monotonic() < began_s + 2.0:
                assert time.monotonic() < began_s + 60.0, f"{turns} turns of the loop beside {said} lines"
                await asyncio.sleep(0.01)
                turns += 1
        finally:
            ended.set()
            flooding.join()
        passed_s = time.monotonic() - began_s
        assert 50 < len(bridge.values(10)) < 100 * (passed_s + 2)
        assert bridge.recorder.dropped(Drop.RATE_LIMITED) > 5 * len(bridge.values(10))
        await asyncio.to_thread(box.wait_for_reader)
        box.say("TAG last\n")
        await until(lambda: bridge.values(10)[-1] == "last", "the last line")


async def test_a_command_is_answered_fails_or_is_given_up(tmp_path: Path, box: PtyDevice) -> None:
    async with started(fleet(tmp_path)) as bridge:
        done: Any = await bridge.end(bridge.begin(20, 1))
        assert (done.status, done.values) == (0, (0.5,))
        failed: Any = await bridge.end(bridge.begin(20, 2))
        assert (failed.status, failed.message) == (StatusCode.BAD_UNEXPECTED_ERROR, "no battery")
        silent: Any = await bridge.end(bridge.begin(20, 3))
        assert silent.status == StatusCode.BAD_TIMEOUT
        assert silent.message.endswith("; it was told to stop")
        await until(lambda: box.heard[-1] == "HUSH", "the command that stops it")
        await until(lambda: bridge.driver.status().connected, "the port that is opened anew")
        again: Any = await bridge.end(bridge.begin(20, 1))
        assert again.values == (0.5,)
        lost = bridge.begin(20, 4)
        box.unplug()
        assert "see what it did" in (await bridge.end(lost)).message


async def test_a_command_into_a_port_that_is_gone_was_not_sent(tmp_path: Path, box: PtyDevice) -> None:
    async with started(fleet(tmp_path)) as bridge:
        sent: Any = await bridge.end(bridge.begin(21))
        assert (sent.status, sent.message) == (0, "it was sent to the device")
        box.unplug()
        begun = [bridge.begin(21), bridge.begin(20, 1)]  # the bridge has not looked yet
        for execution in begun:
            gone: Any = await bridge.end(execution)
            assert gone.status == StatusCode.BAD_NO_COMMUNICATION
            assert "before it was written to" in gone.message


async def test_a_port_that_may_not_be_opened_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "box").write_text("")
    really = os.open

    def refused(path: Any, *arguments: Any, **options: Any) -> int:
        if str(path) == str(tmp_path / "box"):
            raise PermissionError(13, "Permission denied", str(path))
        return really(path, *arguments, **options)

    async with started(fleet(tmp_path)) as bridge:
        await until(lambda: "it is no serial port" in bridge.driver.status().detail, "the reason")
    monkeypatch.setattr(os, "open", refused)
    async with started(fleet(tmp_path)) as bridge:
        said = "permission denied; put the bridge's user into the group dialout and log in again"
        await until(lambda: said in bridge.driver.status().detail, said)
        assert bridge.recorder.found(bridge.topic(10)) == []


async def test_two_programs_on_one_port(tmp_path: Path, box: PtyDevice) -> None:
    async with started(fleet(tmp_path)) as bridge:
        await bridge.found(10)
        async with started(fleet(tmp_path)) as second:
            await until(lambda: "another program uses it" in second.driver.status().detail, "the reason")
            assert second.recorder.found(second.topic(10)) == []
