"""Random scenarios that can be carried, by a seed: sequences, forks over bridges, conditions, repetitions, retries."""

from __future__ import annotations

import json
from random import Random
from typing import Any, Final

from ua_fleet.carrying import PlanView
from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.scenario import FleetView, RobotView, Scenario, scenario_of
from ua_fleet.values import BuiltinType

__all__ = ["VIEW", "alone_by", "robot_space", "scenario_by"]

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

    def task(self, known: list[str], robots: list[str], beside: list[str] | None = None) -> dict[str, Any]:
        """A task that may read results of those that are known; or come after one that is done beside it."""
        self._count += 1
        random = self._random
        task: dict[str, Any] = {"task": f"t{self._count}", "skill": "work", "robot": random.choice(robots)}
        if beside and random.random() < 0.4:
            before = random.choice(beside)
            task["after"] = [before]
            if random.random() < 0.5:
                task["arguments"] = {"x": f"={before}.out + 2"}
        elif known and random.random() < 0.6:
            task["arguments"] = {"x": f"={random.choice(known)}.out + 1"}
        if random.random() < 0.3:
            task["retries"] = random.randint(1, 2)
        return task

    def steps(
        self, known: list[str], robots: list[str], depth: int, beside: list[str] | None = None
    ) -> list[dict[str, Any]]:
        """Steps whose tasks may read the results of those that are known, to which it adds its own.

        Args:
            known: tasks that are done before.
            robots: that do them.
            depth: of steps within each other.
            beside: tasks of other branches that are done, whatever way theirs take.
        """
        made: list[dict[str, Any]] = []
        for _ in range(self._random.randint(1, 3)):
            kind = self._random.choice(("task", "task", "task", "parallel", "if", "repeat", "wait"))
            if kind == "parallel" and depth:
                made.append(self._parallel(known, robots, depth, beside))
            elif kind == "if" and depth:
                some = self._some(robots)
                then = self.steps(list(known), some, depth - 1, beside)
                step = {"if": self._condition(known), "then": then}
                if self._random.random() < 0.7:
                    step["else"] = self.steps(list(known), some, depth - 1, beside)
                made.append(step)
            elif kind == "repeat" and depth:
                made.append(self._repeat(known, robots, depth, beside))
            elif kind == "wait":
                made.append({"wait": 0.5})
            else:
                task = self.task(known, robots, beside)
                known.append(task["task"])
                made.append(task)
        return made

    def _parallel(self, known: list[str], robots: list[str], depth: int, beside: list[str] | None) -> dict[str, Any]:
        branches: list[list[dict[str, Any]]] = []
        done, others = list(known), list(beside or [])
        for _ in range(self._random.randint(2, 3)):
            own = list(known)
            branches.append(self.steps(own, robots, depth - 1, others))
            others += [step["task"] for step in branches[-1] if "task" in step]
            done += [name for name in own if name not in done]
        known[:] = done
        self._random.shuffle(branches)
        return {"parallel": branches}

    def _repeat(self, known: list[str], robots: list[str], depth: int, beside: list[str] | None) -> dict[str, Any]:
        times, is_sure = self._random.randint(1, 3), self._random.random() < 0.6
        within = list(known)
        body = self.steps(within, self._some(robots), depth - 1, beside)
        if not any("task" in step for step in body):
            body.append({"wait": 0.1})  # each round has to take some time
        step: dict[str, Any] = {"repeat": body, "times": times}
        if is_sure:
            known[:] = within
        else:
            step["while"] = self._condition(known)
        return step

    def _condition(self, known: list[str]) -> str:
        """About a result, or a value of a robot, which may be one of another bridge."""
        random = self._random
        if known and random.random() < 0.5:
            return f"{random.choice(known)}.out > {random.choice((20, 50))}"
        return f"{random.choice(list(ROBOTS))}.level > {random.choice((20, 50))}"

    def _some(self, robots: list[str]) -> list[str]:
        """All robots, or those of one bridge."""
        if self._random.random() < 0.7:
            return robots
        space = robot_space(self._random.choice(robots))
        return [robot for robot in robots if robot_space(robot) == space]


def scenario_by(random: Random) -> Scenario:
    """A scenario with at least one task; most have tasks of several bridges within forks, conditions or repetitions."""
    writer = _Writer(random)
    known: list[str] = []
    steps = [writer.task(known, list(ROBOTS))]
    known.append(steps[0]["task"])
    steps += writer.steps(known, list(ROBOTS), 2)
    return scenario_of(json.dumps({"version": 1, "name": "made", "steps": steps}))


def alone_by(random: Random) -> Scenario:
    """A scenario most rounds of which one bridge does without any other one."""
    writer, robots = _Writer(random), list(ROBOTS)
    here = [robot for robot in robots if robot_space(robot) == robot_space("r1")]
    seldom = _seldom(writer, random.choice((101, 101, 20)))
    rounds: list[dict[str, Any]] = [writer.task([], here), seldom]
    if random.random() < 0.5:
        rounds.insert(random.randint(0, 2), {"repeat": [writer.task([], here), _seldom(writer, 101)], "times": 3})
    if random.random() < 0.4:
        rounds.append(_whole(writer, here, random))
    loop = {"repeat": rounds, "times": random.randint(3, 6)}
    if random.random() < 0.4:
        loop = _whole(writer, here, random, depth=1)
    steps = [writer.task([], robots), loop, *[writer.task([], here) for _ in range(random.randint(0, 1))]]
    if random.random() < 0.3:
        steps[1] = {"parallel": [[loop], [writer.task([], robots)]]}
    return scenario_of(json.dumps({"version": 1, "name": "made", "steps": [*steps, writer.task([], ["r2"])]}))


def _whole(writer: _Writer, here: list[str], random: Random, depth: int = 0) -> dict[str, Any]:
    """A repetition all of whose tasks are at one bridge; some have one within them."""
    known: list[str] = []
    body: list[dict[str, Any]] = []
    for _ in range(random.randint(1, 3)):
        body.append(writer.task(known, here))
        known.append(body[-1]["task"])
    if depth and random.random() < 0.5:
        body.insert(random.randint(0, len(body)), _whole(writer, here, random))
    return {"repeat": body, "times": random.randint(2, 6)}


def _seldom(writer: _Writer, level: int) -> dict[str, Any]:
    """What two other bridges do, where the level of a robot is above this: of 101 it never is."""
    return {"if": f"r5.level > {level}", "then": [writer.task([], ["r2"]), writer.task([], ["r3"])]}
