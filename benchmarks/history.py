"""What history costs a whole server: 5,000 values a second into each store, and a day of seconds read back.

50 robots send ten numbers each at 10 Hz by UDP, and a client watches all of them. The server without a history is the
floor of those with SQLite and PostgreSQL. The figures of reading are of a store with a day of one node, in blocks, over
an encrypted connection; the client decodes nothing but the continuation points.

HISTORY_SECONDS says how long values are sent in each of the three servers (20; the goals are meant for 600).
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import tempfile
import threading
import time
from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks._history import BEGIN, PASSWORD, READ_NODE, SECONDS, SPACE, USER, robots_config
from benchmarks.harness import FEWEST_ROUNDS, Figure, interleaved, within
from benchmarks.ingest import Process
from tests import postgres, system
from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore
from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import Row
from ua_fleet.history.store import HistoryStore
from ua_fleet.storage.history_store import HISTORY_FILE, SqliteHistory
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, NodeId, ticks_from_datetime

MODULE = "benchmarks._history"
SECONDS_SENT = float(os.environ.get("HISTORY_SECONDS", "20"))
WARM_S = 3.0
MOST_CORE = 0.2
MOST_SLOWER, MOST_LATER_MS = 1.2, 5.0
LONG = 36_500
"""Days: what is read lies in the past."""


class Sent(NamedTuple):
    """What values have cost."""

    cpu: float
    """Of a core, in the server's process."""
    age_p99_ms: float


class Place:
    """A folder with a fleet."""

    def __init__(self, folder: Path, history: dict[str, Any] | None) -> None:
        self.folder, self.port = folder, system.free_tcp_port()
        self.group = system.free_multicast_url()
        self.url = f"opc.tcp://127.0.0.1:{self.port}/ua_fleet"
        raw: dict[str, Any] = {
            "version": 1,
            "server": {
                "port": self.port, "trust_all_clients": True, "allow_none_security": True, "allow_anonymous": True
            },
            "pubsub": {"security": "none", "url": self.group, "interface": "lo"},
            "bridges": {"side": {"kind": "ros2", "space": SPACE, "status_id": 900}},
            "robots": robots_config(),
            **({} if history is None else {"history": history}),
        }  # fmt: skip
        self.fleet = folder / "fleet.yaml"
        self.fleet.write_text(json.dumps(raw))
        state = folder / "state"
        state.mkdir(mode=0o700, exist_ok=True)
        UserStore(state / USERS_FILE).add(USER, PASSWORD, Role.OPERATOR)

    def sent(self) -> Sent:
        """Send values for a while."""
        with contextlib.ExitStack() as stack:
            server, robots, watcher = (
                _process(stack, *arguments)
                for arguments in (("server", self.fleet), ("robots", self.group), ("watcher", self.url))
            )
            robots.ask(WARM_S)
            watcher.ask("age")
            before, began = server.ask("cpu"), time.monotonic()
            count = robots.ask(SECONDS_SENT)
            seconds = time.monotonic() - began
            cpu = server.ask("cpu") - before
            assert count / seconds > 4_800, f"{count / seconds:.0f} values a second: the machine is too slow"
            return Sent(cpu / seconds, watcher.ask("age"))


def _process(stack: contextlib.ExitStack, *arguments: object) -> Process:
    process = Process(*arguments, module=MODULE)
    stack.callback(process.end)
    return process


def fill(store: HistoryStore) -> float:
    """A day of one node, in blocks; bytes that a value takes."""
    random_, begin = random.Random(5), ticks_from_datetime(BEGIN)
    key, kind = NodeId(2, READ_NODE), int(BuiltinType.DOUBLE)
    rows: list[Kept] = [
        (key, Row(begin + second * TICKS_PER_SECOND, 0, kind, random_.gauss(20, 3))) for second in range(SECONDS)
    ]
    for at in range(0, SECONDS, 5_000):
        store.write(rows[at : at + 5_000], rows[at][1].time)
    now = rows[-1][1].time
    while store.tend(now, lambda _key: LONG, 2**40):
        pass
    return store.used_bytes() / SECONDS


class Read:
    """A server whose store has a day."""

    def __init__(self, place: Place, stack: contextlib.ExitStack) -> None:
        self._server = _process(stack, "server", place.fleet)
        self._reader = _process(stack, "reader", place.url, place.folder / "reader")
        self._other = _process(stack, "reader", place.url, place.folder / "other")
        for what in ("raw", "average"):
            self._reader.ask(what)

    def cpu(self, what: str) -> float:
        before = self._server.ask("cpu")
        self._reader.ask(what)
        return self._server.ask("cpu") - before

    def seconds(self, what: str) -> float:
        return self._reader.ask(what)

    def slowest_other_ms(self, what: str) -> float:
        """Of small requests of another client meanwhile."""
        found: list[float] = []
        asking = threading.Thread(target=lambda: found.append(self._other.ask("others 2")))
        asking.start()
        while asking.is_alive():
            self._reader.ask(what)
        asking.join()
        return found[0]


@contextlib.contextmanager
def _databases() -> Generator[postgres.Postgres | None]:
    """A PostgreSQL, where there is one."""
    if postgres.programs() is None:
        yield None
        return
    with postgres.Postgres() as running:
        yield running


def _postgres_history(place: Path, url: str) -> dict[str, Any]:
    secret = place / "secrets" / "history"
    secret.parent.mkdir()
    secret.write_text(postgres.PASSWORD + "\n")
    secret.chmod(0o600)
    return {"store": url, "user": postgres.USER, "password_file": "secrets/history"}


def _written(folder: Path, server: postgres.Postgres | None) -> list[Figure]:
    kinds: list[str] = ["none", "SQLite", *(["PostgreSQL"] if server is not None else [])]
    measured: dict[str, Sent] = {}
    for kind in kinds:
        place = folder / kind
        place.mkdir()
        with contextlib.ExitStack() as stack:
            history: dict[str, Any] | None = None if kind == "none" else {}
            if kind == "PostgreSQL":
                assert server is not None
                history = _postgres_history(place, stack.enter_context(server.database("written")))
            measured[kind] = Place(place, history).sent()
    floor = measured["none"]
    found: list[Figure] = []
    for kind in kinds[1:]:
        sent = measured[kind]
        found.append(within(f"5,000 values a second into {kind}, CPU more", sent.cpu - floor.cpu, "core", MOST_CORE))
        limit = max(MOST_SLOWER * floor.age_p99_ms, floor.age_p99_ms + MOST_LATER_MS)
        found.append(within(f"99 % of notifications with {kind}, age at most", sent.age_p99_ms, "ms", limit))
    return found


def _read(folder: Path, server: postgres.Postgres | None, rounds: int) -> list[Figure]:
    found: list[Figure] = []
    for kind in ("SQLite", *(["PostgreSQL"] if server is not None else [])):
        place = folder / f"read {kind}"
        place.mkdir()
        with contextlib.ExitStack() as stack:
            history: dict[str, Any] = {}
            store: HistoryStore
            if server is not None and kind == "PostgreSQL":
                from ua_fleet.storage.postgres_history import PostgresHistory

                url = stack.enter_context(server.database("read"))
                history = _postgres_history(place, url)
                store = PostgresHistory(url, postgres.USER, postgres.PASSWORD)
            else:
                store = SqliteHistory(place / "state" / HISTORY_FILE)
            with contextlib.closing(store):
                size = fill(store)
            read = Read(Place(place, {**history, "days": LONG}), stack)
            measures: list[Callable[[], float]] = [
                partial(read.cpu, "raw"), partial(read.seconds, "raw"), partial(read.seconds, "average"),
                partial(read.slowest_other_ms, "raw"), partial(read.slowest_other_ms, "average"),
            ]  # fmt: skip
            cpu, last, average, other, other_than_average = interleaved(rounds, measures)
        what = f"86,400 values of {kind} read raw"
        found += [
            within(f"bytes of a value in {kind}, compacted", size, "B", 24),
            within(f"{what}, CPU of the server", cpu, "s", 0.4),
            within(f"{what}, until the last byte", last, "s", 1.0),
            within(f"{what}, the slowest other request meanwhile", other, "ms", 20),
            within(f"Average of {kind} in 96 intervals", average * 1e3, "ms", 150),
            within(f"Average of {kind}, the slowest other request meanwhile", other_than_average, "ms", 20),
        ]
    return found


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    with tempfile.TemporaryDirectory() as folder, _databases() as server:
        return [*_read(Path(folder), server, rounds), *_written(Path(folder), server)]
