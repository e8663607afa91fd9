"""A scenario split into the segments of a plan, and what keeps it from being carried.

Steps of one bridge stay together as they are; what has steps of several is taken apart. What is built so far is open
at its ends: the segments behind which the next step comes, of which an `if` has one for each way. A task of which
another branch hears ends its segment, so that its token goes when it is done.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ua_fleet.carrying.crossings import Crossing, crossings_of, keys_in
from ua_fleet.carrying.needs import results_needed
from ua_fleet.carrying.plan import (
    MOST_SEGMENTS,
    MOST_SLOTS,
    Edge,
    Hearing,
    MailSlot,
    Plan,
    PlanView,
    Segment,
    Split,
    missing_requestors,
)
from ua_fleet.carrying.steps import inner_steps, names_at, tasks_in, walked
from ua_fleet.carrying.token import MOST_LOOPS, MOST_TOKEN_BYTES, WHOLE, most_bytes
from ua_fleet.errors import ConfigError
from ua_fleet.scenario.expression import split_index
from ua_fleet.scenario.model import BranchPoint, Condition, Parallel, Repeat, Scenario, Step, Task, Wait
from ua_fleet.scenario.model import Sequence as Steps

__all__ = ["split"]

LEASE_MARGIN_S: Final = 600.0
"""What a run may take beside its tasks, before its reservations end by themselves."""
_FOR_EVER_S: Final = 24 * 3600.0
"""What a wait without a timeout, or a repetition without a number, counts in the lease."""
_MOST_LEASE_S: Final = 7 * 24 * 3600.0


def split(scenario: Scenario, view: PlanView, file: str = "") -> Split:
    """Split a scenario without problems; all that keeps it from being carried is told, with its line."""
    splitter = _Splitter(scenario, view, file)
    plan = splitter.plan()
    problems = tuple(sorted(splitter.problems, key=lambda problem: problem.line))
    return Split(None if problems else plan, problems)


class _End(NamedTuple):
    """A segment behind which the next step comes."""

    segment: int
    way: bool = True
    """False: where what the segment decides does not hold."""
    is_fork: bool = False
    """Whether other branches begin there, too, so that nothing can be added to it."""


@dataclass(slots=True)
class _Branch:
    """Where steps stand: a branch of a `parallel` that is taken apart, or the scenario."""

    fails: Edge | None = None
    around: _Branch | None = None
    members: list[int] = field(default_factory=list[int])
    """Its segments, without those of branches within it."""


class _Splitter:
    def __init__(self, scenario: Scenario, view: PlanView, file: str) -> None:
        self._scenario, self._view, self._file = scenario, view, file
        self._tasks = {task.name: task for task in scenario.tasks()}
        self._parameters = {parameter.name for parameter in scenario.parameters}
        self._segments: list[Segment] = []
        self._space_of_task = {task.name: self._space(task) for task in scenario.tasks()}
        self._crossings = crossings_of(scenario)
        self._home: dict[str, int] = {}
        """The segment of each step, by its key."""
        self._branch_of: dict[int, _Branch] = {}
        self._closed: set[int] = set()
        """Segments that end with what they have: a decision, or a task of which others hear."""
        self._joined: dict[int, list[frozenset[str]]] = {}
        """The tasks of the branches of each join."""
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
        top = _Branch()
        first = self._open(spaces[0], 1, top, ())
        last = self._place(None, self._sequence(self._scenario.body.steps, [_End(first)], top, ()), top, ())
        for number, segment in enumerate(self._segments):
            if segment.fails is None and number != last:
                segment.fails = Edge(last, WHOLE)
        self._add_mailboxes()
        self._check_roads(last)
        self._check_tokens()
        self._check_values()
        if len(self._segments) > MOST_SEGMENTS:
            self._problem(0, f"it has {len(self._segments)} segments; at most {MOST_SEGMENTS} are carried")
        lease_s = LEASE_MARGIN_S + _most_s(self._scenario.body)
        return Plan(tuple(self._segments), last, min(lease_s, _MOST_LEASE_S))

    # Whether steps can be carried at all.

    def _look_at(self, step: Step) -> None:
        match step:
            case Task() if self._space_of_task[step.name] is None:
                self._problem(step.line, f"task {step.name!r}: no robot for it lives behind a bridge")
            case Wait(event=str() as event):
                self._problem(step.line, f"the event {event!r} is sent to the server, and no bridge receives it")
            case Parallel(branches=branches) if len(branches) > MOST_SLOTS:
                self._problem(step.line, f"at most {MOST_SLOTS} branches are carried, here are {len(branches)}")
            case _:
                pass
        for name in sorted(names_at(step) - self._parameters):
            if split_index(name)[0] in self._view.of_server:
                self._problem(
                    step.line, f"{name!r} is a value of the server, and no bridge has it while the server is away"
                )
            elif split_index(name)[0] in self._view.on_demand:
                self._problem(
                    step.line, f"{name!r} is read only on demand of the server, and not while the server is away"
                )

    def _space(self, task: Task) -> int | None:
        """Where a task is done: by the robot that it names, or by the first that can do it."""
        if task.robot is not None:
            return self._view.space_of.get(task.robot)
        able = [robot.name for robot in self._view.fleet.able(task.skill, task.capacities)]
        return next((self._view.space_of[name] for name in able if name in self._view.space_of), None)

    def _spaces(self, step: Step) -> list[int]:
        """The spaces of the tasks in a step, in their order."""
        found = [self._space_of_task[task.name] for task in tasks_in(step)]
        return list(dict.fromkeys([space for space in found if space is not None]))

    def _is_whole(self, step: Step) -> bool:
        """Whether one bridge does a step, and nobody beside it hears of a task within it before it is over."""
        if isinstance(step, Task):
            return True
        inside = keys_in(step)
        is_heard = any(each.source in inside and each.reader not in inside for each in self._crossings)
        return len(self._spaces(step)) <= 1 and not is_heard

    # Segments.

    def _open(self, space: int, slots: int, branch: _Branch, loops: tuple[int, ...]) -> int:
        self._segments.append(Segment(space, slots, fails=branch.fails, loops=loops))
        number = len(self._segments) - 1
        branch.members.append(number)
        self._branch_of[number] = branch
        return number

    def _connect(self, ends: Iterable[_End], target: int, slot: int = 0, *, is_next: bool = False) -> None:
        for end in ends:
            segment = self._segments[end.segment]
            (segment.then if end.way else segment.otherwise).append(Edge(target, slot, is_next))

    def _place(self, space: int | None, ends: Sequence[_End], branch: _Branch, loops: tuple[int, ...]) -> int:
        """The segment in which the next step stands: the one that is open, or a new one behind the ends."""
        at, way, is_fork = ends[0]
        before = self._segments[at]
        is_open = len(ends) == 1 and way and not is_fork and at not in self._closed and before.loops == loops
        if is_open and space in (None, before.space):
            return at
        if is_open and at == 0 and not before.steps and space is not None:
            before.space = space  # it has nothing to do
            return at
        number = self._open(before.space if space is None else space, 1, branch, loops)
        self._connect(ends, number)
        return number

    def _sequence(self, steps: Iterable[Step], ends: list[_End], branch: _Branch, loops: tuple[int, ...]) -> list[_End]:
        """Add steps behind the ends; the ends that there are then."""
        for step in steps:
            ends = self._add(step, ends, branch, loops)
        return ends

    def _add(self, step: Step, ends: list[_End], branch: _Branch, loops: tuple[int, ...]) -> list[_End]:
        if self._is_whole(step):
            at = self._place(next(iter(self._spaces(step)), None), ends, branch, loops)
            self._segments[at].steps.append(step)
            self._home.update(dict.fromkeys(keys_in(step), at))
            if any(each.source == step.key for each in self._crossings):
                self._closed.add(at)
            return [_End(at)]
        match step:
            case Steps(steps=steps):
                return self._sequence(steps, ends, branch, loops)
            case Parallel():
                return self._fork(step, ends, branch, loops)
            case Condition():
                return self._condition(step, ends, branch, loops)
            case Repeat():
                return self._repeat(step, ends, branch, loops)
            case Task() | Wait() | BranchPoint() | _:
                raise AssertionError(f"{step!r} has no steps within it")

    def _decide(self, at: int, point: BranchPoint) -> None:
        self._segments[at].steps.append(point)
        self._home[point.key] = at
        self._closed.add(at)

    def _condition(self, step: Condition, ends: list[_End], branch: _Branch, loops: tuple[int, ...]) -> list[_End]:
        """The bridge that has the token decides."""
        at = self._place(None, ends, branch, loops)
        self._decide(at, BranchPoint(step.key, step.line, step.when, step.timeout_s))
        then = self._sequence(step.then.steps, [_End(at)], branch, loops)
        return then + self._sequence(step.otherwise.steps, [_End(at, way=False)], branch, loops)

    def _repeat(self, step: Repeat, ends: list[_End], branch: _Branch, loops: tuple[int, ...]) -> list[_End]:
        """The bridge of the first task within it decides about each round."""
        head = len(self._segments)
        within = (*loops, head)
        self._open(self._spaces(step)[0], 1, branch, within)
        self._connect(ends, head)
        point = BranchPoint(step.key, step.line, step.while_, step.timeout_s, is_loop=True, times=step.times)
        self._decide(head, point)
        if len(within) > MOST_LOOPS:
            self._problem(step.line, f"at most {MOST_LOOPS} repetitions within each other are carried")
        self._connect(self._sequence(step.body.steps, [_End(head)], branch, within), head, is_next=True)
        return [_End(head, way=False)]

    def _fork(self, step: Parallel, ends: list[_End], branch: _Branch, loops: tuple[int, ...]) -> list[_End]:
        at = self._place(None, ends, branch, loops)
        join = self._open(self._segments[at].space, len(step.branches), branch, loops)
        self._joined[join] = [frozenset(task.name for task in tasks_in(each)) for each in step.branches]
        self._closed.add(at)
        for slot, each in enumerate(step.branches):
            within = _Branch(Edge(join, slot), branch)
            done = self._sequence(each.steps, [_End(at, is_fork=True)], within, loops)
            self._connect(done, join, slot)
        return [_End(join)]

    # What is heard of other branches.

    def _add_mailboxes(self) -> None:
        by_task: dict[tuple[str, int], list[Crossing]] = {}
        for each in self._crossings:
            home, heard = self._home[each.source], self._home[each.reader]
            if home != heard:
                by_task.setdefault((each.task, self._segments[heard].space), []).append(each)
        for (task, space), readings in by_task.items():
            home = self._home[readings[0].source]
            loops, number = self._segments[home].loops, len(self._segments)
            mailbox = Segment(space, len(MailSlot), loops=loops, tells=task)
            mailbox.needs = [tuple(sorted({name for each in readings for name in each.results})), ()]
            self._segments.append(mailbox)
            self._segments[home].then.append(Edge(number, MailSlot.DONE))
            for reader in sorted({self._home[each.reader] for each in readings}):
                common = len(_common(loops, self._segments[reader].loops))
                self._segments[reader].hears.append(Hearing(number, common))
            branch = self._branch_of[home]
            while branch.around is not None:
                for member in branch.members:
                    self._segments[member].lost.append(Edge(number, MailSlot.LOST))
                branch = branch.around

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

    def _check_tokens(self) -> None:
        found = results_needed(self._segments, self._tasks, self._joined)
        for segment, needs in zip(self._segments, found, strict=True):
            segment.needs = needs or segment.needs
            for names in segment.needs:
                size = most_bytes((self._kind(name) for name in names), len(segment.loops))
                if size > MOST_TOKEN_BYTES:
                    line = segment.steps[0].line if segment.steps else 0
                    self._problem(
                        line,
                        f"{len(names)} results are read from here on: a token of up to {size} bytes, "
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

    def _check_values(self) -> None:
        """Each bridge hears the values that its steps read."""
        for segment in self._segments:
            heard = self._view.hears.get(segment.space)
            if heard is None:
                continue
            for step in [each for one in segment.steps for each in walked(one)]:
                for name in sorted(names_at(step)):
                    space = self._view.values.get(split_index(name)[0])
                    is_own = name in self._parameters or name.partition(".")[0] in self._tasks
                    if space is not None and not is_own and space != segment.space and space not in heard:
                        self._problem(
                            step.line,
                            f"the bridge of space {segment.space} has no connection by which {name!r} comes",
                            f"put the bridge of space {space} on one of its connections, or run it orchestrated",
                        )

    def _problem(self, line: int, message: str, suggestion: str = "") -> None:
        self.problems.append(ConfigError(message, file=self._file, line=line, suggestion=suggestion))


def _common(one: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, ...]:
    """The repetitions around both."""
    count = 0
    while count < min(len(one), len(other)) and one[count] == other[count]:
        count += 1
    return one[:count]


def _most_s(step: Step) -> float:
    """So long a step takes at most, by its timeouts."""
    match step:
        case Task():
            return (step.timeout_s or 0.0) * (1 + step.retries)
        case Wait():
            return step.for_s or step.timeout_s or _FOR_EVER_S
        case Repeat(body=body, times=times):
            once_s = _most_s(body)
            return max(once_s, _FOR_EVER_S) if times is None else min(once_s * times, _MOST_LEASE_S)
        case _:
            return sum(_most_s(each) for each in inner_steps(step))
