"""A virtual world of a carried run: bridges with holders and engines, a bad network, kills at any write. By a seed.

Durable are the journals and the robots; all else is lost when a bridge is killed. Time is virtual. After `HEALED_S` the
network is good, and every bridge is up; then the run has to end.
"""

from __future__ import annotations

import heapq
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from itertools import count
from random import Random
from typing import Any, Final

from tests.carried.plans import ROBOTS, VIEW, alone_by, robot_space, scenario_by
from ua_fleet.carrying import (
    AskEpoch,
    Begin,
    Gone,
    Holder,
    Part,
    Pause,
    Plan,
    SegmentRound,
    Send,
    SendToken,
    Stop,
    Tell,
    Token,
    decode_token,
    encode_part,
    encode_token,
    parts_of,
    segment_of,
    segment_run,
    split,
)
from ua_fleet.carrying.adoption import (
    Adoption,
    FilledSlot,
    adopted_places,
    begun_places,
    begun_slots,
    encode_adoption,
    needed_places,
    plan_without,
)
from ua_fleet.carrying.compacting import forgotten_segments, superseded
from ua_fleet.carrying.effects import Carry, fact_before
from ua_fleet.carrying.facts import CarryFact, decode_carry_fact, encode_carry_fact
from ua_fleet.carrying.named_rounds import NO_ROUND
from ua_fleet.carrying.part import PartSegment
from ua_fleet.carrying.proof import heads_alone, needed_slots
from ua_fleet.carrying.segment_scenario import decode_scenario, segment_scenario, way_taken
from ua_fleet.carrying.whole_repeats import whole_repeats
from ua_fleet.errors import ScenarioError, StorageUnavailable
from ua_fleet.operation.runs.adopting import Adopting
from ua_fleet.scenario import Run, Scenario, Value, ValueUnknown
from ua_fleet.scenario.effects import CancelTask, DecisionNeeded, Effect, ReleaseRobot, StartTask, WantRobot
from ua_fleet.scenario.facts import (
    Fact,
    RunAdopted,
    RunOutcome,
    TaskOutcome,
    decode_fact,
    encode_fact,
)

__all__ = ["HEALED_S", "World", "orchestrated"]

HEALED_S: Final = 60.0
END_S: Final = 900.0
ADOPT_S: Final = 10.0
AGAIN_S: Final = 0.5
RUN: Final = "run"


class Killed(Exception):
    """A process ends at a write."""


def said_by_robots(name: str) -> Value:
    """The values of robots, which stay what they are: every robot has a level from 0 to 99."""
    if name.partition(".")[2] == "level":
        return float(zlib.crc32(name.encode()) % 100)
    raise ValueUnknown(f"{name} is not known")


def result_of(step: str, arguments: Mapping[str, Value]) -> float:
    """What a task gives: something of its own, of its round and of its argument, from 0 to 99."""
    return float(zlib.crc32(f"{step}/{float(arguments.get('x', 0.0)):g}".encode()) % 100)


@dataclass
class Begun:
    """A robot begins something."""

    at: float
    robot: str
    step: str
    task: str
    execution: str
    fails: bool
    result: float
    ended: float | None = None


@dataclass
class Robots:
    """What all robots do, and have done: nothing of it is lost. They do each execution once, by its id."""

    fails: Callable[[str, int], bool]
    broken: frozenset[str] = frozenset()
    """Robots with a fault, which begin nothing: another one does what they are to do."""
    are_seen: bool = True
    """Whether a person sees what robots have begun whose bridge is off, and is asked; else another robot begins it."""
    identity: Callable[[StartTask, int], str] = lambda effect, _attempt: f"{effect.robot}/{effect.execution_id}"
    begun: list[Begun] = field(default_factory=list[Begun])
    by_id: dict[str, Begun] = field(default_factory=dict[str, Begun])

    def has(self, effect: StartTask, attempt: int) -> bool:
        """Whether an execution was begun."""
        return self.identity(effect, attempt) in self.by_id

    def begin(self, effect: StartTask, attempt: int, now: float) -> Begun:
        """Begin an execution, or find what is known of it."""
        key = self.identity(effect, attempt)
        if key not in self.by_id:
            tries = sum(1 for one in self.begun if one.step == effect.step)
            result = result_of(effect.step, effect.arguments)
            made = Begun(now, effect.robot, effect.step, effect.task, key, self.fails(effect.step, tries), result)
            self.by_id[key] = made
            self.begun.append(made)
        return self.by_id[key]


class Engine:
    """The segments of one bridge: `Run` with the queue of each robot, as the orchestrator has it."""

    def __init__(self, robots: Robots, now: Callable[[], float], later: Callable[[float, Callable[[], None]], None]):
        self.robots, self.now, self.later = robots, now, later
        self.runs: dict[str, Run] = {}
        self.scenarios: dict[str, Scenario] = {}
        self.waiting: dict[str, list[tuple[str, str]]] = {}
        self.has: dict[str, tuple[str, str]] = {}
        self.gone: set[int] = set()
        """Spaces of bridges that are off: their robots cannot be asked."""

    def take(self, run_id: str, effects: list[Effect]) -> None:
        """Carry out what a run says. What is taken back with what follows is not begun, as the server has it."""
        taken_back = {effect.execution_id for effect in effects if isinstance(effect, CancelTask)}
        for effect in effects:
            match effect:
                case WantRobot(step=step, robot=robot):
                    assert robot is not None
                    queue = self.waiting.setdefault(robot, [])
                    if (run_id, step) not in queue and self.has.get(robot) != (run_id, step):
                        queue.append((run_id, step))
                    self.grant(robot)
                case ReleaseRobot(step=step):
                    self.release(run_id, step)
                case StartTask(execution_id=execution_id) if execution_id in taken_back:
                    pass
                case StartTask():
                    self.has[effect.robot] = (run_id, effect.step)
                    self.start(run_id, effect)
                case CancelTask():
                    pass
                case DecisionNeeded(step=step, robot=robot) if robot and not self.works(robot):
                    other = next(one for one in ROBOTS if self.works(one))
                    self.take(run_id, self.runs[run_id].replaced(step, other, "automatic", self.now()))
                case DecisionNeeded(step=step):
                    self.take(run_id, self.runs[run_id].not_replaced(step, "nobody else can do it", self.now()))
                case _:
                    pass

    def works(self, robot: str) -> bool:
        """Whether a robot can be asked for something."""
        return robot not in self.robots.broken and robot_space(robot) not in self.gone

    def release(self, run_id: str, step: str) -> None:
        """A run needs a robot no more."""
        for queue in self.waiting.values():
            if (run_id, step) in queue:
                queue.remove((run_id, step))
        for robot, holder in list(self.has.items()):
            if holder == (run_id, step):
                del self.has[robot]
                self.grant(robot)

    def grant(self, robot: str) -> None:
        """The next one gets a robot that is free; in a turn of its own."""
        if robot in self.has or not self.waiting.get(robot):
            return
        run_id, step = self.has[robot] = self.waiting[robot].pop(0)
        self.later(0.0, lambda: self.take(run_id, self.runs[run_id].granted(step, robot, self.now())))

    def start(self, run_id: str, effect: StartTask) -> None:
        """Have a robot begin, and tell its end."""
        attempt = self.runs[run_id].state.tasks[effect.step].attempt
        # What a robot has begun before its bridge went off is not known, so that a person is asked, who sees it.
        is_gone = robot_space(effect.robot) in self.gone
        is_asked = is_gone and self.robots.are_seen and self.robots.has(effect, attempt)
        if not self.works(effect.robot) and not is_asked:
            self.later(0.0, partial(self.end, run_id, effect, TaskOutcome.FAULT, {}))
            return
        begun = self.robots.begin(effect, attempt, self.now())
        took_s = 0.2 + zlib.crc32(begun.execution.encode()) % 30 / 10
        begun.ended = begun.ended or begun.at + took_s

        results: dict[str, Value] = {} if begun.fails else {"out": begun.result}
        outcome = TaskOutcome.FAILED if begun.fails else TaskOutcome.DONE
        self.later(max(0.0, begun.ended - self.now()), partial(self.end, run_id, effect, outcome, results))

    def end(self, run_id: str, effect: StartTask, outcome: TaskOutcome, results: dict[str, Value]) -> None:
        """Tell the end of an execution."""
        run = self.runs[run_id]
        self.take(run_id, run.accepted(effect.execution_id, self.now()))
        self.take(run_id, run.ended(effect.execution_id, outcome, self.now(), results=results))

    def poll(self) -> None:
        """Time has passed."""
        for run_id, run in list(self.runs.items()):
            if run.state.outcome is None:
                self.take(run_id, run.poll(said_by_robots, self.now()))


class Bridge:
    """One bridge as a process."""

    def __init__(self, world: World, space: int) -> None:
        self.world, self.space = world, space
        self.lines: list[str] = []
        self.segments: dict[str, list[str]] = {}
        """What is on its disk."""
        self.archive: dict[str, list[str]] = {}
        """Segments that are not on its disk any more: the server may have fetched them."""
        self.compacting = Random(f"compacting {world.seed} {space}")
        self.is_open = False
        self.unwritten: list[Callable[[], None]] = []
        self.is_up, self.life = True, 0
        self.start()

    def write(self, to: list[str], *lines: str) -> None:
        """Write lines, all or none; the process may be killed before or after it."""
        random = self.world.random
        is_killed = self.world.now < HEALED_S and random.random() < self.world.kill_rate
        if is_killed and random.random() < 0.5:
            raise Killed
        if self.world.is_lazy:
            self.unwritten.append(lambda: to.extend(lines))
        else:
            to.extend(lines)
        if is_killed:
            raise Killed

    def start(self) -> None:
        """Go on where the journals end."""
        self.holder = Holder(self.space, self.note, [decode_carry_fact(line) for line in self.lines])
        self.engine = Engine(self.world.robots, lambda: self.world.now, self.later)
        self.is_open = False
        self.do(self.holder.again(self.world.now))
        if not self.holder.in_doubt:
            self.open_engine([])
        self.look()

    def open_engine(self, effects: list[Carry]) -> None:
        """Go on with the segments of the journal, once it is known that they are this bridge's."""
        self.is_open = True
        for effect in effects:
            if isinstance(effect, Gone):
                self.engine.gone.add(effect.space)
            if isinstance(effect, Stop | Pause):
                for place in effect.places:
                    if lines := self.segments.get(segment_run(RUN, place)):
                        self.write(lines, encode_fact(fact_before(effect, self.world.now)))
        for run_id, lines in list(self.segments.items()):
            if lines:
                facts = [decode_fact(line) for line in lines]
                scenario = decode_scenario(getattr(facts[0], "text"))  # noqa: B009 - the first fact is RunCreated
                self.engine.runs[run_id] = Run.restore(scenario, facts, self.journal_of(run_id))
                self.engine.scenarios[run_id] = scenario
        for run_id, run in self.engine.runs.items():
            self.engine.take(run_id, run.again(said_by_robots, self.world.now))

    def note(self, fact: CarryFact) -> None:
        """The journal of the holder."""
        if self.world.now < HEALED_S and self.world.full.random() < self.world.full_rate:
            self.world.refused += 1
            raise StorageUnavailable("the disk is full")
        if self.world.forgets is None or not isinstance(fact, self.world.forgets):
            self.write(self.lines, encode_carry_fact(fact))

    def journal_of(self, run_id: str) -> Callable[[Fact], None]:
        """The journal of a segment."""
        return lambda fact: self.write(self.segments.setdefault(run_id, []), encode_fact(fact))

    def later(self, after_s: float, work: Callable[[], None]) -> None:
        """Do something in this life of the process."""
        life = self.life
        self.world.at(self.world.now + after_s, lambda: self.act(work) if self.life == life else None)

    def act(self, work: Callable[[], None]) -> None:
        """Do something, unless the process is dead; it may die of it."""
        if not self.is_up:
            return
        try:
            work()
            self.look()
        except Killed:
            self.die()
        except StorageUnavailable:
            if self.world.forgets_again:
                for held in self.holder.runs.values():
                    held.again_at = None

    def die(self) -> None:
        """All but the disk is lost; it comes back some time later."""
        self.is_up, self.life, self.unwritten = False, self.life + 1, []
        self.world.kills += 1
        self.world.at(self.world.rises_at(self.space), self.rise)

    def rise(self) -> None:
        """The process is started again."""
        if self.is_up or self.world.is_off(self.space):
            return
        self.is_up = True
        try:
            self.start()
        except (Killed, StorageUnavailable):  # a bridge whose disk is full does not start
            self.die()

    def do(self, effects: list[Carry]) -> None:
        """Begin and stop segments."""
        if not self.is_open and not self.holder.in_doubt:
            self.open_engine(effects)
        for effect in effects:
            match effect:
                case Gone(space=space):
                    self.engine.gone.add(space)
                case Begin():
                    self.begin(effect)
                case Tell(run_id=run_id, place=place):
                    key = segment_run(run_id, place)
                    run = self.engine.runs[key]
                    told = run.told(effect.task, self.world.now, is_done=effect.is_done, results=effect.results)
                    self.engine.take(key, told)
                case Pause(run_id=run_id, places=places, is_paused=is_paused):
                    for place in places:
                        key = segment_run(run_id, place)
                        if (begun := self.engine.runs.get(key)) is not None:
                            change = begun.pause if is_paused else begun.resume
                            self.engine.take(key, change("x", self.world.now))
                case Stop(run_id=run_id, places=places, reason=reason):
                    for place in places:
                        key = segment_run(run_id, place)
                        if key in self.engine.runs:
                            self.engine.take(key, self.engine.runs[key].abort(reason, "x", self.world.now))
                        else:
                            self.stopped(run_id, place, reason)

    def stopped(self, run_id: str, place: SegmentRound, reason: str) -> None:
        """A segment that the engine has not got is over; said until it is written down."""
        try:
            self.do(self.holder.segment_ended(run_id, place, self.world.now, failed=reason))
        except StorageUnavailable:
            self.later(1.0, partial(self.stopped, run_id, place, reason))

    def begin(self, effect: Begin) -> None:
        """Begin a segment, unless it was begun before."""
        key, now = segment_run(effect.run_id, SegmentRound(effect.segment.number, effect.rounds)), self.world.now
        if key in self.engine.runs:
            return
        scenario = segment_scenario("made", effect.segment.body, effect.rounds, effect.values, effect.outside)
        given = {one.name: one.default for one in scenario.parameters if one.default is not None}
        known: list[Fact] = []
        Run.create(key, scenario, given, known.append, by="x", now=now)
        known += [decode_fact(line) for line in effect.facts]
        self.write(self.segments.setdefault(key, []), *[encode_fact(fact) for fact in known])
        run = self.engine.runs[key] = Run.restore(scenario, known, self.journal_of(key))
        self.engine.scenarios[key] = scenario
        self.engine.take(key, run.again(said_by_robots, now))
        self.engine.take(key, run.poll(said_by_robots, now))

    def look(self) -> None:
        """Tell the holder of segments that have ended, and others of what is not acknowledged."""
        for key, run in list(self.engine.runs.items()):
            run_id, place = segment_of(key)
            held = self.holder.runs.get(run_id)
            if run.state.outcome is None or held is None or place not in held.active:
                continue
            results = {
                f"{task}.{name}": one for task, given in run.state.results.items() for name, one in given.items()
            }
            is_done = run.state.outcome is RunOutcome.DONE
            failed = "" if is_done else run.state.reason or "failed"
            way = way_taken(self.engine.scenarios[key], run.state) if is_done else True
            self.do(self.holder.segment_ended(run_id, place, self.world.now, failed=failed, results=results, way=way))

    def compact(self) -> None:
        """Forget now and then what the journals need no more, in one transaction."""
        held = self.holder.runs.get(RUN)
        if held is None or self.unwritten or self.compacting.random() < 0.7:
            return
        gone = set(superseded(held, [self.world.fact_of(line) for line in self.lines]))
        self.lines[:] = [line for number, line in enumerate(self.lines) if number not in gone]
        self.world.compacted += len(gone)
        for key in forgotten_segments(held, list(self.segments)):
            self.archive[key] = self.segments.pop(key)
            self.engine.runs.pop(key, None)

    @property
    def all_segments(self) -> dict[str, list[str]]:
        """The facts of segments that were on its disk ever."""
        return self.archive | self.segments

    def tick(self) -> None:
        """Each half second: time, what lazy writers write, what is not acknowledged."""
        if self.is_up:
            self.act(self.engine.poll)
        if self.is_up:
            self.act(lambda: self.do(self.holder.poll(self.world.now)))
        if self.is_up and self.world.random.random() < 0.2:
            for write in self.unwritten:
                write()
            self.unwritten = []
        if not self.is_up:
            return
        self.compact()
        for sent in list(self.holder.to_send()):
            self.world.say(self, sent)


class Off:
    """A bridge that is off for long, and what a person has the server do then. `before`: another one was before.

    Where not all bridges know yet that the one before is off, both are left out as one.
    """

    def __init__(self, world: World, before: Off | None = None) -> None:
        random = Random(f"off {world.seed}" if before is None else f"off again {world.seed}")
        self.world, self.random, self.before = world, random, before
        self.epoch: int = 2 if before is None else before.epoch + 1
        spaces = list(world.bridges if before is None else before.parts)
        self.space = random.choice(spaces)
        soon = random.uniform(2.0, 30.0) if before is None else world.now + random.uniform(0.0, 10.0)
        is_one_left = len(spaces) < (2 if before is None or before.is_done else 3)
        self.at = END_S * 2 if is_one_left else random.choice((END_S * 2, soon))
        self.until = random.choice((END_S * 2, self.at + random.uniform(15.0, 60.0)))
        if world.is_alone and before is None:
            self.space, self.at, self.until = robot_space("r1"), random.uniform(10.0, 30.0), END_S * 2
        self.adopted: float | None = None
        """When the person has said it."""
        self.filled: dict[int, tuple[FilledSlot, ...]] = {}
        self.is_done: bool = False
        self.plan: Plan = world.plan
        self.parts: Mapping[int, Part] = {}
        """What the others get."""
        self.first_plan: Plan = world.plan
        self.first_parts: Mapping[int, Part] = {}
        """Those before it, and before all that are left out with it."""
        self.heir = 0
        self.gone: tuple[int, ...] = (self.space,)
        self.segments: dict[int, PartSegment] = {}
        self.facts: dict[SegmentRound, tuple[str, ...]] = {}
        self.heard: list[Fact] = []
        """What the server has fetched of those that are left out as one."""
        self.begun: list[FilledSlot] = []
        """Tokens that the others have, as far as the server has fetched it."""
        self.done: list[str] = []
        """What the person says that robots have done."""
        self.is_superseded = False
        """Whether another one is left out together with this one."""

    @property
    def is_both(self) -> bool:
        """Whether another one is left out together with this one."""
        return len(self.gone) > 1

    def begin(self) -> None:
        """It is off now."""
        if (bridge := self.world.bridges[self.space]).is_up:
            bridge.die()
        self.world.at(self.until, bridge.rise)

    def is_off(self, space: int) -> bool:
        """Whether this bridge is off for longer than others are."""
        is_being_left_out = self.adopted is not None and not self.is_done
        return space == self.space and (self.at <= self.world.now < self.until or is_being_left_out)

    def tick(self) -> None:
        """Each half second of the server: it asks the person, and tells all that are left until they have it."""
        world, victim = self.world, self.world.bridges[self.space]
        if self.is_superseded:
            return
        if self.adopted is None:
            is_needed = not all(one.holder.runs[RUN].closed for one in world.bridges.values() if RUN in one.holder.runs)
            if not is_needed or not self.at + ADOPT_S + 5.0 <= world.now < self.until or victim.is_up:
                return
            self.adopted = world.now
            self._leave_out(victim)
            world.next_off()
        for space, part in self.parts.items():
            if space != self.heir and space not in self.filled:
                self._tell(world.bridges[space], Adoption(part, self.gone, "x"))
        if not self.is_done and self.filled.keys() >= self.parts.keys() - {self.heir}:
            own = begun_places(self.segments, self.facts) if world.has_proof else []
            others = needed_slots(self.segments, [one for slots in self.filled.values() for one in slots])
            filled = (*others, *own)
            results = {f"{one.task}.out": one.result for one in world.robots.begun if not one.fails}
            facts = needed_places(self.segments, self.facts, (*filled, *self.begun))
            adoption = Adoption(self.parts[self.heir], self.gone, "x", filled, dict(results), facts)
            self._tell(world.bridges[self.heir], adoption)
        if world.now > self.adopted + 300.0:
            world.is_closing = True

    def _leave_out(self, victim: Bridge) -> None:
        """A person has said that it is off."""
        world, before = self.world, self.before
        parts: Mapping[int, Part] = world.parts if before is None else before.parts
        plan = world.plan if before is None else before.plan
        if before is not None and not before.is_done:  # both as one, from the plan before both
            before.is_superseded, self.gone = True, (*before.gone, self.space)
            plan, parts = before.first_plan, before.first_parts
            self.segments, self.heard = dict(before.segments), list(before.heard)
        left = [space for space in parts if space not in self.gone]
        is_kept = before is not None and before.is_superseded and before.heir in left
        self.heir = before.heir if before is not None and is_kept else self.random.choice(left)
        self.first_plan, self.first_parts = plan, parts
        self.plan = reduce(lambda plan, space: plan_without(plan, space, self.heir), self.gone, plan)
        adopt_after_s = 0.0 if world.no_epoch else ADOPT_S
        self.parts = parts_of(self.plan, RUN, "made", {}, "x", adopt_after_s=adopt_after_s, epoch=self.epoch)
        self.segments |= parts[self.space].segments
        self._fetch(victim)  # the heir of the one before may have begun what was that one's
        self.begun = self._begun(parts)
        self.done = self._said()
        self.facts = self._facts(self.done)

    def _begun(self, parts: Mapping[int, Part]) -> list[FilledSlot]:
        """What the server has fetched of the others says of their tokens."""
        random, found = Random(f"fetched {self.world.seed} {self.epoch}"), list[FilledSlot]()
        for space in self.parts:
            own = [one for one in parts[space].segments.values() if self.world.plan.segments[one.number].space == space]
            if self.world.is_brief:
                found += begun_slots(own, self._fetched(space))
                continue
            lines = [line for one in self.world.bridges[space].all_segments.values() for line in one]
            fetched = [decode_fact(line) for line in lines]
            fetched.sort(key=lambda fact: fact.at)
            found += begun_slots(own, fetched[: random.choice((random.randint(0, len(fetched)), len(fetched)))])
        return found

    def _fetch(self, victim: Bridge) -> None:
        """Know what the server has fetched before it was off, which may not be all."""
        fetched = self._fetched(victim.space) if self.world.is_brief else []
        for lines in victim.all_segments.values() if not self.world.is_brief else ():
            fetched += [decode_fact(line) for line in lines[: self.random.randint(0, len(lines))]]
        self.heard = list({encode_fact(fact): fact for fact in (*self.heard, *fetched)}.values())
        self.heard.sort(key=lambda fact: fact.at)

    def _said(self) -> list[str]:
        """What robots have done in truth, as a person says it.

        Some name the last rounds of a repetition only when the server refuses to go on without them.
        """
        done = [one.step for one in self.world.robots.begun if not one.fails]
        if not self.world.is_brief:
            return done
        done = _last_rounds(done)
        if not self.world.is_terse:
            return done
        within = [one for head in heads_alone(self.segments) for one in self.segments.values() if head in one.loops]
        tasks = [task for one in within for task in one.tasks()]
        tasks += [task for one in self.segments.values() for repeat in whole_repeats(one, ()) for task in repeat.tasks]
        keys = {task.key for task in tasks}
        said = [step for step in done if step.partition("@")[0] not in keys]
        if self.before is not None and self.before.is_superseded:
            said += self.before.done  # what was said then counts still
        while (unknown := self._adopting(said).unknown_rounds()) is not None:
            self.world.asked += 1
            asked = {task.key for task in unknown.tasks}
            more = [step for step in done if step.partition("@")[0] in asked and step not in said]
            said += more or [f"{key}@{NO_ROUND}" for key in asked]
        return said

    def _adopting(self, done: list[str]) -> Adopting:
        """What the server would have the bridges told, which knows whether it has to ask for rounds."""
        said = RunAdopted(self.world.now, self.space, self.heir, done, "x", self.gone[:-1])
        homes = {number: space for space in self.gone for number in self.first_parts[space].segments}
        repeats = [repeat for one in self.segments.values() for repeat in whole_repeats(one, self.heard)]
        return Adopting(said, self.parts, {}, self.segments, self._facts(done), self.begun, {}, homes, repeats)

    def _facts(self, done: list[str]) -> dict[SegmentRound, tuple[str, ...]]:
        """What was heard, and what the person says."""
        facts: dict[SegmentRound, tuple[str, ...]] = {}
        for segment in self.segments.values():
            for place, said in adopted_places(segment, self.heard, done, self.world.now, "x").items():
                facts[place] = tuple([encode_fact(fact) for fact in said])
        return facts

    def _fetched(self, space: int) -> list[Fact]:
        """What the server has fetched of a bridge in truth: not what it had forgotten by then."""
        facts = [decode_fact(line) for lines in self.world.fetched.get(space, {}).values() for line in lines]
        return sorted(facts, key=lambda fact: fact.at)

    def _tell(self, bridge: Bridge, adoption: Adoption) -> None:
        world, content = self.world, encode_adoption(adoption, self.world.content_of(adoption.part))

        def acknowledged(filled: tuple[FilledSlot, ...]) -> None:
            self.filled.setdefault(bridge.space, filled)
            if bridge.space == self.heir and not self.is_done:
                self.is_done = True  # and the one that was off may be started again
                world.at(max(world.now, self.until), world.bridges[self.space].rise)
                if self.is_both:
                    assert self.before is not None
                    self.before.is_done = True
                    world.at(max(world.now, self.before.until), world.bridges[self.before.space].rise)
                world.next_off()

        def take() -> None:
            bridge.do(bridge.holder.take_adoption(content, world.now))
            filled = bridge.holder.runs[RUN].filled()
            world.carry(bridge.space, 0, lambda: acknowledged(filled))

        world.carry(0, bridge.space, lambda: world.refusable(bridge, take))


def _last_rounds(steps: list[str]) -> list[str]:
    """The last round of each step, which is all that a person has seen of what robots have done."""
    newest: dict[str, str] = {}
    for step in steps:
        key, *rounds = step.split("@")
        known = newest.get(key, key).split("@")[1:]
        if [int(number) for number in rounds] >= [int(number) for number in known]:
            newest[key] = step
    return list(newest.values())


class World:
    """One run, decided by its seed."""

    asked = 0
    """How often the server has refused to have a bridge left out before people have named rounds."""

    def __init__(
        self,
        seed: int,
        *,
        is_lazy: bool = False,
        identity: Callable[[StartTask, int], str] | None = None,
        parts: Callable[[dict[int, Part]], dict[int, Part]] = lambda parts: parts,
        forgets: type[CarryFact] | None = None,
        no_epoch: bool = False,
        forgets_again: bool = False,
        has_proof: bool = True,
        is_alone: bool = False,
    ) -> None:
        """Make it.

        Args:
            seed: of everything.
            is_lazy: a wrong journal, which writes later than it says.
            identity: a wrong execution id.
            parts: makes wrong parts of right ones.
            no_epoch: a wrong adoption, after which a bridge cannot tell a token from one before it.
            forgets: a kind of fact that a wrong journal leaves out.
            forgets_again: a wrong holder, which does not know that it could not write a fact.
            is_alone: whether one bridge does most of it, so that no other one knows how far it is.
            has_proof: False: a wrong adoption, in which the rounds that nobody has heard of are not known to be over.
        """
        self.random = Random(seed)
        self.seed, self.now, self.is_lazy = seed, 0.0, is_lazy
        self.kills = self.compacted = 0
        self.forgets, self.forgets_again, self.has_proof = forgets, forgets_again, has_proof
        self.is_alone = is_alone
        self.is_brief = is_alone or Random(f"person {seed}").random() < 0.5
        """Whether the server knows of bridges what it has fetched, and people the last round of each task alone."""
        self.fetched: dict[int, dict[str, list[str]]] = {}
        """Lines of each segment of each bridge, as the server has fetched them."""
        self.full, self.refused = Random(f"full {seed}"), 0
        self.full_rate = self.full.choice((0.0, 0.0, 0.05, 0.3))
        """How often a disk has no room for a fact; how often that was so is in `refused`."""
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._facts, self._contents = dict[str, CarryFact](), dict[int, tuple[Part, bytes]]()
        self.scenario = (alone_by if is_alone else scenario_by)(Random(f"scenario {seed}"))
        plan, problems = split(self.scenario, VIEW)
        self.problems = problems
        if plan is None:
            return
        self.plan = plan
        self.loss = self.random.choice((0.0, 0.3, 0.3))
        self.kill_rate = self.random.choice((0.0, 0.02, 0.08))
        self.robots = Robots(fails_by(seed), broken_by(seed))
        self.robots.are_seen = not is_alone
        if identity is not None:
            self.robots.identity = identity
        self.parts = parts(parts_of(plan, RUN, "made", {}, "x", adopt_after_s=0.0 if no_epoch else ADOPT_S))
        self.no_epoch = no_epoch
        self.bridges = {space: Bridge(self, space) for space in self.parts}
        self.cuts = [self._cut() for _ in range(self.random.randint(0, 3))]
        self.server_dies_at = self.random.choice((END_S * 2, self.random.uniform(0.0, 20.0)))
        self.server_is_back_at = self.random.choice((END_S * 2, self.server_dies_at + self.random.uniform(1.0, 90.0)))
        if is_alone:
            self.server_dies_at, self.server_is_back_at = self.random.uniform(3.0, 9.0), self.random.uniform(20.0, 50.0)
        self.pauses_at = self.random.choice((END_S * 2, self.random.uniform(1.0, 20.0)))
        self.resumes_at = self.pauses_at + self.random.uniform(1.0, 60.0)
        self.paused_told: set[int] = set()
        self.resumed_told: set[int] = set()
        self.still: list[float] = []
        """From when all bridges knew that the run is paused, and until when."""
        self.accepted: set[int] = set()
        self.has_begun = self.is_closing = False
        self.ended_told: set[int] = set()
        self.offs = [Off(self)]
        token = Token(RUN, next(iter(self.parts.values())).plan_hash, 1, 0, 0)
        self.token = encode_token(token, ())

    def _cut(self) -> tuple[float, float, frozenset[int]]:
        """A time in which some processes hear nobody else; 0 is the server."""
        begin = self.random.uniform(0.0, HEALED_S)
        spaces = [0, *self.bridges]
        some = frozenset(self.random.sample(spaces, self.random.randint(1, len(spaces))))
        return begin, min(HEALED_S, begin + self.random.uniform(1.0, 30.0)), some

    def at(self, time: float, work: Callable[[], None]) -> None:
        """Do something then."""
        heapq.heappush(self._events, (time, next(self._order), work))

    def run(self) -> None:
        """Let it go until it is over, or for a long time."""
        for bridge in self.bridges.values():
            self.at(self.random.uniform(0.0, AGAIN_S), partial(self._each, bridge))
        self.at(0.0, self._server)
        self.at(self.offs[0].at, self.offs[0].begin)
        while self._events and self.now < END_S:
            self.now, _, work = heapq.heappop(self._events)
            work()
            if self.now > HEALED_S and self.is_over:
                return

    @property
    def is_terse(self) -> bool:
        """Whether people name the last rounds of a repetition that one bridge does alone only when they are asked."""
        return self.is_brief and Random(f"terse {self.seed}").random() < 0.5

    def fact_of(self, line: str) -> CarryFact:
        """A fact of a journal, which is looked at again and again."""
        if (fact := self._facts.get(line)) is None:
            fact = self._facts[line] = decode_carry_fact(line)
        return fact

    def content_of(self, part: Part) -> bytes:
        """A part as it is sent, again and again until it is acknowledged."""
        kept = self._contents.get(id(part))
        if kept is None:
            kept = self._contents[id(part)] = part, encode_part(part)
        return kept[1]

    @property
    def is_over(self) -> bool:
        """Whether every bridge knows that the run is over, and does nothing for it."""
        there = [bridge for space, bridge in self.bridges.items() if not self.is_off(space)]
        held = [bridge.holder.runs.get(RUN) for bridge in there]
        return all(bridge.is_up for bridge in there) and all(
            one is not None and one.closed is not None and not one.active for one in held
        )

    def is_off(self, space: int) -> bool:
        """Whether a bridge is off for longer than the others are."""
        return any(off.is_off(space) for off in self.offs)

    @property
    def adoptions(self) -> int:
        """How many bridges a person has had left out."""
        return sum(off.adopted is not None for off in self.offs)

    def next_off(self) -> None:
        """A bridge is left out, or was: it may be another one's turn."""
        is_turn = self.offs[0].is_done or Random(f"both {self.seed}").random() < 0.5
        if len(self.offs) == 1 and len(self.offs[0].parts) > 1 and is_turn:
            off = Off(self, self.offs[0])
            self.offs.append(off)
            self.at(max(self.now, off.at), off.begin)

    def rises_at(self, space: int) -> float:
        """When a bridge that has just died is started again."""
        until = [off.until for off in self.offs if off.is_off(space)]
        return max(self.now, *until) if until else self.now + self.random.uniform(0.5, 15.0)

    def _each(self, bridge: Bridge) -> None:
        bridge.tick()
        self.at(self.now + AGAIN_S, lambda: self._each(bridge))

    # The network.

    def carry(self, source: int, target: int, work: Callable[[], None]) -> None:
        """Bring a message: late, twice, or not at all."""
        is_bad = self.now < HEALED_S
        if self._is_cut_off(source, target) or (is_bad and self.random.random() < self.loss):
            return
        self.at(self.now + self.random.uniform(0.001, 2.0 if is_bad else 0.01), work)
        if is_bad and self.random.random() < 0.2:
            self.at(self.now + self.random.uniform(0.5, 100.0), work)

    def _is_cut_off(self, source: int, target: int) -> bool:
        return any(begin <= self.now < end and (source in some) != (target in some) for begin, end, some in self.cuts)

    def say(self, bridge: Bridge, sent: Send) -> None:
        """A bridge tells another one, which acknowledges it."""
        space = sent.road.space if isinstance(sent, SendToken) else sent.space
        if isinstance(sent, AskEpoch):
            self._ask(bridge, sent)
            return
        target, life = self.bridges[space], bridge.life

        def acknowledged() -> None:
            if bridge.life != life:
                return
            if isinstance(sent, SendToken):
                bridge.act(partial(bridge.holder.handed_over, sent, self.now))
            else:
                bridge.act(partial(bridge.holder.end_told, sent, self.now))

        def refused() -> None:
            if bridge.life == life and isinstance(sent, SendToken):
                bridge.act(partial(bridge.holder.refused, sent))

        def arrive() -> None:
            def take() -> None:
                if isinstance(sent, SendToken):
                    content = self._as_of_now(target, sent.content) if self.no_epoch else sent.content
                    try:
                        target.do(target.holder.take_token(content, bridge.space, self.now))
                    except (ScenarioError, StorageUnavailable) as error:
                        self.carry(space, bridge.space, refused)
                        if isinstance(error, StorageUnavailable):
                            raise
                        return
                else:
                    target.do(target.holder.take_end(sent.run_id, sent.outcome, sent.reason, bridge.space, self.now))
                self.carry(space, bridge.space, acknowledged)

            self.refusable(target, take)

        self.carry(bridge.space, space, arrive)

    def _ask(self, bridge: Bridge, sent: AskEpoch) -> None:
        """A bridge asks another one for the epoch of the run."""
        target, life = self.bridges[sent.space], bridge.life

        def answered(told: dict[str, Any]) -> None:
            if bridge.life == life:
                over = {name: told[name] for name in told if name != "epoch"}
                bridge.act(lambda: bridge.do(bridge.holder.told_epoch(sent, told["epoch"], self.now, **over)))

        def take() -> None:
            held = target.holder.runs.get(RUN)
            if held is not None:
                self.carry(sent.space, bridge.space, partial(answered, target.holder.asked_epoch(held, bridge.space)))

        self.carry(bridge.space, sent.space, lambda: self.refusable(target, take))

    @staticmethod
    def _as_of_now(target: Bridge, content: bytes) -> bytes:
        """A token as a bridge takes it that does not look at its epoch."""
        held = target.holder.runs[RUN]
        names = {number: one.needs for number, one in held.part.segments.items()}
        try:
            token = decode_token(content, names)
        except ScenarioError:
            return content
        made = replace(token, plan_hash=held.part.plan_hash, epoch=held.part.epoch)
        return encode_token(made, () if token.failed else names[token.segment][token.slot])

    def refusable(self, target: Bridge, take: Callable[[], None]) -> None:
        def guarded() -> None:
            try:
                take()
            except ScenarioError:
                return  # refused: who has sent it says it again

        target.act(guarded)

    # The server.

    def _server(self) -> None:
        """Each half second, while it lives: it offers parts, then begins; a new one ends what had not begun."""
        self.at(self.now + AGAIN_S, self._server)
        if self.server_dies_at <= self.now < self.server_is_back_at:
            if not self.has_begun:
                self.is_closing = True
            return
        for space, part in self.parts.items():
            bridge = self.bridges[space]
            if bridge.is_up and not self._is_cut_off(0, space):
                self.fetched.setdefault(space, {}).update({key: list(one) for key, one in bridge.segments.items()})
            if self.is_closing:
                if space not in self.ended_told:
                    self._tell_server_end(bridge)
            elif space not in self.accepted:
                self._offer(bridge, self.content_of(part))
        if self.has_begun and not self.is_closing:
            self._pause()
            for off in list(self.offs):
                off.tick()
        if not self.is_closing and not self.has_begun and len(self.accepted) == len(self.parts):
            self._begin(self.bridges[self.plan.segments[0].space])

    def _offer(self, bridge: Bridge, content: bytes) -> None:
        def take() -> None:
            bridge.holder.take_part(content, self.now)
            self.carry(bridge.space, 0, lambda: self.accepted.add(bridge.space))

        self.carry(0, bridge.space, lambda: self.refusable(bridge, take))

    def _begin(self, bridge: Bridge) -> None:
        def take() -> None:
            bridge.do(bridge.holder.take_token(self.token, 0, self.now))
            self.carry(bridge.space, 0, self._begun)

        self.carry(0, bridge.space, lambda: self.refusable(bridge, take))

    def _begun(self) -> None:
        self.has_begun = True

    def _pause(self) -> None:
        """Have all bridges pause, and go on later: each is told until it has acknowledged."""
        if self.now < self.pauses_at:
            return
        is_paused = self.now < self.resumes_at
        if not is_paused and len(self.still) == 1:
            self.still.append(self.now)
        told = self.paused_told if is_paused else self.resumed_told
        for bridge in self.bridges.values():
            if bridge.space not in told:
                self._tell_pause(bridge, told, is_paused=is_paused)

    def _tell_pause(self, bridge: Bridge, told: set[int], *, is_paused: bool) -> None:
        def acknowledged() -> None:
            told.add(bridge.space)
            if is_paused and len(told) == len(self.bridges) and self.now < self.resumes_at and not self.still:
                self.still.append(self.now)

        def take() -> None:
            if is_paused and self.now >= self.resumes_at:
                return  # who asks has its own order: a request that is late is not answered any more
            bridge.do(bridge.holder.take_pause(RUN, is_paused, "x", self.now))
            self.carry(bridge.space, 0, acknowledged)

        self.carry(0, bridge.space, lambda: self.refusable(bridge, take))

    def _tell_server_end(self, bridge: Bridge) -> None:
        def take() -> None:
            bridge.do(bridge.holder.take_end(RUN, "aborted", "the server ended", 0, self.now))
            self.carry(bridge.space, 0, lambda: self.ended_told.add(bridge.space))

        self.carry(0, bridge.space, lambda: self.refusable(bridge, take))


def fails_by(seed: int) -> Callable[[str, int], bool]:
    """Which attempts fail: the same ones however a run is done."""
    return lambda step, tries: zlib.crc32(f"{seed}/{step}/{tries}".encode()) % 100 < 12


def broken_by(seed: int) -> frozenset[str]:
    """Which robots have a fault, likewise."""
    random = Random(f"broken {seed}")
    return frozenset(random.sample(list(ROBOTS), random.choice((0, 0, 1, 2))))


def orchestrated(scenario: Scenario, seed: int) -> tuple[RunOutcome, dict[str, float]]:
    """How the same run ends where one engine does all of it, and what its tasks gave in each round."""
    events: list[tuple[float, int, Callable[[], None]]] = []
    order, now = count(), 0.0

    def later(after_s: float, work: Callable[[], None]) -> None:
        heapq.heappush(events, (now + after_s, next(order), work))

    engine = Engine(Robots(fails_by(seed), broken_by(seed)), lambda: now, later)
    run = engine.runs[RUN] = Run.create(RUN, scenario, {}, lambda _fact: None, by="x", now=0.0)
    engine.take(RUN, run.poll(said_by_robots, 0.0))
    while run.state.outcome is None:
        if not events:
            now += 0.5
            engine.poll()
            continue
        now, _, work = heapq.heappop(events)
        work()
        engine.poll()
    return run.state.outcome, {begun.step: begun.result for begun in engine.robots.begun if not begun.fails}
