"""A fleet of robots in virtual time, for the orchestrator: what it says is what robots do."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from itertools import count

from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.orchestrator import (
    DecisionChanged,
    DistanceFrom,
    Orchestrator,
    Output,
    ResilienceSettings,
    RunBroken,
    RunChanged,
    TaskCancelled,
    TasksAhead,
    TaskStarted,
    ValueOf,
)
from ua_fleet.resilience import (
    Criterion,
    CriterionKind,
    DecisionMode,
    OnLimit,
)
from ua_fleet.scenario import FleetView, RobotView, Value, ValueUnknown, scenario_of
from ua_fleet.scenario.facts import Fact, RunEnded, TaskOutcome, encode_fact
from ua_fleet.values import BuiltinType

GO = SkillModel(1, "go", ("mobile",), (ArgumentModel("to", BuiltinType.STRING, default=""),))
GRAB = SkillModel(2, "grab", ("grab",))
FLEET = FleetView(
    {
        "ridgeback": RobotView("ridgeback", frozenset({"mobile", "grab"}), {"go": GO, "grab": GRAB}),
        "pioneer_1": RobotView("pioneer_1", frozenset({"mobile"}), {"go": GO}),
        "pioneer_2": RobotView("pioneer_2", frozenset({"mobile"}), {"go": GO}),
        "ur3": RobotView("ur3", frozenset({"grab"}), {"grab": GRAB}),
    }
)
BATTERY = Criterion("battery", CriterionKind.BENEFIT, (0, 100), "%")
DISTANCE = Criterion("distance", CriterionKind.COST, (0, 50), "m")
FREE = Criterion("availability", CriterionKind.BENEFIT, (0, 100))
JUDGEMENTS = {("battery", "distance"): 2.0, ("battery", "availability"): 2.0, ("distance", "availability"): 1.0}


def settings(mode: DecisionMode = DecisionMode.AUTOMATIC, on_limit: OnLimit = OnLimit.BEST) -> ResilienceSettings:
    sources = (
        (BATTERY, ValueOf("battery")),
        (DISTANCE, DistanceFrom("x", "y", "to", {"dock": (0.0, 0.0)})),
        (FREE, TasksAhead()),
    )
    return ResilienceSettings(sources, JUDGEMENTS, mode=mode, limit_s=30, on_limit=on_limit)


class World:
    """Robots that take a second for each task and stop at once, and everything that was said."""

    def __init__(self, mode: DecisionMode = DecisionMode.AUTOMATIC, on_limit: OnLimit = OnLimit.BEST) -> None:
        self.values: dict[str, Value] = {}
        for number, robot in enumerate(FLEET.robots):
            self.values.update({f"{robot}.battery": 50.0, f"{robot}.x": float(number), f"{robot}.y": 0.0})
        self.journal: list[tuple[str, str]] = []
        self.now = 0.0
        self.log: list[str] = []
        self.said: list[Output] = []
        self.outcome: dict[tuple[str, str], TaskOutcome] = {}
        self.unstoppable: set[str] = set()
        """Robots that do not say that they have stopped."""
        self.mode, self.on_limit = mode, on_limit
        self._events: list[tuple[float, int, Callable[[], list[Output]]]] = []
        self._order = count()
        self.make = Orchestrator(settings(mode, on_limit), FLEET, self.lookup, self._write)

    def _write(self, run_id: str, fact: Fact) -> None:
        self.journal.append((run_id, encode_fact(fact)))

    def lookup(self, name: str) -> Value:
        if name not in self.values:
            raise ValueUnknown(f"{name} is not known")
        return self.values[name]

    def start(self, run_id: str, steps: str) -> None:
        scenario = scenario_of(f"version: 1\nname: s\nsteps:\n{steps}")
        self.take(self.make.start(run_id, scenario, {}, by="anna", now=self.now))

    def at(self, when: float, what: Callable[[], list[Output]]) -> None:
        heapq.heappush(self._events, (when, next(self._order), what))

    def take(self, outputs: list[Output]) -> None:
        self.said += outputs
        for output in outputs:
            if isinstance(output, TaskStarted):
                self._begin(output)
            elif isinstance(output, TaskCancelled):
                self.log.append(f"{self.now:g} {output.robot} halted")
                if output.robot not in self.unstoppable:
                    self.take(self.make.ended(output.execution_id, TaskOutcome.FAILED, self.now, message="stopped"))
            elif isinstance(output, RunBroken):
                raise output.error
            elif isinstance(output, RunChanged) and isinstance(output.fact, RunEnded):
                fact = output.fact
                self.log.append(f"{self.now:g} {output.run_id} {fact.outcome.value} {fact.reason}".rstrip())

    def _begin(self, task: TaskStarted) -> None:
        self.log.append(f"{self.now:g} {task.run_id} {task.robot} {task.skill}")
        outcome = self.outcome.get((task.robot, task.skill), TaskOutcome.DONE)
        self.take(self.make.accepted(task.execution_id, self.now))
        self.at(self.now + 1, lambda: self.make.ended(task.execution_id, outcome, self.now))

    def go(self, until_s: float = 500) -> None:
        while True:
            deadline = self.make.next_deadline()
            happening = self._events[0][0] if self._events else None
            due = min((at for at in (deadline, happening) if at is not None), default=None)
            if due is None or due > until_s:
                self.now = until_s
                return
            self.now = max(self.now, due)
            if happening is not None and happening <= self.now:
                _, _, what = heapq.heappop(self._events)
                self.take(what())
            else:
                self.take(self.make.poll(self.now))

    def heard(self, kind: type[Output]) -> list[Output]:
        return [output for output in self.said if isinstance(output, kind)]

    def decisions(self) -> list[DecisionChanged]:
        return [output for output in self.said if isinstance(output, DecisionChanged)]
