"""What robots say that they have begun: their events in the volume, and what simulated controllers write."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Final

from tests.testbed.engine import Container
from tests.testbed.ledger import Begun

__all__ = ["begun_in", "read_events", "read_log"]

_BEGINS: Final = "begins"
_SAME: Final = "program ua_fleet"
"""What the arm's controller says of each program of the bridge: it tells none from another."""
_TOLD: Final = re.compile(r"^(\S+) told: (.*)$")
_READ: Final = """
import pathlib
for path in sorted(pathlib.Path("/var/lib/ua-fleet/events").glob("*.events*")):
    print(path.read_text(), end="")
"""


def read_events(text: str) -> list[Begun]:
    """From lines of robots' programs; see `demo/ua_demo/report.py`."""
    found: list[Begun] = []
    for line in text.splitlines():
        try:
            event = json.loads(line)
        except ValueError:
            continue  # a program was killed while it wrote
        if str(event.get("what", "")).startswith(_BEGINS):
            found.append(Begun(str(event["who"]), float(event["t"]), str(event.get("execution", ""))))
    return found


def read_log(robot: str, text: str) -> list[Begun]:
    """From the log of a simulated controller, as `docker logs --timestamps` shows it."""
    found: list[Begun] = []
    for line in text.splitlines():
        if told := _TOLD.match(line):
            # Python takes six digits of a second, and the engine writes nine.
            at = datetime.fromisoformat(re.sub(r"(\.\d{6})\d*Z$", r"\1+00:00", told[1])).timestamp()
            found.append(Begun(robot, at, "" if told[2] == _SAME else told[2]))
    return found


def begun_in(
    containers: Mapping[str, Container], conductor: str, controllers: Iterable[str], since: float, until: float
) -> list[Begun]:
    """What all robots have begun in a time, in seconds since 1970.

    Args:
        containers: by service.
        conductor: the service that sees the volume of events.
        controllers: robots whose logs say it.
        since: the earliest.
        until: the latest.
    """
    found = read_events(containers[conductor].python(_READ))
    for robot in controllers:
        found += read_log(robot, containers[robot].logs(timestamps=True))
    return [one for one in found if since <= one.at < until]
