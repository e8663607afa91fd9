"""Which process of `make test` runs which file of tests next.

Some files compute nearly all of the time, most wait for processes that they have started. Where four files of the first
kind are run side by side on two cores, all of them are late; where six of the second are, the cores rest. So as many
processes as there are cores take those that compute, the others those that wait, each the longest first, and last what
no run has recorded: the many short files of `tests/unit` fill the end up. A process that finds none of its kind takes
one of the other.

`durations.txt` decides an order and nothing else. `make test ARGS=--record-durations` writes it anew.
"""

from __future__ import annotations

import functools
import os
from collections import OrderedDict, defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import pytest
from xdist.scheduler.loadscope import LoadScopeScheduling  # type: ignore[import-untyped]

__all__ = ["DURATIONS", "DurationRecorder", "KindScheduling", "computes", "durations", "in_order", "unit_of"]

DURATIONS: Final = Path(__file__).with_name("durations.txt")
_TOGETHER: Final = ("tests/integration/cli/",)
"""Folders whose files share something that takes long to start; they are run one after the other."""
_COMPUTE: Final = (
    "tests/architecture/",
    "tests/carried/",
    "tests/console/",
    "tests/docs/test_site",
    "tests/integration/server_model/",
    "tests/integration/server_security/",
    "tests/unit/",
)
"""How files begin that compute for more than half of their time."""
_NETWORK: Final = ("tests/integration/ros1/test_cut_off.py", "tests/integration/transport/test_udp")
"""How files begin that make and take away interfaces of the machine, for which a browser gives up what it loads."""
_BROWSERS: Final = "tests/console/"
_SHORTEST_S: Final = 3.0
"""Of what is recorded."""


def unit_of(nodeid: str) -> str:
    """The file of a test, or the folder whose files are run by one process."""
    path = nodeid.split("::", 1)[0]
    return next((folder for folder in _TOGETHER if path.startswith(folder)), path)


def computes(unit: str) -> bool:
    """Whether a file or folder computes for most of its time, or has to come after those that do."""
    return unit.startswith((*_COMPUTE, *_NETWORK))


@functools.cache
def durations() -> Mapping[str, float]:
    """Seconds that files and folders have taken."""
    lines = [line.split() for line in DURATIONS.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return {unit: float(seconds) for seconds, unit in lines}


def in_order(units: Iterable[str]) -> list[str]:
    """The longest first; those that no run has recorded come last, in the order in which they are given.

    Those of `tests/console` come before all others: they share a browser as long as no other file is between.
    Those that change the network come when all that is longer is under way, and so all that has a browser.
    """
    known = durations()

    def seconds(unit: str) -> float:
        if unit.startswith(_NETWORK):
            return _SHORTEST_S
        return known.get(unit, 2 * _SHORTEST_S if unit.startswith(_BROWSERS) else 0.0)

    return sorted(units, key=lambda unit: (not unit.startswith(_BROWSERS), -seconds(unit)))


class KindScheduling(LoadScopeScheduling):  # type: ignore[misc]
    """Gives a file to one process, and the next one when that has two tests left."""

    def __init__(self, config: Any, log: Any = None) -> None:
        super().__init__(config, log)
        self._cores = len(os.sched_getaffinity(0))
        self._places: dict[str, int] = {}
        self.workqueue: OrderedDict[str, dict[str, bool]]

    def _split_scope(self, nodeid: str) -> str:
        return unit_of(nodeid)

    def _assign_work_unit(self, node: Any) -> None:
        """Give a process the longest that is left of its kind."""
        if not self._places:
            # All processes have collected the same tests in the same order, else xdist ends the run before this.
            self._places = {nodeid: place for place, nodeid in enumerate(self.registered_collections[node])}
            self.workqueue = OrderedDict((unit, self.workqueue[unit]) for unit in in_order(self.workqueue))
        is_computing = self.nodes.index(node) < self._cores
        unit = next((unit for unit in self.workqueue if computes(unit) is is_computing), next(iter(self.workqueue)))
        tests = self.assigned_work[node][unit] = self.workqueue.pop(unit)
        node.send_runtest_some([self._places[nodeid] for nodeid, is_done in tests.items() if not is_done])


class DurationRecorder:
    """Writes what the files of a run have taken. What was not run keeps what it took before."""

    def __init__(self, path: Path = DURATIONS) -> None:
        self._path = path
        self._seconds: dict[str, float] = defaultdict(float)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A part of a test is done."""
        self._seconds[unit_of(report.nodeid)] += report.duration

    def pytest_sessionfinish(self) -> None:
        """All tests are done."""
        known = {unit: seconds for unit, seconds in {**durations(), **self._seconds}.items() if seconds >= _SHORTEST_S}
        lines = [f"{known[unit]:.0f} {unit}" for unit in sorted(known, key=lambda unit: (-round(known[unit]), unit))]
        header = "# Seconds of files of tests, of all that is in them: make test ARGS=--record-durations"
        self._path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
