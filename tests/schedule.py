"""Which process of `make test` runs which file of tests next.

Some files compute nearly all of the time, most wait for processes that they have started. Where four files of the first
kind are run side by side on two cores, all of them are late; where six of the second are, the cores rest. So as many
processes as there are cores take those that compute, the others those that wait, each the longest first, and what
nobody has measured last: the many short files of `tests/unit` fill the end up. Who finds none of its kind helps out.

`durations.txt` has what was measured, with the files alone on two cores; it decides an order and nothing else.
"""

from __future__ import annotations

import functools
import os
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, NamedTuple

from xdist.scheduler.loadscope import LoadScopeScheduling

__all__ = ["DURATIONS", "TOGETHER", "Duration", "KindScheduling", "computes", "durations", "in_order", "unit_of"]

DURATIONS: Final = Path(__file__).with_name("durations.txt")
TOGETHER: Final = ("tests/integration/cli/",)
"""Folders whose files share something that takes long to start; they are run one after the other."""
_COMPUTES: Final = 0.5
"""What computes for more than this part of its time is of the kind that computes."""


class Duration(NamedTuple):
    """What a file of tests takes."""

    seconds: float
    cpu_seconds: float


def unit_of(nodeid: str) -> str:
    """The file of a test, or the folder whose files are run by one process."""
    path = nodeid.split("::", 1)[0]
    return next((folder for folder in TOGETHER if path.startswith(folder)), path)


@functools.cache
def durations() -> dict[str, Duration]:
    """What was measured, by the file or folder."""
    found: dict[str, Duration] = {}
    for line in DURATIONS.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            seconds, cpu_seconds, path = line.split()
            found[path] = Duration(float(seconds), float(cpu_seconds))
    return found


def computes(unit: str) -> bool:
    """Whether a file or folder computes for most of its time."""
    if (known := durations().get(unit)) is not None:
        return known.cpu_seconds > _COMPUTES * known.seconds
    return unit.startswith("tests/unit/")


def in_order(units: Iterable[str]) -> list[str]:
    """The longest first; those that nobody has measured come last, in the order in which they are given."""
    known = durations()
    return sorted(units, key=lambda unit: -known[unit].seconds if unit in known else 0.0)


class KindScheduling(LoadScopeScheduling):
    """Gives a file to one process, and the next one when that has two tests left."""

    def __init__(self, config: Any, log: Any = None) -> None:
        super().__init__(config, log)
        self._cores = len(os.sched_getaffinity(0))
        self._places: dict[str, int] = {}

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
