"""All runs of a fleet: who gets which robot, what a fault brings with it, and who decides."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVarTuple

from ua_fleet.errors import ScenarioError, UaFleetError
from ua_fleet.orchestrator.candidates import ResilienceSettings
from ua_fleet.orchestrator.choosing import Choosing
from ua_fleet.orchestrator.conditions import FaultFound
from ua_fleet.orchestrator.faults import Fault, FaultChange, Faults
from ua_fleet.orchestrator.halts import Halts
from ua_fleet.orchestrator.knowledge import Knowledge
from ua_fleet.orchestrator.outputs import (
    DecisionChanged,
    FaultChanged,
    Forecast,
    Halt,
    HaltChanged,
    OperatorAsked,
    Output,
    RunBroken,
    RunChanged,
    TaskCancelled,
    TaskFollowed,
    TaskStarted,
)
from ua_fleet.resilience import Aborted, Confirmation, Decision, DecisionEvent, ReplacementChosen
from ua_fleet.scenario import FleetView, Grant, Lookup, Reservations, Run, Scenario, Value
from ua_fleet.scenario.consequences import LEAST_SILENCE_S, NOT_HALTED, SKILL
from ua_fleet.scenario.effects import (
    AskOperator,
    CancelTask,
    Effect,
    FollowTask,
    Happened,
    OpenDecision,
    ReleaseRobot,
    StartTask,
    WantRobot,
)
from ua_fleet.scenario.facts import (
    Fact,
    RunEnded,
    TaskAnswered,
    TaskFound,
    TaskHalting,
    TaskOutcome,
    TaskOver,
    Then,
)
from ua_fleet.scenario.model import Task
from ua_fleet.scenario.run import HELD_PHASES
from ua_fleet.scenario.state import TaskPhase, TaskRun
from ua_fleet.scenario.world import Trouble

__all__ = ["Orchestrator"]

_Told = TypeVarTuple("_Told")

RunJournal = Callable[[str, Fact], None]
"""Writes a fact of a run down; when it returns the fact is there after a crash."""


@dataclass(slots=True)
class _Open:
    """A decision with what it is about."""

    run_id: str
    asked: OpenDecision
    decision: Decision
    is_unknown: bool
    """Whether it is about what nobody knows, and not about a robot that cannot."""


@dataclass(slots=True)
class _Anybody:
    """A task that waits for whichever robot can do it."""

    wanted: WantRobot
    hope_until: float | None = None
    """So long a robot may still be heard that can, where none is."""


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
        self._lookup, self._journal = lookup, journal
        self._known = Knowledge(settings, fleet)
        self.runs: dict[str, Run] = {}
        """Runs that have not ended."""
        self._choosing = Choosing(self._known, self.runs, lookup)
        self._scenarios: dict[str, Scenario] = {}
        self._reservations = Reservations[tuple[str, str]]()
        self._halts = Halts(self._reservations)
        self._open: dict[str, _Open] = {}
        self._anybody: dict[tuple[str, str], _Anybody] = {}
        self._executions: dict[str, str] = {}
        """The run of each execution that is under way."""
        self._outputs: list[Output] = []
        self._has_news = False
        """Whether something became known of robots that runs have not looked at."""

    @property
    def settings(self) -> ResilienceSettings:
        """How replacements are chosen now."""
        return self._known.settings

    @property
    def faults(self) -> Faults:
        """The faults of all robots."""
        return self._known.faults

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
        run = Run.create(run_id, scenario, parameters, self._journal_of(run_id), by=by, now=now, world=self._known)
        self.runs[run_id], self._scenarios[run_id] = run, scenario
        self._tell(run_id, now, Run.poll, self._lookup, now)
        return self._taken(now)

    def take_back(self, run_id: str, now: float) -> list[Output]:
        """Undo `start`: the run cannot be written down. What others get of its robots follows."""
        self._end(run_id, now)
        return self._taken(now)

    def restore(self, run_id: str, scenario: Scenario, facts: list[Fact], now: float) -> list[Output]:
        """Go on with a run of the journal. Tell what is known of robots before."""
        return self.restore_all([(run_id, scenario, facts)], now)

    def restore_all(
        self, stored: Sequence[tuple[str, Scenario, list[Fact]]], now: float, halts: Iterable[Halt] = ()
    ) -> list[Output]:
        """Go on with all runs of the journal. Tell what is known of robots before.

        Robots stay with the tasks that they are at, and with the halts that they have not confirmed, before others get
        any.
        """
        restored: list[str] = []
        for run_id, scenario, facts in stored:
            run = Run.restore(scenario, facts, self._journal_of(run_id), self._known)
            if run.state.outcome is not None:
                continue
            self.runs[run_id], self._scenarios[run_id] = run, scenario
            restored.append(run_id)
            for step, task_run in run.state.tasks.items():
                if task_run.phase in HELD_PHASES:
                    self._reservations.want((run_id, step), task_run.robot)
        self._halts.restore(halts, now)
        self._has_news = True
        for run_id in restored:
            self._tell(run_id, now, Run.again, self._lookup, now)
        for run_id in restored:
            self._tell(run_id, now, Run.poll, self._lookup, now)
        return self._taken(now)

    def must_not_begin(self) -> list[str]:
        """Executions that were asked for and must not begin any more, by their ids: their robots have a fault, or were
        told to stop, or their runs are to end.
        """
        to_stop = [halt.execution_id for halt in self._halts.all()]
        to_stop += [
            task_run.execution_id
            for run in self.runs.values()
            for step, task_run in run.state.tasks.items()
            if task_run.phase in HELD_PHASES
            and (
                run.state.closing is not None
                or task_run.phase is TaskPhase.HALTING
                or self._trouble(task_run.robot, run.task(step)) is not None
            )
        ]
        return list(dict.fromkeys(to_stop))

    def _trouble(self, robot: str, task: Task) -> Trouble | None:
        return self._known.trouble(robot, self._known.needs(robot, task))

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
        return self._taken(now)

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
        if outcome is not TaskOutcome.UNKNOWN:
            self._settle(execution_id, now)
        return self._of_execution(
            execution_id, lambda run: run.ended(execution_id, outcome, now, message=message, results=results), now
        )

    def fleet_changed(self, fleet: FleetView, now: float) -> list[Output]:
        """Robots, skills or capacities have come or gone."""
        self._known.fleet = fleet
        return self.poll(now)

    def told(self, found: Iterable[FaultFound], now: float) -> list[Output]:
        """What has become known of robots. All of it is taken in before anything follows from it."""
        for one in found:
            self._take_in(one, now)
        return self._taken(now)

    def not_heard(self, robots: Iterable[str], now: float) -> list[Output]:
        """Nothing is heard of robots, from now on: so it is at a start. A fault `silent` is another matter."""
        self._known.not_heard(robots, now)
        self._has_news = True
        return self._taken(now)

    def followed(self, robot: str, told: frozenset[str], now: float) -> list[Output]:
        """A robot's SkillStatus says which executions it is at: none of them, where nothing says so any more."""
        if self._known.follow(robot, told, self._executions, now):
            self._has_news = True
        return self._taken(now)

    def is_silent(self, robot: str) -> bool:
        """Whether nothing is heard of a robot."""
        return self._known.silent_since(robot) is not None

    def forget(self, robot: str) -> None:
        """A robot that no run uses is gone, its faults cleared before."""
        self._known.forget(robot)

    def fault_raised(
        self, robot: str, source: str, reason: str, now: float, capacities: tuple[str, ...] = ()
    ) -> list[Output]:
        """A robot cannot work, or do what needs some capacities: it says so, or something has found it."""
        return self.told([FaultFound(robot, source, True, reason, capacities)], now)

    def fault_cleared(self, robot: str, source: str, now: float) -> list[Output]:
        """A fault's cause is gone; without any other the robot takes its later tasks back."""
        return self.told([FaultFound(robot, source, False, "")], now)

    def acknowledge(self, fault_id: str, by: str, now: float) -> list[Output]:
        """An operator has seen a fault; raises ScenarioError where there is none, or it was acknowledged before."""
        fault, change = self.faults.acknowledge(fault_id, by)
        self._outputs.append(FaultChanged(fault, change))
        if fault.source == SKILL:
            self._take_in(FaultFound(fault.robot, SKILL, False, ""), now)
        return self._taken(now)

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
        self._rank_again(opened, now)
        confirmation, events = opened.decision.confirm(robot, by)
        self._decided(opened, events, now)
        return confirmation, self._taken(now)

    def set_settings(self, settings: ResilienceSettings, now: float) -> list[Output]:
        """Other criteria, judgements or modes; open decisions are ranked again."""
        self._known.settings = settings
        return self.poll(now)

    def what_if(self, robot: str) -> tuple[int, Iterator[Forecast]]:
        """How many tasks a robot has ahead, and who would take over each of them, one by one and without effect."""
        return self._choosing.forecasts(robot)

    def runs_with(self, robot: str) -> list[str]:
        """Ids of the runs in which a robot has tasks ahead."""
        return self._choosing.runs_with(robot)

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
        self._has_news = True
        return self._taken(now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next even if nothing changes, or None."""
        deadlines = [run.next_deadline() for run in self.runs.values()]
        deadlines += [opened.decision.next_deadline() for opened in self._open.values()]
        deadlines.append(self._halts.next_deadline())
        deadlines += [waiting.hope_until for waiting in self._anybody.values()]
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    # Within.

    def _journal_of(self, run_id: str) -> Callable[[Fact], None]:
        return lambda fact: self._journal(run_id, fact)

    def _taken(self, now: float) -> list[Output]:
        """What follows, with what follows from what became known meanwhile."""
        while self._has_news:
            self._has_news = False
            self._go_on(now)
        outputs, self._outputs = self._outputs, []
        return outputs

    def _go_on(self, now: float) -> None:
        self._look_after_halts(now)
        for run_id in list(self.runs):
            self._tell(run_id, now, Run.poll, self._lookup, now)
        for claim, waiting in list(self._anybody.items()):
            self._look_for_anybody(claim, waiting, now)
        for opened in list(self._open.values()):
            self._rank_again(opened, now)
            self._decided(opened, opened.decision.poll(now), now)

    def _on(self, run_id: str, what: Callable[[Run], list[Effect]], now: float) -> list[Output]:
        run = self.runs.get(run_id)
        if run is None:
            raise ScenarioError(f"there is no run {run_id!r} under way")
        self._tell(run_id, now, what)
        return self._taken(now)

    def _of_execution(self, execution_id: str, what: Callable[[Run], list[Effect]], now: float) -> list[Output]:
        run_id = self._executions.get(execution_id)
        run = self.runs.get(run_id or "")
        if run_id is not None and run is not None:
            self._tell(run_id, now, what)
        return self._taken(now)

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
                    self._anybody.pop((run_id, step), None)
                    self._let_go((run_id, step), now)
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
                case FollowTask():
                    self._executions[effect.execution_id] = run_id
                    self._outputs.append(
                        TaskFollowed(effect.execution_id, effect.robot, effect.skill, effect.may_be_unasked)
                    )
                case CancelTask():
                    halt = Halt(effect.execution_id, effect.robot, effect.skill, now)
                    if self._halts.order(halt):
                        self._outputs.append(HaltChanged(halt, is_owed=True))
                    self._outputs.append(TaskCancelled(halt.execution_id, halt.robot, halt.skill))
                case OpenDecision():
                    self._decide(run_id, effect, now, is_unknown=False)
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
                    asked = OpenDecision(
                        effect.step, effect.task, effect.skill, effect.capacities, effect.robot, effect.question
                    )
                    self._decide(run_id, asked, now, is_unknown=True)

    def _happened(self, run_id: str, fact: Fact, now: float) -> None:
        self._outputs.append(RunChanged(run_id, fact))
        if isinstance(fact, TaskOver | TaskAnswered | TaskFound | TaskHalting):
            self._close_question(run_id, fact, now)
        if isinstance(fact, TaskOver):
            task_run = self.runs[run_id].state.tasks[fact.step]
            self._executions.pop(task_run.execution_id, None)
            self._blame(task_run, fact, now)
        elif isinstance(fact, TaskAnswered):
            if (
                fact.then is not Then.REPLACE
            ):  # that one consents to a second robot, the others say that the first is not at it
                self._settle(self.runs[run_id].state.tasks[fact.step].execution_id, now)
        elif isinstance(fact, RunEnded):
            self._end(run_id, now)

    def _blame(self, task_run: TaskRun, fact: TaskOver, now: float) -> None:
        """Whoever fails at a task may be right: a fault is what the robot says, or what another one has shown."""
        skill = task_run.skill
        if fact.outcome is TaskOutcome.STOPPED:
            named = self._known.fleet.named_first(task_run.robot, fact.message)[0]
            self._take_in(FaultFound(task_run.robot, SKILL, True, f"{skill} failed: {fact.message}", named), now)
        elif fact.outcome is TaskOutcome.DONE:
            for robot, said in task_run.failed_on.items():
                if robot != task_run.robot:
                    reason = f"{skill} failed ({said}), and {task_run.robot} has done it"
                    lost = self._known.fleet.named_first(robot, said)[0] or self._known.fleet.needs(robot, skill)
                    self._take_in(FaultFound(robot, SKILL, True, reason, lost), now)

    def _close_question(self, run_id: str, fact: TaskOver | TaskAnswered | TaskFound | TaskHalting, now: float) -> None:
        """It is known what a robot was at, or somebody has said what follows: nobody has to choose any more."""
        opened = self._open.get(f"{run_id}.{fact.step}")
        if opened is None:
            return
        del self._open[opened.decision.id]
        if isinstance(fact, TaskAnswered):
            why = f"{fact.by} has answered: {fact.then.value}"
        elif isinstance(fact, TaskFound):
            why = f"{opened.asked.robot} has told: it is still at it"
        elif isinstance(fact, TaskHalting):
            why = f"{opened.asked.robot} stands: {fact.reason}"
        else:
            why = fact.message or fact.outcome.value
        self._say(opened, opened.decision.give_up(why))

    def _end(self, run_id: str, now: float) -> None:
        run = self.runs.pop(run_id)
        del self._scenarios[run_id]
        for opened in [opened for opened in self._open.values() if opened.run_id == run_id]:
            self._decided(opened, opened.decision.give_up("the run has ended"), now)
        for execution_id in [key for key, owner in self._executions.items() if owner == run_id]:
            del self._executions[execution_id]
        for step in run.state.tasks:
            self._anybody.pop((run_id, step), None)
            self._let_go((run_id, step), now)

    def _let_go(self, claim: tuple[str, str], now: float) -> None:
        """A run needs a robot no more, or waits for it no more."""
        self._grant(self._halts.let_go(claim), now)
        self._has_news = self._has_news or bool(self._halts.all())

    def _settle(self, execution_id: str, now: float) -> None:
        """A robot has stopped, or has ended what it was to stop, or a person says so."""
        settled = self._halts.settle(execution_id)
        if settled is None:
            return
        halt, grants = settled
        self._outputs.append(HaltChanged(halt, is_owed=False))
        if not self._halts.of(halt.robot):
            self._take_in(FaultFound(halt.robot, NOT_HALTED, False, ""), now)
        self._grant(grants, now)

    def _look_after_halts(self, now: float) -> None:
        """Tell robots again that have not stopped, and people of those about which no run asks."""
        for halt in self._halts.all():
            trouble = self._known.trouble(halt.robot, self._known.fleet.needs(halt.robot, halt.skill))
            if trouble is not None and trouble.stands:
                self._settle(halt.execution_id, now)
        self._outputs += self._halts.told_again(now)
        for halt in self._halts.unanswered(now):
            if not any(fault.source == NOT_HALTED for fault in self.faults.active(halt.robot)):
                said = f"it was told to stop {halt.skill}, and has not said that it has; look, then call ClearFault"
                self._take_in(FaultFound(halt.robot, NOT_HALTED, True, said), now)

    def _want(self, run_id: str, wanted: WantRobot, now: float) -> None:
        if wanted.robot is None:
            self._want_anybody(run_id, wanted, now)
        else:
            self._grant(self._reservations.want((run_id, wanted.step), wanted.robot), now)

    def _want_anybody(self, run_id: str, wanted: WantRobot, now: float) -> None:
        claim = run_id, wanted.step
        todo = self._choosing.wanted(run_id, wanted)
        ranking = self._choosing.ranked(todo)
        robot = ranking.best
        if robot is not None:
            self._anybody[claim] = _Anybody(wanted)
            self._grant(self._reservations.want(claim, robot), now)
            return
        self._grant(self._reservations.release(claim), now)
        hope_until = self._known.hope_until(todo, now)
        if hope_until is not None:
            self._anybody[claim] = _Anybody(wanted, hope_until)
            return
        self._anybody.pop(claim, None)
        reasons = "; ".join(f"{left.robot} {left.reason}" for left in ranking.excluded)
        reason = f"no robot can do {wanted.skill}: {reasons or 'there is none'}"
        self._tell(run_id, now, Run.nobody, wanted.step, reason, now)

    def _look_for_anybody(self, claim: tuple[str, str], waiting: _Anybody, now: float) -> None:
        """Look again where nobody was there, or who was to do it cannot be asked now."""
        run_id, step = claim
        run = self.runs.get(run_id)
        if run is None or run.state.phase(step) is not TaskPhase.WANTED:
            self._anybody.pop(claim, None)
            return
        robot = self._reservations.robot_of(claim)
        task = run.task(step)
        if robot is None or self._known.unfit(robot, self._known.needs(robot, task)) is not None:
            self._want_anybody(run_id, waiting.wanted, now)

    def _grant(self, grants: list[Grant[tuple[str, str]]], now: float) -> None:
        for (run_id, step), robot in grants:
            run = self.runs.get(run_id)
            if run is not None:
                skill = self._known.fleet.declared(robot, run.task(step).skill)
                self._tell(run_id, now, Run.granted, step, robot, now, skill)

    def _take_in(self, found: FaultFound, now: float) -> None:
        """Know it from now on; `_taken` has runs look at it."""
        change: tuple[Fault, FaultChange] | None
        if found.active:
            change = self._known.raised(found.robot, found.source, found.reason, now, found.capacities)
        else:
            change = self._known.cleared(found.robot, found.source)
            if found.source == NOT_HALTED:
                for halt in self._halts.of(found.robot):
                    self._settle(halt.execution_id, now)
        self._has_news = True
        if change is not None:
            self._outputs.append(FaultChanged(*change))

    # Decisions.

    def _decide(self, run_id: str, asked: OpenDecision, now: float, *, is_unknown: bool) -> None:
        decision_id = f"{run_id}.{asked.step}"
        todo = self._choosing.asked(run_id, asked, is_unknown=is_unknown)
        settings = self.settings
        decision = Decision(
            decision_id,
            settings.mode,
            self._choosing.ranked(todo),
            limit_s=settings.limit_s,
            on_limit=settings.on_limit,
            now=now,
            is_unknown=is_unknown,
            hope_until=self._known.hope_until(todo, now),
            not_before=now + LEAST_SILENCE_S if asked.may_be_done else None,
        )
        opened = self._open[decision_id] = _Open(run_id, asked, decision, is_unknown)
        self._decided(opened, decision.begin(), now)

    def _rank_again(self, opened: _Open, now: float) -> None:
        todo = self._choosing.asked(opened.run_id, opened.asked, is_unknown=opened.is_unknown)
        events = opened.decision.rank_again(self._choosing.ranked(todo), self._known.hope_until(todo, now))
        self._decided(opened, events, now)

    def _decided(self, opened: _Open, events: list[DecisionEvent], now: float) -> None:
        self._say(opened, events)
        step = opened.asked.step
        for event in events:
            if isinstance(event, ReplacementChosen):
                self._open.pop(event.decision_id, None)
                self._tell(opened.run_id, now, Run.replaced, step, event.robot, event.by, now)
            elif isinstance(event, Aborted):
                self._open.pop(event.decision_id, None)
                self._tell(opened.run_id, now, Run.not_replaced, step, event.reason, now)

    def _say(self, opened: _Open, events: list[DecisionEvent]) -> None:
        asked = opened.asked
        self._outputs += [
            DecisionChanged(opened.run_id, asked.step, asked.task, asked.robot, asked.reason, event) for event in events
        ]
