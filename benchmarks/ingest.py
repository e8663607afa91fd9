"""10,000 nodes with 0, 1,000 and 10,000 monitored items: CPU of the server's process for each update.

Ours goes from a received message through state, coalescer and projection to the node and its notification; the
reference is `write_value` of a stock asyncua server. The client is another process, for both the same. Each pass writes
another value to every node, and is over when the client has all its notifications.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path

from benchmarks._ingest import NODES, PUBLISHING_MS
from benchmarks.harness import FEWEST_ROUNDS, Figure, interleaved, shown
from tests import system

MONITORED = (0, 1_000, NODES)
PASSES = 3
GOAL = 2.0
REFERENCE = "stock asyncua write_value"


class Process:
    """A child that answers each line with a line."""

    def __init__(self, *arguments: object, module: str = "benchmarks._ingest", root: Path = system.ROOT) -> None:
        """Start a module of ours, or the program whose file it is: a script of Node's.

        Args:
            arguments: of the program.
            module: its name, or its path where it ends with `.cjs`.
            root: of the clone that it is of.
        """
        program = ["node", module] if module.endswith(".cjs") else [sys.executable, "-m", module]
        modules = system.ROOT / "tests" / "interop" / "node_modules"
        self._child = subprocess.Popen(
            [*program, *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=root,
            env={**os.environ, "NODE_PATH": str(modules)},
        )
        self._name = str(arguments[0])
        assert self._line() == "ready"

    def _line(self) -> str:
        assert self._child.stdout is not None
        line = self._child.stdout.readline().strip()
        if not line:
            raise RuntimeError(f"the process {self._name} of the benchmark ended")
        return line

    def ask(self, line: object) -> float:
        assert self._child.stdin is not None
        self._child.stdin.write(f"{line}\n")
        self._child.stdin.flush()
        return float(self._line())

    def end(self) -> None:
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.close()
        self._child.wait(30)
        self._child.stdout.close()


class Road:
    """A server with its client."""

    def __init__(self, role: str, monitored: int, stack: contextlib.ExitStack) -> None:
        port = system.free_tcp_port()
        self._server = Process(role, port)
        stack.callback(self._server.end)
        self._monitored = monitored
        self._client: Process | None = None
        if monitored:
            self._client = Process("client", f"opc.tcp://127.0.0.1:{port}/ua_fleet", monitored)
            stack.callback(self._client.end)
            self._client.ask(monitored)
        self._value = 0.0

    def measure(self) -> float:
        """CPU seconds of the server for one update; the median of a few passes."""
        return statistics.median(self._pass() for _ in range(PASSES)) / NODES

    def _pass(self) -> float:
        self._value += 1.0
        seconds = self._server.ask(self._value)
        if self._client is not None:
            told = self._client.ask(self._monitored)
            assert told == self._monitored, told
            seconds = self._server.ask("cpu")
        # Not before the analog values may be written again.
        time.sleep(2 * PUBLISHING_MS / 1000)
        return seconds


@contextlib.contextmanager
def roads(monitored: int) -> Generator[tuple[Road, Road]]:
    with contextlib.ExitStack() as stack:
        yield Road("stock", monitored, stack), Road("ours", monitored, stack)


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    rows: list[Figure] = []
    for monitored in MONITORED:
        with roads(monitored) as (stock, ours):
            for road in (stock, ours):
                road.measure()
            theirs, own = interleaved(rounds, [stock.measure, ours.measure])
        name = f"CPU for each update, {monitored:,} of {NODES:,} nodes monitored"
        rows.append(shown(name, own * 1e6, "us", reference=REFERENCE, reference_value=theirs * 1e6))
        if monitored == NODES:
            ratio = theirs / own
            name = f"notifications for each CPU second, {monitored:,} monitored"
            rows.append(Figure(name, 1 / own, "1/s", REFERENCE, 1 / theirs, ratio, GOAL, ratio >= GOAL))
    return rows
