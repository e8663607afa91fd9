"""A virtual world of a carried run: bridges with holders and engines, a bad network, kills at any write. By a seed.

Durable are the journals and the robots; all else is lost when a bridge is killed. Time is virtual. After `HEALED_S` the
network is good, and every bridge is up; then the run has to end.
"""

from __future__ import annotations

import heapq
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from random import Random
from typing import Final

from tests.carried.plans import VIEW, scenario_by
from ua_fleet.carrying import (
    Begin,
    Holder,
    Part,
    Pause,
    SendEnd,
    SendToken,
    Stop,
    Token,
    encode_part,
    encode_token,
    parts_of,
    split,
)
from ua_fleet.carrying.effects import Carry
from ua_fleet.carrying.facts import CarryFact, decode_carry_fact, encode_carry_fact
from ua_fleet.carrying.fragments import decode_scenario, segment_scenario
from ua_fleet.errors import ScenarioError
from ua_fleet.scenario import Run, Scenario, Value, ValueUnknown
from ua_fleet.scenario.effects import CancelTask, DecisionNeeded, Effect, ReleaseRobot, StartTask, WantRobot
from ua_fleet.scenario.facts import Fact, RunOutcome, TaskOutcome, decode_fact, encode_fact

__all__ = ["HEALED_S", "World", "orchestrated"]

HEALED_S: Final = 60.0
END_S: Final = 900.0
AGAIN_S: Final = 0.5
RUN: Final = "run"


class Killed(Exception):
    """A process ends at a write."""


def _unknown(name: str) -> Value:
    raise ValueUnknown(f"{name} is not known")


def result_of(task: str, arguments: Mapping[str, Value]) -> float:
    """What a task gives: something of its own and of its argument, from 0 to 99."""
    return float(zlib.crc32(f"{task}/{float(arguments.get('x', 0.0)):g}".encode()) % 100)


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
    identity: Callable[[StartTask], str] = lambda effect: effect.execution_id
    begun: list[Begun] = field(default_factory=list[Begun])
    by_id: dict[str, Begun] = field(default_factory=dict[str, Begun])

    def begin(self, effect: StartTask, now: float) -> Begun:
        """Begin an execution, or find what is known of it."""
        key = self.identity(effect)
        if key not in self.by_id:
            tries = sum(1 for one in self.begun if one.step == effect.step)
            result = result_of(effect.task, effect.arguments)
            made = Begun(now, effect.robot, effect.step, effect.task, key, self.fails(effect.step, tries), result)
            self.by_id[key] = made
            self.begun.append(made)
        return self.by_id[key]


class Engine:
    """The segments of one bridge: `Run` with the queue of each robot, as the orchestrator has it."""

    def __init__(self, robots: Robots, now: Callable[[], float], later: Callable[[float, Callable[[], None]], None]):
        self.robots, self.now, self.later = robots, now, later
        self.runs: dict[str, Run] = {}
        self.waiting: dict[str, list[tuple[str, str]]] = {}
        self.has: dict[str, tuple[str, str]] = {}

    def take(self, run_id: str, effects: list[Effect]) -> None:
        """Carry out what a run says."""
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
                case StartTask():
                    self.has[effect.robot] = (run_id, effect.step)
                    self.start(run_id, effect)
                case CancelTask():
                    pass
                case DecisionNeeded(step=step):
                    self.take(run_id, self.runs[run_id].not_replaced(step, "nobody else can do it", self.now()))
                case _:
                    pass

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
        begun = self.robots.begin(effect, self.now())
        took_s = 0.2 + zlib.crc32(begun.execution.encode()) % 30 / 10
        begun.ended = begun.ended or begun.at + took_s

        def end() -> None:
            run = self.runs[run_id]
            results: dict[str, Value] = {} if begun.fails else {"out": begun.result}
            outcome = TaskOutcome.FAILED if begun.fails else TaskOutcome.DONE
            self.take(run_id, run.accepted(effect.execution_id, self.now()))
            self.take(run_id, run.ended(effect.execution_id, outcome, self.now(), results=results))

        self.later(max(0.0, begun.ended - self.now()), end)

    def poll(self) -> None:
        """Time has passed."""
        for run_id, run in list(self.runs.items()):
            if run.state.outcome is None:
                self.take(run_id, run.poll(_unknown, self.now()))


class Bridge:
    """One bridge as a process."""

    def __init__(self, world: World, space: int) -> None:
        self.world, self.space = world, space
        self.lines: list[str] = []
        self.segments: dict[str, list[str]] = {}
        """What is on its disk."""
        self.unwritten: list[Callable[[], None]] = []
        self.is_up, self.life = True, 0
        self.start()

    def write(self, to: list[str], line: str) -> None:
        """Write a line; the process may be killed before or after it."""
        random = self.world.random
        is_killed = self.world.now < HEALED_S and random.random() < self.world.kill_rate
        if is_killed and random.random() < 0.5:
            raise Killed
        if self.world.is_lazy:
            self.unwritten.append(lambda: to.append(line))
        else:
            to.append(line)
        if is_killed:
            raise Killed

    def start(self) -> None:
        """Go on where the journals end."""
        self.holder = Holder(self.space, self.note, [decode_carry_fact(line) for line in self.lines])
        self.engine = Engine(self.world.robots, lambda: self.world.now, self.later)
        for run_id, lines in list(self.segments.items()):
            if lines:
                facts = [decode_fact(line) for line in lines]
                scenario = decode_scenario(getattr(facts[0], "text"))  # noqa: B009 - the first fact is RunCreated
                self.engine.runs[run_id] = Run.restore(scenario, facts, self.journal_of(run_id))
        for run_id, run in self.engine.runs.items():
            self.engine.take(run_id, run.again(_unknown, self.world.now))
        self.do(self.holder.again(self.world.now))
        self.look()

    def note(self, fact: CarryFact) -> None:
        """The journal of the holder."""
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

    def die(self) -> None:
        """All but the disk is lost; it comes back some time later."""
        self.is_up, self.life, self.unwritten = False, self.life + 1, []
        self.world.kills += 1
        self.world.at(self.world.now + self.world.random.uniform(0.5, 15.0), self.rise)

    def rise(self) -> None:
        """The process is started again."""
        self.is_up = True
        try:
            self.start()
        except Killed:
            self.die()

    def do(self, effects: list[Carry]) -> None:
        """Begin and stop segments."""
        for effect in effects:
            match effect:
                case Begin(run_id=run_id, segment=segment, values=values):
                    key = f"{run_id}.{segment.number}"
                    if key not in self.engine.runs:
                        scenario = segment_scenario("made", segment.body, values)
                        given = {one.name: one.default for one in scenario.parameters if one.default is not None}
                        run = Run.create(key, scenario, given, self.journal_of(key), by="x", now=self.world.now)
                        self.engine.runs[key] = run
                        self.engine.take(key, run.poll(_unknown, self.world.now))
                case Pause(run_id=run_id, segments=segments, is_paused=is_paused):
                    for number in segments:
                        key = f"{run_id}.{number}"
                        if (known := self.engine.runs.get(key)) is not None:
                            change = known.pause if is_paused else known.resume
                            self.engine.take(key, change("x", self.world.now))
                case Stop(run_id=run_id, segments=segments, reason=reason):
                    for number in segments:
                        key = f"{run_id}.{number}"
                        if key in self.engine.runs:
                            self.engine.take(key, self.engine.runs[key].abort(reason, "x", self.world.now))

    def look(self) -> None:
        """Tell the holder of segments that have ended, and others of what is not acknowledged."""
        for key, run in list(self.engine.runs.items()):
            run_id, _, number = key.rpartition(".")
            held = self.holder.runs.get(run_id)
            if run.state.outcome is None or held is None or int(number) in held.over:
                continue
            results = {
                f"{task}.{name}": one for task, given in run.state.results.items() for name, one in given.items()
            }
            failed = "" if run.state.outcome is RunOutcome.DONE else run.state.reason or "failed"
            self.do(self.holder.segment_ended(run_id, int(number), self.world.now, failed=failed, results=results))

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
        for sent in list(self.holder.to_send()):
            self.world.say(self, sent)


class World:
    """One run, decided by its seed."""

    def __init__(
        self,
        seed: int,
        *,
        is_lazy: bool = False,
        identity: Callable[[StartTask], str] | None = None,
        parts: Callable[[dict[int, Part]], dict[int, Part]] = lambda parts: parts,
        forgets: type[CarryFact] | None = None,
    ) -> None:
        """Make it.

        Args:
            seed: of everything.
            is_lazy: a wrong journal, which writes later than it says.
            identity: a wrong execution id.
            parts: makes wrong parts of right ones.
            forgets: a kind of fact that a wrong journal leaves out.
        """
        self.random = Random(seed)
        self.seed, self.now, self.is_lazy, self.kills = seed, 0.0, is_lazy, 0
        self.forgets = forgets
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self.scenario = scenario_by(Random(f"scenario {seed}"))
        plan, problems = split(self.scenario, VIEW)
        self.problems = problems
        if plan is None:
            return
        self.plan = plan
        self.loss = self.random.choice((0.0, 0.3, 0.3))
        self.kill_rate = self.random.choice((0.0, 0.02, 0.08))
        self.robots = Robots(fails_by(seed))
        if identity is not None:
            self.robots.identity = identity
        self.parts = parts(parts_of(plan, RUN, "made", {}, "x"))
        self.bridges = {space: Bridge(self, space) for space in self.parts}
        self.cuts = [self._cut() for _ in range(self.random.randint(0, 3))]
        self.server_dies_at = self.random.choice((END_S * 2, self.random.uniform(0.0, 20.0)))
        self.server_is_back_at = self.random.choice((END_S * 2, self.server_dies_at + self.random.uniform(1.0, 90.0)))
        self.pauses_at = self.random.choice((END_S * 2, self.random.uniform(1.0, 20.0)))
        self.resumes_at = self.pauses_at + self.random.uniform(1.0, 60.0)
        self.paused_told: set[int] = set()
        self.resumed_told: set[int] = set()
        self.still: list[float] = []
        """From when all bridges knew that the run is paused, and until when."""
        self.accepted: set[int] = set()
        self.has_begun = self.is_closing = False
        self.ended_told: set[int] = set()
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
        while self._events and self.now < END_S:
            self.now, _, work = heapq.heappop(self._events)
            work()
            if self.now > HEALED_S and self.is_over:
                return

    @property
    def is_over(self) -> bool:
        """Whether every bridge knows that the run is over, and does nothing for it."""
        held = [bridge.holder.runs.get(RUN) for bridge in self.bridges.values()]
        return all(bridge.is_up for bridge in self.bridges.values()) and all(
            one is not None and one.closed is not None and not one.active for one in held
        )

    def _each(self, bridge: Bridge) -> None:
        bridge.tick()
        self.at(self.now + AGAIN_S, lambda: self._each(bridge))

    # The network.

    def carry(self, source: int, target: int, work: Callable[[], None]) -> None:
        """Bring a message: late, twice, or not at all."""
        is_cut = any(begin <= self.now < end and (source in some) != (target in some) for begin, end, some in self.cuts)
        is_bad = self.now < HEALED_S
        if is_cut or (is_bad and self.random.random() < self.loss):
            return
        self.at(self.now + self.random.uniform(0.001, 2.0 if is_bad else 0.01), work)
        if is_bad and self.random.random() < 0.2:
            self.at(self.now + self.random.uniform(0.5, 100.0), work)

    def say(self, bridge: Bridge, sent: SendToken | SendEnd) -> None:
        """A bridge tells another one, which acknowledges it."""
        space = sent.road.space if isinstance(sent, SendToken) else sent.space
        target, life = self.bridges[space], bridge.life

        def acknowledged() -> None:
            if bridge.life != life:
                return
            if isinstance(sent, SendToken):
                bridge.act(partial(bridge.holder.handed_over, sent, self.now))
            else:
                bridge.act(partial(bridge.holder.end_told, sent, self.now))

        def arrive() -> None:
            def take() -> None:
                if isinstance(sent, SendToken):
                    target.do(target.holder.take_token(sent.content, bridge.space, self.now))
                else:
                    target.do(target.holder.take_end(sent.run_id, sent.outcome, sent.reason, bridge.space, self.now))
                self.carry(space, bridge.space, acknowledged)

            self._refusable(target, take)

        self.carry(bridge.space, space, arrive)

    def _refusable(self, target: Bridge, take: Callable[[], None]) -> None:
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
            if self.is_closing:
                if space not in self.ended_told:
                    self._tell_server_end(bridge)
            elif space not in self.accepted:
                self._offer(bridge, encode_part(part))
        if self.has_begun and not self.is_closing:
            self._pause()
        if not self.is_closing and not self.has_begun and len(self.accepted) == len(self.parts):
            self._begin(self.bridges[self.plan.segments[0].space])

    def _offer(self, bridge: Bridge, content: bytes) -> None:
        def take() -> None:
            bridge.holder.take_part(content, self.now)
            self.carry(bridge.space, 0, lambda: self.accepted.add(bridge.space))

        self.carry(0, bridge.space, lambda: self._refusable(bridge, take))

    def _begin(self, bridge: Bridge) -> None:
        def take() -> None:
            bridge.do(bridge.holder.take_token(self.token, 0, self.now))
            self.carry(bridge.space, 0, self._begun)

        self.carry(0, bridge.space, lambda: self._refusable(bridge, take))

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

        self.carry(0, bridge.space, lambda: self._refusable(bridge, take))

    def _tell_server_end(self, bridge: Bridge) -> None:
        def take() -> None:
            bridge.do(bridge.holder.take_end(RUN, "aborted", "the server ended", 0, self.now))
            self.carry(bridge.space, 0, lambda: self.ended_told.add(bridge.space))

        self.carry(0, bridge.space, lambda: self._refusable(bridge, take))


def fails_by(seed: int) -> Callable[[str, int], bool]:
    """Which attempts fail: the same ones however a run is done."""
    return lambda step, tries: zlib.crc32(f"{seed}/{step}/{tries}".encode()) % 100 < 12


def orchestrated(scenario: Scenario, seed: int) -> tuple[RunOutcome, dict[str, float]]:
    """How the same run ends where one engine does all of it, and what its tasks gave."""
    events: list[tuple[float, int, Callable[[], None]]] = []
    order, now = count(), 0.0

    def later(after_s: float, work: Callable[[], None]) -> None:
        heapq.heappush(events, (now + after_s, next(order), work))

    engine = Engine(Robots(fails_by(seed)), lambda: now, later)
    run = engine.runs[RUN] = Run.create(RUN, scenario, {}, lambda _fact: None, by="x", now=0.0)
    engine.take(RUN, run.poll(_unknown, 0.0))
    while run.state.outcome is None:
        if not events:
            now += 0.5
            engine.poll()
            continue
        now, _, work = heapq.heappop(events)
        work()
        engine.poll()
    results = {task: float(given["out"]) for task, given in run.state.results.items()}
    return run.state.outcome, results
