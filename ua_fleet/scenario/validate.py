"""A scenario held against a fleet: every problem with its line, and the scenario made ready to run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from typing import Final

from ua_fleet.errors import ConfigError
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.names import closest, listed
from ua_fleet.scenario.expression import Expression, ValueUnknown, split_index
from ua_fleet.scenario.model import BranchPoint, Condition, End, OnTimeout, Parallel, Repeat, Scenario, Step, Task, Wait
from ua_fleet.scenario.model import Sequence as Steps
from ua_fleet.scenario.parameters import argument_problems

__all__ = ["FleetView", "RobotView", "Validation", "validate"]

MOST_HINTS: Final = 20
"""Problems that say which known name may have been meant."""


@dataclass(frozen=True, slots=True)
class RobotView:
    """What validation needs to know of a robot."""

    name: str
    capacities: frozenset[str] = frozenset()
    skills: Mapping[str, SkillModel] = field(default_factory=dict[str, SkillModel])
    lacks: Mapping[str, str] = field(default_factory=dict[str, str])
    """Capacities that it could have, with why it has not: a device is not plugged in."""


@dataclass(frozen=True, slots=True)
class FleetView:
    """What validation needs to know of a fleet."""

    robots: Mapping[str, RobotView]
    values: Mapping[str, int] = field(default_factory=dict[str, int])
    """Names that conditions may use, `robot.data` and `data`, each with the number of values that it may mean."""
    events: frozenset[str] | None = None
    """Names of events that can happen; None: any."""
    arrays: frozenset[str] = frozenset()
    """Those of `values` that mean an array, of which a condition names one element."""

    def declared(self, robot: str, skill: str) -> SkillModel | None:
        """A robot's declaration of a skill, None where there is none."""
        view = self.robots.get(robot)
        return None if view is None else view.skills.get(skill)

    def needs(self, robot: str, skill: str) -> tuple[str, ...]:
        """The capacities that a skill needs on a robot; none where there is no such skill."""
        declared = self.declared(robot, skill)
        return () if declared is None else declared.capacities

    def named_first(self, robot: str, text: str) -> tuple[tuple[str, ...], str]:
        """The capacities that a word about a fault begins with, and the rest: `mobile, grab: it is stuck`.

        They count only where the robot has all of them, or could have them; else there are none, and all of the text.
        """
        head, colon, rest = text.partition(":")
        names = tuple(dict.fromkeys(name.strip() for name in head.split(",")))
        view = self.robots.get(robot)
        if not colon or view is None or not all(name in view.capacities or name in view.lacks for name in names):
            return (), text
        return names, rest.strip()

    def able(self, skill: str, capacities: Sequence[str]) -> list[RobotView]:
        """The robots that have a skill and capacities now."""
        return [
            robot for robot in self.robots.values() if skill in robot.skills and robot.capacities.issuperset(capacities)
        ]

    def could(self, skill: str, capacities: Sequence[str]) -> list[RobotView]:
        """The robots that have a skill, and capacities now or when all their devices are there."""
        return [
            robot
            for robot in self.robots.values()
            if skill in robot.skills and (robot.capacities | robot.lacks.keys()).issuperset(capacities)
        ]


@dataclass(frozen=True, slots=True)
class Validation:
    """What became of a scenario: run it only without problems."""

    scenario: Scenario
    """Each task has its timeout. Units and defaults are left to the robot that will be asked."""
    problems: tuple[ConfigError, ...]


def validate(scenario: Scenario, fleet: FleetView, file: str = "") -> Validation:
    """Hold a scenario against a fleet. Nothing is started by it."""
    checker = _Checker(scenario, fleet, file)
    body = checker.checked(scenario.body)
    assert isinstance(body, Steps)
    checker.check_order()
    problems = sorted(checker.problems, key=lambda problem: problem.line)
    return Validation(replace(scenario, body=body), tuple(problems))


class _Checker:
    def __init__(self, scenario: Scenario, fleet: FleetView, file: str) -> None:
        self._scenario, self._fleet, self._file = scenario, fleet, file
        self._parameters = {parameter.name for parameter in scenario.parameters}
        self._tasks = {task.name: task for task in scenario.tasks()}
        self._declared: dict[tuple[str, tuple[str, ...]], list[SkillModel]] = {}
        self.problems: list[ConfigError] = []

    def checked(self, step: Step) -> Step:
        """A step with its arguments made ready, after noting what is wrong with it."""
        match step:
            case Task():
                return self._task(step)
            case Steps(steps=steps):
                for before, after in pairwise(steps):
                    if _ends_run(before):
                        self._problem(after.line, "is never reached: the run ends before", "remove it, or the `end`")
                return replace(step, steps=tuple(map(self.checked, steps)))
            case Parallel(branches=branches):
                return replace(step, branches=tuple(self._steps(branch) for branch in branches))
            case Condition(when=when):
                holds = self._condition(when, step.line)
                never = step.otherwise if holds else step.then
                if holds is not None and never.steps:
                    self._never(never, when, holds=holds)
                return replace(step, then=self._steps(step.then), otherwise=self._steps(step.otherwise))
            case Repeat():
                if step.while_ is not None and self._condition(step.while_, step.line) is False and step.body.steps:
                    self._never(step.body, step.while_, holds=False)
                return replace(step, body=self._steps(step.body))
            case Wait():
                self._wait(step)
                return step
            case End() | BranchPoint():
                return step

    def _steps(self, steps: Steps) -> Steps:
        checked = self.checked(steps)
        assert isinstance(checked, Steps)
        return checked

    def _wait(self, step: Wait) -> None:
        goes_on = step.timeout_s is not None and step.on_timeout is OnTimeout.CONTINUE
        if step.until is not None and self._condition(step.until, step.line) is False and not goes_on:
            self._problem(step.line, f"never ends: {step.until.text!r} is always false")
        events = self._fleet.events
        if step.event is not None and events is not None and step.event not in events:
            hint = self._closest(step.event, events) or f"known events: {listed(sorted(events))}"
            self._problem(step.line, f"there is no event {step.event!r}", hint)

    def _condition(self, when: Expression, line: int) -> bool | None:
        """Note what is wrong with a condition; what it always is, None where that depends."""
        self._expression(when, line)
        try:
            return None if when.names else when.holds(_no_value)
        except ValueUnknown as error:
            self._problem(line, str(error))
            return None

    def _never(self, steps: Steps, when: Expression, *, holds: bool) -> None:
        self._problem(steps.steps[0].line, f"is never reached: {when.text!r} is always {'true' if holds else 'false'}")

    # Tasks.

    def _task(self, task: Task) -> Task:
        skills = self._skills_for(task)
        for name, value in task.arguments.items():
            if isinstance(value, Expression):
                self._expression(value, task.line, f"argument {name!r}")
        if not skills:
            return task
        for problem in sorted({each for skill in skills for each in argument_problems(skill, task.arguments, task)}):
            self._problem(task.line, f"task {task.name!r}: {problem}")
        timeout_s = max(skill.timeout_s for skill in skills) if task.timeout_s is None else task.timeout_s
        return replace(task, timeout_s=timeout_s)

    def _skills_for(self, task: Task) -> list[SkillModel]:
        """The declarations that a task's skill may have; none after noting why."""
        fleet = self._fleet
        if task.robot is None:
            able = self._able(task)
            if not able:
                known = {skill for robot in fleet.robots.values() for skill in robot.skills}
                hint = "" if task.skill in known else self._closest(task.skill, known)
                what = " and ".join(task.capacities)
                self._problem(task.line, f"task {task.name!r}: no robot with {what} has the skill {task.skill!r}", hint)
            return able
        robot = fleet.robots.get(task.robot)
        if robot is None:
            hint = self._closest(task.robot, fleet.robots) or f"known robots: {listed(fleet.robots) or 'none'}"
            self._problem(task.line, f"task {task.name!r}: there is no robot {task.robot!r}", hint)
            return []
        skill = robot.skills.get(task.skill)
        if skill is None:
            hint = self._closest(task.skill, robot.skills) or f"its skills: {listed(robot.skills) or 'none'}"
            self._problem(task.line, f"task {task.name!r}: {task.robot} has no skill {task.skill!r}", hint)
            return []
        return [skill]

    def _able(self, task: Task) -> list[SkillModel]:
        """The declarations of a skill on the robots that are able, each once: thousands may have the same."""
        key = task.skill, task.capacities
        if key not in self._declared:
            robots = self._fleet.could(*key)
            self._declared[key] = list(dict.fromkeys([replace(robot.skills[task.skill], id=0) for robot in robots]))
        return self._declared[key]

    # Names.

    def _expression(self, expression: Expression, line: int, where: str = "") -> None:
        for name in sorted(expression.names):
            problem = self._unknown(name)
            if problem is not None:
                self._problem(line, f"{where + ': ' if where else ''}{problem[0]}", problem[1])

    def _unknown(self, name: str) -> tuple[str, str] | None:
        """What is wrong with a name in a condition, and a hint; None if it is known."""
        name, index = split_index(name)
        problem = self._unknown_name(name)
        if problem is not None or (index is not None) == (name in self._fleet.arrays):
            return problem
        return (f"{name!r} is an array", f"write {name}[0]") if index is None else (f"{name!r} is no array", "")

    def _unknown_name(self, name: str) -> tuple[str, str] | None:
        if name in self._parameters:
            return None
        owner, _, rest = name.partition(".")
        task = self._tasks.get(owner)
        if task is not None and rest:
            results = self._results(task)
            if results is None or rest in results:
                return None
            return f"{task.skill} has no result {rest!r}", self._closest(
                rest, results
            ) or f"its results: {listed(results)}"
        meanings = self._fleet.values.get(name, 0)
        if meanings == 1:
            return None
        if meanings > 1:
            candidates = [full for full in self._fleet.values if full.endswith(f".{name}")]
            return f"{name!r} may be {meanings} values", f"write one of {listed(candidates)}"
        known = [*self._parameters, *self._fleet.values, *(f"{task}." for task in self._tasks)]
        return f"{name!r} is no parameter, no result and no robot's value", self._closest(name, known)

    def _results(self, task: Task) -> set[str] | None:
        if task.robot is None:
            skills = self._able(task)
        else:
            robot = self._fleet.robots.get(task.robot)
            skills = [robot.skills[task.skill]] if robot is not None and task.skill in robot.skills else []
        return {result.name for skill in skills for result in skill.results} if skills else None

    # Order.

    def check_order(self) -> None:
        """Find tasks that wait for each other, and tasks that wait for what may never be done."""
        enclosing = dict(_enclosing(self._scenario.body, ()))
        graph: dict[str, set[str]] = {name: set() for name in self._tasks}
        _order(self._scenario.body, graph, set())
        for task in self._tasks.values():
            for name in task.after:
                if name not in self._tasks:
                    hint = self._closest(name, self._tasks)
                    self._problem(task.line, f"task {task.name!r} comes after {name!r}, which is not there", hint)
                    continue
                graph[task.name].add(name)
                optional = [step for step in enclosing[name] if step not in enclosing[task.name]]
                if optional:
                    self._problem(
                        task.line,
                        f"task {task.name!r} comes after {name!r}, which may never be done (line {optional[0].line})",
                        "take it out of the condition or repetition, or wait for an event",
                    )
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            circle: list[str] = error.args[1]
            line = max(self._tasks[name].line for name in circle)
            self._problem(line, f"tasks wait for each other: {' after '.join(circle)}")

    def _closest(self, word: str, known: Iterable[str]) -> str:
        """A hint for the first problems; to look for one among many names takes its time."""
        return closest(word, known) if len(self.problems) < MOST_HINTS else ""

    def _problem(self, line: int, message: str, suggestion: str = "") -> None:
        self.problems.append(ConfigError(message, file=self._file, line=line, suggestion=suggestion))


def _no_value(name: str) -> bool:
    raise ValueUnknown(f"{name} has no value")


def _ends_run(step: Step) -> bool:
    """Whether the run is over after a step, whatever way it goes."""
    match step:
        case End():
            return True
        case Steps(steps=inner) | Parallel(branches=inner):
            return any(_ends_run(part) for part in inner)
        case Condition(then=then, otherwise=otherwise):
            return _ends_run(then) and _ends_run(otherwise)
        case Repeat(body=body, while_=while_):
            return while_ is None and _ends_run(body)
        case Task() | Wait() | BranchPoint():
            return False


def _inner(step: Step) -> tuple[Step, ...]:
    match step:
        case Steps(steps=inner) | Parallel(branches=inner):
            return inner
        case Condition(then=then, otherwise=otherwise):
            return then, otherwise
        case Repeat(body=body):
            return (body,)
        case Task() | Wait() | End() | BranchPoint():
            return ()


def _enclosing(step: Step, around: tuple[Step, ...]) -> Iterator[tuple[str, tuple[Step, ...]]]:
    """Each task with the steps around it that may leave it out."""
    if isinstance(step, Task):
        yield step.name, around
    if isinstance(step, Condition):
        # The two ways exclude each other, so each is a place of its own.
        yield from _enclosing(step.then, (*around, step.then))
        yield from _enclosing(step.otherwise, (*around, step.otherwise))
        return
    if isinstance(step, Repeat) and step.while_ is not None:
        around = (*around, step)
    for part in _inner(step):
        yield from _enclosing(part, around)


def _order(step: Step, graph: dict[str, set[str]], before: set[str]) -> set[str]:
    """Enter which tasks precede which; the tasks that have been done when a step is over, or `before` without any."""
    if isinstance(step, Task):
        graph[step.name] |= before
        return {step.name}
    if isinstance(step, Steps):
        for part in step.steps:
            before = _order(part, graph, before)
        return before
    inner = _inner(step)
    ends = {task for part in inner for task in _order(part, graph, before)}
    return ends if inner else before
