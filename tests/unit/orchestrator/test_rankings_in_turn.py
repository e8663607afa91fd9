"""Open decisions are ranked again where a change can alter them, in turns. What is chosen is what ranking all of them
at each moment would have chosen.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.unit.orchestrator.world import FLEET, World
from ua_fleet.orchestrator import Output
from ua_fleet.orchestrator import decisions as decisions_module
from ua_fleet.orchestrator.candidates import rank_robots
from ua_fleet.orchestrator.claims import Claim, Claims
from ua_fleet.orchestrator.decisions import TURN_S, Decisions, OpenedDecision
from ua_fleet.resilience import DecisionMode, OnLimit, Ranking, RankingChanged
from ua_fleet.scenario.facts import TaskOutcome

SEEDS = range(int(os.environ.get("SEEDS", "25")))
ROBOTS = list(FLEET.robots)
GO = "  - {task: t1, robot: ridgeback, skill: go}\n  - {task: t2, robot: pioneer_1, skill: go}\n"
NAMED = "  - {task: t1, robot: ridgeback, skill: go, arguments: {to: =ur3.where}}\n"
PARALLEL = (
    "  - parallel:\n"
    "    - - {task: t1, robot: ridgeback, skill: go}\n"
    "    - - {task: t2, robot: ridgeback, skill: grab}\n"
    "    - - {task: t3, skill: go, capacity: mobile}\n"
)


def from_scratch(world: World) -> dict[str, Ranking]:
    """The ranking of each open decision, made anew of all that is known."""
    return {decision_id: world.make.preview(decision_id, None) for decision_id in world.make.decisions}


def shown(world: World) -> dict[str, Ranking]:
    return {decision_id: decision.ranking for decision_id, decision in world.make.decisions.items()}


class AlwaysRanked(Decisions):
    """Ranks all decisions again each time that anything becomes known, or a value changes."""

    def next_deadline(self) -> float | None:
        deadlines = [opened.decision.next_deadline() for opened in self]
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def _is_stale(self, opened: OpenedDecision) -> bool:
        return True

    def _cannot_wait(self, opened: OpenedDecision, now: float) -> bool:
        return True


def never_seen(claims: Claims, claim: Claim) -> object:
    """What was seen is never what is seen now."""
    del claims, claim
    return object()


@contextmanager
def ranked(decisions: type[Decisions], places: int) -> Generator[None]:
    """Make orchestrators with such decisions, of which a turn ranks so many robots."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ua_fleet.orchestrator.orchestrator.Decisions", decisions)
        patch.setattr(decisions_module, "PLACES", places)
        if decisions is AlwaysRanked:
            patch.setattr(Claims, "_seen", never_seen)
        yield


Step = tuple[str, str, float]
CHANGES = ("fault", "repaired", "silent", "heard", "hold", "release", "drive", "left", "fails", "stops", "well")


def steps_of(seed: int) -> list[Step]:
    """What happens to a fleet, the same for one seed."""
    chance = random.Random(seed)
    steps: list[Step] = [("start", steps, 0.0) for steps in (GO, NAMED, PARALLEL)]
    for _ in range(60):
        robot = chance.choice(ROBOTS)
        kind = chance.choice(["value"] * 4 + ["change"] * 4 + ["go"] * 2 + ["start", "confirm"])
        if kind == "value":
            steps.append(
                (chance.choice(["battery", "x", "unknown", "where"]), robot, chance.choice([0.0, 9.0, 80.0, 1e9]))
            )
        elif kind == "change":
            steps.append((chance.choice(CHANGES), robot, 0.0))
        elif kind == "start":
            steps.append(("start", chance.choice([GO, NAMED, PARALLEL]), 0.0))
        else:
            steps.append((kind, robot, chance.choice([0.0, 0.05, 1.0, 6.0, 31.0])))
    return steps


def do(world: World, number: int, step: Step) -> None:
    make, now = world.make, world.now
    kind, robot, value = step
    changes: dict[str, Callable[[], list[Output]]] = {
        "fault": lambda: make.fault_raised(robot, "robot", f"it is hot ({number})", now),
        "repaired": lambda: make.fault_cleared(robot, "robot", now),
        "silent": lambda: make.fault_raised(robot, "silent", "it is silent", now),
        "heard": lambda: make.fault_cleared(robot, "silent", now),
        "hold": lambda: make.hold(robot, "anna", "", now),
        "release": lambda: make.release(robot, "anna", now),
        "drive": lambda: make.driven(robot, "is driven by hand by bert", now),
        "left": lambda: make.driven(robot, "", now),
    }
    outcomes = {"fails": TaskOutcome.FAILED, "stops": TaskOutcome.STOPPED, "well": TaskOutcome.DONE}
    if kind in changes:
        world.take(changes[kind]())
    elif kind in outcomes:
        world.outcome[robot, "go"] = outcomes[kind]
    elif kind == "start":
        world.start(f"r{number}", robot)
    elif kind == "confirm":
        confirm(world, robot)
    elif kind == "go":
        world.go(now + value)
    else:
        set_value(world, kind, robot, value)


def set_value(world: World, kind: str, robot: str, value: float) -> None:
    if kind == "unknown":
        world.values.pop(f"{robot}.battery", None)
    elif kind == "where":
        world.values["ur3.where"] = "dock" if value else "elsewhere"
    else:
        world.values[f"{robot}.{kind}"] = value
    world.take(world.make.poll(world.now))


def confirm(world: World, robot: str) -> None:
    for decision_id in list(world.make.decisions):
        if not from_scratch(world)[decision_id].without(robot):
            world.take(world.make.confirm(decision_id, robot, "anna", world.now)[1])
            return


def told(outputs: list[Output]) -> list[str]:
    """All that was said and done, apart from rankings that are shown."""
    return [str(one) for one in outputs if not isinstance(getattr(one, "event", None), RankingChanged)]


def let_all_have_their_turns(world: World) -> None:
    while (due := world.make.next_deadline()) is not None and due <= world.now + TURN_S:
        world.now = max(world.now, due)
        world.take(world.make.poll(world.now))


class Counted:
    """Counts the rankings that are made of robots."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.rankings = 0
        self._rank = rank_robots
        patch.setattr("ua_fleet.orchestrator.choosing.rank_robots", self)

    def __call__(self, *args: Any, **kwargs: Any) -> Ranking:
        self.rankings += 1
        return self._rank(*args, **kwargs)


def many_decisions(count: int) -> World:
    world = World(DecisionMode.OPERATOR)
    world.take(world.make.fault_raised("ridgeback", "robot", "it is hot", 0))
    for number in range(count):
        world.start(f"r{number}", "  - {task: t1, robot: ridgeback, skill: go}\n")
    let_all_have_their_turns(world)
    return world


def test_what_no_ranking_is_made_of_ranks_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    world, counted = many_decisions(20), Counted(monkeypatch)
    for number in range(5):
        world.now += 1
        world.values["ur3.noise"] = world.values["ur3.battery"] = float(number)
        world.take(world.make.poll(world.now))
    assert counted.rankings == 0, "ur3 is no candidate"
    world.values["pioneer_1.battery"] = 1.0
    world.take(world.make.poll(world.now))
    assert counted.rankings == 20, "a small fleet is ranked at once"


def test_a_turn_ranks_no_more_robots_however_many_decisions_are_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decisions_module, "PLACES", 3 * len(ROBOTS))
    world, counted = many_decisions(20), Counted(monkeypatch)
    world.now += 1
    for number in range(10):
        world.values["pioneer_1.battery"] = float(number)
        world.take(world.make.poll(world.now))
    assert counted.rankings == 3, "ten values at one moment have one turn"
    assert world.make.next_deadline() == pytest.approx(world.now + TURN_S)
    begun = world.now
    let_all_have_their_turns(world)
    assert counted.rankings == 3 + 20, "each once with the last of these values"
    assert shown(world) == from_scratch(world)
    assert world.now - begun == pytest.approx(7 * TURN_S)


@pytest.mark.parametrize("mode", [DecisionMode.OPERATOR, DecisionMode.AUTOMATIC])
@pytest.mark.parametrize("on_limit", list(OnLimit))
@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_chosen_is_what_ranking_all_at_each_moment_chooses(
    seed: int, mode: DecisionMode, on_limit: OnLimit
) -> None:
    said: list[list[str]] = []
    for decisions, places in ((AlwaysRanked, 10**9), (Decisions, 1), (Decisions, 10**9)):
        with ranked(decisions, places):
            world = World(mode, on_limit)
            for number, step in enumerate(steps_of(seed)):
                do(world, number, step)
            said.append(told(world.said))
            if decisions is Decisions:
                let_all_have_their_turns(world)
                assert shown(world) == from_scratch(world), "people see the rankings of now"
    assert said[1] == said[0]
    assert said[2] == said[0]
