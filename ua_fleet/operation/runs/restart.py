"""What was there when the server ended: runs that were under way, and faults."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Sequence
from typing import Final, NamedTuple

from ua_fleet.operation.log import Log
from ua_fleet.operation.runs.clock import SteadyTime
from ua_fleet.operation.runs.finding import FaultFinder
from ua_fleet.operation.runs.library import Checked
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.orchestrator import Fault, Halt, HaltChanged, Orchestrator, Output
from ua_fleet.orchestrator.faults import BY_PERSON
from ua_fleet.orchestrator.restoring import halts_of
from ua_fleet.scenario import Scenario
from ua_fleet.scenario.consequences import NOT_HALTED
from ua_fleet.scenario.facts import Fact, RunCarried, RunCreated, RunEnded, RunOutcome
from ua_fleet.storage.run_journal import RunJournal

__all__ = [
    "JournaledRuns",
    "parted_halts",
    "restore_faults",
    "runs_of_journal",
    "scenario_to_go_on",
    "time_to_go_on",
]

_STAYING: Final = BY_PERSON.keys() - {NOT_HALTED}
"""Sources of faults that count also of robots that are not there. A halt that is owed says `not_halted` again."""


class JournaledRuns(NamedTuple):
    """The runs of the journal."""

    records: list[RunRecord]
    """Of all."""
    carried: list[RunRecord]
    """Of those that bridges carry, and that have not ended."""
    going_on: list[tuple[str, Scenario, list[Fact]]]
    """Those that go on: id, scenario, facts."""

    @property
    def going_on_ids(self) -> set[str]:
        """The ids of those that go on."""
        return {run_id for run_id, _, _ in self.going_on}


def runs_of_journal(journal: RunJournal, check: Callable[[str], Checked], *, log: Log, now: float) -> JournaledRuns:
    """Read all runs, and end those that do not fit the fleet any more; see `scenario_to_go_on`."""
    found = JournaledRuns([], [], [])
    for run_id, ended in journal.runs():
        facts = journal.facts(run_id)
        record = RunRecord.of(run_id, facts)
        if not ended and record.state.carried:
            found.carried.append(record)
        elif not ended:
            scenario = scenario_to_go_on(record, facts, check, journal, log=log, now=now)
            if scenario is not None:
                found.going_on.append((run_id, scenario, facts))
        found.records.append(record)
    if found.going_on:
        log.info("runs go on", runs=len(found.going_on))
    return found


def time_to_go_on(time: SteadyTime, journal: RunJournal, log: Log) -> float:
    """The time at a restart. Where the wall clock is behind what runs wrote down, it goes on there.

    Else what waits would wait until the clock is there again. Runs that bridges carry are left out: their facts are by
    the clocks of these bridges.

    Args:
        time: of runs; is set forward.
        journal: of them.
        log: is told of a clock that is behind.
    """
    times = [halt.since for halt in journal.halts()]
    for run_id, ended in journal.runs():
        facts = [] if ended else journal.facts(run_id)
        if not any(isinstance(fact, RunCarried) for fact in facts):
            times += [fact.at for fact in facts]
    if times and (behind_s := time.go_on_from(max(times))):
        log.warning(
            "the clock is behind what runs wrote down last: no time counts as passed for them; set the clock",
            behind_s=round(behind_s, 3),
        )
    return time()


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

    What robots may be at for such a run they are to stop, as the journal says then.

    Args:
        record: of the run; takes its end in.
        facts: of the run.
        check: a scenario's text against the fleet as it is now; whatever it raises ends this run alone.
        journal: its end and the halts are written there.
        log: is told of its end.
        now: wall time in seconds.

    Raises:
        StorageUnavailable: the end cannot be written.
    """
    text = next((fact.text for fact in facts if isinstance(fact, RunCreated)), "")
    try:
        checked = check(text)
    except Exception as error:  # noqa: BLE001 - the other runs, and the server, go on
        reason = f"its scenario cannot be read ({type(error).__name__}): {error}"
    else:
        if not checked.problems:
            return checked.scenario
        reason = f"it does not fit the fleet any more: {checked.problems[0]}"
    ended = RunEnded(now, RunOutcome.FAILED, reason)
    log.error("run cannot go on after the restart", run_id=record.run_id, reason=reason)
    halts = [HaltChanged(halt, is_owed=True) for halt in halts_of(facts, now)]
    journal.write([(record.run_id, ended)], halts=halts)
    record.apply(ended)
    return None


def parted_halts(halts: Iterable[Halt], robots: Container[str]) -> tuple[list[Halt], list[Halt]]:
    """The halts of robots that are there, and those of the others, whose executions must not begin any more either."""
    known, gone = list[Halt](), list[Halt]()
    for halt in halts:
        (known if halt.robot in robots else gone).append(halt)
    return known, gone


def restore_faults(
    faults: Iterable[Fault], robots: Container[str], orchestrator: Orchestrator, finder: FaultFinder, now: float
) -> list[Output]:
    """Have the orchestrator know faults of robots that are still there, and what people say of the others.

    A fault whose condition is in `fleet.yaml` no more ends.

    Args:
        faults: as they were kept.
        robots: names of those that are there.
        orchestrator: gets them, acknowledged and over as they were.
        finder: told of those whose end it has to find.
        now: wall time in seconds.
    """
    outputs: list[Output] = []
    for fault in faults:
        if fault.robot not in robots and not (fault.active and fault.source in _STAYING):
            continue
        outputs += orchestrator.fault_raised(fault.robot, fault.source, fault.reason, fault.since, fault.capacities)
        if fault.acknowledged:
            outputs += orchestrator.acknowledge(fault.id, fault.acknowledged_by, now)
        if fault.active and not finder.has_lost_condition(fault):
            finder.restored(fault)
        else:
            outputs += orchestrator.fault_cleared(fault.robot, fault.source, now)
    return outputs
