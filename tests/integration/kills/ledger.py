"""What machines were told, held against what the server has written down of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from ua_fleet.scenario.facts import Fact, RunEnded, TaskAssigned, TaskOutcome, TaskOver
from ua_fleet.storage.server_records import ServerRecords

__all__ = ["Ledger", "facts_of", "keep"]

NEVER_BEGUN = (TaskOutcome.REFUSED, TaskOutcome.BUSY, TaskOutcome.TIMED_OUT)
"""Tasks of these tests have no timeout of their own: it is the responder that says so."""


@dataclass(slots=True)
class Ledger:
    """Executions by what became of them."""

    assigned: int = 0
    done: int = 0
    failed: int = 0
    never_begun: int = 0
    unknown: list[str] = field(default_factory=list[str])
    """Nobody can tell whether they were done."""
    doubled: list[str] = field(default_factory=list[str])
    """Told more than once, or to another machine than the one that was meant."""
    lost: list[str] = field(default_factory=list[str])
    """Held to be done or failed though no machine was told, or never ended."""
    invented: list[str] = field(default_factory=list[str])
    """Told though nobody has asked, or though it is held that it never was."""

    def __str__(self) -> str:
        counts = f"{self.done} done, {self.failed} failed, {self.never_begun} never begun, {len(self.unknown)} unknown"
        wrong = f"{len(self.doubled)} doubled, {len(self.lost)} lost, {len(self.invented)} invented"
        return f"{self.assigned} executions: {counts}; {wrong}"


def facts_of(state_dir: Path) -> list[Fact]:
    """All facts of all runs of a server that has ended."""
    with ServerRecords(state_dir) as records:
        return [fact for run in records.runs.runs() for fact in records.runs.facts(run.run_id)]


def keep(facts: Iterable[Fact], told: Iterable[tuple[str, str]]) -> Ledger:
    """Hold facts of runs against what machines were told.

    Args:
        facts: of complete runs, in their order within each run.
        told: robot and execution id of each thing that a machine was told.
    """
    ledger = Ledger()
    by_robot = Counter(told)
    times = Counter({execution_id: 0 for _, execution_id in by_robot})
    for (_, execution_id), count in by_robot.items():
        times[execution_id] += count
    ledger.doubled += [execution_id for execution_id, count in times.items() if count > 1]
    last: dict[str, str] = {}
    """The last execution of each step."""
    open_: set[str] = set()
    """Executions that are under way."""
    known: set[str] = set()
    for fact in facts:
        if isinstance(fact, TaskAssigned):
            ledger.assigned += 1
            known.add(fact.execution_id)
            open_.add(fact.execution_id)
            last[fact.step] = fact.execution_id
            if any(id_ == fact.execution_id and robot != fact.robot for robot, id_ in by_robot):
                ledger.doubled.append(fact.execution_id)
        elif isinstance(fact, TaskOver):
            execution_id = last[fact.step]
            open_.discard(execution_id)
            if execution_id in ledger.unknown:  # the robot could tell after all
                ledger.unknown.remove(execution_id)
            _close(ledger, execution_id, fact.outcome, times)
        elif isinstance(fact, RunEnded):
            ledger.lost += open_
            open_.clear()
    ledger.invented += times.keys() - known
    return ledger


def _close(ledger: Ledger, execution_id: str, outcome: TaskOutcome, times: Counter[str]) -> None:
    was_told = times[execution_id] > 0
    if outcome is TaskOutcome.UNKNOWN:
        ledger.unknown.append(execution_id)
    elif outcome in NEVER_BEGUN:
        ledger.never_begun += 1
        if was_told:
            ledger.invented.append(execution_id)
    else:
        if outcome is TaskOutcome.DONE:
            ledger.done += 1
        else:
            ledger.failed += 1
        if not was_told:
            ledger.lost.append(execution_id)
