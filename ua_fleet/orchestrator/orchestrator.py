"""All runs of a fleet: who gets which robot, what a fault brings with it, and who decides."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVarTuple

from ua_fleet.errors import ScenarioError, UaFleetError
from ua_fleet.orchestrator.candidates import ResilienceSettings, TaskToDo, rank_robots
from ua_fleet.orchestrator.faults import FaultChange, Faults
from ua_fleet.orchestrator.outputs import (
    DecisionChanged,
    FaultChanged,
    Forecast,
    OperatorAsked,
    Output,
    RunBroken,
    RunChanged,
    TaskCancelled,
    TaskStarted,
)
from ua_fleet.resilience import Aborted, Confirmation, Decision, DecisionEvent, Ranking, ReplacementChosen
from ua_fleet.scenario import FleetView, Grant, Lookup, Reservations, Run, Scenario, Value
from ua_fleet.scenario.effects import (
    AskOperator,
    CancelTask,
    Effect,
    Happened,
    OpenDecision,
    ReleaseRobot,
    StartTask,
    WantRobot,
)
from ua_fleet.scenario.expression import Expression
from ua_fleet.scenario.facts import Fact, RunEnded, TaskOutcome, TaskOver, Then
from ua_fleet.scenario.parameters import known_arguments
from ua_fleet.scenario.state import TaskPhase

__all__ = ["Orchestrator"]

_Told = TypeVarTuple("_Told")

RunJournal = Callable[[str, Fact], None]
"""Writes a fact of a run down; when it returns the fact is there after a crash."""

_FAULTY: dict[TaskOutcome, str] = {
    TaskOutcome.FAILED: "failed",
    TaskOutcome.TIMED_OUT: "took too long",
    TaskOutcome.UNKNOWN: "may or may not have been done",
}
SKILL_SOURCE = "skill"
"""Source of the fault that a failed task is. Nobody can see whether its cause is gone: acknowledging it clears it."""


@dataclass(slots=True)
class _Open:
    """A decision with what it is about."""

    run_id: str
    asked: OpenDecision
    decision: Decision
    is_repaired: bool = False
    """Whether the robot that failed works again."""


class Orchestrator:
    """Runs side by side. Every method that takes something in returns what follows, in order."""

    def __init__(self, settings: ResilienceSettings, fleet: FleetView, lookup: Lookup, journal: RunJournal) -> None:
        """Make an orchestrator without runs.

        Args:
            settings: how replacements are chosen.
            fleet: the robots; `fleet_changed` brings another.
            lookup: values of robots, for conditions and criteria.
            journal: of all runs.
        """
        self.settings, self._fleet, self._lookup, self._journal = settings, fleet, lookup, journal
        self.runs: dict[str, Run] = {}
        """Runs that have not ended."""
        self.faults = Faults()
        self._scenarios: dict[str, Scenario] = {}
        self._reservations = Reservations[tuple[str, str]]()
        self._open: dict[str, _Open] = {}
        self._executions: dict[str, str] = {}
        """The run of each execution that is under way."""
        self._outputs: list[Output] = []

    # Runs.

    def start(
        self, run_id: str, scenario: Scenario, parameters: Mapping[str, Value], *, by: str, now: float
    ) -> list[Output]:
        """Begin a run of a scenario that was validated.

        Raises:
            ScenarioError: a parameter does not fit, or the id is in use.
        """
        if run_id in self.runs:
            raise ScenarioError(f"there is a run {run_id!r} already")
        run = Run.create(run_id, scenario, parameters, self._journal_of(run_id), by=by, now=now)
        self.runs[run_id], self._scenarios[run_id] = run, scenario
        for fault in self.faults:
            if fault.active:
                self._tell(run_id, now, Run.robot_faulted, fault.robot, fault.reason, now)
        self._tell(run_id, now, Run.poll, self._lookup, now)
        return self._taken()

    def take_back(self, run_id: str, now: float) -> list[Output]:
        """Undo `start`: the run cannot be written down. What others get of its robots follows."""
        self._end(run_id, now)
        return self._taken()

    def restore(self, run_id: str, scenario: Scenario, facts: list[Fact], now: float) -> list[Output]:
        """Go on with a run of the journal. Raise what faults there are before."""
        return self.restore_all([(run_id, scenario, facts)], now)

    def restore_all(self, stored: Sequence[tuple[str, Scenario, list[Fact]]], now: float) -> list[Output]:
        """Go on with all runs of the journal. Robots stay with the tasks that they are at, before others get any."""
        restored: list[str] = []
        for run_id, scenario, facts in stored:
            run = Run.restore(scenario, facts, self._journal_of(run_id))
            if run.state.outcome is not None:
                continue
            self.runs[run_id], self._scenarios[run_id] = run, scenario
            restored.append(run_id)
            for step, task_run in run.state.tasks.items():
                if task_run.phase in (TaskPhase.ASSIGNED, TaskPhase.ACCEPTED):
                    self._reservations.want((run_id, step), task_run.robot)
        for run_id in restored:
            self._tell(run_id, now, Run.again, now)
            for fault in self.faults:
                if fault.active:
                    self._tell(run_id, now, Run.robot_faulted, fault.robot, fault.reason, now)
            self._tell(run_id, now, Run.poll, self._lookup, now)
        return self._taken()

    def pause(self, run_id: str, by: str, now: float) -> list[Output]:
        """Let a run start no further task; raises ScenarioError where there is no such run."""
        return self._on(run_id, lambda run: run.pause(by, now), now)

    def resume(self, run_id: str, by: str, now: float) -> list[Output]:
        """Let a run go on; raises ScenarioError where there is no such run."""
        return self._on(run_id, lambda run: run.resume(by, now), now)

    def abort(self, run_id: str, reason: str, by: str, now: float) -> list[Output]:
        """End a run; raises ScenarioError where there is no such run."""
        return self._on(run_id, lambda run: run.abort(reason, by, now), now)

    def answer(self, run_id: str, step: str, answer: str, by: str, now: float) -> list[Output]:
        """An operator says what became of a task; raises ScenarioError where nobody was asked."""
        return self._on(run_id, lambda run: run.answered(step, answer, by, now), now)

    def event(self, name: str, now: float) -> list[Output]:
        """An event has happened that steps may wait for."""
        for run_id in list(self.runs):
            self._tell(run_id, now, Run.event, name, now)
        return self._taken()

    # Robots.

    def accepted(self, execution_id: str, now: float) -> list[Output]:
        """A robot has taken a task."""
        return self._of_execution(execution_id, lambda run: run.accepted(execution_id, now), now)

    def ended(
        self,
        execution_id: str,
        outcome: TaskOutcome,
        now: float,
        *,
        message: str = "",
        results: Mapping[str, Value] | None = None,
    ) -> list[Output]:
        """A robot's execution has ended."""
        return self._of_execution(
            execution_id, lambda run: run.ended(execution_id, outcome, now, message=message, results=results), now
        )

    def fleet_changed(self, fleet: FleetView, now: float) -> list[Output]:
        """Robots, skills or capacities have come or gone."""
        self._fleet = fleet
        return self.poll(now)

    def fault_raised(self, robot: str, source: str, reason: str, now: float) -> list[Output]:
        """A robot cannot work: it says so, or something has found it."""
        self._fault(robot, source, reason, now)
        return self._taken()

    def fault_cleared(self, robot: str, source: str, now: float) -> list[Output]:
        """A fault's cause is gone; without any other the robot takes its later tasks back."""
        self._clear(robot, source, now)
        return self._taken()

    def acknowledge(self, fault_id: str, by: str, now: float) -> list[Output]:
        """An operator has seen a fault; raises ScenarioError where there is none, or it was acknowledged before."""
        fault, change = self.faults.acknowledge(fault_id, by)
        self._outputs.append(FaultChanged(fault, change))
        if fault.source == SKILL_SOURCE:
            self._clear(fault.robot, SKILL_SOURCE, now)
        return self._taken()

    # Decisions.

    def confirm(self, decision_id: str, robot: str, by: str, now: float) -> tuple[Confirmation, list[Output]]:
        """An operator chooses a replacement.

        Raises:
            NoCandidate: the robot is no candidate, or another was chosen before.
            ScenarioError: there is no such decision.
        """
        opened = self._open.get(decision_id)
        if opened is None:
            raise ScenarioError(f"there is no decision {decision_id!r}")
        confirmation, events = opened.decision.confirm(robot, by)
        self._decided(opened, events, now)
        return confirmation, self._taken()

    def set_settings(self, settings: ResilienceSettings, now: float) -> list[Output]:
        """Other criteria, judgements or modes; open decisions are ranked again."""
        self.settings = settings
        return self.poll(now)

    def what_if(self, robot: str) -> list[Forecast]:
        """Who would take over each task that a robot has ahead, without effect."""
        forecasts: list[Forecast] = []
        for run in self.runs.values():
            for task in [task for wanted, task in run.ahead() if wanted == robot]:
                arguments = known_arguments(task, run.look_up)
                todo = TaskToDo(task, self._needs(task.skill, robot, task.capacities), arguments, robot)
                forecasts.append(Forecast(run.state.run_id, task.name, self._ranked(todo)))
        return forecasts

    def needed_names(self) -> set[str]:
        """The names that conditions and arguments of all runs mention."""
        return {name for scenario in self._scenarios.values() for name in scenario.names()}

    @property
    def decisions(self) -> dict[str, Decision]:
        """The open decisions by id."""
        return {decision_id: opened.decision for decision_id, opened in self._open.items()}

    # Time.

    def poll(self, now: float) -> list[Output]:
        """Go on with everything: time has passed, or values have changed."""
        for run_id in list(self.runs):
            self._tell(run_id, now, Run.poll, self._lookup, now)
        for opened in list(self._open.values()):
            ranking = self._ranked(self._todo(opened.run_id, opened.asked, is_repaired=opened.is_repaired))
            self._decided(opened, opened.decision.rank_again(ranking), now)
            self._decided(opened, opened.decision.poll(now), now)
        return self._taken()

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next even if nothing changes, or None."""
        deadlines = [run.next_deadline() for run in self.runs.values()]
        deadlines += [opened.decision.next_deadline() for opened in self._open.values()]
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    # Within.

    def _journal_of(self, run_id: str) -> Callable[[Fact], None]:
        return lambda fact: self._journal(run_id, fact)

    def _taken(self) -> list[Output]:
        outputs, self._outputs = self._outputs, []
        return outputs

    def _on(self, run_id: str, what: Callable[[Run], list[Effect]], now: float) -> list[Output]:
        run = self.runs.get(run_id)
        if run is None:
            raise ScenarioError(f"there is no run {run_id!r} under way")
        self._tell(run_id, now, what)
        return self._taken()

    def _of_execution(self, execution_id: str, what: Callable[[Run], list[Effect]], now: float) -> list[Output]:
        run_id = self._executions.get(execution_id)
        run = self.runs.get(run_id or "")
        if run_id is not None and run is not None:
            self._tell(run_id, now, what)
        return self._taken()

    def _tell(self, run_id: str, now: float, what: Callable[[Run, *_Told], list[Effect]], *told: *_Told) -> None:
        """Tell a run something, and carry out what follows. A run that cannot go on ends, and takes nothing along."""
        run = self.runs.get(run_id)
        if run is None:
            return
        try:
            effects = what(run, *told)
        except UaFleetError:
            raise
        except Exception as error:  # noqa: BLE001 - the other runs, and the server, go on
            self._outputs.append(RunBroken(run_id, error))
            effects = run.broken(f"a mistake of ua_fleet ({type(error).__name__}: {error}); report the log", now)
        self._carry_out(run_id, effects, now)

    def _carry_out(self, run_id: str, effects: list[Effect], now: float) -> None:
        for effect in effects:
            match effect:
                case Happened(fact=fact):
                    self._happened(run_id, fact, now)
                case WantRobot():
                    self._want(run_id, effect, now)
                case ReleaseRobot(step=step):
                    self._grant(self._reservations.release((run_id, step)), now)
                case StartTask():
                    self._executions[effect.execution_id] = run_id
                    self._outputs.append(
                        TaskStarted(
                            run_id,
                            effect.step,
                            effect.task,
                            effect.execution_id,
                            effect.robot,
                            effect.skill,
                            effect.arguments,
                            effect.timeout_s,
                        )
                    )
                case CancelTask():
                    self._outputs.append(TaskCancelled(effect.execution_id, effect.robot))
                case OpenDecision():
                    self._decide(run_id, effect, now)
                case AskOperator():
                    self._executions[effect.execution_id] = run_id  # its robot may tell later
                    self._outputs.append(
                        OperatorAsked(
                            run_id,
                            effect.step,
                            effect.task,
                            effect.robot,
                            effect.question,
                            effect.skill,
                            effect.execution_id,
                        )
                    )

    def _happened(self, run_id: str, fact: Fact, now: float) -> None:
        self._outputs.append(RunChanged(run_id, fact))
        if isinstance(fact, TaskOver):
            task_run = self.runs[run_id].state.tasks[fact.step]
            self._executions.pop(task_run.execution_id, None)
            stands_still = fact.outcome is TaskOutcome.BUSY and task_run.tries > 0  # with an attempt of ours
            if fact.then is Then.REPLACE and stands_still:
                self._fault(task_run.robot, SKILL_SOURCE, f"{task_run.skill} took too long, and does not stop", now)
            elif fact.then is Then.REPLACE and fact.outcome in _FAULTY:
                self._fault(task_run.robot, SKILL_SOURCE, f"{task_run.skill} {_FAULTY[fact.outcome]}", now)
        elif isinstance(fact, RunEnded):
            self._end(run_id, now)

    def _end(self, run_id: str, now: float) -> None:
        run = self.runs.pop(run_id)
        del self._scenarios[run_id]
        for opened in [opened for opened in self._open.values() if opened.run_id == run_id]:
            self._decided(opened, opened.decision.give_up("the run has ended"), now)
        for execution_id in [key for key, owner in self._executions.items() if owner == run_id]:
            del self._executions[execution_id]
        for step in run.state.tasks:
            self._grant(self._reservations.release((run_id, step)), now)

    def _want(self, run_id: str, wanted: WantRobot, now: float) -> None:
        robot = wanted.robot
        if robot is None:
            refused_by = self.runs[run_id].state.tasks[wanted.step].refused_by
            task = self.runs[run_id].task(wanted.step)
            todo = TaskToDo(task, wanted.capacities, self._arguments(run_id, wanted.step), "", refused_by)
            ranking = self._ranked(todo)
            robot = ranking.best or self._least_busy(todo)
            if robot is None:
                reasons = "; ".join(f"{left.robot} {left.reason}" for left in ranking.excluded)
                reason = f"no robot can do {wanted.skill}: {reasons or 'there is none'}"
                self._tell(run_id, now, Run.nobody, wanted.step, reason, now)
                return
        self._grant(self._reservations.want((run_id, wanted.step), robot), now)

    def _least_busy(self, todo: TaskToDo) -> str | None:
        """Who can do a task though it cannot be ranked: a criterion that nobody knows must not stop the work."""
        unfit, ahead = {*self.faults.unfit(), *todo.refused_by}, self._count_ahead()
        able = self._fleet.able(todo.task.skill, todo.capacities)
        fit = [robot.name for robot in able if robot.name not in unfit and not todo.problems(robot)]
        return min(fit, key=lambda robot: (ahead[robot], robot), default=None)

    def _grant(self, grants: list[Grant[tuple[str, str]]], now: float) -> None:
        for (run_id, step), robot in grants:
            run = self.runs.get(run_id)
            if run is not None:
                skill = self._fleet.declared(robot, run.task(step).skill)
                self._tell(run_id, now, Run.granted, step, robot, now, skill)

    def _fault(self, robot: str, source: str, reason: str, now: float) -> None:
        change = self.faults.raise_fault(robot, source, reason, now)
        if change is None:
            return
        self._outputs.append(FaultChanged(*change))
        if change[1] is FaultChange.RAISED:
            for run_id in list(self.runs):
                self._tell(run_id, now, Run.robot_faulted, robot, reason, now)

    def _clear(self, robot: str, source: str, now: float) -> None:
        change = self.faults.clear(robot, source)
        if change is None:
            return
        self._outputs.append(FaultChanged(*change))
        if not self.faults.active(robot):
            for opened in self._open.values():
                opened.is_repaired |= opened.asked.robot == robot
            for run_id in list(self.runs):
                self._tell(run_id, now, Run.robot_returned, robot, now)

    # Decisions.

    def _decide(self, run_id: str, asked: OpenDecision, now: float) -> None:
        decision_id = f"{run_id}.{asked.step}"
        todo = self._todo(run_id, asked)
        settings = self.settings
        decision = Decision(
            decision_id,
            settings.mode,
            self._ranked(todo),
            limit_s=settings.limit_s,
            on_limit=settings.on_limit,
            now=now,
        )
        opened = self._open[decision_id] = _Open(run_id, asked, decision)
        self._decided(opened, decision.begin(), now)

    def _decided(self, opened: _Open, events: list[DecisionEvent], now: float) -> None:
        asked = opened.asked
        for event in events:
            self._outputs.append(
                DecisionChanged(opened.run_id, asked.step, asked.task, asked.robot, asked.reason, event)
            )
            if isinstance(event, ReplacementChosen):
                self._open.pop(event.decision_id, None)
                self._tell(opened.run_id, now, Run.replaced, asked.step, event.robot, event.by, now)
            elif isinstance(event, Aborted):
                self._open.pop(event.decision_id, None)
                self._tell(opened.run_id, now, Run.not_replaced, asked.step, event.reason, now)

    def _todo(self, run_id: str, asked: OpenDecision, *, is_repaired: bool = False) -> TaskToDo:
        needs = self._needs(asked.skill, asked.robot, asked.capacities)
        refused_by = self.runs[run_id].state.tasks[asked.step].refused_by
        task = self.runs[run_id].task(asked.step)
        arguments = self._arguments(run_id, asked.step)
        return TaskToDo(task, needs, arguments, asked.robot, refused_by, is_repaired)

    def _arguments(self, run_id: str, step: str) -> Mapping[str, Value]:
        """As they were written; what is computed as a task was begun with it, or would be now."""
        run = self.runs[run_id]
        task, begun = run.task(step), run.state.tasks[step].arguments
        computed = {name for name, value in task.arguments.items() if isinstance(value, Expression)}
        return known_arguments(task, run.look_up) | {name: begun[name] for name in computed & begun.keys()}

    def _needs(self, skill: str, robot: str, capacities: tuple[str, ...]) -> tuple[str, ...]:
        """The capacities that a task needs: those that it names, and those that the skill needs on its robot."""
        declared = self._fleet.declared(robot, skill)
        return tuple(dict.fromkeys((*capacities, *(declared.capacities if declared is not None else ()))))

    def _ranked(self, todo: TaskToDo) -> Ranking:
        return rank_robots(
            todo,
            self._fleet,
            self.settings,
            unfit=self.faults.unfit(),
            tasks_ahead=self._count_ahead().__getitem__,
            lookup=self._lookup,
        )

    def _count_ahead(self) -> Counter[str | None]:
        """How many tasks of all runs each robot has ahead."""
        return Counter(robot for run in self.runs.values() for robot, _ in run.ahead())
