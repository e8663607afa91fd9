"""What a robot's program says of itself: events, and that it works. Nothing but the standard library is needed.

UA_FLEET_EVENTS names a file that gets the events too, and UA_FLEET_HEARTBEAT one that is touched by `beat`.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from pathlib import Path
from typing import Any, Final

__all__ = ["EVENTS_VARIABLE", "HEARTBEAT_VARIABLE", "beat", "report"]

EVENTS_VARIABLE: Final = "UA_FLEET_EVENTS"
HEARTBEAT_VARIABLE: Final = "UA_FLEET_HEARTBEAT"
MOST_BYTES: Final = 8 * 1024 * 1024
"""Of the file of events; then it is kept as `<name>.1`, and begun anew."""
_writing: Final = threading.Lock()
"""`print` writes a line and its end apart: of two threads at once, neither line could be read."""


def report(who: str, what: str, **details: Any) -> None:
    """Print one event, and append it to the file of events; from any thread, each on a line of its own."""
    line = json.dumps({"t": time.time(), "who": who, "what": what, **details})
    name = os.environ.get(EVENTS_VARIABLE)
    with _writing:
        print(line, flush=True)
        if name:
            # A full disk must not stop a robot: the file is for people.
            with contextlib.suppress(OSError):
                _append(Path(name), line)


def _append(path: Path, line: str) -> None:
    if path.exists() and path.stat().st_size > MOST_BYTES:
        path.replace(path.with_name(f"{path.name}.1"))
    with path.open("a", encoding="ascii") as file:
        file.write(f"{line}\n")


def beat() -> None:
    """Show that the program works; to be called about once a second by what does its work."""
    name = os.environ.get(HEARTBEAT_VARIABLE)
    if name:
        with contextlib.suppress(OSError):
            Path(name).touch()
