"""The words of carried runs in one bridge: others tell the holder, and it tells the engine or others.

    Action -> holder (journal) -> engine -> facts (journal) -> pages for the server
    end of a segment -> holder (journal) -> Action to another bridge, until it is acknowledged

The engine is made when the first part comes, and hears nothing while there is no run.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import structlog

from ua_fleet.bridge.carry import CarryFactory, CarryGround
from ua_fleet.bridge.immediate import ImmediateActions
from ua_fleet.carrier.engine import INSTANCE, SegmentEnd, SegmentEngine
from ua_fleet.carrier.outbox import Outbox
from ua_fleet.carrier.pages import FactPages
from ua_fleet.carrier.watching import RunWatch
from ua_fleet.carrying import Begin, Gone, Holder, Pause, RunRefused, Tell, segment_of, segment_run
from ua_fleet.carrying.adoption import decode_adoption, encode_filled
from ua_fleet.carrying.effects import Carry, Stop, fact_before
from ua_fleet.carrying.held import CLOCK_STEP_S, HeldRun
from ua_fleet.carrying.holder import ADOPTED, LOST
from ua_fleet.carrying.segment_scenario import segment_scenario
from ua_fleet.carrying.token import SegmentRound
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import LocalWireError, ScenarioError, StorageUnavailable
from ua_fleet.operation.runs.decision_words import encode_decision
from ua_fleet.orchestrator import DecisionChanged
from ua_fleet.pubsub.carry_action import CARRY, CARRY_ID, CARRY_REQUEST, CARRY_RESPONSE, Word, carry_topic
from ua_fleet.pubsub.events import ActionReceived, AnnouncementReceived, SubscriberEvent
from ua_fleet.scenario.facts import Fact, RunClosing, RunEnded, RunOutcome, decode_fact
from ua_fleet.skill.executions import RequestorName, pack
from ua_fleet.storage.boot import BootNote
from ua_fleet.storage.carried_records import CARRIED_FILE, CarriedRecords
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.values import TICKS_PER_SECOND, UNIX_EPOCH_TICKS, BuiltinType, StatusCode
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.security import read_security

__all__ = ["carrier_of"]

REQUESTS_AT_ONCE: Final = 64
MOST_DECISIONS: Final = 8
"""Of one run, about who takes a task over, that the server is told of: the last ones."""
COMPACTED_EACH: Final = 250
"""After so many facts of a run, its records are compacted."""
KEPT_SEGMENTS: Final = 500
"""Of rounds that are over: the last ones of a run, which the server may not have yet. It shows as many tasks."""
_BYTES: Final = (int(BuiltinType.BYTE_STRING),)


class RunUnknown(ScenarioError):
    """A bridge is asked about a run that it does not carry."""

    ua_status = StatusCode.BAD_NOT_FOUND
    remedy = "The bridge has forgotten it, or its state folder is another one."


def carrier_of(
    config: FleetConfig, name: str, state_dir: Path, records: Callable[[], CarriedRecords] | None = None
) -> CarryFactory:
    """What makes who carries runs in a bridge.

    Args:
        config: the fleet's.
        name: of the bridge.
        state_dir: of the bridge; its file of carried runs is made when the first part comes.
        records: makes that file, where it is another one.
    """
    return partial(_Carrier, config, name, state_dir, records or partial(CarriedRecords, state_dir))


class _Carrier:
    """See `bridge.carry.CarrySide`."""

    def __init__(
        self,
        config: FleetConfig,
        name: str,
        state_dir: Path,
        records: Callable[[], CarriedRecords],
        ground: CarryGround,
    ) -> None:
        self._config, self._name, self._state_dir, self._ground = config, name, state_dir, ground
        self._make_records = records
        self._bridge = config.bridges[name]
        self._space, ns = self._bridge.space, config.fleet.namespace_index
        self._topic = carry_topic(self._space, ns)
        self._log: Any = structlog.get_logger("ua_fleet.carrier", bridge=name)
        self._records: CarriedRecords | None = None
        self._boot = BootNote(state_dir)
        self._holder = Holder(self._space, self._note)
        self._offset_s = (ground.wall_ticks() - UNIX_EPOCH_TICKS) / TICKS_PER_SECOND - ground.loop.time()
        """Of the wall clock."""
        self._engine: SegmentEngine | None = None
        self._pages = FactPages(self._open)
        spaces = {bridge.space: each for each, bridge in config.bridges.items()}
        self._decisions: dict[str, dict[str, DecisionChanged]] = {}
        """The last ones of each run about who takes a task over, by their ids."""
        self._written = Counter[str]()
        """Facts of each run that were written since the start."""
        self._lost = 0
        """Runs that were forgotten since the start, and that the server had not fetched."""
        self._owed_before = False
        """Whether the process before had told robots to stop that have not said that they have."""
        self._outbox = Outbox(self._space, ns, spaces, ground, self._log)
        self._watch = RunWatch(self._space, ns, name, ground)
        self._actions = ImmediateActions(
            self._space,
            ground.publisher,
            ground.counters,
            self._asked,
            about="carried runs",
            requestors=self._bridge.requestors,
            spaces=self._bridge.requestors,
            must_be_verified=ground.must_be_verified,
            requests_at_once=REQUESTS_AT_ONCE,
            send=self._send,
            send_to=ground.send_to,
            wall_ticks=ground.wall_ticks,
            caught=ground.mistakes.caught,
            answers=ground.answers,
            limits=replace(ground.limits, most_repeats=0),  # who has not heard it asks again
        )
        ground.actions.reserved_for = self._holder.reserved_for

    @property
    def problem(self) -> str:
        """What keeps runs from going on here; empty where nothing does."""
        engine = "" if self._engine is None else self._engine.problem
        storage = self._holder.problem and f"carried runs cannot be recorded, and stand still: {self._holder.problem}"
        return storage or engine or self._outbox.waits()

    def _send(self, datagram: bytes) -> None:
        self._ground.send(datagram)

    # The beginning.

    def begin(self, now: float) -> None:
        """Announce the Action, and go on where the journal ends."""
        if is_there := (self._state_dir / CARRIED_FILE).exists():
            self._open()  # what its robots were asked for is under way, whether or not runs can go on here
        try:
            self._actions.offer(self._topic, CARRY, self._name, CARRY_REQUEST, CARRY_RESPONSE, now)
            if set(self._bridge.requestors) - {SERVER_SPACE, self._space}:  # it is to take part in runs with others
                self._watch.announce()
        except LocalWireError as error:
            self._log.error("this bridge carries no runs", reason=str(error))
            return
        if is_there:
            self._restore(now)

    def _open(self) -> CarriedRecords:
        """The file, made where it is not there yet; raises StorageUnavailable."""
        if self._records is None:
            is_new = not (self._state_dir / CARRIED_FILE).exists()
            self._records = self._make_records()
            if is_new:
                self._boot.write()
            self._ground.actions.record_own_in(self._records.executions, self._ground.loop.time())
        return self._records

    def _restore(self, now: float) -> None:
        records = self._open()
        self._holder = Holder(self._space, self._note, records.facts())
        self._ground.actions.reserved_for = self._holder.reserved_for
        self._leave_out(records)
        self._forget()
        last = records.last_number()
        for run_id, held in self._holder.runs.items():
            # Of one that is over nothing more is told than the number of its facts.
            segments = records.segments_of(run_id) if held.closed is None or held.active else ()
            self._watch.restored(run_id, (fact for one in segments for fact in records.runs.facts(one)), last)
        effects = self._holder.again(self._wall_s(), is_other_boot=self._boot.is_other())
        self._boot.write()
        self._owed_before = bool(records.runs.halts())
        for run_id, held in self._holder.runs.items():
            asks_all = run_id in self._holder.in_doubt
            self._want_others(held.part.spaces if asks_all else held.part.tells())
        if self._holder.in_doubt:
            waiting = ", ".join(sorted(self._holder.in_doubt))
            self._log.warning("this bridge was away, and asks whether its tokens were adopted", runs=waiting)
            self._ground.loop.call_soon(self._send_out)
        elif self._is_busy or self._owed_before:
            self._open_engine(effects, now)

    def _leave_out(self, records: CarriedRecords) -> None:
        """Say which runs cannot be read, and have the engine begin nothing of them; what is recorded stays."""
        for run_id, why in self._holder.unreadable.items():
            self._log.error("a carried run of the journal cannot be read, and is left out", run_id=run_id, reason=why)
            closing = RunClosing(self._wall_s(), RunOutcome.ABORTED, why)
            for segment in records.segments_of(run_id):
                if not any(isinstance(fact, RunClosing | RunEnded) for fact in records.runs.facts(segment)):
                    records.runs.write([(segment, closing)])

    def _open_engine(self, effects: Iterable[Carry], now: float) -> None:
        """Go on with the segments of the journal, which have to know before what is to be stopped or paused."""
        effects, records = list(effects), self._open()
        changed = [one for one in effects if isinstance(one, Stop | Pause)]
        segments = [(segment_run(one.run_id, place), one) for one in changed for place in one.places]
        begun = [(run_id, fact_before(one, self._wall_s())) for run_id, one in segments if records.runs.facts(run_id)]
        if begun:
            records.runs.write(begun)
        for run_id, fact in begun:
            self._happened(run_id, fact)
        engine = self._engine_now(now)
        self._do(effects)
        for ended in engine.ended:
            self._segment_ended(ended)

    def _engine_now(self, now: float) -> SegmentEngine:
        """The engine, which is made when there is something to do."""
        if self._engine is None:
            self._engine = SegmentEngine(
                self._config,
                self._space,
                self._ground,
                self._open(),
                happened=self._happened,
                decided=self._decided,
                ended=self._segment_ended,
                returned=self._bridge_returned,
            )
            self._engine.begin(now)
        return self._engine

    def _note(self, fact: Any) -> None:
        self._open().note(fact)
        self._written[fact.run_id] += 1
        if self._written[fact.run_id] % COMPACTED_EACH == 0:
            self._ground.loop.call_soon(self._compact, fact.run_id)

    def _compact(self, run_id: str) -> None:
        """Have the file, and what is made of it at the next start, not grow with the rounds of a run."""
        held = self._holder.runs.get(run_id)
        if held is not None:
            with self._ground.mistakes.guard("carried runs", run_id=run_id), suppress(StorageUnavailable):
                self._open().compact(held, KEPT_SEGMENTS)

    def _wall_s(self) -> float:
        wall_s = (self._ground.wall_ticks() - UNIX_EPOCH_TICKS) / TICKS_PER_SECOND
        before_s, self._offset_s = self._offset_s, wall_s - self._ground.loop.time()
        if abs(step_s := self._offset_s - before_s) > CLOCK_STEP_S:
            self._holder.clock_set(step_s)
        return wall_s

    # What comes.

    def takes(self, message: ActionMessage) -> bool:
        """Whether an Action is for this."""
        if message.is_request:
            return message.data_set_writer_id == CARRY_ID
        name = RequestorName.parse(message.requestor_id)
        return name is not None and name.space == self._space

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take it."""
        if event.message.is_request:
            self._actions.receive(event, now)
        elif event.message.requestor_id == f"{self._space}.{INSTANCE}":
            if self._engine is not None:
                self._engine.receive(event, now)
        else:
            self._outbox.receive(event, now)
        self._ground.sooner()

    def hear(self, event: SubscriberEvent, now: float) -> None:
        """Take what is heard of other spaces."""
        if isinstance(event, AnnouncementReceived) and isinstance(event.announcement, ActionMetaDataAnnouncement):
            self._outbox.announced(event.announcement)
        if self._engine is not None and self._is_busy:
            self._engine.hear(event, now)

    def own(self, datagram: bytes) -> None:
        """Take what this bridge says to all."""
        if self._engine is not None and (self._is_busy or read_security(datagram).is_discovery):
            self._engine.own(datagram)

    @property
    def _is_busy(self) -> bool:
        """Whether the engine has something to do: a run, or a robot that has not said that it has stopped."""
        return self._has_open_runs or (self._engine is not None and self._engine.owes_halts)

    @property
    def _has_open_runs(self) -> bool:
        return any(held.closed is None or held.active for held in self._holder.runs.values())

    def _asked(self, _writer_id: int, values: list[Any], now: float) -> bytes:
        """Do what a word says; raises UaFleetError where it is refused."""
        word, content = values[0], bytes(values[1] or b"")
        sender, wall_s = self._actions.asked_by, self._wall_s()
        answer = b""
        match word:
            case Word.PART if sender == 0:
                self._take_part(content, now)
            case Word.TOKEN:
                # The token, what its first task is asked with, and that its robot is to begin. The server is answered
                # before that: one that is killed without the answer has to ask all bridges whether the run has begun.
                with self._one_sync(is_turn=sender != 0):
                    self._do(self._holder.take_token(content, sender, wall_s))
            case Word.END:
                words = decode_words(content)
                run_id, outcome, reason = (str(words.get(name, "")) for name in ("run", "outcome", "reason"))
                self._do(self._holder.take_end(run_id, outcome, reason, sender, wall_s))
            case Word.FETCH if sender == 0:
                answer = self._page(decode_words(content))
            case Word.ANSWER if sender == 0:
                self._answer(decode_words(content))
            case Word.PAUSE if sender == 0:
                words = decode_words(content)
                run_id, by = str(words.get("run", "")), str(words.get("by", ""))
                self._do(self._holder.take_pause(run_id, bool(words.get("paused")), by, wall_s))
            case Word.ADOPT if sender == 0:
                answer = self._take_adoption(content, wall_s)
            case Word.EPOCH:
                held = self._held(str(decode_words(content).get("run", "")))
                answer = encode_words(**self._holder.asked_epoch(held, sender))
            case Word.CONFIRM if sender == 0:
                answer = self._confirm(decode_words(content)).encode()
            case _:
                raise RunUnknown(
                    f"space {sender} sent request {word} of carried runs, which this bridge does not take from it"
                )
        return pack(_BYTES, (answer,))

    def _one_sync(self, *, is_turn: bool) -> AbstractContextManager[None]:
        if self._engine is not None and is_turn:
            return self._engine.turn()
        return nullcontext() if self._records is None else self._records.one_sync()

    def _take_part(self, content: bytes, now: float) -> None:
        if self._holder.in_doubt:
            raise RunRefused("this bridge was away, and waits to hear whether tokens of its runs were adopted")
        was_idle = not self._is_busy
        self._holder.take_part(content, self._wall_s())
        if self._engine is not None and was_idle:
            self._engine.catch_up(now)
        self._ground.loop.call_soon(self._make_ready)  # it takes a while, and the part is acknowledged at once

    def _make_ready(self) -> None:
        """Have the engine, and know the other bridges, before the first token comes."""
        with self._ground.mistakes.guard("carried runs"):
            self._engine_now(self._ground.loop.time())
            for held in self._holder.runs.values():
                self._want_others(held.part.tells())

    def _want_others(self, spaces: Iterable[int]) -> None:
        for space in spaces:
            if space != self._space:
                self._outbox.want(space)

    def _answer(self, words: dict[str, Any]) -> None:
        run_id, step, answer, by = (str(words.get(name, "")) for name in ("run", "step", "answer", "by"))
        held = self._holder.runs.get(run_id)
        for place in () if held is None else held.active:
            segment = segment_run(run_id, place)
            if self._engine is not None and self._engine.has_step(segment, step):
                self._engine.answer(segment, step, answer, by)
                return
        raise RunUnknown(f"step {step!r} of run {run_id!r} asks no question here")

    def _held(self, run_id: str) -> HeldRun:
        if (held := self._holder.runs.get(run_id)) is None:
            raise RunUnknown(f"run {run_id[:80]!r} is not known here")
        return held

    def _take_adoption(self, content: bytes, wall_s: float) -> bytes:
        """Take it, and say which tokens are here: they prove what the bridge that is off has done."""
        self._do(self._holder.take_adoption(content, wall_s))
        part = decode_adoption(content).part
        self._want_others(part.tells())
        return encode_words(filled=encode_filled(self._held(part.run_id).filled()))

    def _confirm(self, words: dict[str, Any]) -> str:
        run_id, decision, robot, by = (str(words.get(name, "")) for name in ("run", "decision", "robot", "by"))
        if self._engine is None or decision not in self._decisions.get(run_id, {}):
            raise RunUnknown(f"there is no decision {decision!r} of run {run_id!r} here")
        return self._engine.confirm(decision, robot, by).value

    def _page(self, words: dict[str, Any]) -> bytes:
        """The facts that the server has not, as far as one answer has room, and how the run is here."""
        run_id, after = str(words.get("run", "")), int(words.get("after", 0))
        held = self._held(run_id)
        page = self._pages.after(run_id, max(0, after))
        closed = held.closed
        told = {
            "facts": page.lines,
            "last": page.last,
            "more": not page.is_last,
            "told": self._watch.facts_of(run_id),
            "active": [str(place) for place in held.active],
            "holds": [str(place) for place in held.holds],
            "waits": self._outbox.waits(run_id) or held.stale,
            "closed": None if closed is None else [closed.at, closed.outcome, closed.reason],
            "decisions": [encode_decision(changed) for changed in self._decisions.get(run_id, {}).values()],
        }
        if page.is_last:
            with suppress(StorageUnavailable):  # `problem` says so; the server is answered
                self._holder.fetched(run_id, self._wall_s())
            self._ground.loop.call_soon(self._forget)
        return zlib.compress(encode_words(**told))

    # What follows.

    def _do(self, effects: Iterable[Carry]) -> None:
        """Have the engine do what follows from facts that are written down; where it cannot write, somewhat later."""
        try:
            self._carry_out(list(effects), self._ground.loop.time())
        except StorageUnavailable as error:
            self._holder.put_off(str(error), self._wall_s())
        if self._engine is None:
            self._ground.loop.call_soon(self._send_out)
        else:
            self._engine.after_turn(self._send_out)

    def _carry_out(self, effects: list[Carry], now: float) -> None:
        if self._engine is None and effects:
            self._open_engine(effects, now)
            return
        for effect in effects:
            engine = self._engine_now(now)
            if isinstance(effect, Begin):
                self._begin(engine, effect)
            elif isinstance(effect, Tell):
                with self._ground.mistakes.guard("carried runs", run_id=effect.run_id):
                    segment = segment_run(effect.run_id, effect.place)
                    engine.tell_segment(segment, effect.task, effect.results, is_done=effect.is_done)
            elif isinstance(effect, Gone):
                with self._ground.mistakes.guard("carried runs", run_id=effect.run_id):
                    engine.lose_bridge(effect.space, effect.by)
            else:
                self._tell_engine(engine, effect)

    def _begin(self, engine: SegmentEngine, effect: Begin) -> None:
        part = self._holder.runs[effect.run_id].part
        values = dict(part.parameters) | effect.values
        scenario = segment_scenario(part.scenario, effect.segment.body, effect.rounds, values, effect.outside)
        facts = [decode_fact(line) for line in effect.facts]
        run_id = segment_run(effect.run_id, SegmentRound(effect.segment.number, effect.rounds))
        engine.begin_segment(run_id, scenario, part.by, facts, effect.stand_ins)

    def _tell_engine(self, engine: SegmentEngine, effect: Stop | Pause) -> None:
        for place in effect.places:
            run_id = segment_run(effect.run_id, place)
            with self._ground.mistakes.guard("carried runs", run_id=effect.run_id):
                if isinstance(effect, Pause):
                    engine.pause_segment(run_id, effect.by, is_paused=effect.is_paused)
                else:
                    engine.stop_segment(run_id, effect.reason)

    def _happened(self, segment: str, fact: Fact) -> None:
        run_id = segment.rpartition(".")[0]
        self._watch.happened(run_id, fact)

    def _decided(self, changed: DecisionChanged) -> None:
        """Keep it for the server, where it is of a segment."""
        known = self._decisions.setdefault(changed.run_id.rpartition(".")[0], {})
        known.pop(changed.event.decision_id, None)
        known[changed.event.decision_id] = changed
        while len(known) > MOST_DECISIONS:
            del known[next(iter(known))]
        self._watch.decided(changed.run_id.rpartition(".")[0], changed)

    def _bridge_returned(self, space: int) -> None:
        self._holder.bridge_returned(space, self._wall_s())

    def _segment_ended(self, end: SegmentEnd) -> None:
        run_id, place = segment_of(end.run_id)
        try:
            effects = self._holder.segment_ended(
                run_id,
                place,
                self._wall_s(),
                failed=end.failed,
                results=end.results,
                ends=end.ends,
                reason=end.reason,
                way=end.way,
            )
        except StorageUnavailable:
            self._ground.loop.call_later(1.0, self._segment_ended, end)
            return
        if self._engine is not None:
            self._engine.forget([end.run_id])  # it is not begun again
        self._do(effects)

    # Time.

    def _send_out(self) -> None:
        """Say what others have not acknowledged."""
        with self._ground.mistakes.guard("carried runs"):
            try:
                if self._records is not None:
                    self._records.settle()  # after a sync that failed, nothing that follows from it may leave
                self._outbox.say(list(self._holder.to_send()), self._told)
            except StorageUnavailable as error:
                self._outbox.put_off(str(error))
            self._watch.look(self._holder)
        self._forget()  # it follows each end of a run
        self._ground.sooner()

    def _told(self, note: Callable[[Holder, float], list[Carry] | None]) -> None:
        """Another bridge has acknowledged something, or answered."""
        before = {run_id for run_id, held in self._holder.runs.items() if held.closed is None}
        try:
            effects = note(self._holder, self._wall_s())
        except StorageUnavailable:
            return  # `problem` says so, and the holder goes over it again
        if effects:
            self._do(effects)
        for run_id in sorted(before):
            closed = self._holder.runs[run_id].closed
            if closed is not None and closed.outcome in (ADOPTED, LOST):
                self._log.warning(
                    "what this bridge had of a carried run is parked", run_id=run_id, reason=closed.reason
                )
        self._forget()
        self._watch.look(self._holder)

    def _forget(self) -> None:
        """Forget runs that nobody asks for any more; where the disk fails, with the next one."""
        if self._engine is not None and not self._has_open_runs:
            self._engine.forget_failures()
        gone = self._holder.forgettable()
        if not gone:
            return
        lost = [run_id for run_id in gone if not self._holder.is_fetched(run_id)]
        with self._ground.mistakes.guard("carried runs"), suppress(StorageUnavailable):
            records = self._open()
            with records.one_sync():
                for run_id in gone:
                    self._forget_run(records, run_id)
            if lost:
                self._lost += len(lost)
                self._log.warning(
                    "carried runs are forgotten that the server has not fetched",
                    oldest=lost[0],
                    runs=len(lost),
                    since_the_start=self._lost,
                )

    def _forget_run(self, records: CarriedRecords, run_id: str) -> None:
        segments = records.segments_of(run_id)
        records.forget(run_id)
        if self._engine is not None:
            self._engine.forget(segments)
            self._engine.forget_run(run_id)
        self._holder.forget(run_id)
        self._written.pop(run_id, None)
        self._decisions.pop(run_id, None)
        self._watch.forget(run_id)

    def poll(self, now: float) -> None:
        """Do what is due."""
        if self._owed_before and self._engine is None and not self._holder.in_doubt:
            self._make_ready()
        self._actions.poll(now)
        self._outbox.poll(now)
        if self._engine is not None and self._is_busy:
            self._engine.poll(now)
        if (due := self._holder.next_deadline()) is not None and self._wall_s() >= due:
            self._do(self._holder.poll(self._wall_s()))
        if self._outbox.is_due(now):
            self._send_out()

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        deadlines = [self._actions.next_deadline(), self._outbox.next_deadline()]
        if self._engine is not None and self._is_busy:
            deadlines.append(self._engine.next_deadline())
        if (due := self._holder.next_deadline()) is not None:
            deadlines.append(self._ground.loop.time() + max(1.0, due - self._wall_s()))
        return min((due for due in deadlines if due is not None), default=None)
