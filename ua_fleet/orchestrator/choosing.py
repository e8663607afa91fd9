"""Who could do a task of a run: what the task needs and holds, and the ranking of those who are there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping

from ua_fleet.orchestrator.candidates import ResilienceSettings, TaskToDo, rank_robots
from ua_fleet.orchestrator.knowledge import Knowledge
from ua_fleet.orchestrator.outputs import FaultForecast
from ua_fleet.resilience import Ranking
from ua_fleet.scenario import Lookup, Run, Value
from ua_fleet.scenario.effects import DecisionNeeded, WantRobot
from ua_fleet.scenario.expression import Expression
from ua_fleet.scenario.model import Task
from ua_fleet.scenario.parameters import known_arguments

__all__ = ["Choosing"]


class Choosing:
    """Looks at runs and robots as they are; changes nothing."""

    def __init__(self, known: Knowledge, runs: Mapping[str, Run], lookup: Lookup) -> None:
        """Make one.

        Args:
            known: the robots.
            runs: those that are under way, by their ids.
            lookup: values of robots.
        """
        self._known, self._runs, self._lookup = known, runs, lookup
        self.facts = 0
        """How many facts of runs there were: each may change what robots have ahead."""
        self._facts_of: Counter[str] = Counter()
        self._ahead: tuple[tuple[object, ...], Counter[str | None]] | None = None
        """The counts of tasks ahead, with what they were made of."""
        self.promised: Callable[[], Iterable[str]] = tuple
        """Robots that tasks have of which their runs are not told yet; once for each."""

    def happened(self, run_id: str) -> None:
        """A run has another fact."""
        self.facts += 1
        self._facts_of[run_id] += 1

    def forget(self, run_id: str) -> None:
        """A run is over."""
        self.facts += 1
        self._facts_of.pop(run_id, None)

    def moment(self, run_id: str) -> tuple[int, int]:
        """While this is the same, a run can choose among the same robots; values apart."""
        return self._known.version, self._facts_of[run_id]

    def arguments(self, run_id: str, step: str) -> Mapping[str, tuple[type, Value]]:
        """What a task would be begun with now, as far as it is known, with the kinds of these values."""
        return {name: (type(value), value) for name, value in self._arguments(run_id, step).items()}

    def argument_names(self, run_id: str, step: str) -> set[str]:
        """The names that arguments of a task are computed from."""
        arguments = self._runs[run_id].task(step).arguments.values()
        return {name for value in arguments if isinstance(value, Expression) for name in value.names}

    def wanted(self, run_id: str, wanted: WantRobot) -> TaskToDo:
        """A task that waits for whichever robot can do it."""
        run = self._runs[run_id]
        excluded = run.state.tasks[wanted.step].excluded
        return TaskToDo(run.task(wanted.step), wanted.capacities, self._arguments(run_id, wanted.step), "", excluded)

    def asked(self, run_id: str, asked: DecisionNeeded, *, is_unknown: bool) -> TaskToDo:
        """A task that somebody has to take over; `is_unknown`: nobody knows what its robot is at."""
        run = self._runs[run_id]
        task, excluded = run.task(asked.step), run.state.tasks[asked.step].excluded
        needs = self._needs(asked.skill, asked.robot, asked.capacities)
        if is_unknown:
            excluded = {**excluded, asked.robot: "may still be at it"}
        is_back = not is_unknown and self._known.unfit(asked.robot, needs) is None
        return TaskToDo(task, needs, self._arguments(run_id, asked.step), asked.robot, excluded, is_back)

    def runs_with(self, robot: str) -> list[str]:
        """Ids of the runs in which a robot has tasks ahead."""
        return [run_id for run_id, run in self._runs.items() if any(wanted == robot for wanted, _ in run.ahead())]

    def forecasts(self, robot: str) -> tuple[int, Iterator[FaultForecast]]:
        """How many tasks a robot has ahead, and who would take over each of them, found one by one.

        What changes meanwhile is seen in those that follow; the tasks are those that there were.
        """
        counts: Counter[str | None] = Counter()
        ahead: list[tuple[Run, Task]] = []
        for run in self._runs.values():
            for wanted, task in run.ahead():
                counts[wanted] += 1
                if wanted == robot:
                    ahead.append((run, task))

        def found() -> Iterator[FaultForecast]:
            for run, task in ahead:
                arguments = known_arguments(task, run.look_up)
                todo = TaskToDo(task, self._needs(task.skill, robot, task.capacities), arguments, robot)
                yield FaultForecast(run.state.run_id, task.name, self._ranked(todo, counts))

        return len(ahead), found()

    def ranked(
        self, todo: TaskToDo, settings: ResilienceSettings | None = None, lookup: Lookup | None = None
    ) -> Ranking:
        """The ranking now; by other settings than those that count, or another lookup of values, where it is given."""
        return self._ranked(todo, self._count_ahead(), settings, lookup)

    def _ranked(
        self,
        todo: TaskToDo,
        ahead: Counter[str | None],
        settings: ResilienceSettings | None = None,
        lookup: Lookup | None = None,
    ) -> Ranking:
        return rank_robots(
            todo,
            self._known.fleet,
            settings or self._known.settings,
            unfit=self._known.unfit,
            tasks_ahead=ahead.__getitem__,
            lookup=lookup or self._lookup,
        )

    def _arguments(self, run_id: str, step: str) -> Mapping[str, Value]:
        """As they were written; what is computed as a task was begun with it, or would be now."""
        run = self._runs[run_id]
        task, begun = run.task(step), run.state.tasks[step].arguments
        computed = {name for name, value in task.arguments.items() if isinstance(value, Expression)}
        return known_arguments(task, run.look_up) | {name: begun[name] for name in computed & begun.keys()}

    def _needs(self, skill: str, robot: str, capacities: tuple[str, ...]) -> tuple[str, ...]:
        """The capacities that a task needs: those that it names, and those that the skill needs on its robot."""
        return tuple(dict.fromkeys((*capacities, *self._known.fleet.needs(robot, skill))))

    def _count_ahead(self) -> Counter[str | None]:
        """How many tasks of all runs each robot has ahead."""
        promised = tuple(self.promised())
        tasks = sum([len(run.state.tasks) for run in self._runs.values()])
        made_of = (self.facts, self._known.version, len(self._runs), tasks, promised)
        if self._ahead is None or self._ahead[0] != made_of:
            counts = Counter[str | None](promised)
            for run in self._runs.values():
                counts.update(run.count_ahead())
            self._ahead = made_of, counts
        return self._ahead[1]
