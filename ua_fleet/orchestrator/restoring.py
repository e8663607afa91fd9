"""A run of the journal whose facts cannot be taken in, by a mistake of ours: it ends, and its robots are to stop."""

from __future__ import annotations

from collections.abc import Iterable

from ua_fleet.orchestrator.outputs import Halt
from ua_fleet.scenario.facts import Fact, RunEnded, RunOutcome, TaskAssigned, TaskOver, Then

__all__ = ["end_of", "halts_of"]


def halts_of(facts: Iterable[Fact], now: float) -> list[Halt]:
    """What robots may be at, by the facts themselves."""
    begun: dict[str, TaskAssigned] = {}
    for fact in facts:
        if isinstance(fact, TaskAssigned):
            begun[fact.step] = fact
        elif isinstance(fact, TaskOver) and fact.then not in (Then.ASK, Then.AWAIT):
            begun.pop(fact.step, None)
    return [Halt(fact.execution_id, fact.robot, fact.skill, now) for fact in begun.values()]


def end_of(error: Exception, now: float) -> RunEnded:
    """How such a run ends."""
    reason = f"a mistake of ua_fleet ({type(error).__name__}: {error}), so that it cannot go on; report the log"
    return RunEnded(now, RunOutcome.FAILED, reason)
