"""The engine of scenarios in a bridge: it runs segments there as the server runs whole scenarios.

    what the bridge says ---> local subscriber ---> fleet state ---> service ---> requests ---> the bridge's Actions
    what it hears of others --------------------->                                         ---> other bridges

The bridge is asked as the server would ask it, by Actions, with both journals; but the messages stay in the process.
What is heard is taken in only while there is a run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import structlog

from ua_fleet.bridge.carry import CarryGround
from ua_fleet.carrier.concerned import fleet_around
from ua_fleet.carrying.fragments import FragmentInvalid
from ua_fleet.carrying.segment_scenario import decode_scenario, way_taken
from ua_fleet.config.nodes import fleet_model, max_ages_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import publisher_ids
from ua_fleet.counters import Counters
from ua_fleet.errors import ConfigError, StorageUnavailable
from ua_fleet.fleet.changes import CapacitiesChanged, Change, ValueChanged
from ua_fleet.fleet.state import FleetState
from ua_fleet.operation.runs.library import Checked
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.orchestrator import DecisionChanged, Fault, FaultChange, FaultChanged, Output, RunChanged
from ua_fleet.pubsub.events import (
    ActionReceived,
    AnnouncementReceived,
    DataReceived,
    ProbeDue,
    ProbeReceived,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.resilience import Confirmation
from ua_fleet.scenario import Scenario, Value
from ua_fleet.scenario.consequences import NOT_HALTED, SKILL
from ua_fleet.scenario.facts import Fact, Replaced, RobotReturned, RunCreated, RunEnded, RunOutcome, StandInTold
from ua_fleet.scenario.model import Sequence
from ua_fleet.scenario.stand_ins import StandIns, take_stand_in, told_stand_ins
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.storage.carried_records import CarriedRecords
from ua_fleet.topics import SERVER_SPACE, LoopVerdict, Side, Topic
from ua_fleet.values import TICKS_PER_SECOND, UNIX_EPOCH_TICKS
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.security import read_security

__all__ = ["SegmentEnd", "SegmentEngine"]

INSTANCE: Final = "carry"
"""Second part of the RequestorId with which robots are asked."""
TICK_S: Final = 1.0
_LOST: Final = (SourceSilent, SourceStale, SourceRefused)


class SegmentEnd(NamedTuple):
    """How a segment has ended."""

    run_id: str
    """Of the segment."""
    failed: str
    """Why; empty: it is done."""
    results: dict[str, Value]
    ends: str
    """How all of the run ends, where an `end` step says so."""
    reason: str
    way: bool = True
    """What it has decided, where it ends with a decision."""


class _SegmentService(ScenarioService):
    """Runs segments, whose texts are no scenarios of a folder."""

    def check_text(self, text: str) -> Checked:
        """A segment after a restart: its steps were held against the fleet by the server."""
        try:
            return Checked(decode_scenario(text), ())
        except FragmentInvalid as error:
            return Checked(Scenario("", Sequence("", 0, ())), (ConfigError(str(error)),))

    @property
    def owes_halts(self) -> bool:
        """Whether robots were told to stop that have not said that they have."""
        return self._orchestrator.owes_halts

    def has(self, run_id: str) -> bool:
        """Whether a segment is under way."""
        return run_id in self._orchestrator.runs

    def adopt_segment(self, run_id: str, scenario: Scenario, by: str, facts: Iterable[Fact]) -> None:
        """Begin a segment of which something is known: what was done of it at another bridge, or who stands in."""
        self.take_news()
        now, values = self._wall_s(), {one.name: one.default for one in scenario.parameters}
        given = {name: value for name, value in values.items() if value is not None}
        known: list[Fact] = [RunCreated(now, run_id, scenario.text, given, by), *facts]
        self.note(run_id, known)
        self._do(self._orchestrator.restore_all([(run_id, scenario, known)], now))

    def begin_segment(self, run_id: str, scenario: Scenario, by: str) -> None:
        """Begin a segment; what its first tasks are asked with is written down before they are asked."""
        self.take_news()
        now, values = self._wall_s(), {one.name: one.default for one in scenario.parameters}
        given = {name: value for name, value in values.items() if value is not None}
        outputs = self._orchestrator.start(run_id, scenario, given, by=by, now=now)
        created = self._carrier.first_unwritten(run_id)
        assert created is not None, "a run begins with a fact"
        self._do([RunChanged(run_id, created), *outputs])

    def tell_segment(self, run_id: str, task: str, results: Mapping[str, Value], *, is_done: bool) -> None:
        """Have a segment know what became of a task of another branch."""
        self._do(self._orchestrator.outside_told(run_id, task, self._wall_s(), is_done=is_done, results=results))

    def tell_stand_in(self, run_id: str, told: StandInTold) -> None:
        """Have a segment know who stands in for a robot, as another one of the run has chosen."""
        self._do(self._orchestrator.stand_in_told(run_id, told.failed, told.robot, told.capacity, self._wall_s()))


class SegmentEngine:
    """Runs the segments of one bridge. All times that go in are of the loop's clock."""

    def __init__(
        self,
        config: FleetConfig,
        space: int,
        ground: CarryGround,
        records: CarriedRecords,
        *,
        happened: Callable[[str, Fact], None],
        decided: Callable[[DecisionChanged], None],
        ended: Callable[[SegmentEnd], None],
        returned: Callable[[int], None],
    ) -> None:
        """Make an engine, which goes on where the journal ends.

        Args:
            config: the fleet's.
            space: of the bridge.
            ground: the bridge.
            records: of the bridge.
            happened: told of each fact of a segment once it is written down.
            decided: told of decisions about who takes a task over, while they are open and when they are over.
            ended: told of the end of a segment, at the end of a turn of the loop.
            returned: told of the space of a bridge that is heard, and that a person has said to be off.
        """
        self._space, self._ground, self._records = space, ground, records
        self._happened, self._decided, self._ended, self._returned = happened, decided, ended, returned
        self._log: Any = structlog.get_logger("ua_fleet.carrier")
        config = fleet_around(config, space)
        timing, model = config.pubsub.timing(), fleet_model(config)
        self._local = Subscriber(
            SERVER_SPACE,
            timing,
            Counters(),
            Codec(),
            max_ages=max_ages_of(config),
            publisher_ids=publisher_ids(config),
        )
        self._inbound = Subscriber(space, timing, Counters(), Codec(), _lets_all_in)
        self._state = FleetState(model, Counters())
        self._state.caught = self._local.caught = ground.mistakes.caught
        self._skills = SkillCommands(
            records.requests,
            send=self._send,
            want=self._want,
            sooner=ground.sooner,
            wall_ticks=ground.wall_ticks,
            must_be_verified=ground.must_be_verified,
            clock=ground.loop.time,
            log=self._log,
            space=space,
            instance=INSTANCE,
            told=self._concluded,
        )
        self._actions = [action for robot in model.robots for action in robot.actions()]
        self._segments: dict[str, RunRecord] = {}
        self._stand_ins: dict[str, StandIns] = {}
        """Of each run, in any of its segments here: one that begins goes by it."""
        self._off: set[int] = set()
        """Spaces of bridges that a person has said are off."""
        self._queue: deque[bytes] = deque()
        """What the bridge has said, and is taken in with the next turn of the loop."""
        self._ends: list[SegmentEnd] | None = None
        """Segments that have ended in this turn, which is synced to the disk once; None between turns."""
        self._to_own: deque[bytes] = deque()
        """What the bridge's own robots are asked at the end of this turn, with the same sync; else in the next one."""
        self._is_in_turn = False
        self._after_turn: list[Callable[[], None]] = []
        self._next_tick = 0.0
        self._service = _SegmentService(
            config,
            model,
            records.runs,
            self._skills,
            folder=Path("/nonexistent"),
            show=self._show,
            forgotten=lambda _run_id: None,
            requested=lambda _key, _execution_id: None,
            sooner=ground.sooner,
            clock=ground.loop.time,
            wall_s=lambda: (ground.wall_ticks() - UNIX_EPOCH_TICKS) / TICKS_PER_SECOND,
            capacities=self._state.capacities,
            mistakes=ground.mistakes,
            log=self._log,
        )
        self.wall_s = self._service.wall_s
        ground.actions.answer_own = self.own

    # The beginning.

    def begin(self, now: float) -> None:
        """Go on where the journal ends, and take in what is known."""
        for record in self._service.restore():
            self._segments[record.run_id] = record
        off = self._service.fault_reports.are_off()
        self._off |= {space for space in self._spaces() if off.intersection(self._robots_of(space))}
        for fact, run_id in self._facts_of_stand_ins():
            take_stand_in(self._stand_ins.setdefault(run_id, {}), fact)
        withdrawn = self._service.must_not_begin()
        self._skills.resume(now, tuple(withdrawn))
        for action in self._actions:
            if action.space == self._space:
                self._skills.want(action)
        self.catch_up(now)
        self._service.go_on()

    def _facts_of_stand_ins(self) -> list[tuple[Fact, str]]:
        """What the journal says of who stands in for robots, in order, each with its run."""
        facts = [(fact, _run_of(one)) for one in self._segments for fact in self._records.runs.facts(one)]
        found = [(fact, run) for fact, run in facts if isinstance(fact, StandInTold | Replaced | RobotReturned)]
        return sorted(found, key=lambda one: one[0].at)

    def catch_up(self, now: float) -> None:
        """Take in what the bridge and all that it has heard have said last: nothing was taken in without a run.

        All of it now: the first decision of the run goes by it.
        """
        for datagram in self._ground.publisher.said_last():
            self._hear(self._local.receive(datagram, now, ("", 0)), now)
        for topic in list(self._ground.subscriber.writers):
            self._hear(self._ground.subscriber.known(topic), now)
        self._service.take_news()

    @property
    def ended(self) -> list[SegmentEnd]:
        """The segments that had ended when the journal was read."""
        return [_end_of(record) for record in self._segments.values() if record.state.outcome is not None]

    @property
    def owes_halts(self) -> bool:
        """Whether a robot was told to stop and has not said that it has: it is told again, and listened to."""
        return self._service.owes_halts

    @property
    def problem(self) -> str:
        """Why segments stand still; empty while they go on."""
        return self._service.problem

    def begin_segment(
        self,
        run_id: str,
        scenario: Scenario,
        by: str,
        facts: Iterable[Fact] = (),
        stand_ins: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
    ) -> None:
        """Begin a segment, unless it was begun before.

        Args:
            run_id: of the segment.
            scenario: its steps.
            by: the person who has started the run.
            facts: of a segment that another bridge had.
            stand_ins: who stands in for robots, where this bridge knows nothing newer.
        """
        record = self._segments.get(run_id)
        if record is not None or self._service.has(run_id):
            if record is not None and record.state.outcome is not None:
                self._tell_end(record)
            return
        known_here = dict(stand_ins) | self._stand_ins.get(_run_of(run_id), {})
        if known := [*told_stand_ins(known_here, self.wall_s()), *facts]:
            self._service.adopt_segment(run_id, scenario, by, known)
        else:
            self._service.begin_segment(run_id, scenario, by)

    def lose_bridge(self, space: int, by: str) -> None:
        """A person says that a bridge is off: its robots have a fault until something is heard of them."""
        self._off.add(space)
        for robot in self._robots_of(space):
            self._service.fault_reports.bridge_is_off(robot, f"its bridge is off, as {by} has said")

    def _spaces(self) -> set[int]:
        return {one.skill_status.space for one in self._service.robots.values() if one.skill_status is not None}

    def _robots_of(self, space: int) -> list[str]:
        robots = self._service.robots.values()
        return [robot.name for robot in robots if robot.skill_status is not None and robot.skill_status.space == space]

    def stop_segment(self, run_id: str, reason: str) -> None:
        """End a segment; what its robots are at is halted."""
        if self._service.has(run_id):
            self._service.runs.abort(run_id, reason, "the end of the run")
        elif (record := self._segments.get(run_id)) is None:  # the process was killed before it had begun
            self._ground.loop.call_soon(self._ended, SegmentEnd(run_id, reason, {}, "", reason))
        elif record.state.outcome is not None:
            self._tell_end(record)

    def pause_segment(self, run_id: str, by: str, *, is_paused: bool) -> None:
        """Begin no further task of a segment, or go on with it."""
        if self._service.has(run_id):
            (self._service.runs.pause if is_paused else self._service.runs.resume)(run_id, by)

    def tell_segment(self, run_id: str, task: str, results: Mapping[str, Value], *, is_done: bool) -> None:
        """Have a segment know what became of a task of another branch."""
        if self._service.has(run_id):
            self._service.tell_segment(run_id, task, results, is_done=is_done)

    def confirm(self, decision_id: str, robot: str, by: str) -> Confirmation:
        """A person chooses who takes a task over; raises ScenarioError."""
        return self._service.decisions.confirm(decision_id, robot, by)

    def answer(self, run_id: str, step: str, answer: str, by: str) -> None:
        """A person says what became of a task of a segment; raises ScenarioError."""
        self._service.runs.answer(run_id, step, answer, by)

    def has_step(self, run_id: str, step: str) -> bool:
        """Whether a segment that is under way has a step of that key, or a task of that name."""
        record = self._segments.get(run_id)
        if record is None or not self._service.has(run_id):
            return False
        return any(step in (key, task.name) for key, task in record.state.tasks.items())

    # What comes.

    def own(self, datagram: bytes) -> None:
        """Take what the bridge says, to all or to this; in the next turn, since it is in the middle of something."""
        if not self._queue:
            self._ground.loop.call_soon(self._take_own)
        self._queue.append(datagram)

    def _take_own(self) -> None:
        if not self._queue:
            return
        now = self._ground.loop.time()
        with self.turn():
            for _ in range(len(self._queue)):
                datagram = self._queue.popleft()
                with self._ground.mistakes.guard("carried runs"):
                    self._hear(self._local.receive(datagram, now, ("", 0)), now, is_own=True)
        if self._queue:
            self._ground.loop.call_soon(self._take_own)
        self._ground.sooner()

    def hear(self, event: SubscriberEvent, now: float) -> None:
        """Take what the bridge has heard of others."""
        if not isinstance(event, SourceUnknown | ProbeDue | ProbeReceived | ActionReceived):
            self._hear([event], now)

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take the response of another bridge."""
        with self.turn():
            self._skills.receive(event, now)

    def _hear(self, events: Iterable[SubscriberEvent], now: float, *, is_own: bool = False) -> None:
        wall = self._ground.wall_ticks()
        for event in events:
            if isinstance(event, SourceUnknown | ProbeDue):
                if event.datagram is not None:
                    self._send(event.datagram)
            elif isinstance(event, ActionReceived):
                self._skills.receive(event._replace(verified=event.verified or is_own), now)
            elif isinstance(event, AnnouncementReceived):
                if isinstance(event.announcement, ActionMetaDataAnnouncement):
                    self._skills.announced(event.announcement)
            else:
                self._take(self._state.apply(event, wall))
                self._follow(event)
        if is_own:
            self._service.take_news()  # a bridge has few robots of its own: the end of a step waits for no others
        self._service.end_batch()

    def _take(self, changes: Iterable[Change]) -> None:
        for change in changes:
            if isinstance(change, ValueChanged):
                self._service.value_changed(change)
            elif isinstance(change, CapacitiesChanged):
                self._service.fleet_changed()

    def _follow(self, event: SubscriberEvent) -> None:
        if isinstance(event, DataReceived):
            if event.topic.space in self._off and self._is_heard(event.topic):
                self._off.discard(event.topic.space)
                self._returned(event.topic.space)
                for robot in self._robots_of(event.topic.space):
                    self._service.fault_reports.bridge_is_back(robot)
            self._service.heard(event)
        elif isinstance(event, SourceReturned):
            self._service.source_returned(event.topic)
        elif isinstance(event, _LOST):
            self._service.source_lost(event.topic)

    def _is_heard(self, topic: Topic) -> bool:
        """Whether data is of now: `catch_up` takes in what was heard last, also of a bridge that is off."""
        writer = self._ground.subscriber.writers.get(topic)
        return writer is None or not (writer.silent or writer.stale)

    # What goes out.

    def _want(self, space: int, data_set_writer_id: int, now: float) -> bool:
        subscriber = self._local if space == self._space else self._ground.subscriber
        return subscriber.want_action(space, data_set_writer_id, now)

    def _send(self, plain: bytes) -> None:
        if read_security(plain).publisher_id == self._space:
            if not (self._to_own or self._is_in_turn):
                self._ground.loop.call_soon(self._ask_own)
            self._to_own.append(plain)
        elif self._is_settled():
            self._ground.send(plain)

    def _is_settled(self) -> bool:
        """Whether all that a message depends on is on the disk now; one that has to stay is lost, as any may be."""
        try:
            self._records.settle()
        except StorageUnavailable:
            return False  # whoever records next says so
        return True

    def _ask_own(self) -> None:
        while self._to_own:
            self._to_bridge(self._to_own.popleft())

    def _to_bridge(self, plain: bytes) -> None:
        now = self._ground.loop.time()
        with self._ground.mistakes.guard("carried runs"):
            for event in self._inbound.receive(plain, now, ("", 0)):
                if isinstance(event, ActionReceived):
                    self._ground.actions.receive_own(event.message, now)
                elif isinstance(event, ProbeReceived):
                    self._ground.core.hear([event], now)
        self._ground.sooner()

    def _concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self._service.concluded(execution_id, outcome)

    # What has happened.

    def _show(self, output: Output) -> None:
        if isinstance(output, DecisionChanged):
            self._decided(output)
        if isinstance(output, FaultChanged) and output.change is FaultChange.RAISED:
            self._say_fault(output.fault)
        if not isinstance(output, RunChanged):
            return
        record = self._segments.get(output.run_id)
        if record is None:
            record = self._segments[output.run_id] = RunRecord(output.run_id)
        record.apply(output.fact)
        self._happened(output.run_id, output.fact)
        self._take_stand_in(output.run_id, output.fact)
        if isinstance(output.fact, RunEnded):
            self._tell_end(record)

    def _say_fault(self, fault: Fault) -> None:
        """The server has no such fault: people read of it here."""
        if fault.source == NOT_HALTED:
            self._log.warning("a robot of a carried run is not known to stand", robot=fault.robot, reason=fault.reason)
        elif fault.source == SKILL:
            self._log.warning(
                "a robot gets no such task before all carried runs here are over",
                robot=fault.robot,
                reason=fault.reason,
            )

    def forget_failures(self) -> None:
        """No run is open: the next one may try again what robots have failed at. Nobody else can end these faults."""
        self._service.fault_reports.forget_failures()

    def _take_stand_in(self, segment: str, fact: Fact) -> None:
        """One segment has chosen who stands in for a robot: the others of the run go by it, and rank nobody anew."""
        run_id = _run_of(segment)
        known = self._stand_ins.setdefault(run_id, {})
        if not take_stand_in(known, fact) or not isinstance(fact, Replaced):
            return
        chosen = told_stand_ins({fact.failed: known.get(fact.failed, {})}, fact.at)
        others = [one for one in self._segments if one != segment and _run_of(one) == run_id and self._service.has(one)]
        for told in chosen:
            for one in others:
                self._service.tell_stand_in(one, told)

    def _tell_end(self, record: RunRecord) -> None:
        if self._ends is None:
            self._ground.loop.call_soon(self._ended, _end_of(record))
        else:
            self._ends.append(_end_of(record))

    def after_turn(self, do: Callable[[], None]) -> None:
        """Do something, once, as soon as the turn is over and synced; outside of one in the next turn of the loop."""
        if not self._is_in_turn:
            self._ground.loop.call_soon(do)
        elif do not in self._after_turn:
            self._after_turn.append(do)

    @contextmanager
    def turn(self) -> Generator[None]:
        """Have what happens within synced once, with the ends of segments and the requests to own robots that follow.

        The bridge settles before a robot is told.
        """
        if self._is_in_turn:
            yield
            return
        ends: list[SegmentEnd] = []
        try:
            with self._records.one_sync():
                self._ends, self._is_in_turn = ends, True
                try:
                    yield
                finally:
                    self._ends = None
                    for end in ends:
                        with self._ground.mistakes.guard("carried runs", run_id=end.run_id):
                            self._ended(end)
                    self._ask_own()
                    self._is_in_turn = False
        finally:
            after, self._after_turn = self._after_turn, []
            for do in after:
                with self._ground.mistakes.guard("carried runs"):
                    do()

    # Time.

    def poll(self, now: float) -> None:
        """Do what is due."""
        with self.turn():
            self._hear(self._local.poll(now), now)
            self._skills.poll(now)
            if now >= self._next_tick:
                self._next_tick = now + TICK_S
                self._take(self._state.tick(self._ground.wall_ticks()))
            self._service.poll()

    def next_deadline(self) -> float:
        """When `poll` is to be called next."""
        deadlines = (self._local.next_deadline(), self._skills.next_deadline(), self._service.next_deadline())
        return min((due for due in deadlines if due is not None), default=self._next_tick)

    def forget(self, run_ids: Iterable[str]) -> None:
        """These segments are not in the journal any more."""
        for run_id in run_ids:
            self._segments.pop(run_id, None)

    def forget_run(self, run_id: str) -> None:
        """A run is not in the journal any more."""
        self._stand_ins.pop(run_id, None)


def _lets_all_in(_side: Side, _origin: int, _space: int, _own_publication: bool) -> LoopVerdict:
    """In place of the loop rule: what is asked here comes from this very process."""
    return LoopVerdict.TO_SPACE


def _run_of(segment: str) -> str:
    return segment.rpartition(".")[0]


def _end_of(record: RunRecord) -> SegmentEnd:
    state = record.state
    closing, reason = state.closing, state.reason
    results = {f"{task}.{name}": value for task, given in state.results.items() for name, value in given.items()}
    if closing is not None and closing.outcome is not RunOutcome.ABORTED:
        return SegmentEnd(record.run_id, "", results, closing.outcome.value, reason)
    if state.outcome is not RunOutcome.DONE:
        return SegmentEnd(record.run_id, reason or "it has failed", results, "", reason)
    return SegmentEnd(record.run_id, "", results, "", reason, way_taken(decode_scenario(record.text), state))
