"""What has to be true of a carried run, whatever happened: pure, of what the robots and the journals know."""

from __future__ import annotations

from itertools import pairwise, takewhile

from tests.carried.world import RUN, World, orchestrated
from ua_fleet.carrying import SegmentRound
from ua_fleet.carrying.holder import ADOPTED
from ua_fleet.scenario import Scenario
from ua_fleet.scenario.facts import TaskAssigned, decode_fact
from ua_fleet.scenario.model import Condition, Parallel, Repeat, Sequence, Step, Task

__all__ = ["problems_of"]


def problems_of(world: World) -> list[str]:
    """All that is wrong with a world that has run."""
    found = _not_over(world) + _twice(world) + _order(world) + _paused(world) + _parked(world)
    if found or _stays_paused(world) or _waits_for_people(world) or world.adoptions:
        return found
    return _otherwise(world)


def _waits_for_people(world: World) -> bool:
    """Whether a bridge is off for good, or its segments are on their way, and nobody can have them adopted."""
    is_gone = world.server_dies_at <= world.now < world.server_is_back_at
    is_off = any(world.is_off(off.space) and off.adopted is None for off in world.offs)
    return is_off or (is_gone and any(off.adopted is not None and not off.is_done for off in world.offs))


def _stays_paused(world: World) -> bool:
    """Whether a person has paused it somewhere, and the server through which it could go on is gone for good."""
    held = [bridge.holder.runs.get(RUN) for bridge in world.bridges.values()]
    is_gone = world.server_dies_at <= world.now < world.server_is_back_at
    return is_gone and any(one is not None and one.is_paused for one in held)


def _not_over(world: World) -> list[str]:
    if world.is_over or _stays_paused(world) or _waits_for_people(world):
        return []
    states: dict[int, tuple[str | None, tuple[SegmentRound, ...]] | None] = {}
    for space, bridge in world.bridges.items():
        held = bridge.holder.runs.get(RUN)
        states[space] = None if held is None else (held.closed.outcome if held.closed else None, held.active)
    if not world.robots.begun and all(held is None or held[0] or not held[1] for held in states.values()):
        return []  # nothing begun: the reservations end with their lease
    return [f"it has not ended: {states}"]


def _parked(world: World) -> list[str]:
    """Only a bridge that a person has had left out parks what it has; and the others get the run to its end."""
    left_out = {off.space for off in world.offs if off.adopted is not None}
    return [
        f"the bridge of space {space} was not left out, and has parked the run: {held.closed.reason}"
        for space, bridge in world.bridges.items()
        if (held := bridge.holder.runs.get(RUN)) and held.closed and held.closed.outcome == ADOPTED
        if space not in left_out
    ]


def _twice(world: World) -> list[str]:
    """Each attempt once, and none after a task was done, or beside another one."""
    found: list[str] = []
    retries = {task.key: task.retries for task in world.scenario.tasks()}
    by_step: dict[str, list[tuple[float, float, bool]]] = {}
    for begun in world.robots.begun:
        by_step.setdefault(begun.step, []).append((begun.at, begun.ended or begun.at, begun.fails))
    for step, attempts in by_step.items():
        # Of one that was under way when its bridge went off, nobody knows how it has failed: it is tried once more.
        more = world.adoptions
        if len(attempts) > 1 + more + retries[step.partition("@")[0]]:
            found.append(f"step {step} was begun {len(attempts)} times")
        for (_, ended, fails), (begun_at, _, _) in pairwise(attempts):
            if not fails:
                found.append(f"step {step} was begun again after it was done")
            if begun_at < ended:
                found.append(f"step {step} was begun again before its first attempt had ended")
    return found


def _order(world: World) -> list[str]:
    """What comes after something begins when that has ended; in each round of the repetitions around both."""
    found: list[str] = []
    for before, after, loops in _pairs(world.scenario):
        firsts, lasts = _times(world, before, loops), _times(world, after, loops)
        found += [
            f"step {after} was begun before step {before} had ended, in round {rounds}"
            for rounds in sorted(firsts.keys() & lasts.keys())
            if min(begin for begin, _ in lasts[rounds]) < max(end for _, end in firsts[rounds])
        ]
    return found + _rounds(world) + _after(world)


def _times(world: World, key: str, loops: int) -> dict[tuple[str, ...], list[tuple[float, float]]]:
    """When a step was begun and has ended, by the rounds of so many repetitions around it."""
    found: dict[tuple[str, ...], list[tuple[float, float]]] = {}
    for begun in world.robots.begun:
        step, *rounds = begun.step.split("@")
        if step == key:
            found.setdefault(tuple(rounds[:loops]), []).append((begun.at, begun.ended or begun.at))
    return found


def _rounds(world: World) -> list[str]:
    """A round begins when the one before it is over."""
    found: list[str] = []
    for repeat in [step for step in world.scenario.steps() if isinstance(step, Repeat)]:
        loops = f"{repeat.key}.repeat".split(".").count("repeat")
        times: dict[tuple[int, ...], list[tuple[float, float]]] = {}
        for task in _tasks(repeat.body):
            for rounds, each in _times(world, task, loops).items():
                times.setdefault(tuple(map(int, rounds)), []).extend(each)
        for number, each in times.items():
            before = times.get((*number[:-1], number[-1] - 1), [])
            if before and min(begin for begin, _ in each) < max(end for _, end in before):
                found.append(f"round {number} of {repeat.key} was begun before the one before it had ended")
    return found


def _after(world: World) -> list[str]:
    """A task begins when those that it comes after are done, once at least in the rounds around both."""
    found: list[str] = []
    keys = {task.name: task.key for task in world.scenario.tasks()}
    for task in world.scenario.tasks():
        for key in [keys[name] for name in task.after]:
            both = zip(task.key.split("."), key.split("."), strict=False)
            loops = sum(part == "repeat" for part, _ in takewhile(lambda pair: pair[0] == pair[1], both))
            done = _times(world, key, loops)
            for rounds, times in _times(world, task.key, loops).items():
                ends = [end for _, end in done.get(rounds, [])]
                if not ends or min(begin for begin, _ in times) < min(ends):
                    found.append(f"step {task.key} was begun before {key}, after which it comes")
    return found


def _paused(world: World) -> list[str]:
    """Nothing is begun while every bridge knows that the run is paused."""
    if not world.still:
        return []
    since, until = world.still[0], world.still[1] if len(world.still) > 1 else world.resumes_at
    return [
        f"step {begun.step} was begun at {begun.at:.1f}, and all were paused from {since:.1f} to {until:.1f}"
        for begun in world.robots.begun
        if since < begun.at < until and not _was_assigned(world, begun.step, since)
    ]


def _was_assigned(world: World, step: str, before: float) -> bool:
    """Whether an engine had begun a step by then: a process that was killed meanwhile asks the robot again."""
    lines = [line for bridge in world.bridges.values() for each in bridge.all_segments.values() for line in each]
    facts = [decode_fact(line) for line in lines]
    return any(isinstance(fact, TaskAssigned) and fact.step == step and fact.at < before for fact in facts)


def _tasks(step: Step) -> list[str]:
    return [each.key for each in Scenario("", Sequence("", 0, (step,))).steps() if isinstance(each, Task)]


def _pairs(scenario: Scenario) -> list[tuple[str, str, int]]:
    """All tasks with the tasks that come after them, and the number of repetitions around both."""
    found: list[tuple[str, str, int]] = []

    def walk(step: Step, loops: int) -> None:
        match step:
            case Sequence(steps=steps):
                for number, first in enumerate(steps):
                    walk(first, loops)
                    later = [one for other in steps[number + 1 :] for one in _tasks(other)]
                    found.extend((one, other, loops) for one in _tasks(first) for other in later)
            case Parallel(branches=branches):
                for branch in branches:
                    walk(branch, loops)
            case Condition(then=then, otherwise=otherwise):
                walk(then, loops)
                walk(otherwise, loops)
            case Repeat(body=body):
                walk(body, loops + 1)
            case _:
                pass

    walk(scenario.body, 0)
    return found


def _otherwise(world: World) -> list[str]:
    """Where the run was not ended by the server, it ends as an orchestrated one, with the same tasks and results."""
    ends = {
        (held.closed.outcome if held.closed else "")
        for bridge in world.bridges.values()
        if (held := bridge.holder.runs.get(RUN)) is not None
    }
    if len(ends) > 1 and "aborted" not in ends:
        return [f"bridges say that the run is {sorted(ends)}"]
    if not world.robots.begun or "aborted" in ends:
        return [] if ends <= {"aborted", "", "lost", "done", "failed"} else [f"it has ended as {sorted(ends)}"]
    outcome, results = orchestrated(world.scenario, world.seed)
    done = {begun.step: begun.result for begun in world.robots.begun if not begun.fails}
    if {outcome.value} != ends or done != results:
        return [f"it has ended as {sorted(ends)} with {done}, and orchestrated as {outcome.value} with {results}"]
    return []
