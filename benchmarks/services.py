"""CPU of the server for one request of each service, beside stock servers of asyncua and node-opcua in the same rounds.

All have the same 1,000 Doubles in ten folders, one client, and the same requests one after the other, secured
(Basic256Sha256, signed and encrypted) and unsecured. What the client computes is in no figure.

Then 50 clients watch all values, which are written 10 times a second: what a notification costs the server, and how
old it is when it comes.
"""

from __future__ import annotations

import contextlib
import statistics
import tempfile
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from benchmarks._services import URI, VALUES
from benchmarks.harness import FEWEST_ROUNDS, OTHER, Figure, at_least, beside, interleaved, wanted, within
from benchmarks.ingest import Process
from tests import system
from ua_fleet.endpoint.certificates import ensure_application_certificate

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
    Job("Connect", 1, 300, OTHERS),
)


NODE_SERVER: Final = system.ROOT / "tests" / "interop" / "node_modules" / "node-opcua-server"
NODE: Final = "benchmarks/_services_node.cjs"
BESIDE_NODE: Final = {("Read", 100), ("Read", 1_000), ("Browse", 1), ("Write", 100), ("Call", 1)}
"""Requests that node-opcua's server answers in the same rounds: it has to take no less."""
CLIENTS, HERTZ, INTERVAL_MS = 50, 10, 100
WATCHED_S: Final = 4


class Served:
    """A server with a client that asks, or with clients that watch."""

    def __init__(
        self, role: str, policy: str, stack: contextlib.ExitStack, *, asking: str = "client", root: Path = system.ROOT
    ) -> None:
        folder, port = stack.enter_context(tempfile.TemporaryDirectory()), system.free_tcp_port()
        if role == "node":
            own = ensure_application_certificate(Path(folder) / "node", URI, ["127.0.0.1"])
            self._server = Process(port, own.certificate, own.private_key, f"{folder}/pki", module=NODE)
        else:
            self._server = Process(role, port, folder, module=MODULE, root=root)
        stack.callback(self._server.end)
        self._client = Process(asking, f"opc.tcp://127.0.0.1:{port}/ua_fleet", folder, policy, module=MODULE)
        stack.callback(self._client.end)

    def watch(self) -> None:
        """Have the clients watch all values, which are written from now on."""
        self._client.ask(f"watch {CLIENTS} {VALUES} {INTERVAL_MS}")
        self._server.ask(f"write {HERTZ}")
        self._client.ask("count 1")

    def seconds_per_notification(self) -> float:
        """CPU of the server's process, with that of writing the values."""
        before = self._server.ask("cpu")
        number = self._client.ask(f"count {WATCHED_S}")
        return (self._server.ask("cpu") - before) / number

    def age_s(self) -> float:
        """The 99th percentile of the ages of the notifications that were counted last."""
        return self._client.ask("age")

    def rest(self) -> None:
        """Write no more."""
        self._server.ask("write 0")

    def seconds_per_request(self, job: Job) -> float:
        """CPU of the server's process."""
        self._client.ask(f"{job.service} {job.operations} {max(1, job.requests // 10)}")
        before = self._server.ask("cpu")
        self._client.ask(f"{job.service} {job.operations} {job.requests}")
        return (self._server.ask("cpu") - before) / job.requests


def figures(rounds: int) -> list[Figure]:
    found: list[Figure] = []
    with_node = system.missing("node") is None and NODE_SERVER.exists()
    for name, policy in POLICIES.items():
        with contextlib.ExitStack() as stack:
            ours, stock = Served("ours", policy, stack), Served("stock", policy, stack)
            node = Served("node", policy, stack) if with_node else None
            for job in JOBS:
                if not wanted(job.service):
                    continue
                servers = [ours, stock]
                if node is not None and (job.service, job.operations) in BESIDE_NODE:
                    servers.append(node)
                value, reference, *others = interleaved(
                    rounds, [partial(server.seconds_per_request, job) for server in servers]
                )
                what = f"{job.service} of {job.operations}" if job.operations > 1 else job.service
                found.append(
                    at_least(
                        f"{what}, {name}, CPU of the server", value * 1e6, "us",
                        reference="stock asyncua", reference_value=reference * 1e6, goal=job.goals[name],
                    )
                )  # fmt: skip
                found.extend(
                    at_least(
                        f"{what}, {name}, CPU of the server beside node-opcua", value * 1e6, "us",
                        reference="node-opcua", reference_value=other * 1e6, goal=1.0,
                    )
                    for other in others
                )  # fmt: skip
    return found + (watched(rounds) if wanted("notification") else [])


def watched(rounds: int) -> list[Figure]:
    """What notifications cost, one server after the other: each takes all that it gets of the machine."""
    roots = {"ours": ("ours", system.ROOT), "stock asyncua": ("stock", system.ROOT)}
    if (other := beside()) is not None:
        roots[OTHER] = "ours", other
    costs: dict[str, list[float]] = {name: [] for name in roots}
    ages: list[float] = []
    with contextlib.ExitStack() as stack:
        servers = {
            name: Served(role, "Basic256Sha256", stack, asking="watchers", root=root)
            for name, (role, root) in roots.items()
        }
        for _ in range(max(rounds, FEWEST_ROUNDS)):
            for name, server in servers.items():
                server.watch()
                costs[name].append(server.seconds_per_notification())
                if name == "ours":
                    ages.append(server.age_s())
                server.rest()
    medians = {name: statistics.median(values) for name, values in costs.items()}
    what = f"a notification to one of {CLIENTS} clients with {VALUES:,} items, secured"
    rows = [
        at_least(
            f"{what}, CPU of the server", medians["ours"] * 1e6, "us",
            reference=name, reference_value=value * 1e6, goal=1.0,
        )
        for name, value in medians.items() if name != "ours"
    ]  # fmt: skip
    limit_ms = 1.5 * INTERVAL_MS
    return [*rows, within(f"{what}, age, p99", statistics.median(ages) * 1e3, "ms", limit_ms)]
