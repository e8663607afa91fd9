"""Runs that bridges carry, as the server sees them: it gives each bridge its part, begins, and follows.

    offering  each bridge is asked to take its part --all have-------------> beginning
              one refuses, or does not answer in time ---------------------> closing, as failed: nothing has begun
    beginning the first bridge is asked to take the token --it has---------> following
              not in time, or the server has ended: it may have begun -----> asking
    asking    what each bridge knows of the run --one has begun------------> following
              the first one has had no token, or none knows anything ------> closing, as aborted
    following pages of each bridge's facts; one says that the run is over, and there are no more facts --> ended
              an operator pauses it, or has it go on: each bridge is told until it has acknowledged
              a bridge is silent, and an operator says that it is off --> adopting
              an operator aborts it ---------------------------------------> closing
    adopting  the bridges that are left get their parts anew, with the next epoch; then the heir --all have--> following
              one of them is silent too, and an operator says that it is off --> adopting, without both
              one does not take it, and says that the run is over -----------> following
    closing   each bridge is told the end --all have acknowledged----------> ended
              one is silent, and an operator says that it is off: it is told when it answers

A run that was following when the server ended is followed by the next one; of one that was offering or beginning, the
bridges are asked. A bridge that is away keeps the run from ending here, and is named; the run itself goes on without
the server. One that has left fleet.yaml cannot be asked: the run is followed, and ends, without it.
"""

from __future__ import annotations

import secrets
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from ua_fleet.carrying import Split, encode_part, parts_of, split
from ua_fleet.carrying.held import LOST
from ua_fleet.carrying.token import Token, encode_token
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline, ScenarioError, ScenarioInvalid, StorageUnavailable, UaFleetError
from ua_fleet.operation.log import Log, MistakeLog
from ua_fleet.operation.runs.adopting import Adopting
from ua_fleet.operation.runs.carried_adoption import Adoptions, plan_view
from ua_fleet.operation.runs.carried_begun import Beginning, beginning_of, has_begun, has_not_begun, why_not_begun
from ua_fleet.operation.runs.carried_questions import BridgesAnswered, CarriedQuestions, is_good
from ua_fleet.operation.runs.carried_state import AskedBridge, BridgeNames, CarriedPhase, FollowedRun
from ua_fleet.operation.runs.followed_facts import FollowedFacts
from ua_fleet.operation.runs.library import Checked, parameters_of
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.operation.runs.run_commands import new_run_id
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.orchestrator import BridgesFollowed, BridgeTold
from ua_fleet.pubsub.carry_action import CARRY, CARRY_ID, Word, carry_topic
from ua_fleet.pubsub.events import ActionReceived, DataReceived, SourceSilent, SubscriberEvent
from ua_fleet.pubsub.run_data import RUN_DATA_HOLDS, RUN_DATA_ID, RUN_DATA_TYPES
from ua_fleet.scenario import Scenario
from ua_fleet.scenario.effects import TaskWaits
from ua_fleet.scenario.facts import (
    AdoptionTold,
    OutsideTold,
    RunAdopted,
    RunCarried,
    RunClosing,
    RunCreated,
    RunEnded,
    RunOutcome,
    RunPaused,
    RunResumed,
    StandInTold,
    StepStarted,
    decode_fact,
)
from ua_fleet.scenario.parameters import checked_parameters
from ua_fleet.skill.executions import EXECUTION_ID_BYTES, OutcomeKind, RequestOutcome, unpack
from ua_fleet.values import StatusCode
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

__all__ = ["INSTANCE", "CarriedRuns"]

INSTANCE: Final = "carried"
"""Second part of the RequestorId with which bridges are asked."""
OFFER_S: Final = 10.0
"""So long all bridges have for their parts, and then the first one for the token."""
ANSWER_S: Final = 2.0
AGAIN_S: Final = 0.2
"""A bridge that has not answered is asked again after so long."""
FOLLOW_S: Final = 5.0
"""A bridge that tells nothing of a run is asked what has become of it after so long."""
HEARD_FOLLOW_S: Final = 30.0
"""The same for one whose DataSet of runs is heard, which tells of news."""
CLOSING_S: Final = 0.5
"""The same for one that cannot hand over a token, and at the end, when no robot says anything."""
NEWS_S: Final = 0.1
"""One that tells of news is asked so long after that: it may hand over the token meanwhile."""
ORDER_S: Final = 5.0
"""So long facts wait for those of bridges that have not answered yet, which may have happened before."""
MOST_NAMED: Final = 5
"""Bridges that the reason of an end names."""
MOST_TEXT: Final = 60
"""Characters of what each of them says."""
MOST_REASON: Final = 600
"""Characters of the reason that bridges are told: whatever they are, a bridge can read them."""
MOST_JSON_BYTES: Final = 1_000_000
"""Of one page, decompressed."""
HEIR_WAITS: Final = "it goes on once all others know which bridge is off"
_PAGE_WORDS: Final = frozenset({"facts", "last", "more", "told", "active", "waits", "closed"})
"""What a page has at least; other versions have others."""
_OF_SEGMENTS: Final = (RunCreated, RunPaused, RunResumed, RunClosing, RunEnded, OutsideTold, StandInTold)
"""Facts of a segment that say nothing of the run: the server notes its own."""
_PAUSED_IN: Final = (CarriedPhase.OFFERING, CarriedPhase.BEGINNING, CarriedPhase.FOLLOWING)
_OUTCOMES: Final = {"done": RunOutcome.DONE, "failed": RunOutcome.FAILED, "aborted": RunOutcome.ABORTED}
_ANSWERS: Final = {has_token: BridgeTold("answers", has_token, "") for has_token in (False, True)}
"""How nearly all bridges stand: one object for all of them, since they are compared at each poll."""


class CarriedRuns:
    """The carried runs of one server. `clock` is monotonic, `wall_s` the wall clock, both in seconds."""

    def __init__(
        self,
        config: FleetConfig,
        service: ScenarioService,
        commands: Callable[..., SkillCommands],
        *,
        reserve: Callable[[str, str], None],
        sooner: Callable[[], None],
        clock: Callable[[], float],
        wall_s: Callable[[], float],
        mistakes: MistakeLog,
        log: Log,
        new_id: Callable[[float], str] = new_run_id,
        follow_s: float = FOLLOW_S,
    ) -> None:
        """Go on with those of the journal; `service` has read it.

        Args:
            config: the fleet's.
            service: shows and journals runs, and knows robots and scenarios.
            commands: makes the requestor, given `instance`, `told` and `most_remembered`.
            reserve: told which robot has no other tasks from now on, and why; with an empty text: that it may.
            sooner: called when the next deadline may have come nearer.
            clock: monotonic seconds.
            wall_s: wall time.
            mistakes: counts what has cost a run its turn.
            log: gets the lines.
            new_id: makes the id of a run that begins at a time.
            follow_s: after so long a bridge whose robots say nothing new is asked what has become of a run.
        """
        self._config, self._service, self._reserve, self._sooner = config, service, reserve, sooner
        self._new_id, self._follow_s = new_id, follow_s
        self._clock, self._wall_s, self._mistakes, self._log = clock, wall_s, mistakes, log
        self._names = BridgeNames({bridge.space: name for name, bridge in config.bridges.items()})
        self._asked: dict[bytes, Callable[[RequestOutcome], None]] = {}
        self._commands = commands(instance=INSTANCE, told=self._told, most_remembered=1000)
        self._adoptions = Adoptions(config, service, clock=clock, wall_s=wall_s, log=log)
        self._questions = CarriedQuestions(self._names, self._ask, service.show_told)
        self._runs: dict[str, FollowedRun] = {}
        for record in service.carried:
            run = self._runs[record.run_id] = FollowedRun(
                record.run_id,
                _robots(service.check_text(record.text).scenario),
                CarriedPhase.FOLLOWING,
                {space: AskedBridge(answered_at=clock()) for space in record.state.carried if space in self._names},
            )
            facts = service.facts_of(record.run_id)
            run.known = FollowedFacts(facts)
            if any(isinstance(fact, RunPaused) for fact in facts):
                self._pause(run, "the server", is_paused=record.state.paused)
            run.adopting = self._adoptions.again(record.run_id, facts)
            if run.adopting is not None:
                self._enter(run, CarriedPhase.ADOPTING, 0.0)
            closing = record.state.closing
            if closing is not None:
                self._close(run, closing.outcome.value, closing.reason, is_noted=True)
            elif "" not in record.state.started:
                run.first = next((fact.first for fact in facts if isinstance(fact, RunCarried)), 0)
                self._enter(run, CarriedPhase.ASKING, 0.0)
            removed = [space for space in record.state.carried if space not in self._names]
            run.late = {space: AskedBridge() for space in (*record.state.untold, *removed)}
            self._hold(run)
        self._late = {record.run_id: _late_run(record, self._names) for record in service.untold}
        """Runs that have ended without bridges that were off."""

    # People.

    def check(self, name_or_text: str) -> tuple[Checked, Split]:
        """A scenario with its problems; where it has none, whether it can be carried and why not."""
        checked = self._service.check(name_or_text)
        if checked.problems:
            return checked, Split(None, ())
        return checked, split(checked.scenario, plan_view(self._config, self._service))

    def start(self, scenario: Scenario, names: Sequence[str], values: Sequence[str], by: str) -> str:
        """Start a run of a valid scenario that bridges carry; its id. Whether it begins is seen in its state.

        Raises:
            ScenarioInvalid: it cannot be carried, or a parameter does not fit.
            ScenarioError: too many runs are under way, or a robot has tasks in another run.
            StorageUnavailable: it cannot be written down, and there is no run.
        """
        self._service.check_room(len(self._runs))
        plan, problems = split(scenario, plan_view(self._config, self._service))
        if plan is None:
            raise ScenarioInvalid([str(problem) for problem in problems])
        robots = _robots(scenario)
        for robot in sorted(robots):
            if users := self._service.users_of(robot):
                raise ScenarioError(f"{robot} has tasks in the run {users[0]}; wait for its end, or abort it")
        parameters = checked_parameters(scenario, parameters_of(scenario, names, values))
        now = self._wall_s()
        run_id = self._new_id(now)
        parts = parts_of(
            plan, run_id, scenario.name, parameters, by, adopt_after_s=self._config.scenarios.adopt_after_s
        )
        plan_hash = next(iter(parts.values())).plan_hash
        run = FollowedRun(run_id, robots, CarriedPhase.OFFERING, {space: AskedBridge() for space in plan.spaces})
        for asked in run.bridges.values():
            asked.answered_at = self._clock()
        run.parts = {space: encode_part(part) for space, part in parts.items()}
        run.first = plan.segments[0].space
        run.token = encode_token(Token(run_id, plan_hash, 1, 0, 0), ())
        run.until = self._clock() + OFFER_S
        created = RunCreated(now, run_id, scenario.text, parameters, by)
        content = [run.parts[space].hex() for space in plan.spaces]
        carried = RunCarried(now, plan.spaces, plan_hash.hex(), content, run.first)
        self._service.note_now(run_id, [created, carried])
        self._runs[run_id] = run
        self._hold(run)
        self._log.info("carried run started", run_id=run_id, scenario=scenario.name, by=by)
        self._step(run, self._clock())
        return run_id

    def has(self, run_id: str) -> bool:
        """Whether a run is under way that bridges carry."""
        return run_id in self._runs

    def abort(self, run_id: str, reason: str, by: str) -> None:
        """End a run; every bridge is told until it has acknowledged. Raises StorageUnavailable, and does not then."""
        run = self._runs[run_id]
        reason = " ".join(reason.split())[:200] or f"aborted by {by}"
        if run.phase is not CarriedPhase.CLOSING:
            self._close(run, "aborted", reason, by=by)

    def pause(self, run_id: str, by: str) -> None:
        """Have all bridges begin no further task of a run; each is told until it has acknowledged.

        Those of a run that is being offered, or that the first one has not said to have begun, are told after that.

        Raises:
            ScenarioError: nobody knows whether the run has begun, another bridge goes on with it, or it is to end.
            StorageUnavailable: it cannot be written down, and no bridge is told.
        """
        self._want_pause(run_id, by, is_paused=True)

    def resume(self, run_id: str, by: str) -> None:
        """Have them go on; raises as `pause` does."""
        self._want_pause(run_id, by, is_paused=False)

    def _want_pause(self, run_id: str, by: str, *, is_paused: bool) -> None:
        run = self._runs[run_id]
        if run.phase not in _PAUSED_IN or run.closed is not None:
            raise ScenarioError(f"run {run_id} is {run.phase.value}, and can be paused only while it is under way")
        if run.is_paused != is_paused:
            now = self._wall_s()
            self._service.note_now(run_id, [RunPaused(now, by) if is_paused else RunResumed(now, by)])
            self._pause(run, by, is_paused=is_paused)
            self._sooner()

    def _pause(self, run: FollowedRun, by: str, *, is_paused: bool) -> None:
        run.is_paused, run.paused_by = is_paused, by
        for asked in run.bridges.values():
            asked.has_pause, asked.next_at = False, 0.0

    def adopt(self, run_id: str, bridge: str, done: Sequence[str], by: str) -> str:
        """A person says that a bridge is off, and what its robots have done: another one goes on; its name.

        Where the run is to end it does so without the bridge, and nobody goes on; the bridge is told when it answers.

        Raises:
            ScenarioError: the bridge has answered a moment ago, or no other one can go on.
            StorageUnavailable: it cannot be written down, or something that was fetched; nothing has changed then.
        """
        run = self._runs[run_id]
        if run.needs_nobody:
            self._end_without(run, bridge, by)
            return ""
        fetched, run.fetched = sorted(run.fetched, key=lambda fact: fact.at), []
        # What is not in the journal yet the heir would not know, and have done once more.
        self._service.note(run_id, fetched, must_be_written=True)
        adopting = self._adoptions.begin(run, bridge, done, by)
        said = adopting.said
        self._service.note_now(run_id, [said])  # no bridge may know what the next server does not
        run.adopting = adopting
        self._log.warning("a bridge of a carried run is left out", run_id=run_id, bridge=bridge, by=by)
        for known in (run.bridges, run.late):
            known.pop(said.space, None)
        self._enter(run, CarriedPhase.ADOPTING, 0.0)
        self._sooner()
        return self._names[said.heir]

    def _end_without(self, run: FollowedRun, bridge: str, by: str) -> None:
        space = self._adoptions.silent(run, bridge)
        self._service.note_now(run.run_id, [RunAdopted(self._wall_s(), space, 0, (), by)])
        self._log.warning("a carried run ends without a bridge", run_id=run.run_id, bridge=bridge, by=by)
        run.late[space] = run.bridges.pop(space)
        self._sooner()

    def answer(self, run_id: str, step: str, answer: str, by: str, said: BridgesAnswered) -> None:
        """Hand on to all bridges what an operator says of a task: the one that has asked takes it."""
        self._questions.answer(run_id, self._runs[run_id].bridges, step, answer, by, said)

    def confirm(self, run_id: str, decision_id: str, robot: str, by: str, said: BridgesAnswered) -> None:
        """Hand on likewise who takes a task over."""
        self._questions.confirm(run_id, self._runs[run_id].bridges, decision_id, robot, by, said)

    def _hold(self, run: FollowedRun) -> None:
        for robot in run.robots:
            self._reserve(robot, f"is reserved for the run {run.run_id}, which bridges carry")

    # What comes.

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Learn of an Action, where it is one of these."""
        if announcement.data_set_writer_id == CARRY_ID and announcement.publisher_id in self._names:
            self._commands.announced(announcement)

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        self._commands.receive(event, now)

    def follow(self, event: SubscriberEvent) -> None:
        """Take what a bridge tells of a run: it is asked for what is new there."""
        topic = getattr(event, "topic", None)
        if topic is None or topic.id != RUN_DATA_ID:
            return
        if isinstance(event, SourceSilent):
            for run in self._runs.values():
                if (asked := run.bridges.get(topic.space)) is not None:
                    asked.is_heard = False
        elif isinstance(event, DataReceived) and event.message.types == RUN_DATA_TYPES:
            self._look(topic.space, event.message.values)

    def _look(self, space: int, values: Sequence[Any]) -> None:
        run = self._runs.get(values[0] or "")
        asked = None if run is None else run.bridges.get(space)
        if run is None or asked is None:
            return
        asked.is_heard, asked.has_token = True, bool(values[RUN_DATA_HOLDS])
        self._show_waits(run)
        if run.phase is CarriedPhase.FOLLOWING and asked.has_news(values):
            asked.told_meanwhile = asked.is_asked
            asked.next_at = min(asked.next_at, self._clock() + NEWS_S)
            self._sooner()

    def _told(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        if (told := self._asked.pop(execution_id, None)) is not None:
            with self._mistakes.guard("carried runs"):  # the outcomes of other questions come after it
                told(outcome)

    # Time.

    def poll(self, now: float) -> None:
        """Do what is due."""
        self._commands.poll(now)
        for run in list(self._runs.values()):
            with self._mistakes.guard("carried runs", run_id=run.run_id):
                self._step(run, now)
        for run in list(self._late.values()):
            with self._mistakes.guard("carried runs", run_id=run.run_id):
                self._tell_late(run, now)

    def _tell_late(self, run: FollowedRun, now: float) -> None:
        """Tell bridges that were off how the run has ended, once they answer."""
        missing = {space: asked for space, asked in run.bridges.items() if not asked.is_done}
        if not missing:
            del self._late[run.run_id]
        elif now >= run.until:
            run.until = now + self._follow_s
            for space, asked in missing.items():
                if not asked.is_asked:
                    self._ask_for(run, space, asked, now)

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next, or None."""
        # One that is being asked is asked nothing else until it has answered, or has not in time.
        bridges = [asked for run in self._runs.values() for asked in run.bridges.values() if not asked.is_asked]
        deadlines = [asked.next_at for asked in bridges] + [run.until for run in self._late.values()]
        if (due := self._commands.next_deadline()) is not None:
            deadlines.append(due)
        return max(now, min(deadlines)) if deadlines else None

    def _step(self, run: FollowedRun, now: float) -> None:
        """Ask each bridge for what it is to be asked for in this phase, and see whether that is over."""
        with suppress(StorageUnavailable):  # it is tried again, and until then the phase goes on
            self._end_phase(run, now)
        for space, asked in run.bridges.items():
            if not asked.is_asked and now >= asked.next_at:
                self._ask_for(run, space, asked, now)
        self._show_waits(run)

    def _show_fetched(self, run: FollowedRun) -> None:
        """Write down and show what was fetched, in the order in which it happened."""
        is_late = self._clock() >= run.fetched_at + ORDER_S
        if run.fetched and (is_late or all(asked.is_caught_up or asked.is_complete for asked in run.bridges.values())):
            run.fetched.sort(key=lambda fact: fact.at)
            self._service.note(run.run_id, run.fetched)
            run.fetched = []
            if past := run.known.forget():
                with suppress(StorageUnavailable):  # they stay in the file then
                    self._service.forget_facts(run.run_id, past)
        if run.decided and not run.fetched:  # after the facts that have led to them
            decided, run.decided = run.decided, []
            self._questions.take(run.run_id, decided)

    def _end_phase(self, run: FollowedRun, now: float) -> None:
        self._show_fetched(run)
        is_late = now >= run.until
        missing = [space for space, asked in run.bridges.items() if not asked.is_done]
        match run.phase:
            case CarriedPhase.OFFERING if not missing:
                self._enter(run, CarriedPhase.BEGINNING, now + OFFER_S)
            case CarriedPhase.OFFERING if is_late:
                said = [f"{self._names[space]}: {run.bridges[space].problem[:MOST_TEXT]}" for space in missing]
                more = len(said) - MOST_NAMED
                why = "; ".join([*said[:MOST_NAMED], *([f"and {more} more"] if more > 0 else [])])
                self._close(run, "failed", f"nothing was begun, since not every bridge has its part: {why}")
            case CarriedPhase.BEGINNING if run.bridges[run.first].is_done:
                self._service.note(run.run_id, [StepStarted(self._wall_s(), "")])
                self._enter(run, CarriedPhase.FOLLOWING, 0.0)
            case CarriedPhase.BEGINNING if is_late:
                run.first_said = f"; {self._names[run.first]} was to take the token: {run.bridges[run.first].problem}"
                self._enter(run, CarriedPhase.ASKING, 0.0)
            case CarriedPhase.ASKING:
                self._end_asking(run)
            case CarriedPhase.ADOPTING if run.closed is not None:  # before it was known that a bridge is off
                self._enter(run, CarriedPhase.FOLLOWING, 0.0)
            case CarriedPhase.ADOPTING if not missing:
                self._log.info("a carried run goes on without one of its bridges", run_id=run.run_id)
                self._service.note(run.run_id, [AdoptionTold(self._wall_s())])
                self._enter(run, CarriedPhase.FOLLOWING, 0.0)
            case CarriedPhase.FOLLOWING if run.closed is not None and all(a.is_complete for a in run.bridges.values()):
                self._end(run)
            case CarriedPhase.CLOSING if not missing:
                self._end(run)
            case _:
                pass

    def _end_asking(self, run: FollowedRun) -> None:
        """Follow a run that has begun, as any bridge proves, and close one that has not; else it waits for the word."""
        said = {space: asked.beginning for space, asked in run.bridges.items()}
        if has_begun(said.values()):
            self._service.note(run.run_id, [StepStarted(self._wall_s(), "")])
            self._enter(run, CarriedPhase.FOLLOWING, 0.0)
        elif has_not_begun(said, run.first, [*run.bridges, *run.late]):
            reason = f"{why_not_begun(said, run.first, self._names)}{run.first_said}"
            self._close(run, "aborted", reason[:MOST_REASON])

    def _enter(self, run: FollowedRun, phase: CarriedPhase, until: float) -> None:
        run.phase, run.until = phase, until
        for asked in run.bridges.values():
            asked.is_done, asked.has_refused, asked.next_at = False, False, 0.0
            asked.problem = "" if phase is CarriedPhase.FOLLOWING else "it has not answered yet"

    def _ask_for(self, run: FollowedRun, space: int, asked: AskedBridge, now: float) -> None:
        asked.next_at = now + self._follow_after_s(asked)
        match run.phase:
            case CarriedPhase.OFFERING if not asked.is_done:
                word, content = Word.PART, run.parts[space]
            case CarriedPhase.BEGINNING if space == run.first and not asked.is_done:
                word, content = Word.TOKEN, run.token
            case CarriedPhase.ADOPTING if run.adopting and asked.may_take and (said := run.adopting.told_to(space)):
                word, content = Word.ADOPT, said
            case CarriedPhase.CLOSING if not asked.is_done:
                _, outcome, reason = run.closed or (0.0, "aborted", "")
                word, content = Word.END, encode_words(run=run.run_id, outcome=outcome, reason=reason[:MOST_REASON])
            case CarriedPhase.FOLLOWING if _is_pause_owed(run, asked):
                word, content = Word.PAUSE, encode_words(run=run.run_id, paused=run.is_paused, by=run.paused_by)
            case CarriedPhase.FOLLOWING | CarriedPhase.CLOSING | CarriedPhase.ASKING | CarriedPhase.ADOPTING:
                # Also one that knows of an adoption, or cannot be told yet: the run may be over there.
                word, content = Word.FETCH, encode_words(run=run.run_id, after=asked.last)
            case _:
                return
        phase, adopting, is_paused = run.phase, run.adopting, run.is_paused
        if (waited := _why_untold(run, space)) and not asked.is_away:
            asked.problem = waited

        def told(outcome: RequestOutcome) -> None:
            if word is Word.PAUSE and is_good(outcome):
                asked.has_pause = is_paused == run.is_paused
            self._answered(run, (phase, adopting), space, word, outcome)
            if waited and not _why_untold(run, space):
                asked.next_at = 0.0

        asked.told_meanwhile, asked.is_asked = False, self._ask(space, word, content, told)
        if not asked.is_asked:
            asked.is_away, asked.problem, asked.next_at = True, "it is not heard", now + AGAIN_S

    def _ask(self, space: int, word: Word, content: bytes, told: Callable[[RequestOutcome], None]) -> bool:
        """Ask a bridge; whether it could be."""
        execution_id = secrets.token_bytes(EXECUTION_ID_BYTES)
        topic, name = carry_topic(space, self._config.fleet.namespace_index), self._names[space]
        self._asked[execution_id] = told
        try:
            arguments: dict[str, Any] = {"Word": int(word), "Content": content}
            self._commands.request(topic, name, CARRY, arguments, ANSWER_S, execution_id)
        except RobotOffline:
            del self._asked[execution_id]
            return False
        except UaFleetError as error:
            del self._asked[execution_id]
            self._log.warning("a bridge cannot be asked for a carried run", bridge=name, reason=str(error))
            return False
        return True

    def _follow_after_s(self, asked: AskedBridge) -> float:
        adopt_s = self._config.scenarios.adopt_after_s
        heard_s = min(HEARD_FOLLOW_S, adopt_s / 2) if adopt_s else HEARD_FOLLOW_S
        return self._follow_s * max(1.0, heard_s / FOLLOW_S) if asked.is_heard else self._follow_s

    def _answered(
        self,
        run: FollowedRun,
        asked_in: tuple[CarriedPhase, Adopting | None],
        space: int,
        word: Word,
        outcome: RequestOutcome,
    ) -> None:
        asked, report, (phase, adopting) = run.bridges.get(space, run.late.get(space)), outcome.report, asked_in
        if asked is None or not (run.run_id in self._runs or run.run_id in self._late):
            return  # it was left out meanwhile
        asked.is_away = outcome.kind in (OutcomeKind.UNKNOWN, OutcomeKind.TIMED_OUT)
        if not asked.is_away:
            asked.answered_at = self._clock()
        # Else another bridge was left out as well since, or the run was aborted: the end is still to be told.
        is_now = phase is run.phase and adopting is run.adopting
        has_time = word is Word.FETCH and is_now
        asked.is_asked, asked.next_at = False, self._clock() + (self._follow_after_s(asked) if has_time else 0.0)
        asked.has_refused = word is Word.ADOPT and is_now and outcome.kind is OutcomeKind.REFUSED
        if is_good(outcome):
            asked.problem = ""
            if word is Word.FETCH:
                self._take_page(run, space, asked, report.result)
                if _is_pause_owed(run, asked):  # a person has said so while it was asked
                    asked.next_at = 0.0
                elif asked.told_meanwhile:  # of what this page may lack, and will not say it again
                    asked.next_at = min(asked.next_at, self._clock() + NEWS_S)
            elif word is Word.ADOPT and run.adopting is not None:
                if is_now:
                    run.adopting.take(space, report.result)
                    asked.is_done = True
                    run.bridges[run.adopting.said.heir].next_at = 0.0  # it may be the last one now
            elif phase is run.phase:
                asked.is_done = True
        else:
            asked.problem = report.message or "it does not answer"
            if word is Word.FETCH and outcome.kind is OutcomeKind.REFUSED and report.status == StatusCode.BAD_NOT_FOUND:
                asked.beginning = Beginning.UNKNOWN
                if run.closed is not None:  # it has forgotten the run, or its folder is another one: it does nothing
                    asked.is_complete, asked.problem = True, ""
            asked.next_at = self._clock() + AGAIN_S
            if outcome.kind is OutcomeKind.REFUSED and phase is run.phase is CarriedPhase.OFFERING:
                run.until = self._clock()  # what was refused once is refused again
        self._sooner()

    def _take_page(self, run: FollowedRun, space: int, asked: AskedBridge, result: bytes) -> None:
        """The facts of one bridge, as they happened there."""
        (packed,) = unpack(result)
        words = decode_words(zlib.decompressobj().decompress(packed.value, MOST_JSON_BYTES), most=MOST_JSON_BYTES)
        if not words.keys() >= _PAGE_WORDS:
            asked.problem = "it has another version of ua-fleet: update it, or abort the run"
            return
        if run.phase is CarriedPhase.ASKING:
            asked.beginning = beginning_of(words)
        for line in words["facts"]:
            fact = decode_fact(line)
            is_ours = not isinstance(fact, _OF_SEGMENTS) and getattr(fact, "step", "x").partition("@")[0] != ""
            if is_ours and run.known.take(fact):
                run.fetched_at = run.fetched_at if run.fetched else self._clock()
                run.fetched.append(fact)
        run.decided += words.get("decisions", ())
        asked.last, has_all = int(words["last"]), not words["more"]
        asked.told = int(words["told"]) if has_all else asked.told
        asked.is_caught_up = asked.is_caught_up or has_all
        # One that does not know yet that the run is over may have had a token since, and begun something.
        asked.is_complete = has_all and not words["active"] and words["closed"] is not None
        asked.has_token = bool(words["holds"])  # of several runs of a bridge its DataSet repeats one alone
        asked.problem = _why_untold(run, space) or str(words["waits"])
        if asked.problem or words["closed"] is not None:
            asked.next_at = self._clock() + CLOSING_S
        # That one has waited too long says less than how another one has ended the run.
        if words["closed"] is not None and (run.closed is None or run.closed[1] == LOST):
            at, outcome, reason = words["closed"]
            run.closed = (float(at), str(outcome), str(reason))
        if run.closed is not None:  # the others know it by now, or soon
            for each in run.bridges.values():
                each.next_at = min(each.next_at, self._clock() + CLOSING_S)
        if not has_all:
            asked.next_at = 0.0

    # The end.

    def _close(self, run: FollowedRun, outcome: str, reason: str, *, by: str = "", is_noted: bool = False) -> None:
        now = self._wall_s()
        if not is_noted:
            self._service.note_now(run.run_id, [RunClosing(now, _OUTCOMES[outcome], reason, by)])
        run.closed = (now, outcome, reason)
        self._enter(run, CarriedPhase.CLOSING, 0.0)
        self._sooner()

    def _end(self, run: FollowedRun) -> None:
        at, outcome, reason = run.closed or (self._wall_s(), "aborted", "")
        ended = _OUTCOMES.get(outcome, RunOutcome.FAILED)
        said = reason if outcome in _OUTCOMES else f"the run is {outcome}: {reason}"
        removed = self._removed(run)
        if run.late:
            lost = [fact.space for fact in removed]
            off = [space for space in run.late if space not in lost]
            why_off = "off, as people have said, and told when there"
            why_lost = "not in fleet.yaml any more, and told when it is again"
            for spaces, why in ((off, why_off), (lost, why_lost)):
                if names := " and ".join([self._names[space] for space in spaces]):
                    said = f"{said and f'{said}; '}{names} did not know it: {why}"
            there = {space: asked for space, asked in run.late.items() if space in self._names}
            late = replace(run, bridges=there, phase=CarriedPhase.CLOSING, until=self._clock() + self._follow_s)
            self._late[run.run_id] = late
        self._questions.end(run.run_id)
        fetched = sorted(run.fetched, key=lambda fact: fact.at)  # they may wait for those of a bridge that never came
        self._service.note(run.run_id, [*fetched, *removed, RunEnded(at, ended, said)])
        del self._runs[run.run_id]
        for robot in run.robots:
            self._reserve(robot, "")
        self._log.info("carried run ended", run_id=run.run_id, outcome=outcome, reason=reason)

    def _removed(self, run: FollowedRun) -> list[RunAdopted]:
        """That a run ends without bridges which fleet.yaml has lost: one that is there again is told at a start."""
        if not (removed := [space for space in run.late if space not in self._names]):
            return []
        facts = self._service.facts_of(run.run_id)
        noted = {fact.space for fact in facts if isinstance(fact, RunAdopted) and not fact.heir}
        return [RunAdopted(self._wall_s(), space, 0, (), "the server") for space in removed if space not in noted]

    def _show_waits(self, run: FollowedRun) -> None:
        """Name the bridges that do not answer, and what they cannot hand over, while there are some."""
        said = [
            f"{self._names[space]}: {asked.problem}{self._offer(run, space)}"
            for space, asked in run.bridges.items()
            if asked.problem
        ]
        removed = self._adoptions.removed(run)
        said += [f"{self._names[space]}: {self._adoptions.why_removed(run, space)}" for space in removed]
        said += [
            f"{self._names[space]}: it is not in fleet.yaml"
            for space in run.late
            if space not in self._names and space not in removed
        ]
        if run.phase not in (CarriedPhase.OFFERING, CarriedPhase.BEGINNING):
            text = "; ".join(said)
            if text != run.shown and run.run_id in self._runs:
                run.shown = text
                self._service.show_waiting(run.run_id, TaskWaits("", "bridges", "", "", text))
        told = {space: self._bridge_told(run, space) for space in (*run.bridges, *removed)}
        if told != run.bridges_shown and run.run_id in self._runs:
            run.bridges_shown = told
            self._service.show_told(BridgesFollowed(run.run_id, told))

    def _offer(self, run: FollowedRun, space: int) -> str:
        """What a person can do about a bridge that does not answer; empty while there is nothing."""
        if run.phase is not CarriedPhase.ASKING or run.bridges[space].beginning is not Beginning.UNSAID:
            return self._adoptions.offer(run, space)
        name, abort = self._names[space], f"ua-fleet scenario abort {run.run_id}"
        return f"; whether the run has begun is not known: start {name}, or abort it: {abort}"

    def _bridge_told(self, run: FollowedRun, space: int) -> BridgeTold:
        asked, state = run.bridges.get(space), "answers"
        if asked is not None and not asked.is_away and not asked.problem:
            return _ANSWERS[asked.has_token]
        if asked is None or asked.is_away:
            state = "silent" if self._adoptions.can_leave_out(run, space) else "away"
        if asked is None:
            return BridgeTold(state, False, "it is not in fleet.yaml any more")
        return BridgeTold(state, asked.has_token, asked.problem)


def _is_pause_owed(run: FollowedRun, asked: AskedBridge) -> bool:
    """Whether a bridge has still to be told that the run is paused, or goes on."""
    return run.phase is CarriedPhase.FOLLOWING and not asked.has_pause


def _why_untold(run: FollowedRun, space: int) -> str:
    """Why a bridge is not told now which other one is off; empty where it is, or nothing is to be told."""
    if run.phase is not CarriedPhase.ADOPTING or run.adopting is None:
        return ""
    if problem := run.adopting.problems.get(space):
        return f"{problem}; the run cannot go on, abort it: ua-fleet scenario abort {run.run_id}"
    return "" if run.adopting.may_be_told(space) else HEIR_WAITS


def _late_run(record: RunRecord, names: BridgeNames) -> FollowedRun:
    """A run of the journal that has ended without some bridges: those of fleet.yaml are told when they answer."""
    state, closing = record.state, record.state.closing
    ended = RunOutcome.ABORTED if state.outcome is None else state.outcome
    reason = state.reason if closing is None else closing.reason  # the first one names bridges that are off as well
    bridges = {space: AskedBridge() for space in state.untold if space in names}
    closed = (record.ended or 0.0, ended.value, reason)
    return FollowedRun(record.run_id, frozenset(), CarriedPhase.CLOSING, bridges, closed=closed)


def _robots(scenario: Scenario) -> frozenset[str]:
    """The robots that tasks name."""
    return frozenset([task.robot for task in scenario.tasks() if task.robot is not None])
