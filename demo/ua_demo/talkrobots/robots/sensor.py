"""A thermometer on a serial port, which says once a second how warm it is: `T=22.5`. A pseudo-terminal is its port."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import pty
import signal
import threading
import tty
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Final

from ua_demo.report import beat, report

PERIOD_S: Final = 1.0
WAVE_S: Final = 60.0


@contextmanager
def serial_port(path: Path) -> Generator[int]:
    """The device's end of a port that is found at `path` while the context lasts."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    path.unlink(missing_ok=True)
    path.symlink_to(os.ttyname(theirs))
    try:
        yield ours
    finally:
        path.unlink(missing_ok=True)
        os.close(ours)
        os.close(theirs)


def main() -> None:
    """Run the sensor until SIGTERM. The temperature is always a little above or below the one that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", type=Path, required=True, help="file of the serial port")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--temperature", type=float, default=22.5, help="in degrees Celsius")
    options = parser.parse_args()
    stopped = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        stopped.set()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    with serial_port(options.device) as port:
        report("temperature_sensor", "is ready")
        count = 0
        while not stopped.is_set():
            degrees = options.temperature + math.sin(2 * math.pi * count * PERIOD_S / WAVE_S)
            with contextlib.suppress(BlockingIOError):  # what nobody reads is lost, as on a real line
                os.write(port, f"T={degrees:.2f}\n".encode())
            beat()
            count += 1
            stopped.wait(PERIOD_S / options.speed)


if __name__ == "__main__":
    main()
