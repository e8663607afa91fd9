"""What was there when the server ended: runs that were under way, and faults."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Sequence

from ua_fleet.operation.log import Log
from ua_fleet.operation.runs.finding import FaultFinder
from ua_fleet.operation.runs.library import Checked
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.orchestrator import Fault, Orchestrator, Output
from ua_fleet.scenario import Scenario
from ua_fleet.scenario.facts import Fact, RunCreated, RunEnded, RunOutcome
from ua_fleet.storage.run_journal import RunJournal

__all__ = ["restore_faults", "scenario_to_go_on"]


def scenario_to_go_on(
    record: RunRecord,
    facts: Sequence[Fact],
    check: Callable[[str], Checked],
    journal: RunJournal,
    *,
    log: Log,
    now: float,
) -> Scenario | None:
    """The scenario of a run that goes on; None after ending a run that no longer fits the fleet.

    Args:
        record: of the run; takes its end in.
        facts: of the run.
        check: a scenario's text against the fleet as it is now.
        journal: its end is written there.
        log: is told of its end.
        now: wall time in seconds.

    Raises:
        StorageUnavailable: the end cannot be written.
    """
    text = next((fact.text for fact in facts if isinstance(fact, RunCreated)), "")
    checked = check(f"{text}\n")
    if not checked.problems:
        return checked.scenario
    reason = f"it does not fit the fleet any more: {checked.problems[0]}"
    ended = RunEnded(now, RunOutcome.FAILED, reason)
    log.error("run cannot go on after the restart", run_id=record.run_id, reason=reason)
    journal.write([(record.run_id, ended)])
    record.apply(ended)
    return None


def restore_faults(
    faults: Iterable[Fault], robots: Container[str], orchestrator: Orchestrator, finder: FaultFinder, now: float
) -> list[Output]:
    """Have the orchestrator know faults of robots that are still there; what follows from that.

    Args:
        faults: as they were kept.
        robots: names of those that are there.
        orchestrator: gets them, acknowledged and over as they were.
        finder: told of those whose end it has to find.
        now: wall time in seconds.
    """
    outputs: list[Output] = []
    for fault in faults:
        if fault.robot not in robots:
            continue
        outputs += orchestrator.fault_raised(fault.robot, fault.source, fault.reason, fault.since, fault.capacities)
        if fault.acknowledged:
            outputs += orchestrator.acknowledge(fault.id, fault.acknowledged_by, now)
        if fault.active:
            finder.restored(fault)
        else:
            outputs += orchestrator.fault_cleared(fault.robot, fault.source, now)
    return outputs
