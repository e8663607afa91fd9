"""All runs of a fleet: who gets which robot, what a fault brings with it, and who decides."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from ua_fleet.errors import ScenarioError
from ua_fleet.orchestrator.candidates import ResilienceSettings
from ua_fleet.orchestrator.choosing import Choosing
from ua_fleet.orchestrator.claims import Claim, Claims
from ua_fleet.orchestrator.conditions import FaultFound
from ua_fleet.orchestrator.decisions import Decisions
from ua_fleet.orchestrator.faults import Fault, FaultChange, Faults
from ua_fleet.orchestrator.guard import Guard
from ua_fleet.orchestrator.halting import Halting
from ua_fleet.orchestrator.halts import Halts
from ua_fleet.orchestrator.holds import Hold, Holds
from ua_fleet.orchestrator.knowledge import Knowledge
from ua_fleet.orchestrator.outputs import (
    FaultChanged,
    FaultForecast,
    Halt,
    HaltChanged,
    HoldChanged,
    OperatorAsked,
    Output,
    RunBroken,
    RunChanged,
    TaskFollowed,
    TaskStarted,
    TaskWaiting,
)
from ua_fleet.orchestrator.restoring import end_of, halts_of
from ua_fleet.orchestrator.under_way import RunsUnderWay
from ua_fleet.resilience import Confirmation, Decision, Judgements, Ranking
from ua_fleet.scenario import FleetView, Lookup, Reservations, Run, Scenario, Value
from ua_fleet.scenario.consequences import NOT_HALTED, SKILL
from ua_fleet.scenario.effects import (
    AskOperator,
    CancelTask,
    DecisionNeeded,
    Effect,
    FollowTask,
    Happened,
    ReleaseRobot,
    StartTask,
    TaskWaits,
    WantRobot,
)
from ua_fleet.scenario.facts import (
    Fact,
    RunClosing,
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

RunJournal = Callable[[str, Fact], None]
"""Writes a fact of a run down; when it returns the fact is there after a crash."""


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
        self._guard = Guard()
        self._lookup, self._journal = lookup, journal
        self._known = Knowledge(settings, fleet)
        self._outputs: list[Output] = []
        self._under_way = RunsUnderWay(self._outputs, self._carry_out, self._given_up, self._grant_next)
        self.runs = self._under_way.runs
        """Runs that have not ended."""
        self._choosing = Choosing(self._known, self.runs, lookup)
        self._scenarios: dict[str, Scenario] = {}
        reservations = Reservations[Claim]()
        self._halts = Halts(reservations)
        self._claims = Claims(self._known, self._choosing, self._under_way, reservations, self._halts)
        self._halting = Halting(self._halts, self._known, self._claims, self._outputs, self._guard, self._take_in)
        self._decisions = Decisions(self._known, self._choosing, self._under_way, self._outputs, lookup)
        self._executions: dict[str, str] = {}
        """The run of each execution that is under way."""
        self._has_news = False
        """Whether something became known of robots that runs have not looked at."""

    def explain_silence(self, explain: Callable[[str], str]) -> None:
        """Have somebody say why nothing is heard of a robot, and what to do: its bridge is away, say. May be empty."""
        self._known.explain_silence = explain

    def silence_explained(self) -> None:
        """Why nothing is heard of robots is not what it was."""
        self._known.changed()

    def tell_mistakes(self, caught: Callable[[str, Exception], None]) -> None:
        """Tell of each mistake that costs a fault or a halt its turn; without this it is raised. Those that cost a run
        are among the outputs.
        """
        self._guard.caught = caught

    @property
    def settings(self) -> ResilienceSettings:
        """How replacements are chosen now."""
        return self._known.settings

    @property
    def owes_halts(self) -> bool:
        """Whether robots were told to stop that have not said that they have."""
        return bool(self._halts.all())

    def halts_of(self, robot: str) -> list[Halt]:
        """What a robot was told to stop, and has not said that it has."""
        return self._halts.of(robot)

    @property
    def faults(self) -> Faults:
        """The faults of all robots."""
        return self._known.faults

    @property
    def holds(self) -> Holds:
        """The robots that people hold back from tasks."""
        return self._known.holds

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
        self._under_way.tell(run_id, now, Run.poll, self._lookup, now)
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
        owed = list(halts)
        for run_id, scenario, facts in stored:
            try:
                run = Run.restore(scenario, facts, self._journal_of(run_id), self._known)
            except Exception as error:  # noqa: BLE001 - the other runs, and the server, go on
                owed += self._not_restored(run_id, facts, error, now)
                continue
            if run.state.outcome is not None:
                continue
            self.runs[run_id], self._scenarios[run_id] = run, scenario
            restored.append(run_id)
            for execution_id in run.state.executions:
                self._known.asked_for(execution_id)
            for step, task_run in run.state.tasks.items():
                if task_run.phase in HELD_PHASES:
                    self._claims.hold((run_id, step), task_run.robot)
        self._halts.restore(owed, now)
        for halt in owed:
            self._known.asked_for(halt.execution_id)
        self._has_news = True
        for run_id in restored:
            self._under_way.tell(run_id, now, Run.again, self._lookup, now)
        for run_id in restored:
            self._under_way.tell(run_id, now, Run.poll, self._lookup, now)
        return self._taken(now)

    def _not_restored(self, run_id: str, facts: list[Fact], error: Exception, now: float) -> list[Halt]:
        """End a run whose facts cannot be taken in. What its robots may be at they are to stop."""
        halts, ended = halts_of(facts, now), end_of(error, now)
        self._journal(run_id, ended)
        self._outputs += [RunBroken(run_id, error), RunChanged(run_id, ended)]
        self._outputs += [HaltChanged(halt, is_owed=True) for halt in halts]
        return halts

    def halts_found(self, halts: Sequence[Halt], now: float) -> list[Output]:
        """Robots come that were told to stop before a restart, and were not there at that."""
        self._halts.restore(halts, now)
        for halt in halts:
            self._known.asked_for(halt.execution_id)
            self._has_news = True
        return self._taken(now)

    def must_not_begin(self) -> list[str]:
        """Executions that were asked for and must not begin any more, by their ids: their robots have a fault, or were
        told to stop, or their runs are to end.
        """
        to_stop = [halt.execution_id for halt in self._halts.all()]
        for run in self.runs.values():
            held = [(step, one) for step, one in run.state.tasks.items() if one.phase in HELD_PHASES]
            to_stop += [one.execution_id for step, one in held if self._must_not_begin(run, step, one)]
        return list(dict.fromkeys(to_stop))

    def _must_not_begin(self, run: Run, step: str, task_run: TaskRun) -> bool:
        if run.state.closing is not None or task_run.phase is TaskPhase.HALTING:
            return True
        try:
            return self._trouble(task_run.robot, run.task(step)) is not None
        except Exception as error:  # noqa: BLE001 - counted, or raised by `catch`
            self._guard.catch("runs", error)
            return True  # whatever is wrong, this harms nobody

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
            self._under_way.tell(run_id, now, Run.event, name, now)
        return self._taken(now)

    def outside_told(
        self, run_id: str, task: str, now: float, *, is_done: bool, results: Mapping[str, Value]
    ) -> list[Output]:
        """What became of a task that another part of a carried run does; raises ScenarioError where there is no such
        run.
        """
        return self._on(run_id, lambda run: run.told(task, now, is_done=is_done, results=results), now)

    def stand_in_told(self, run_id: str, failed: str, robot: str, capacity: str, now: float) -> list[Output]:
        """Who stands in for a robot, as another part of a carried run has chosen; raises as `outside_told` does."""
        return self._on(run_id, lambda run: run.stand_in_told(failed, robot, capacity, now), now)

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
        """A robot's execution has ended; HALTED: because it was halted, by its run or by anybody else."""
        if outcome is not TaskOutcome.UNKNOWN:
            was_ours = self._halting.settle(execution_id, now)
            if was_ours and outcome is TaskOutcome.HALTED:
                outcome = TaskOutcome.FAILED
        return self._of_execution(
            execution_id, lambda run: run.ended(execution_id, outcome, now, message=message, results=results), now
        )

    def fleet_changed(self, fleet: FleetView, now: float) -> list[Output]:
        """Robots, skills or capacities have come or gone."""
        self._known.fleet = fleet
        self._known.changed()
        return self.poll(now)

    def told(
        self, found: Iterable[FaultFound], now: float, followed: Iterable[tuple[str, frozenset[str]]] = ()
    ) -> list[Output]:
        """What has become known of robots. All of it is taken in before anything follows from it.

        Args:
            found: faults that are there, or are no more.
            now: by the wall clock.
            followed: robots with what each SkillStatus says they are at, as in `followed`.
        """
        for one in found:
            self._guard.do("faults", self._take_in, one, now)
        for robot, told in followed:
            self._guard.do("tasks", self._follow, robot, told, now)
        return self._taken(now)

    def not_heard(self, robots: Iterable[str], now: float) -> list[Output]:
        """Nothing is heard of robots, from now on: so it is at a start. A fault `silent` is another matter."""
        self._known.not_heard(robots, now)
        self._has_news = True
        return self._taken(now)

    def followed(self, robot: str, told: frozenset[str], now: float) -> list[Output]:
        """A robot's SkillStatus says which executions it is at: none of them, where nothing says so any more."""
        self._follow(robot, told, now)
        return self._taken(now)

    def _follow(self, robot: str, told: frozenset[str], now: float) -> None:
        if self._known.follow(robot, told, self._executions, now):
            self._has_news = True

    def hold(self, robot: str, by: str, reason: str, now: float) -> list[Output]:
        """Give a robot no task that it is not at already; raises ScenarioError where somebody else holds it."""
        return self._held(self.holds.hold(robot, by, reason, now), by, now, is_held=True)

    def release(self, robot: str, by: str, now: float) -> list[Output]:
        """Let a robot have tasks again; nothing where it was not held."""
        return self._held(self.holds.release(robot), by, now, is_held=False)

    def _held(self, hold: Hold | None, by: str, now: float, *, is_held: bool) -> list[Output]:
        if hold is not None:
            self._outputs.append(HoldChanged(hold, is_held, by))
            self._known.changed()
            self._has_news = True
        return self._taken(now)

    def driven(self, robot: str, told: str, now: float) -> list[Output]:
        """People drive a robot by hand, in words that follow its name; empty: nobody does.

        It has no task meanwhile, as one that is held; but nobody has said so, so that nothing is written down.
        """
        self._has_news = self._known.drive(robot, told) or self._has_news
        return self._taken(now)

    def is_silent(self, robot: str) -> bool:
        """Whether nothing is heard of a robot."""
        return self._known.silent_since(robot) is not None

    def forget(self, robot: str) -> None:
        """A robot that no run uses is gone. What people say of it stays: a hold, and the faults that they end."""
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
        return self._decisions.confirm(decision_id, robot, by, now), self._taken(now)

    def preview(self, decision_id: str, judgements: Judgements | None) -> Ranking:
        """The ranking of an open decision with other judgements, which changes nothing; None: those that count.

        Raises:
            JudgementsInvalid: no weights can be made of them.
            ScenarioError: there is no such decision.
        """
        return self._decisions.preview(decision_id, judgements)

    def judge(self, decision_id: str, judgements: Judgements | None, now: float) -> list[Output]:
        """Rank an open decision with other judgements; None: with those of all. Raises as `preview` does."""
        self._decisions.judge(decision_id, judgements, now)
        return self._taken(now)

    def restore_judgements(self, judgements: Mapping[str, Judgements]) -> None:
        """Judgements of single decisions, as they were before a restart; before `restore_all`."""
        self._decisions.restore_judgements(judgements)

    def set_settings(self, settings: ResilienceSettings, now: float) -> list[Output]:
        """Other criteria, judgements or modes; open decisions are ranked again."""
        self._known.settings = settings
        self._known.changed()
        return self.poll(now)

    def what_if(self, robot: str) -> tuple[int, Iterator[FaultForecast]]:
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
        return {opened.decision.id: opened.decision for opened in self._decisions}

    # Time.

    def poll(self, now: float) -> list[Output]:
        """Go on with everything: time has passed, or values have changed."""
        self._has_news = True
        return self._taken(now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next even if nothing changes, or None."""
        deadlines = [run.next_deadline() for run in self.runs.values()]
        deadlines += [part.next_deadline() for part in (self._decisions, self._halts, self._claims)]
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    # Within.

    def _journal_of(self, run_id: str) -> Callable[[Fact], None]:
        def journal(fact: Fact) -> None:
            self._choosing.happened(run_id)
            self._journal(run_id, fact)

        return journal

    def _taken(self, now: float) -> list[Output]:
        """What follows, with what follows from what became known meanwhile."""
        while self._has_news or self._claims.tell_queued(now):
            if self._has_news:
                self._has_news = False
                self._go_on(now)
        outputs = list(self._outputs)
        self._outputs.clear()
        return outputs

    def _go_on(self, now: float) -> None:
        self._halting.look_after(now)
        for run_id in list(self.runs):
            self._under_way.tell(run_id, now, Run.poll, self._lookup, now)
        for claim in self._claims.waiting():
            self._under_way.guard(claim[0], now, self._claims.look_again, claim, now)
        self._decisions.look_at_values()
        for opened in self._decisions:
            self._under_way.guard(opened.run_id, now, self._decisions.look_again, opened, now)
        self._decisions.rank_in_turn(now)

    def _on(self, run_id: str, what: Callable[[Run], list[Effect]], now: float) -> list[Output]:
        if run_id not in self.runs:
            raise ScenarioError(f"there is no run {run_id!r} under way")
        self._under_way.ask(run_id, now, what)
        return self._taken(now)

    def _of_execution(self, execution_id: str, what: Callable[[Run], list[Effect]], now: float) -> list[Output]:
        self._under_way.tell(self._executions.get(execution_id, ""), now, what)
        return self._taken(now)

    def _carry_out(self, run_id: str, effect: Effect, now: float) -> None:
        match effect:
            case Happened(fact=fact):
                self._happened(run_id, fact, now)
            case WantRobot():
                self._claims.want(run_id, effect, now)
            case ReleaseRobot(step=step):
                self._claims.let_go((run_id, step), now)
                self._has_news = self._has_news or bool(self._halts.all())
            case StartTask():
                self._know(effect.execution_id, run_id)
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
                self._know(effect.execution_id, run_id)
                self._outputs.append(
                    TaskFollowed(effect.execution_id, effect.robot, effect.skill, effect.may_be_unasked)
                )
            case TaskWaits():
                self._outputs.append(TaskWaiting(run_id, effect))
            case CancelTask():
                why = self._why_halted(run_id, effect.execution_id)
                self._halting.order(Halt(effect.execution_id, effect.robot, effect.skill, now, why))
            case DecisionNeeded():
                self._decisions.open(run_id, effect, now, is_unknown=False)
            case AskOperator():
                self._know(effect.execution_id, run_id)  # its robot may tell later
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
                asked = DecisionNeeded(
                    effect.step, effect.task, effect.skill, effect.capacities, effect.robot, effect.question
                )
                self._decisions.open(run_id, asked, now, is_unknown=True)

    def _why_halted(self, run_id: str, execution_id: str) -> str:
        """Which task of which run an execution is, and why it is told to stop, for people."""
        run = self.runs.get(run_id)
        if run is None or (task_run := run.state.tasks.get(run.state.executions.get(execution_id, ""))) is None:
            return f"run {run_id}"
        closing = run.state.closing
        why = task_run.reason if task_run.halting is None else task_run.halting.reason
        if closing is not None:
            why = f"{closing.reason}; {why}" if why else closing.reason
        return f"task {task_run.name} of run {run_id}{f': {why}' if why else ''}"

    def _know(self, execution_id: str, run_id: str) -> None:
        self._executions[execution_id] = run_id
        self._known.asked_for(execution_id)

    def _grant_next(self, now: float) -> bool:
        return self._claims.grant_next(now)

    def _happened(self, run_id: str, fact: Fact, now: float) -> None:
        self._outputs.append(RunChanged(run_id, fact))
        is_closing = isinstance(fact, RunClosing)
        self._claims.touch(run_id, self.runs[run_id].state.tasks if is_closing else (getattr(fact, "step", ""),))
        if isinstance(fact, TaskOver | TaskAnswered | TaskFound | TaskHalting):
            self._decisions.close(run_id, fact)
        if isinstance(fact, TaskOver):
            task_run = self.runs[run_id].state.tasks[fact.step]
            self._executions.pop(task_run.execution_id, None)
            self._blame(task_run, fact, now)
        elif isinstance(fact, TaskAnswered):
            if (
                fact.then is not Then.REPLACE
            ):  # that one consents to a second robot, the others say that the first is not at it
                self._halting.settle(self.runs[run_id].state.tasks[fact.step].execution_id, now)
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

    def _end(self, run_id: str, now: float) -> None:
        run = self.runs.pop(run_id)
        self._forget(run_id)
        self._decisions.end(run_id, now)
        self._claims.end(run_id, run.state.tasks, now)
        self._has_news = self._has_news or bool(self._halts.all())

    def _forget(self, run_id: str) -> None:
        del self._scenarios[run_id]
        self._choosing.forget(run_id)
        for execution_id in [key for key, owner in self._executions.items() if owner == run_id]:
            del self._executions[execution_id]

    def _given_up(self, run_id: str) -> None:
        """A run that could not be ended: nobody gets what it has before somebody has looked, and a restart."""
        self._forget(run_id)
        self._decisions.forget(run_id)
        self._claims.forget(run_id)

    def _take_in(self, found: FaultFound, now: float) -> None:
        """Know it from now on; `_taken` has runs look at it."""
        change: tuple[Fault, FaultChange] | None
        if found.active:
            change = self._known.raised(found.robot, found.source, found.reason, now, found.capacities)
        else:
            change = self._known.cleared(found.robot, found.source)
            if found.source == NOT_HALTED:
                for halt in self._halts.of(found.robot):
                    self._halting.settle(halt.execution_id, now)
        self._has_news = True
        if change is not None:
            self._outputs.append(FaultChanged(*change))
