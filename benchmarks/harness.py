"""What every benchmark shares: figures beside a peer or a floor, measured in turn in the same run.

A group is a module `benchmarks/<group>.py` with `figures(rounds) -> list[Figure]`. It measures with `interleaved`, and
makes its rows with `at_least`, `at_most` or `shown`. A group that cannot run here raises Unavailable with the reason;
one in which something went wrong raises Failed.
"""

from __future__ import annotations

import json
import os
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

__all__ = [
    "BESIDE",
    "FEWEST_ROUNDS",
    "OTHER",
    "PART",
    "Failed",
    "Figure",
    "Unavailable",
    "at_least",
    "at_most",
    "beside",
    "interleaved",
    "merge_results",
    "seconds_per_call",
    "shown",
    "wanted",
    "within",
]

FEWEST_ROUNDS = 5


BESIDE = "BENCHMARKS_BESIDE"
OTHER = "the other commit"


def beside() -> Path | None:
    """The clone of another commit, set up as this one, whose figures are measured in turn with these."""
    folder = os.environ.get(BESIDE)
    return None if folder is None else Path(folder)


PART = "BENCHMARKS_PART"
"""Environment variable: the part of a group that alone is measured."""


def wanted(part: str) -> bool:
    """Whether this part of a group is to be measured; all are, where none is named."""
    return os.environ.get(PART) in (None, part)


class Figure(NamedTuple):
    """One row of `results.json`."""

    name: str
    value: float
    unit: str
    reference: str
    """The peer or the floor."""
    reference_value: float
    ratio: float
    goal: float | None
    """What `ratio` is held against; None where the figure is only shown."""
    holds: bool


class Unavailable(Exception):
    """A group that cannot run on this machine, and why."""


class Failed(Exception):
    """A group in which something went wrong, and what: it has no figures, and the run ends with exit code 1."""


def at_least(name: str, value: float, unit: str, *, reference: str, reference_value: float, goal: float) -> Figure:
    """A time (or another cost) that has to be at least `goal` times smaller than the reference."""
    ratio = reference_value / value
    return Figure(name, value, unit, reference, reference_value, ratio, goal, ratio >= goal)


def at_most(
    name: str,
    value: float,
    unit: str,
    *,
    reference: str,
    reference_value: float,
    goal: float,
    fails_beyond: float | None = None,
) -> Figure:
    """A cost that may be at most `goal` times the reference; missing it is no failure yet with `fails_beyond`."""
    ratio = value / reference_value
    limit = goal if fails_beyond is None else fails_beyond
    return Figure(name, value, unit, reference, reference_value, ratio, goal, ratio <= limit)


def within(name: str, value: float, unit: str, limit: float) -> Figure:
    """A cost that may be at most a limit, which is no floor but what was asked for."""
    return Figure(name, value, unit, "goal", limit, value / limit, 1.0, value <= limit)


def shown(name: str, value: float, unit: str, *, reference: str, reference_value: float) -> Figure:
    """A figure without a goal, beside its floor."""
    return Figure(name, value, unit, reference, reference_value, value / reference_value, None, True)


def interleaved(rounds: int, measures: Sequence[Callable[[], float]]) -> list[float]:
    """The median of each measure over so many rounds, in each of which every measure runs once.

    Whatever slows the machine down for a while slows all of them down.
    """
    samples = [[measure() for measure in measures] for _ in range(max(rounds, FEWEST_ROUNDS))]
    return [statistics.median(column) for column in zip(*samples, strict=True)]


def seconds_per_call(function: Callable[[Any], object], arguments: Sequence[Any], repeats: int) -> float:
    """Seconds that a call takes, over all arguments, `repeats` times; the loop's own cost is in it."""
    started = time.perf_counter()
    for _ in range(repeats):
        for argument in arguments:
            function(argument)
    return (time.perf_counter() - started) / (repeats * len(arguments))


def merge_results(path: Path, group: str, figures: Iterable[Figure]) -> None:
    """Put the rows of a group into the file in place of those it had; other rows stay, and those of its other parts."""
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    new = [figure._replace(name=f"{group}: {figure.name}")._asdict() for figure in figures]
    if PART in os.environ:
        replaced = {row["name"] for row in new}
    else:
        replaced = {row["name"] for row in rows if str(row["name"]).startswith(f"{group}: ")}
    kept = [row for row in rows if row["name"] not in replaced]
    merged = sorted([*kept, *new], key=lambda row: str(row["name"]).partition(": ")[0])
    path.write_text(json.dumps(merged, indent=2) + "\n", encoding="utf-8")
