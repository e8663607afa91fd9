"""CPU of the server for one request of each service, beside a stock asyncua server in the same rounds.

Both have the same 1,000 Doubles in ten folders, one client, and the same requests one after the other, secured
(Basic256Sha256, signed and encrypted) and unsecured. What the client computes is in no figure.
"""

from __future__ import annotations

import contextlib
import tempfile
from functools import partial
from typing import Final, NamedTuple

from benchmarks.harness import Figure, at_least, interleaved
from benchmarks.ingest import Process
from tests import system

MODULE: Final = "benchmarks._services"
POLICIES: Final = {"secured": "Basic256Sha256", "unsecured": "None"}


class Job(NamedTuple):
    """A request that is sent again and again."""

    service: str
    operations: int
    requests: int
    goals: dict[str, float]
    """How many times less than asyncua's it has to take."""


MANY: Final = {"secured": 3.0, "unsecured": 5.0}
ONE: Final = dict.fromkeys(POLICIES, 1.3)
OTHERS: Final = dict.fromkeys(POLICIES, 1.2)
JOBS: Final = (
    Job("Read", 1, 1_000, ONE),
    Job("Read", 100, 200, MANY),
    Job("Read", 1_000, 40, MANY),
    Job("Browse", 1, 200, MANY),
    Job("Browse", 10, 40, MANY),
    Job("Write", 100, 100, OTHERS),
    Job("Call", 1, 500, OTHERS),
    Job("CreateMonitoredItems", 100, 40, OTHERS),
    Job("Connect", 1, 30, OTHERS),
)


class Served:
    """A server with a client that asks."""

    def __init__(self, role: str, policy: str, stack: contextlib.ExitStack) -> None:
        folder, port = stack.enter_context(tempfile.TemporaryDirectory()), system.free_tcp_port()
        self._server = Process(role, port, folder, module=MODULE)
        stack.callback(self._server.end)
        self._client = Process("client", f"opc.tcp://127.0.0.1:{port}/ua_fleet", folder, policy, module=MODULE)
        stack.callback(self._client.end)

    def seconds_per_request(self, job: Job) -> float:
        """CPU of the server's process."""
        self._client.ask(f"{job.service} {job.operations} {max(1, job.requests // 10)}")
        before = self._server.ask("cpu")
        self._client.ask(f"{job.service} {job.operations} {job.requests}")
        return (self._server.ask("cpu") - before) / job.requests


def figures(rounds: int) -> list[Figure]:
    found: list[Figure] = []
    for name, policy in POLICIES.items():
        with contextlib.ExitStack() as stack:
            ours, stock = Served("ours", policy, stack), Served("stock", policy, stack)
            for job in JOBS:
                value, reference = interleaved(
                    rounds,
                    [partial(ours.seconds_per_request, job), partial(stock.seconds_per_request, job)],
                )
                what = f"{job.service} of {job.operations}" if job.operations > 1 else job.service
                found.append(
                    at_least(
                        f"{what}, {name}, CPU of the server", value * 1e6, "us",
                        reference="stock asyncua", reference_value=reference * 1e6, goal=job.goals[name],
                    )
                )  # fmt: skip
    return found
