"""A scenario split into segments: what one bridge does without another one, and what comes after.

    segment --ended--> a token to each of `then` --all slots filled--> the next segment
            --failed-> a token that says so to `fails`, the join around it; at the top to the last segment

A segment is a list of steps of the scenario as they stand there, which the engine of scenarios runs in the bridge of
their robots. `parallel` over several bridges ends its segment, which has a token for each branch then; the join is a
segment of the same bridge, with a slot for each branch. So each slot gets one token in a run, and the end of the last
segment is the end of the run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ua_fleet.carrying.token import MOST_TOKEN_BYTES, WHOLE, most_bytes
from ua_fleet.errors import ConfigError
from ua_fleet.scenario import FleetView
from ua_fleet.scenario.expression import Expression, split_index
from ua_fleet.scenario.model import Condition, End, Parallel, Repeat, Scenario, Sequence, Step, Task, Wait

__all__ = ["Edge", "Plan", "PlanView", "Segment", "Split", "missing_requestors", "names_in", "split"]

MOST_SEGMENTS: Final = 2000
MOST_SLOTS: Final = WHOLE
"""Branches of one `parallel`, since a slot is one byte."""
LEASE_MARGIN_S: Final = 600.0
"""What a run may take beside its tasks, before its reservations end by themselves."""
_WAIT_FOR_EVER_S: Final = 24 * 3600.0
"""What a wait without a timeout counts in the lease."""
_MOST_LEASE_S: Final = 7 * 24 * 3600.0


class Edge(NamedTuple):
    """Where a token goes."""

    segment: int
    slot: int


@dataclass(slots=True)
class Segment:
    """Steps that one bridge does, one after the other. It has the number that is its place in the plan."""

    space: int
    slots: int
    steps: list[Step] = field(default_factory=list[Step])
    then: list[Edge] = field(default_factory=list[Edge])
    """None: it is the last one."""
    fails: Edge | None = None
    needs: tuple[str, ...] = ()
    """Results of segments before, `task.result`, that are read here or later: what its token holds."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A scenario that can be carried. The first segment begins it, the last one ends it."""

    segments: tuple[Segment, ...]
    last: int
    lease_s: float
    """Reservations end by themselves when so long nothing has come of the run."""

    @property
    def spaces(self) -> tuple[int, ...]:
        """The spaces of all bridges that have a segment."""
        return tuple(sorted({segment.space for segment in self.segments}))


@dataclass(frozen=True, slots=True)
class PlanView:
    """What splitting needs to know of a fleet."""

    fleet: FleetView
    space_of: Mapping[str, int]
    """The space of each robot that lives behind a bridge."""
    requestors: Mapping[int, frozenset[int]]
    """The spaces that may command each bridge, by its space."""
    of_server: frozenset[str] = frozenset()
    """Names of values that the server says: no bridge has them while it is away."""


class Split(NamedTuple):
    """What became of a scenario: a plan, or why it cannot be carried."""

    plan: Plan | None
    problems: tuple[ConfigError, ...]


def split(scenario: Scenario, view: PlanView, file: str = "") -> Split:
    """Split a scenario without problems; all that keeps it from being carried is told, with its line."""
    splitter = _Splitter(scenario, view, file)
    plan = splitter.plan()
    problems = tuple(sorted(splitter.problems, key=lambda problem: problem.line))
    return Split(None if problems else plan, problems)


class _Splitter:
    def __init__(self, scenario: Scenario, view: PlanView, file: str) -> None:
        self._scenario, self._view, self._file = scenario, view, file
        self._tasks = {task.name: task for task in scenario.tasks()}
        self._parameters = {parameter.name for parameter in scenario.parameters}
        self._segments: list[Segment] = []
        self._space_of_task: dict[str, int | None] = {task.name: self._space(task) for task in scenario.tasks()}
        self.problems: list[ConfigError] = []

    def plan(self) -> Plan | None:
        """The plan, as far as there are no problems."""
        for step in self._scenario.steps():
            self._look_at(step)
        spaces = [space for space in self._space_of_task.values() if space is not None]
        if not spaces:
            self._problem(self._scenario.body.line, "no task of it has a bridge that could carry it")
        if self.problems:
            return None
        first = self._open(spaces[0], 1)
        last = self._sequence(self._scenario.body.steps, first, None)
        for number, segment in enumerate(self._segments):
            if segment.fails is None and number != last:
                segment.fails = Edge(last, WHOLE)
        self._check_roads(last)
        needs = _Needs(self._segments, self._tasks)
        self._check_order(needs)
        self._check_tokens(needs)
        if len(self._segments) > MOST_SEGMENTS:
            self._problem(0, f"it has {len(self._segments)} segments; at most {MOST_SEGMENTS} are carried")
        return Plan(tuple(self._segments), last, min(self._lease_s(), _MOST_LEASE_S))

    # Whether steps can be carried at all.

    def _look_at(self, step: Step) -> None:
        match step:
            case Task() if self._space_of_task[step.name] is None:
                self._problem(step.line, f"task {step.name!r}: no robot for it lives behind a bridge")
            case Wait(event=str() as event):
                self._problem(step.line, f"the event {event!r} is told to the server, and no bridge hears it")
            case Condition() | Repeat() if len(self._spaces(step)) > 1:
                kind = "if" if isinstance(step, Condition) else "repeat"
                self._problem(
                    step.line,
                    f"the `{kind}` has tasks of several bridges",
                    "have all tasks within it done by robots of one bridge, or run it orchestrated",
                )
            case Parallel(branches=branches) if len(branches) > MOST_SLOTS:
                self._problem(step.line, f"at most {MOST_SLOTS} branches are carried, here are {len(branches)}")
            case _:
                pass
        for name in sorted(_names_at(step)):
            if split_index(name)[0] in self._view.of_server and name not in self._parameters:
                self._problem(step.line, f"{name!r} is said by the server, and no bridge has it while that is away")

    def _space(self, task: Task) -> int | None:
        """Where a task is done: by the robot that it names, or by the first that can do it."""
        if task.robot is not None:
            return self._view.space_of.get(task.robot)
        able = [robot.name for robot in self._view.fleet.able(task.skill, task.capacities)]
        return next((self._view.space_of[name] for name in able if name in self._view.space_of), None)

    def _spaces(self, step: Step) -> set[int]:
        found = [self._space_of_task[task.name] for task in _tasks_in(step)]
        return {space for space in found if space is not None}

    # Segments.

    def _open(self, space: int, slots: int, fails: Edge | None = None) -> int:
        self._segments.append(Segment(space, slots, fails=fails))
        return len(self._segments) - 1

    def _sequence(self, steps: Iterable[Step], at: int, fails: Edge | None) -> int:
        """Add steps behind a segment; the one with which they end."""
        for step in steps:
            at = self._add(step, at, fails)
        return at

    def _add(self, step: Step, at: int, fails: Edge | None) -> int:
        spaces = self._spaces(step)
        if len(spaces) > 1:
            if isinstance(step, Parallel):
                return self._fork(step, at, fails)
            assert isinstance(step, Sequence), "others were told to be problems"
            return self._sequence(step.steps, at, fails)
        space = next(iter(spaces), self._segments[at].space)
        if self._segments[at].space != space:
            at = self._follow(at, space, fails)
        self._segments[at].steps.append(step)
        return at

    def _follow(self, at: int, space: int, fails: Edge | None) -> int:
        """A new segment behind one. Where that has nothing to do and nothing to join, it takes its place."""
        before = self._segments[at]
        if at == 0 and not before.steps and not before.then:
            before.space = space
            return at
        number = self._open(space, 1, fails)
        self._segments[at].then.append(Edge(number, 0))
        return number

    def _fork(self, step: Parallel, at: int, fails: Edge | None) -> int:
        join = self._open(self._segments[at].space, len(step.branches), fails)
        for slot, branch in enumerate(step.branches):
            edge = Edge(join, slot)
            if not branch.steps:
                self._segments[at].then.append(edge)
                continue
            spaces = self._spaces(branch.steps[0])
            space = next(iter(sorted(spaces)), self._segments[at].space)
            entry = self._open(space, 1, edge)
            self._segments[at].then.append(Edge(entry, 0))
            end = self._sequence(branch.steps, entry, edge)
            self._segments[end].then.append(edge)
        return join

    # Whether they can be carried together.

    def _check_roads(self, last: int) -> None:
        """Each bridge takes tokens of those that send it some, and the end of those that may end the run."""
        for target, missing in missing_requestors(Plan(tuple(self._segments), last, 0.0), self._view.requestors):
            listed = ", ".join(map(str, missing))
            self._problem(
                0,
                f"the bridge of space {target} takes no Actions of space {listed}",
                f"add {listed} to its `requestors`, so that they have the keys of c-{target}",
            )

    def _check_order(self, needs: _Needs) -> None:
        for number, segment in enumerate(self._segments):
            own = {task.name for step in segment.steps for task in _tasks_in(step)}
            for task in [task for step in segment.steps for task in _tasks_in(step)]:
                for name in task.after:
                    if name not in own and needs.home.get(name) not in needs.before[number]:
                        self._problem(
                            task.line,
                            f"task {task.name!r} comes after {name!r}, which another bridge does in another branch",
                        )
            for step in segment.steps:
                for read in sorted(names_in(step)):
                    owner = read.partition(".")[0]
                    if owner in needs.home and owner not in own and needs.home[owner] not in needs.before[number]:
                        line = step.line
                        self._problem(line, f"{read!r} is a result of another branch, which another bridge does")

    def _check_tokens(self, needs: _Needs) -> None:
        for number, segment in enumerate(self._segments):
            segment.needs = needs.of(number)
            size = most_bytes(self._kind(name) for name in segment.needs)
            if size > MOST_TOKEN_BYTES:
                line = segment.steps[0].line if segment.steps else 0
                self._problem(
                    line,
                    f"{len(segment.needs)} results are read from here on: a token of up to {size} bytes, "
                    f"and it has {MOST_TOKEN_BYTES}",
                    "read fewer results of other bridges, or fewer texts",
                )

    def _kind(self, name: str) -> int:
        """The built-in type of a result; of several robots' that of the largest."""
        owner, _, result = name.partition(".")
        task, fleet = self._tasks[owner], self._view.fleet
        named = None if task.robot is None else fleet.robots.get(task.robot)
        robots = fleet.could(task.skill, task.capacities) if named is None else [named]
        kinds = [
            int(declared.type)
            for robot in robots
            if task.skill in robot.skills
            for declared in robot.skills[task.skill].results
            if declared.name == result
        ]
        return max(kinds, key=lambda kind: most_bytes([kind]), default=12)

    def _lease_s(self) -> float:
        lease_s = LEASE_MARGIN_S
        for step in self._scenario.steps():
            if isinstance(step, Task):
                lease_s += (step.timeout_s or 0.0) * (1 + step.retries)
            elif isinstance(step, Wait):
                lease_s += step.for_s or step.timeout_s or _WAIT_FOR_EVER_S
        return lease_s

    def _problem(self, line: int, message: str, suggestion: str = "") -> None:
        self.problems.append(ConfigError(message, file=self._file, line=line, suggestion=suggestion))


def missing_requestors(plan: Plan, requestors: Mapping[int, frozenset[int]]) -> list[tuple[int, list[int]]]:
    """The bridges of a plan, by their spaces, that do not take Actions of others which have to reach them."""
    segments = plan.segments
    senders: dict[int, set[int]] = {segment.space: set() for segment in segments}
    ending = {segments[plan.last].space}
    for segment in segments:
        for edge in (*segment.then, *([] if segment.fails is None else [segment.fails])):
            senders[segments[edge.segment].space].add(segment.space)
        if any(isinstance(each, End) for step in segment.steps for each in _walked(step)):
            ending.add(segment.space)
    found: list[tuple[int, list[int]]] = []
    for target, spaces in sorted(senders.items()):
        if missing := sorted((spaces | ending) - requestors.get(target, frozenset()) - {target}):
            found.append((target, missing))
    return found


class _Needs:
    """Which results each segment's token has to hold."""

    def __init__(self, segments: list[Segment], tasks: Mapping[str, Task]) -> None:
        self.home = {
            task.name: number
            for number, segment in enumerate(segments)
            for step in segment.steps
            for task in _tasks_in(step)
        }
        """The segment of each task."""
        self.before: list[set[int]] = [set() for _ in segments]
        """All segments that have ended before each one begins."""
        order = _order(segments)
        for number in order:
            for edge in segments[number].then:
                self.before[edge.segment] |= self.before[number] | {number}
        self._from: list[set[str]] = [set() for _ in segments]
        """Results that are read in each segment and in all behind it."""
        for number in reversed(order):
            read = {name for step in segments[number].steps for name in names_in(step)}
            self._from[number] = {name for name in read if name.partition(".")[0] in tasks}
            for edge in segments[number].then:
                self._from[number] |= self._from[edge.segment]

    def of(self, number: int) -> tuple[str, ...]:
        """The results of segments before that are read in one, or behind it."""
        before = self.before[number]
        return tuple(sorted(name for name in self._from[number] if self.home[name.partition(".")[0]] in before))


def _order(segments: list[Segment]) -> list[int]:
    """Numbers so that each comes after all that lead to it."""
    waits = [0] * len(segments)
    for segment in segments:
        for edge in segment.then:
            waits[edge.segment] += 1
    ready, order = [number for number, count in enumerate(waits) if not count], list[int]()
    while ready:
        number = ready.pop()
        order.append(number)
        for edge in segments[number].then:
            waits[edge.segment] -= 1
            if not waits[edge.segment]:
                ready.append(edge.segment)
    return order


def _tasks_in(step: Step) -> list[Task]:
    return [each for each in _walked(step) if isinstance(each, Task)]


def _walked(step: Step) -> list[Step]:
    inner: tuple[Step, ...]
    match step:
        case Sequence(steps=inner) | Parallel(branches=inner):
            pass
        case Condition(then=then, otherwise=otherwise):
            inner = (then, otherwise)
        case Repeat(body=body):
            inner = (body,)
        case _:
            inner = ()
    return [step, *(each for part in inner for each in _walked(part))]


def _names_at(step: Step) -> set[str]:
    """The names that a step itself mentions."""
    expressions: list[Expression] = []
    match step:
        case Task(arguments=arguments):
            expressions = [value for value in arguments.values() if isinstance(value, Expression)]
        case Condition(when=when):
            expressions = [when]
        case Repeat(while_=condition) | Wait(until=condition):
            expressions = [] if condition is None else [condition]
        case _:
            pass
    return {name for expression in expressions for name in expression.names}


def names_in(step: Step) -> set[str]:
    """The names that a step and all within it mention."""
    return {name for each in _walked(step) for name in _names_at(each)}
