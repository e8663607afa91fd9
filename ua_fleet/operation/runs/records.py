"""Runs and decisions as people see them, made of the same facts that the engine goes by."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ua_fleet.orchestrator import BridgeTold, DecisionChanged
from ua_fleet.printing import utc_text
from ua_fleet.resilience import Aborted, Ranking, RankingChanged, ReplacementChosen
from ua_fleet.scenario import Value, read_scenario
from ua_fleet.scenario.effects import TaskWaits
from ua_fleet.scenario.facts import (
    Fact,
    Replaced,
    ReplacementWanted,
    RunCreated,
    RunEnded,
    StepEnded,
    TaskAnswered,
    TaskAssigned,
    TaskOver,
    Then,
)
from ua_fleet.scenario.state import RunState, TaskPhase

__all__ = ["DecisionRecord", "RunRecord", "TaskRecord"]

MOST_ROWS: Final = 500
"""Tasks of a run that are shown: the last ones, where repetitions make more."""


MOST_REASONS: Final = 5
"""Tasks of which a run says at once why they wait."""
_LAST_TIME_S: Final = 253_402_300_799
"""The end of the year 9999."""
_DECIDED_ABOUT: Final = (TaskPhase.REPLACING, TaskPhase.ASKED)
_NOT_KNOWN: Final = (Then.ASK, Then.AWAIT)
"""What follows where nobody knows whether an attempt has ended."""


class TaskRecord(NamedTuple):
    """One task of a run."""

    step: str
    task: str
    robot: str
    skill: str
    state: str
    attempt: int
    result: str
    """A JSON object."""
    message: str
    begun: float | None = None
    """When the attempt began, by the wall clock; None before."""
    ended: float | None = None
    """When it ended; None before, and where nobody knows whether it has."""


class RunRecord:
    """A run, whether it is under way or not."""

    def __init__(self, run_id: str) -> None:
        self.run_id = run_id
        self.text = ""
        """The scenario as it was read when the run began."""
        self.started = 0.0
        self.ended: float | None = None
        self.state = RunState()
        self._messages: dict[str, str] = {}
        self._times: dict[str, tuple[float, float | None]] = {}
        """When the last attempt at each task began and ended."""
        self._bridges = ""
        """What the bridges that carry it do not say or hand over, for people."""
        self._bridges_told: Mapping[int, BridgeTold] = {}
        """How these stand, by their spaces."""
        self._waiting: dict[str, TaskWaits] = {}
        """Why tasks cannot begin now."""
        self._decisions: dict[str, str] = {}
        """What the open decisions about tasks wait for."""

    @classmethod
    def of(cls, run_id: str, facts: Iterable[Fact]) -> RunRecord:
        """The record of a run of the journal."""
        record = cls(run_id)
        for fact in facts:
            record.apply(fact)
        return record

    def apply(self, fact: Fact) -> None:
        """Take a fact in."""
        self.state.apply(fact)
        step: str = getattr(fact, "step", "")
        self._waiting.pop(step, None)
        if step in self._decisions and self.state.phase(step) not in _DECIDED_ABOUT:
            del self._decisions[step]
        match fact:
            case RunCreated():
                self.started = fact.at
                self.text = sys.intern(fact.text)  # runs of one scenario share it
            case RunEnded():
                self.ended = fact.at
            case TaskAssigned():
                self._begin(fact.step, fact.at)
            case TaskOver():
                self._messages[fact.step] = fact.message
                if fact.then not in _NOT_KNOWN:
                    self._end(fact.step, fact.at)
            case Replaced():
                self._times.pop(fact.step, None)  # the other one has not begun it
            case TaskAnswered() if fact.then not in _NOT_KNOWN:
                self._end(fact.step, fact.at)
            case StepEnded():
                self._end(fact.step, fact.at)
            case ReplacementWanted():
                self._messages[fact.step] = fact.reason
            case _:
                pass

    def _begin(self, step: str, at: float) -> None:
        self._times[step] = at, None
        if len(self._times) > 4 * MOST_ROWS:  # of repetitions that are over
            self._times = {known: times for known, times in self._times.items() if known in self.state.tasks}
            self._messages = {known: said for known, said in self._messages.items() if known in self.state.tasks}

    def _end(self, step: str, at: float) -> None:
        begun, ended = self._times.get(step, (None, None))
        if begun is not None and ended is None:
            self._times[step] = begun, at

    def show_waiting(self, waits: TaskWaits) -> None:
        """Know why a task cannot begin now; of no step: why bridges that carry the run do not go on."""
        if not waits.step:
            self._bridges = waits.reason
            return
        self._waiting.pop(waits.step, None)
        if waits.reason and waits.step not in self.state.ended:
            self._waiting[waits.step] = waits

    def show_bridges(self, bridges: Mapping[int, BridgeTold]) -> None:
        """Know how the bridges stand that carry it."""
        self._bridges_told = bridges

    @functools.cached_property
    def scenario(self) -> str:
        """The name of the scenario. A segment of a carried run has none, and is not read for it."""
        return read_scenario(self.text.encode()).scenario.name

    @property
    def bridges(self) -> dict[int, BridgeTold]:
        """The bridges that carry it, by their spaces; none where the server orchestrates it."""
        nothing = BridgeTold("", False, "")
        is_over = self.state.outcome is not None
        return {space: nothing if is_over else self._bridges_told.get(space, nothing) for space in self.state.carried}

    def show_decision(self, decision: DecisionRecord, until: float | None) -> None:
        """Know what a decision about a task waits for, or that it is over; `until` when it waits at the latest."""
        self._decisions.pop(decision.step, None)
        if decision.state == "open":
            is_asked = self.state.phase(decision.step) is TaskPhase.ASKED
            self._decisions[decision.step] = decision.awaited(is_asked=is_asked, until=until)

    @property
    def shown_reason(self) -> str:
        """Why it has ended, or is to end; while it goes on, what its tasks wait for, and what people can do."""
        if self.state.outcome is not None:
            return self.state.reason
        said = [self.state.closing.reason] if self.state.closing is not None else []
        said += [self._bridges] if self._bridges else []
        said += self._decisions.values()
        said += [f"task {waits.task} waits: {waits.reason}" for waits in self._waiting.values()]
        said += [
            f"task {task.name}: {task.robot} is to stop, and has not said that it has: {task.halting.reason}"
            for step, task in self.state.tasks.items()
            if task.phase is TaskPhase.HALTING and task.halting is not None and step not in self._decisions
        ]
        more = len(said) - MOST_REASONS
        return "; ".join([*said[:MOST_REASONS], *([f"and {more} more"] if more > 0 else [])])

    @property
    def shown_state(self) -> str:
        """`running`, `paused`, `ending`, `done`, `failed` or `aborted`."""
        state = self.state
        if state.outcome is not None:
            return state.outcome.value
        if state.closing is not None:
            return "ending"
        return "paused" if state.paused else "running"

    @property
    def parameters(self) -> str:
        """The parameters as a JSON object."""
        return json.dumps(self.state.parameters, ensure_ascii=False)

    def rows(self) -> list[TaskRecord]:
        """The tasks, in the order in which their turn came."""
        rows: list[TaskRecord] = []
        for step, task in list(self.state.tasks.items())[-MOST_ROWS:]:
            ended = self.state.ended.get(step)
            state = ended.value if ended is not None else task.phase.name.lower()
            results: dict[str, Value] = {}
            if task.phase is TaskPhase.OVER:
                results.update(self.state.results.get(task.name, {}))
            rows.append(
                TaskRecord(
                    step,
                    task.name,
                    task.robot,
                    task.skill,
                    state,
                    task.attempt,
                    json.dumps(results, ensure_ascii=False),
                    self._messages.get(step, ""),
                    *self._times.get(step, (None, None)),
                )
            )
        shown = {row.step: place for place, row in enumerate(rows)}
        for step, waits in self._waiting.items() if self.state.outcome is None else ():
            if (place := shown.get(step)) is None:
                rows.append(_waiting_row(waits))
            else:
                rows[place] = rows[place]._replace(robot=waits.robot or rows[place].robot, message=waits.reason)
        return rows[-MOST_ROWS:]


def _waiting_row(waits: TaskWaits) -> TaskRecord:
    state = TaskPhase.WANTED.name.lower()
    return TaskRecord(waits.step, waits.task, waits.robot, waits.skill, state, 0, "{}", waits.reason)


@dataclass(slots=True)
class DecisionRecord:
    """A decision, whether it is open or not."""

    id: str
    run_id: str
    step: str
    task: str
    failed: str
    reason: str
    state: str = "open"
    """`open`, `chosen` or `aborted`."""
    chosen: str = ""
    by: str = ""
    ranking: Ranking | None = field(default=None)
    opened: float | None = None
    """When it was opened, by the wall clock; after a restart anew, as its limit."""
    deadline: float | None = None
    """While it is open: when it is decided without a person, by the wall clock; None where nobody knows."""

    @classmethod
    def of(cls, changed: DecisionChanged) -> DecisionRecord:
        """The record of a decision of which nothing was said before."""
        event = changed.event
        return cls(event.decision_id, changed.run_id, changed.step, changed.task, changed.failed, changed.reason)

    def awaited(self, *, is_asked: bool, until: float | None) -> str:
        """What it waits for while it is open, and the commands that end it, for people.

        Args:
            is_asked: whether nobody knows what the first robot is at.
            until: when it is decided without people, by the wall clock; None: not by itself.
        """
        ranked = () if self.ranking is None else self.ranking.ranked
        ways: list[str] = []
        if is_asked:
            ways.append(f"say what became of it: ua-fleet scenario answer {self.run_id} {self.task} done|retry|fail")
        if ranked:
            ways.append(f"say who does it: ua-fleet decision confirm {self.id} {'|'.join(one.robot for one in ranked)}")
        else:
            ways.append(f"no other robot can do it now: ua-fleet scenario abort {self.run_id} ends the run")
        limit = "" if until is None or not _is_time(until) else f"; waits until {utc_text(until)}"
        return f"task {self.task} waits: {self.reason}; {'; '.join(ways)}{limit}"

    def apply(self, changed: DecisionChanged, now: float | None = None) -> None:
        """Take in what was said; `now` by the wall clock."""
        self.failed, self.reason = changed.failed, changed.reason
        is_open = isinstance(changed.event, RankingChanged)
        if is_open and (self.opened is None or self.state != "open"):
            self.opened = now
        self.deadline = changed.until if is_open and changed.until is not None and _is_time(changed.until) else None
        match changed.event:
            case RankingChanged(ranking=ranking):
                self.state, self.chosen, self.by, self.ranking = "open", "", "", ranking
            case ReplacementChosen(robot=robot, by=by, ranking=ranking):
                self.state, self.chosen, self.by, self.ranking = "chosen", robot, by, ranking
            case Aborted(reason=reason):
                self.state, self.reason = "aborted", reason


def _is_time(seconds: float) -> bool:
    """Whether a deadline is a time that can be told: `silence_s` may be longer than there are years."""
    return abs(seconds) <= _LAST_TIME_S
