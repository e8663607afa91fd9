"""Action round trip on UDP, from `invoke` until it is known that the robot was told, beside a bare UDP echo.

Each side in its own process: our requestor and our bridge, whose robot does all at once; and an echo of the same number
of bytes in each direction, in an event loop too. The journals of both sides are on the disk, as in production: one
commit before the request goes out, one before the robot is told, one when the outcome is known. The figures with
journals in memory show what the disk costs.
"""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path

from benchmarks._keys import write_keys
from benchmarks._ros import Node, median_and_p99
from benchmarks.harness import FEWEST_ROUNDS, OTHER, Figure, beside, shown
from tests import system
from ua_fleet.config.schema import FleetConfig

REFERENCE = "bare UDP echo"
WARM_UP, MEASURED = 50, 300
WAYS = (
    ("unsecured", "none", "disk"),
    ("secured", "sign_and_encrypt", "disk"),
    ("unsecured, journals in memory", "none", "memory"),
    ("secured, journals in memory", "sign_and_encrypt", "memory"),
)


class Way:
    """One pair of requestor and bridge, with an echo of the same sizes."""

    def __init__(
        self,
        security: str,
        journal: str,
        stack: contextlib.ExitStack,
        python: str = sys.executable,
        root: Path = system.ROOT,
    ) -> None:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=system.ROOT)))
        raw = {
            "version": 1,
            "pubsub": {"security": security, "url": system.free_multicast_url(), "keys": {"source": "files"}},
            "bridges": {"cell": {"kind": "virtual", "space": 300}},
        }
        fleet = folder / "fleet.json"
        fleet.write_text(json.dumps(raw))
        write_keys(folder, FleetConfig.model_validate(raw))

        def start(*arguments: object) -> Node:
            command = [python, "-m", "benchmarks._actions", *map(str, arguments)]
            node = Node(*command, env=os.environ | {"PYTHONPATH": ".:bridges"}, cwd=root)
            stack.callback(node.end)
            return node

        start("bridge", fleet, journal)
        self._client = start("client", fleet, journal)
        self._request, response = json.loads(self._client.ready.removeprefix("ready"))
        self._port = int(start("echo", response).ready.removeprefix("ready"))
        self.ours(WARM_UP)

    def ours(self, count: int = MEASURED) -> tuple[float, float]:
        """Median and 99th percentile of our round trips."""
        self._client.tell(f"ours {count}")
        return median_and_p99(self._client.ages())

    def echo(self) -> tuple[float, float]:
        """The same of the echo."""
        self._client.tell(f"echo {MEASURED} {self._request} {self._port}")
        return median_and_p99(self._client.ages())


@contextlib.contextmanager
def all_ways(other: Path | None) -> Generator[list[tuple[Way, Way | None]]]:
    """Each way, and the same of the other commit."""
    with contextlib.ExitStack() as stack:
        ways: list[tuple[Way, Way | None]] = []
        for _, security, journal in WAYS:
            way = Way(security, journal, stack)
            python = "" if other is None else str(other / ".venv" / "bin" / "python")
            ways.append((way, None if other is None else Way(security, journal, stack, python, other)))
        yield ways


def figures(rounds: int) -> list[Figure]:
    others: list[list[float]] = [[] for _ in WAYS]
    measured: list[list[tuple[float, float, float, float]]] = []
    with all_ways(beside()) as ways:
        for _ in range(max(rounds, FEWEST_ROUNDS)):
            measured.append([])
            for (way, other), of_other in zip(ways, others, strict=True):
                measured[-1].append((*way.echo(), *way.ours()))
                of_other += [] if other is None else [other.ours()[0]]
    rows: list[Figure] = []
    for (name, _, _), of_way, of_other in zip(WAYS, zip(*measured, strict=True), others, strict=True):
        echo_p50, echo_p99, p50, p99 = (statistics.median(column) for column in zip(*of_way, strict=True))
        rows.append(shown(f"accepted, {name}, p50", p50, "us", reference=REFERENCE, reference_value=echo_p50))
        rows.append(shown(f"accepted, {name}, p99", p99, "us", reference=REFERENCE, reference_value=echo_p99))
        if of_other:
            before = statistics.median(of_other)
            rows.append(shown(f"accepted, {name}, p50, beside", p50, "us", reference=OTHER, reference_value=before))
    return rows
