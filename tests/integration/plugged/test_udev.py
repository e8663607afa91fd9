"""Plugging in and pulling out, as udev tells it; umockdev plays the kernel and udev."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import pytest

from tests.integration.plugged.conftest import UdevBench
from tests.plugged_device import PtyDevice
from tests.waiting import until

pytestmark = pytest.mark.needs("umockdev")

FLEET = r"""
version: 1
pubsub: {security: none}
bridges:
  pc:
    kind: plugged
    space: 300
    status_id: 1
    devices:
      thermometer:
        match: {subsystem: tty, vendor: "2341", product: "0043", serial: "7583"}
      board: {match: {subsystem: hwmon, attributes: {name: coretemp}}}
      camera: {match: {subsystem: video4linux, properties: {ID_MODEL: "C920"}}}
robots:
  rover_pc:
    bridge: pc
    data:
      temperature: {id: 10, type: Double, source: {device: thermometer, line: "T={value}", ask: "T?\n", period_s: 0.05}}
      board: {id: 11, type: Double, source: {device: board, attribute: temp1_input, scale: 0.001, period_s: 0.05}}
      view: {id: 12, type: String, source: {device: camera, url: "rtsp://rover.local:8554/front"}}
      has_camera: {id: 13, type: Boolean, source: {device: camera, plugged: true}}
"""
THERMOMETER = {"ID_VENDOR_ID": "2341", "ID_MODEL_ID": "0043", "ID_SERIAL_SHORT": "7583"}


@pytest.fixture
def bench(tmp_path: Path) -> Generator[UdevBench]:
    (tmp_path / "fleet.yaml").write_text(FLEET)
    made = UdevBench(tmp_path / "fleet.yaml")
    yield made
    made.end()


def thermometer(bench: UdevBench, name: str = "ttyACM0") -> PtyDevice:
    """The firmware of a thermometer behind the device's file."""
    (bench.root / "dev").mkdir(exist_ok=True)
    return PtyDevice(bench.root / "dev" / name, lambda device, _: device.say("T=21.5\n"))


async def test_what_is_plugged_in_is_found_read_and_lost(bench: UdevBench) -> None:
    assert "thermometer: waiting for" in bench.status()
    with thermometer(bench):
        for times in (1, 2):
            path = bench.plug("tty", "ttyACM0", properties={"DEVNAME": "/dev/ttyACM0", **THERMOMETER})
            await until(lambda: len(bench.of("found", 10)) == times, "the thermometer")  # noqa: B023 - awaited here
            assert "thermometer: plugged in at /dev/ttyACM0" in bench.status()
            before = len(bench.values(10))
            bench.do("want", ids=[10])
            await until(lambda: len(bench.values(10)) > before, "a reading")  # noqa: B023 - as above
            bench.do("want", ids=[])
            bench.do("pull", path=path)
            await until(lambda: len(bench.of("lost", 10)) == times, "the loss")  # noqa: B023 - as above
            assert "thermometer: waiting for" in bench.status()
        assert set(bench.values(10)) == {21.5}


async def test_others_are_left_alone_and_the_second_that_fits_waits(bench: UdevBench) -> None:
    other = {**THERMOMETER, "ID_SERIAL_SHORT": "9999"}
    bench.plug("tty", "ttyACM7", properties={"DEVNAME": "/dev/ttyACM7", **other})
    assert "thermometer: waiting for" in bench.status()
    with thermometer(bench), thermometer(bench, "ttyACM1"):
        first = bench.plug("tty", "ttyACM0", properties={"DEVNAME": "/dev/ttyACM0", **THERMOMETER})
        await until(lambda: bench.of("found", 10), "the thermometer")
        bench.plug("tty", "ttyACM1", properties={"DEVNAME": "/dev/ttyACM1", **THERMOMETER})
        said = "device thermometer: /dev/ttyACM1 fits too, and /dev/ttyACM0 came first; tell them apart"
        await until(lambda: said in bench.log(), said)
        assert "plugged in at /dev/ttyACM0" in bench.status()
        bench.do("pull", path=first)
        await until(lambda: "plugged in at /dev/ttyACM1" in bench.status(), "the second")
        await until(lambda: len(bench.of("found", 10)) == 2, "the source again")


async def test_ids_of_the_usb_device_serve_where_udev_has_no_rules(bench: UdevBench) -> None:
    ids = {"idVendor": "2341", "idProduct": "0043", "serial": "7583"}
    usb = bench.plug("usb", "usb1", attributes=ids, properties={"DEVTYPE": "usb_device"})
    with thermometer(bench):
        bench.plug("tty", "ttyACM0", usb, properties={"DEVNAME": "/dev/ttyACM0"})
        await until(lambda: bench.of("found", 10), "the thermometer")


async def test_a_file_of_hwmon_and_a_camera(bench: UdevBench) -> None:
    bench.plug("hwmon", "hwmon0", attributes={"name": "nvme\n", "temp1_input": "1000\n"})
    path = bench.plug("hwmon", "hwmon1", attributes={"name": "coretemp\n", "temp1_input": "42500\n"})
    await until(lambda: bench.of("found", 11), "the board")
    assert bench.values(11) == []
    bench.do("want", ids=[11])
    await until(lambda: 42.5 in bench.values(11), "a reading")
    (bench.root / path.lstrip("/") / "temp1_input").write_text("no number\n")
    await until(lambda: bench.of("lost", 11), "the loss")
    (bench.root / path.lstrip("/") / "temp1_input").write_text("43000\n")
    await until(lambda: 43.0 in bench.values(11), "the next reading")
    camera = bench.plug("video4linux", "video0", properties={"DEVNAME": "/dev/video0", "ID_MODEL": "C920"})
    await until(lambda: bench.of("found", 13), "the camera")
    assert bench.values(12) == ["rtsp://rover.local:8554/front"]
    assert bench.values(13) == [True]
    bench.do("pull", path=camera)
    await until(lambda: bench.of("lost", 12) and bench.of("lost", 13), "the camera's loss")
