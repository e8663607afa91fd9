"""What comes after what: tasks that wait for others, and all that a run has ahead."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping
from itertools import takewhile

from ua_fleet.scenario.model import BranchPoint, Condition, End, Parallel, Repeat, Sequence, Step, Task, Wait
from ua_fleet.scenario.state import RunState

__all__ = ["TaskOrder", "ahead"]


class TaskOrder:
    """Which tasks a task comes after. What repeats both has them come after each other each time."""

    def __init__(self, tasks: Iterable[Task], outside: Container[str] = ()) -> None:
        """Take in all tasks of a scenario; `outside` are those that others do, and of which the run is told."""
        known = list(tasks)
        keys = {task.name: task.key for task in known}
        self._before: Mapping[str, list[tuple[str, str, int]]] = {
            task.key: [
                (name, keys[name], _repetitions_around_both(task.key, keys[name]))
                for name in task.after
                if name in keys
            ]
            for task in known
            if task.after
        }
        """The name and key of each task before one, and how many repetitions are around both."""
        self._outside: Mapping[str, list[str]] = {
            task.key: names for task in known if (names := [name for name in task.after if name in outside])
        }

    def is_turn(self, step: str, state: RunState) -> bool:
        """Whether all tasks before a task's step have been done."""
        is_told = all(state.outside.get(name) for name in self._outside_of(step))
        return is_told and not any(True for _ in self._missing(step, state))

    def lost(self, step: str, state: RunState) -> str | None:
        """A task before a step that was not done and will not be, by its name."""
        for name in self._outside_of(step):
            if state.outside.get(name) is False:
                return name
        return next((name for name, key, numbers in self._missing(step, state) if _is_over(key, numbers, state)), None)

    def _outside_of(self, step: str) -> list[str]:
        return self._outside.get(step.partition("@")[0], []) if self._outside else []

    def _missing(self, step: str, state: RunState) -> Iterator[tuple[str, str, list[str]]]:
        key, *numbers = step.split("@")
        for name, before, common in self._before.get(key, ()):
            if "@".join((before, *numbers[:common])) not in state.tasks_done:
                yield name, before, numbers[:common]


def ahead(step: Step, state: RunState, scope: str = "") -> Iterator[tuple[str, Task]]:
    """The tasks that are not over, with their steps; of what comes again and again, each once."""
    key = step.key + scope
    if key in state.ended:
        return
    match step:
        case Task():
            yield key, step
        case Sequence(steps=inner) | Parallel(branches=inner):
            for part in inner:
                yield from ahead(part, state, scope)
        case Condition(then=then, otherwise=otherwise):
            taken = state.branches.get(key)
            if taken is not False:
                yield from ahead(then, state, scope)
            if taken is not True:
                yield from ahead(otherwise, state, scope)
        case Repeat(body=body, times=times):
            number = state.iterations.get(key, -1)
            now = list(ahead(body, state, f"{scope}@{number}")) if number >= 0 else []
            yield from now
            if times is None or number + 1 < times:
                known = {task.key for _, task in now}
                for later, task in ahead(body, state, f"{scope}@{number + 1}"):
                    if task.key not in known:
                        yield later, task
        case Wait() | End() | BranchPoint():
            return


def _repetitions_around_both(one: str, other: str) -> int:
    common = takewhile(lambda parts: parts[0] == parts[1], zip(one.split("."), other.split("."), strict=False))
    return sum(part == "repeat" for part, _ in common)


def _is_over(key: str, numbers: list[str], state: RunState) -> bool:
    """Whether a step, or one around it, has ended in these repetitions; further in, in those that are on now."""
    path, scope, depth = "", "", 0
    for part in key.split("."):
        if part == "repeat":
            number = numbers[depth] if depth < len(numbers) else state.iterations.get(path + scope)
            if number is None:
                return False
            scope, depth = f"{scope}@{number}", depth + 1
        path = f"{path}.{part}" if path else part
        if path + scope in state.ended:
            return True
    return False
