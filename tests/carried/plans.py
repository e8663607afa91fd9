"""Random scenarios that can be carried, by a seed: sequences, forks over bridges, conditions, repetitions, retries."""

from __future__ import annotations

import json
from random import Random
from typing import Any, Final

from ua_fleet.carrying import PlanView
from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.scenario import FleetView, RobotView, Scenario, scenario_of
from ua_fleet.values import BuiltinType

__all__ = ["VIEW", "robot_space", "scenario_by"]

SPACES: Final = (300, 301, 302, 303)
_DOUBLE: Final = int(BuiltinType.DOUBLE)
_WORK: Final = SkillModel(
    1, "work", (), (ArgumentModel("x", _DOUBLE, default=0.0),), (ArgumentModel("out", _DOUBLE),), timeout_s=1e6
)
ROBOTS: Final = {f"r{number}": SPACES[number % len(SPACES)] for number in range(8)}
"""Two robots behind each bridge."""
VIEW: Final = PlanView(
    FleetView({name: RobotView(name, frozenset(), {"work": _WORK}) for name in ROBOTS}),
    ROBOTS,
    {space: frozenset(SPACES) for space in SPACES},
)


def robot_space(robot: str) -> int:
    """The space of the bridge that a robot lives behind."""
    return ROBOTS[robot]


class _Writer:
    def __init__(self, random: Random) -> None:
        self._random, self._count = random, 0

    def task(self, known: list[str], robots: list[str]) -> dict[str, Any]:
        self._count += 1
        random = self._random
        task: dict[str, Any] = {"task": f"t{self._count}", "skill": "work", "robot": random.choice(robots)}
        if known and random.random() < 0.6:
            task["arguments"] = {"x": f"={random.choice(known)}.out + 1"}
        if random.random() < 0.3:
            task["retries"] = random.randint(1, 2)
        return task

    def steps(self, known: list[str], robots: list[str], depth: int) -> list[dict[str, Any]]:
        """Steps whose tasks may read the results of those that are known, to which it adds its own."""
        made: list[dict[str, Any]] = []
        for _ in range(self._random.randint(1, 3)):
            kind = self._random.choice(("task", "task", "task", "parallel", "if", "repeat", "wait"))
            if kind == "parallel" and depth:
                branches = [list(known) for _ in range(self._random.randint(2, 3))]
                made.append({"parallel": [self.steps(branch, robots, depth - 1) for branch in branches]})
                for branch in branches:
                    known += [name for name in branch if name not in known]
            elif kind == "if" and known and depth:
                local = self._local(robots)
                then, other = self.steps(list(known), local, 0), self.steps(list(known), local, 0)
                made.append({"if": f"{self._random.choice(known)}.out > 50", "then": then, "else": other})
            elif kind == "repeat" and depth:
                made.append({"repeat": [self.task(list(known), self._local(robots))], "times": 2})
            elif kind == "wait":
                made.append({"wait": 0.5})
            else:
                task = self.task(known, robots)
                known.append(task["task"])
                made.append(task)
        return made

    def _local(self, robots: list[str]) -> list[str]:
        """The robots of one bridge."""
        space = robot_space(self._random.choice(robots))
        return [robot for robot in robots if robot_space(robot) == space]


def scenario_by(random: Random) -> Scenario:
    """A scenario with at least one task; about half of those of a hundred seeds fork."""
    writer = _Writer(random)
    known: list[str] = []
    steps = [writer.task(known, list(ROBOTS))]
    known.append(steps[0]["task"])
    steps += writer.steps(known, list(ROBOTS), 2)
    return scenario_of(json.dumps({"version": 1, "name": "made", "steps": steps}))
