"""Values in files below /sys, as hwmon has them: read with a period while they are needed.

A read may take as long as the sensor's bus does, so it is done in a thread of the loop's pool.
"""

from __future__ import annotations

import asyncio
import errno
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from ua_bridges.plugged.sensor import Sensor
from ua_fleet.config.base import ScalarType
from ua_fleet.counters import Drop

__all__ = ["AttributeFiles", "value_of"]

MOST_BYTES: Final = 4096


def value_of(text: str, kind: ScalarType, scale: float, offset: float) -> Any:
    """What stands in an attribute's file as a value of a type; raises ValueError for what is none."""
    if kind is ScalarType.STRING:
        return text
    if kind is ScalarType.BOOLEAN:
        if text not in ("0", "1"):
            raise ValueError(f"{text[:40]!r} is neither 0 nor 1")
        return text == "1"
    number = float(text) * scale + offset
    return number if kind in (ScalarType.FLOAT, ScalarType.DOUBLE) else round(number)


class _File:
    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self.read_at: float | None = None
        """When it is to be read next; None: it has not been needed."""
        self.is_reading = False


class AttributeFiles:
    """The attributes of one device."""

    def __init__(self, sensors: Sequence[Sensor], turned: Callable[[], None]) -> None:
        """`turned` is called when a file was read."""
        self._files = [_File(sensor) for sensor in sensors]
        self._turned = turned
        self._folder: Path | None = None

    def plugged(self, folder: str) -> None:
        """The device is there, with its files below this folder."""
        self._loop = asyncio.get_running_loop()
        self._folder = Path(folder)
        for file in self._files:
            file.read_at = None
            file.sensor.plugged(time.monotonic(), time.time_ns())

    def unplugged(self, why: str) -> None:
        """The device is gone."""
        self._folder = None
        for file in self._files:
            file.sensor.unplugged(why, time.monotonic())

    def read(self, sensor: Sensor, now: float) -> None:
        """A reading waits: read at once."""
        for file in self._files:
            if file.sensor is sensor:
                file.read_at = now

    def turn(self, now: float) -> float | None:
        """Do what is due; when to be called again."""
        times: list[float | None] = []
        for file in self._files:
            times.append(file.sensor.turn(now))
            if self._folder is None or not file.sensor.is_needed:
                file.read_at = None
                continue
            if file.read_at is None:
                file.read_at = now
            if now >= file.read_at and not file.is_reading:
                file.read_at = now + file.sensor.source.period_s
                self._begin(file, self._folder / str(file.sensor.source.attribute))
            if not file.is_reading or file.read_at > now:
                times.append(file.read_at)
        return min((at for at in times if at is not None), default=None)

    def _begin(self, file: _File, path: Path) -> None:
        file.is_reading = True
        reading = self._loop.run_in_executor(None, _read, path)
        reading.add_done_callback(lambda done: self._read(file, path, done))

    def _read(self, file: _File, path: Path, reading: asyncio.Future[str]) -> None:
        file.is_reading = False
        if reading.cancelled():
            return
        sensor, source = file.sensor, file.sensor.source
        error = reading.exception()
        ((name, kind),) = sensor.data.types.items()
        if error is not None:
            sensor.dropped(Drop.NO_ANSWER, f"{sensor.data.label}: {path}: {_reason(error)}")
        elif self._folder is not None:
            try:
                value = value_of(reading.result(), kind, source.scale, source.offset)
            except (ValueError, OverflowError) as problem:
                sensor.dropped(Drop.MALFORMED, f"{sensor.data.label}: {path}: {problem}")
            else:
                sensor.take({name: value}, time.monotonic(), time.time_ns())
        self._turned()


def _read(path: Path) -> str:
    with path.open("rb") as file:
        return file.read(MOST_BYTES).decode("utf-8", "replace").strip()


def _reason(error: BaseException) -> str:
    code = getattr(error, "errno", None)
    if code in (errno.EACCES, errno.EPERM):
        return "permission denied; let the bridge's user read it"
    if code == errno.ENOENT:
        return "there is no such file; see the device's `attribute`"
    return str(getattr(error, "strerror", None) or error)
