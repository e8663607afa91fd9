"""Carries out what runs ask for, with robots in virtual time: the owner that a server is in earnest."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from itertools import count
from math import inf

from ua_fleet.errors import ScenarioError
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
from ua_fleet.scenario.expression import Value, ValueUnknown
from ua_fleet.scenario.facts import Fact, RunEnded, TaskOutcome, decode_fact, encode_fact
from ua_fleet.scenario.model import Task
from ua_fleet.scenario.read import scenario_of
from ua_fleet.scenario.run import Run
from ua_fleet.scenario.world import Trouble


class Killed(Exception):
    """The process ends here; what is in the journal stays."""


@dataclass
class Skill:
    """What a robot does when it is asked."""

    takes_s: float = 1.0
    outcome: TaskOutcome = TaskOutcome.DONE
    results: Mapping[str, Value] = field(default_factory=dict[str, Value])


class Robots:
    """What is known of robots: see `scenario.world.World`."""

    silence_s = 30.0
    return_s = 300.0

    def __init__(self) -> None:
        self.troubles: dict[str, Trouble] = {}
        self.silent: dict[str, float] = {}
        self.busy: dict[str, str] = {}
        """Robots that are at what no run has asked for, and that in words."""
        self.followed: dict[str, float] = {}
        """Until when robots said that they are at executions; infinity: they say so."""

    def needs(self, robot: str, task: Task) -> tuple[str, ...]:
        return task.capacities

    def trouble(self, robot: str, needs: Collection[str] = ()) -> Trouble | None:
        return self.troubles.get(robot)

    def silent_since(self, robot: str) -> float | None:
        return self.silent.get(robot)

    def why_silent(self, robot: str) -> str:
        return ""

    def occupied(self, robot: str) -> str | None:
        return self.busy.get(robot)

    def followed_until(self, robot: str, execution_id: str) -> float:
        return self.followed.get(execution_id, -inf)


class Owner:
    """One run with its robots. `log` is what people would see."""

    def __init__(self, text: str, parameters: Mapping[str, Value] | None = None, *, run_id: str = "r1") -> None:
        self.scenario = scenario_of(text)
        self.journal: list[str] = []
        self.robots = Robots()
        self.values: dict[str, Value] = {}
        self.skills: dict[tuple[str, str], Skill] = {}
        self.says = ""
        """What robots say at each end."""
        self.stand_in: Callable[[DecisionNeeded], str | None] | None = None
        """Decides at once; None lets decisions wait in `decisions`."""
        self.answer: Callable[[AskOperator], str] | None = None
        """Answers after two seconds; None lets questions wait in `questions`."""
        self.unknowable: list[str] = []
        """Executions of which nobody could tell any more."""
        self.any_robot: dict[str, str] = {}
        """Which robot has a capacity."""
        self.log: list[str] = []
        self.decisions: list[DecisionNeeded] = []
        self.questions: list[AskOperator] = []
        self.begun: Counter[str] = Counter()
        """How often robots began an execution; they take each id once."""
        self.done_by: list[tuple[str, str]] = []
        self.ended = False
        self.now = 0.0
        self.writes_left: int | None = None
        self.robots_forget = False
        """Whether a robot takes an execution id that it has had for a new one: to see that tests notice."""
        self._events: list[tuple[float, int, Callable[[], list[Effect]]]] = []
        self._order = count()
        self._known: dict[str, tuple[TaskOutcome, Mapping[str, Value]] | None] = {}
        """What robots remember of executions: None while they are at it."""
        self._begun_by: dict[str, str] = {}
        """The robot of each execution that was begun."""
        self.unstoppable: set[str] = set()
        """Robots that do not say that they have stopped."""
        self.run = Run.create(
            run_id, self.scenario, parameters or {}, self._write, by="test", now=0.0, world=self.robots
        )

    # What is known of robots.

    def fault(self, robot: str, reason: str, *, stands: bool = True) -> list[Effect]:
        """A robot cannot work any more."""
        self.robots.troubles[robot] = Trouble(reason, stands)
        return self.run.poll(self.lookup, self.now)

    def repaired(self, robot: str) -> list[Effect]:
        """A robot works again."""
        del self.robots.troubles[robot]
        return self.run.poll(self.lookup, self.now)

    def silence(self, robot: str) -> list[Effect]:
        """Nothing is heard of a robot any more."""
        self.robots.silent[robot] = self.now
        return self.run.poll(self.lookup, self.now)

    def heard(self, robot: str) -> list[Effect]:
        """A robot is heard again."""
        del self.robots.silent[robot]
        return self.run.poll(self.lookup, self.now)

    # The process.

    def _write(self, fact: Fact) -> None:
        if self.writes_left is not None:
            if self.writes_left == 0:
                raise Killed
            self.writes_left -= 1
        line = encode_fact(fact)
        assert decode_fact(line) == fact
        self.journal.append(line)

    def restart(self) -> None:
        """Come back with the journal alone. Robots go on meanwhile, and remember what they did."""
        self.writes_left = None
        self.decisions, self.questions = [], []
        facts = [decode_fact(line) for line in self.journal]
        self.run = Run.restore(self.scenario, facts, self._write, self.robots)
        self._carry_out(self.run.again(self.lookup, self.now))

    def lookup(self, name: str) -> Value:
        if name not in self.values:
            raise ValueUnknown(f"{name} is not known")
        return self.values[name]

    def facts(self, kind: type[Fact]) -> list[Fact]:
        return [fact for fact in map(decode_fact, self.journal) if isinstance(fact, kind)]

    def tell(self, effects: list[Effect]) -> None:
        self._carry_out(effects)

    def go(self, until_s: float = 1000.0) -> None:
        """Let time pass until the run has ended, nothing is left to happen, or `until_s`."""
        self._carry_out(self.run.poll(self.lookup, self.now))
        while not self.ended:
            deadline = self.run.next_deadline()
            happening = self._events[0][0] if self._events else None
            due = min((at for at in (deadline, happening) if at is not None), default=None)
            if due is None or due > until_s:
                self.now = until_s if due is not None else self.now
                return
            self.now = max(self.now, due)
            if happening is not None and happening <= self.now:
                _, _, what = heapq.heappop(self._events)
                self._carry_out(what())
            self._carry_out(self.run.poll(self.lookup, self.now))

    def at(self, when: float, what: Callable[[], list[Effect]]) -> None:
        """Have something happen."""
        heapq.heappush(self._events, (when, next(self._order), what))

    # What runs ask for.

    def _carry_out(self, effects: list[Effect]) -> None:
        for effect in effects:
            match effect:
                case Happened(fact=fact):
                    if isinstance(fact, RunEnded):
                        self.ended = True
                        self.log.append(f"{fact.at:g} {fact.outcome.value} {fact.reason}".rstrip())
                case WantRobot():
                    self._grant(effect)
                case StartTask():
                    self._start(effect)
                case DecisionNeeded():
                    self._decide(effect)
                case AskOperator():
                    self.questions.append(effect)
                    self._answer(effect)
                case CancelTask():
                    self.log.append(f"{self.now:g} {effect.robot} halted")
                    self._cancel(effect.execution_id)
                case FollowTask():
                    self._follow(effect)
                case TaskWaits():
                    self.log.append(f"{self.now:g} {effect.task} waits: {effect.reason}")
                case ReleaseRobot():
                    pass

    def _grant(self, wanted: WantRobot) -> None:
        robot = wanted.robot or self.any_robot.get(" ".join(wanted.capacities))
        if robot is None:
            reason = f"no robot has {', '.join(wanted.capacities)}"
            self.at(self.now, lambda: self.run.nobody(wanted.step, reason, self.now))
        else:
            self.at(self.now, lambda: self.run.granted(wanted.step, robot, self.now))

    def _start(self, task: StartTask) -> None:
        """A robot, which takes an execution id once and remembers how it ended."""
        execution_id = task.execution_id
        if execution_id in self._known and not self.robots_forget:
            remembered = self._known[execution_id]
            if remembered is not None:
                self._report(execution_id, *remembered, after_s=0.0)
            return
        skill = self.skills.get((task.robot, task.skill), Skill())
        if skill.outcome is TaskOutcome.REFUSED:
            self._known[execution_id] = (skill.outcome, {})
            self._report(execution_id, skill.outcome, {}, after_s=0.0)
            return
        if skill.outcome is TaskOutcome.BUSY:
            self._known[execution_id] = (skill.outcome, {})
            self._report(execution_id, skill.outcome, {}, after_s=0.5)
            return
        self.begun[f"{task.task}"] += 1
        self._begun_by[execution_id] = task.robot
        self._known[execution_id] = None
        self.log.append(f"{self.now:g} {task.robot} {task.skill}{_shown(task.arguments)}")
        self.at(self.now, lambda: self.run.accepted(execution_id, self.now))

        def finish() -> list[Effect]:
            is_unknowable = execution_id in self.unknowable
            is_at_it = is_unknowable or self._known[execution_id] is None
            if is_at_it and skill.outcome is TaskOutcome.DONE:
                self.done_by.append((task.task, task.robot))
            if is_unknowable:
                return []
            if self._known[execution_id] is None:
                self._known[execution_id] = (skill.outcome, skill.results)
            return self._ended(execution_id)

        self.at(self.now + skill.takes_s, finish)

    def kill_bridge(self, robot: str) -> list[Effect]:
        """A robot goes on, but nobody can ask it any more what became of what it is at."""
        for execution_id, begun_by in self._begun_by.items():
            if begun_by == robot and self._known[execution_id] is None:
                self.unknowable.append(execution_id)
                self._known[execution_id] = (TaskOutcome.UNKNOWN, {})
                self._report(execution_id, TaskOutcome.UNKNOWN, {}, after_s=0.5)
        return []

    def _answer(self, question: AskOperator) -> None:
        answer = self.answer
        if answer is None:
            return

        def tell() -> list[Effect]:
            try:
                return self.run.answered(question.step, answer(question), "anna", self.now)
            except ScenarioError:  # asked again after a restart, and answered before
                return []

        self.at(self.now + 2, tell)

    def _follow(self, task: FollowTask) -> None:
        """What a robot remembers of an execution, that nobody is to begin."""
        known = self._known.get(task.execution_id, (TaskOutcome.REFUSED, {}))
        if known is not None:
            self._known[task.execution_id] = known
            self._report(task.execution_id, *known, after_s=0.0)

    def _cancel(self, execution_id: str) -> None:
        if self._begun_by.get(execution_id) in self.unstoppable:
            return
        if self._known.get(execution_id, ()) is None:
            self._known[execution_id] = (TaskOutcome.FAILED, {})
            self._report(execution_id, TaskOutcome.FAILED, {}, after_s=0.5)

    def _report(self, execution_id: str, outcome: TaskOutcome, results: Mapping[str, Value], *, after_s: float) -> None:
        del outcome, results
        self.at(self.now + after_s, lambda: self._ended(execution_id))

    def _ended(self, execution_id: str) -> list[Effect]:
        known = self._known[execution_id]
        assert known is not None
        return self.run.ended(execution_id, known[0], self.now, message=self.says, results=known[1])

    def _decide(self, decision: DecisionNeeded) -> None:
        self.decisions.append(decision)
        if self.stand_in is None:
            return
        robot = self.stand_in(decision)
        step = decision.step
        if robot is None:
            self.at(self.now, lambda: self.run.not_replaced(step, "no robot is left that can take over", self.now))
        else:
            self.at(self.now, lambda: self.run.replaced(step, robot, "automatic", self.now))


def _shown(arguments: Mapping[str, Value]) -> str:
    return f"({', '.join(f'{name}={value}' for name, value in arguments.items())})" if arguments else ""
