"""What the summaries of 1,000 robots with 10 values at 1 Hz cost: CPU of the server's process for each second.

Every value of every robot is another one each second, so each summary is. The floor is the same server without
summaries. Then with a client that follows a list of all robots: by the summaries, or by State, LastUpdate and HeldBy of
each robot, which is the least that a list could do without them and tells neither quality nor tasks nor faults.
"""

from __future__ import annotations

import contextlib
import statistics
import time

from benchmarks._ingest import PUBLISHING_MS
from benchmarks._summaries import PARTS, ROBOTS, TOLD
from benchmarks.harness import FEWEST_ROUNDS, Figure, at_most, interleaved, shown
from benchmarks.ingest import Process
from tests import system

PASSES = 3
MOST = 1.25
"""Of the floor's CPU: summaries are for all clients together."""
MODULE = "benchmarks._summaries"


class Road:
    """A server, with a client that follows something."""

    def __init__(self, what: str, stack: contextlib.ExitStack, *, summaries: bool) -> None:
        port = system.free_tcp_port()
        self._server = Process("server", port, "with" if summaries else "without", module=MODULE)
        stack.callback(self._server.end)
        self._told = TOLD[what]
        self._client = Process("client", f"opc.tcp://127.0.0.1:{port}/ua_fleet", what, module=MODULE)
        stack.callback(self._client.end)
        first = ROBOTS * len(PARTS) if what == "nodes" else self._told
        self._client.ask(first)
        self._value = 0.0
        self._second()  # quality and state of all robots change
        self._second()

    def measure(self) -> float:
        """CPU seconds of the server for a second; the median of a few."""
        return statistics.median(self._second() for _ in range(PASSES))

    def _second(self) -> float:
        self._value += 1.0
        seconds = self._server.ask(self._value)
        if self._told:
            self._client.ask(self._told)
            seconds = self._server.ask("cpu")
        time.sleep(2 * PUBLISHING_MS / 1000)
        self._client.ask(0)  # what came besides is none of the next second
        return seconds


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    with contextlib.ExitStack() as stack:
        without = Road("nothing", stack, summaries=False)
        own = Road("nothing", stack, summaries=True)
        followed = Road("summaries", stack, summaries=True)
        each = Road("nodes", stack, summaries=False)
        roads = [without, own, followed, each]
        floor, alone, listed, by_node = [
            seconds * 1e3 for seconds in interleaved(rounds, [road.measure for road in roads])
        ]
    return [
        at_most(
            f"CPU for a second of {ROBOTS:,} robots, nobody looks",
            alone,
            "ms",
            reference="without summaries",
            reference_value=floor,
            goal=MOST,
        ),
        shown("CPU for what they add", alone - floor, "ms", reference="without summaries", reference_value=floor),
        shown(
            "CPU for a list that a client follows",
            listed - alone,
            "ms",
            reference=f"{', '.join(PARTS)} of each robot",
            reference_value=by_node - floor,
        ),
    ]
