"""What one bridge has of carried runs: parts, tokens, segments under way, and what is yet to be handed over. Pure.

    part       taken                                             journal, reserve its robots
    segment    waits for slots --all filled--> begun             journal each token before it is acknowledged
               begun --ended--> over                             journal the end before any token of it is sent
               over  --each token acknowledged--> handed over    a token is sent until its target says that it has it
               a slot failed, or WHOLE --> over as failed, without its steps
               paused, or in doubt: none is begun, tokens wait in their slots
    run        the last segment over, an `end`, an abort --> closed --each other bridge acknowledged--> told
               no part, token or end for `lease_s`, and not paused --> lost; its reservations end
               told, and the server has fetched all --> forgotten, but for the last MOST_KEPT

A fact is journaled first, then applied, then what follows is done. All that is done follows from the facts alone, so
that a process that is killed at any moment asks for the same again: `begin` of a segment whose run the engine has
already, a token whose target has it already. Where a fact cannot be written, what follows from those before it is gone
over again likewise: by who says the same again, or by `poll`. A token that comes twice, or late, begins nothing: a
segment is begun once in each round, by the last of its slots. What comes to a mailbox is told to the segments under way
that hear it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from ua_fleet.carrying.adoption import decode_adoption
from ua_fleet.carrying.effects import AskEpoch, Carry, Gone, Pause, Send, SendEnd, SendToken, Stop
from ua_fleet.carrying.facts import (
    BridgeReturned,
    CarryFact,
    EndTold,
    HandedOver,
    PartAdopted,
    PartTaken,
    PauseTold,
    RunClosed,
    RunDoubted,
    SegmentBegun,
    SegmentOver,
    TokenTaken,
)
from ua_fleet.carrying.held import ADOPTED, LOST, HeldRun
from ua_fleet.carrying.part import PartInvalid, decode_part
from ua_fleet.carrying.token import MOST_REASON_BYTES, WHOLE, SegmentRound, TokenInvalid, clipped, decode_token
from ua_fleet.errors import ScenarioError, StorageUnavailable
from ua_fleet.scenario import Value
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.values import StatusCode

__all__ = ["ADOPTED", "LOST", "MOST_RUNS", "HeldRun", "Holder", "RunRefused"]

MOST_RUNS: Final = 100
"""Carried runs that a bridge has at a time."""
MOST_KEPT: Final = 50
"""Those that all know to be over and the server has fetched, and that are still known: its last answer may be lost."""
MOST_UNFETCHED: Final = 200
"""Those that are over and the server or another bridge has not heard of yet. It may never come back."""
AGAIN_S: Final = 1.0
"""After so long `poll` tries again to write what could not be written."""


class RunRefused(ScenarioError):
    """A bridge does not take a part or a token; the message says why."""

    ua_status = StatusCode.BAD_INVALID_STATE
    remedy = "See the state of the run in the server."


class Holder:
    """The carried runs of one bridge. `now` is the wall clock in seconds, since a run outlives a process."""

    def __init__(self, space: int, journal: Callable[[CarryFact], None], facts: Iterable[CarryFact] = ()) -> None:
        """Go on where the journal ends; then `again` says what is to be begun.

        Args:
            space: of the bridge.
            journal: writes a fact; when it returns, the fact is there after a crash. Raises where it cannot.
            facts: what it has.
        """
        self._space, self._journal = space, journal
        self.runs: dict[str, HeldRun] = {}
        self.problem = ""
        """Why a fact of a run could not be written; empty once it was, or nothing is to be written again."""
        self.in_doubt: set[str] = set()
        """Runs whose tokens another bridge may have by now. Nothing is begun here until it is known."""
        self._ended_before: dict[str, RunClosed] = {}
        """Runs that were over before their part came, the oldest first: a part that is late does not begin them."""
        self.unreadable: dict[str, str] = {}
        """Runs of which another version has written, and why that cannot be read: they are left out."""
        for fact in facts:
            if fact.run_id not in self.unreadable:
                self._restore(fact)

    def _restore(self, fact: CarryFact) -> None:
        try:
            self._apply(fact)
        except ScenarioError as error:
            self.unreadable[fact.run_id] = str(error)
            self.runs.pop(fact.run_id, None)

    # What comes from others.

    def take_part(self, content: bytes, now: float) -> None:
        """Take a part; the same one again changes nothing.

        Raises:
            PartInvalid: it cannot be read, or is not of this bridge.
            RunRefused: another one of the run is here, or there are too many runs.
        """
        part = decode_part(content)
        known = self.runs.get(part.run_id)
        if known is not None:
            if known.part.plan_hash != part.plan_hash:
                raise RunRefused(f"run {part.run_id} has another plan here")
            if known.closed is not None:
                raise self._is_over(part.run_id, known.closed)
            return
        if part.run_id in self.unreadable:
            raise RunRefused(f"run {part.run_id} was recorded by another version here, and is left out")
        if (ended := self._ended_before.get(part.run_id)) is not None:
            raise self._is_over(part.run_id, ended)
        if self._space not in part.spaces:
            raise PartInvalid(f"the part of run {part.run_id} is not for space {self._space}")
        if sum(1 for held in self.runs.values() if held.closed is None) >= MOST_RUNS:
            raise RunRefused(f"{MOST_RUNS} runs are carried here, and more may not be")
        self._note(PartTaken(now, part.run_id, content.hex()))

    def take_token(self, content: bytes, sender: int, now: float) -> list[Carry]:
        """Take a token that a bridge has sent, or the server (0) to begin; the same one again changes nothing.

        Raises:
            TokenInvalid: it cannot be read, or contradicts one that is here.
            RunRefused: there is no part for it, the run is over, or it is of another plan or epoch.
        """
        head = decode_token(content)
        held = self.runs.get(head.run_id)
        if held is None:
            raise RunRefused(f"there is no part of run {head.run_id[:80]} here")
        part = held.part
        if head.epoch != part.epoch:
            if head.epoch < part.epoch:
                held.stale = f"space {sender} has sent a token of epoch {head.epoch}, and epoch {part.epoch} counts"
            raise RunRefused(f"the token has epoch {head.epoch}, and run {part.run_id} has {part.epoch} here")
        if head.plan_hash != part.plan_hash:
            raise RunRefused(f"the token is of another plan of run {part.run_id}")
        token = decode_token(content, {number: segment.needs for number, segment in part.segments.items()})
        if sender not in (SERVER_SPACE, *part.spaces):
            raise RunRefused(f"space {sender} is not in run {part.run_id}")
        segment, place = part.segments[token.segment], token.place
        if len(token.rounds) != len(segment.loops):
            raise TokenInvalid(f"segment {place} of run {part.run_id} is within {len(segment.loops)} repetitions")
        known = held.tokens.get((place, token.slot))
        if known is not None:
            if known.epoch == token.epoch and known != token:
                raise TokenInvalid(f"segment {place} of run {part.run_id} has another token there")
            return self._unwritten(held, now)
        if held.closed is not None:
            raise self._is_over(part.run_id, held.closed)
        if held.is_known(place) and not segment.tells:
            return []  # of a round that is over
        self._note(TokenTaken(now, part.run_id, content.hex(), sender))
        return self._heard(held, token.segment) if segment.tells else self._go_on(held, place, now)

    def take_end(self, run_id: str, outcome: str, reason: str, sender: int, now: float) -> list[Carry]:
        """A run is over, as a bridge of it says; or the server, also of one that is not known here.

        Raises:
            RunRefused: who says it is not in the run.
        """
        held = self.runs.get(run_id)
        if held is None:
            if run_id not in self._ended_before and sender == SERVER_SPACE:
                self._note(RunClosed(now, run_id, outcome, reason, sender))
            return []
        if sender not in (SERVER_SPACE, *held.part.spaces):
            raise RunRefused(f"space {sender} is not in run {run_id}")
        if held.closed is None:
            return self._close(held, outcome, reason, sender, now)
        if sender == SERVER_SPACE:
            self.fetched(run_id, now)
        return []

    def take_pause(self, run_id: str, is_paused: bool, by: str, now: float) -> list[Carry]:
        """The server has a run paused, or go on; the same again, or of a run that is over, changes nothing.

        Raises:
            RunRefused: the run is not known here.
        """
        held = self.runs.get(run_id)
        if held is None:
            raise RunRefused(f"there is no part of run {run_id[:80]} here")
        if held.closed is not None:
            return []
        if held.is_paused == is_paused:
            return self._unwritten(held, now)
        self._note(PauseTold(now, run_id, is_paused, by))
        if self.in_doubt:
            return []
        return self._paused(held) if is_paused else self._resumed(held, now)

    def take_adoption(self, content: bytes, now: float) -> list[Carry]:
        """A bridge of the run is off, and its segments are at another one from now on; said again nothing changes.

        Raises:
            PartInvalid: it cannot be read.
            RunRefused: the run is not known here, is over, or has this epoch already with another plan.
        """
        adoption = decode_adoption(content)
        part = adoption.part
        held = self.runs.get(part.run_id)
        if held is None:
            raise RunRefused(f"there is no part of run {part.run_id} here")
        if (part.epoch, part.plan_hash) == (held.part.epoch, held.part.plan_hash):
            return self._unwritten(held, now)
        if held.closed is not None:
            raise self._is_over(part.run_id, held.closed)
        if part.epoch <= held.part.epoch or self._space not in part.spaces:
            raise RunRefused(f"epoch {part.epoch} of run {part.run_id} is not for this bridge, which has another one")
        self._note(PartAdopted(now, part.run_id, content.hex()))
        return self._no_doubt(part.run_id, now) if self.in_doubt else self._again(held, now)

    def asked_epoch(self, held: HeldRun, asking: int) -> dict[str, Any]:
        """What the bridge of a space is told that asks for the epoch of a run: also how it has ended, where it has.

        Raises:
            RunRefused: this bridge was left out of the run itself, and does not know.
        """
        closed = held.closed
        said: dict[str, Any] = {"epoch": held.part.epoch, "left_out": asking not in held.part.spaces}
        if closed is None:
            return {**said, "doubt": True} if held.part.run_id in self.in_doubt else said
        if closed.outcome == ADOPTED:
            raise self._is_over(held.part.run_id, closed)
        return {**said, "outcome": closed.outcome, "reason": clipped(closed.reason, MOST_REASON_BYTES)}

    def told_epoch(
        self,
        sent: AskEpoch,
        epoch: int | None,
        now: float,
        *,
        left_out: bool = False,
        doubt: bool = False,
        outcome: str = "",
        reason: str = "",
    ) -> list[Carry]:
        """Another bridge says which epoch a run has; None: that it does not know the run any more.

        Where that is a later one, this bridge was left out, or its part has not come yet. Then it keeps its tokens, and
        its doubt where it has one, until that has.

        Args:
            sent: what it was asked.
            epoch: what it says.
            now: by the wall clock.
            left_out: whether this bridge has no part of it.
            doubt: whether that bridge was away likewise. It may have been left out with this one: it counts once all
                others have said the same.
            outcome: how the run is over there; empty where it goes on.
            reason: why, then.
        """
        held = self.runs.get(sent.run_id)
        if held is None or held.closed is not None:
            return []
        if epoch is None:
            reason = f"the bridge of space {sent.space} does not know it any more"
            return self._close(held, LOST, reason, sent.space, now)
        if epoch > held.part.epoch and left_out:
            reason = f"its token was adopted: the bridge of space {sent.space} has epoch {epoch} of it"
            return self._close(held, ADOPTED, reason, sent.space, now)
        if outcome:
            return self._close(held, outcome, reason, sent.space, now)
        held.asks.discard(sent.space)
        if doubt and epoch == held.part.epoch:
            held.doubters.add(sent.space)
        is_known = epoch <= held.part.epoch and (not doubt or not self._unasked(held))
        return self._no_doubt(sent.run_id, now) if is_known else []

    def _unasked(self, held: HeldRun) -> list[int]:
        """The bridges that have not said yet which epoch they have."""
        return [space for space in held.part.spaces if space not in (self._space, *held.doubters)]

    def refused(self, sent: SendToken) -> None:
        """A bridge has not taken a token: it is asked whether it was adopted."""
        held = self.runs.get(sent.run_id)
        if held is not None and held.part.adopt_after_s > 0:
            held.asks.add(sent.road.space)

    # What comes from the engine.

    def bridge_returned(self, space: int, now: float) -> None:
        """A bridge is heard that a person has said to be off: the engine is told so no more, also after a restart."""
        for held in list(self.runs.values()):
            if held.closed is None and space in [gone for gone, _ in held.off()]:
                held.unwritten_returned.add(space)
                with suppress(StorageUnavailable):  # `poll` tries it again
                    self._note(BridgeReturned(now, held.part.run_id, space))

    def segment_ended(
        self,
        run_id: str,
        place: SegmentRound,
        now: float,
        *,
        failed: str = "",
        results: dict[str, Value] | None = None,
        ends: str = "",
        reason: str = "",
        way: bool = True,
    ) -> list[Carry]:
        """The engine has ended a segment.

        Args:
            run_id: the run.
            place: the segment, in its round.
            now: by the wall clock.
            failed: why it has failed; empty where it is done.
            results: all that its tasks have given, by `task.result`.
            ends: where an `end` step has ended all of the run: how.
            reason: why, then.
            way: what it has decided, where it ends with a decision.
        """
        held = self.runs.get(run_id)
        if held is None or place not in held.begun:
            return []
        if place in held.over:
            return self._unwritten(held, now)
        values, why = {} if failed else held.values(place) | (results or {}), reason if ends else ""
        over = SegmentOver(now, run_id, place.number, failed, values, ends, place.rounds, way, why)
        if not failed and (unfit := self._unfit(held, place, over)):
            over = replace(over, failed=unfit, results={})
        self._note(over)
        return self._after(held, place, now) if held.closed is None else []

    def again(self, now: float, *, is_other_boot: bool = False) -> list[Carry]:
        """After a restart: what is to be begun, also of what the engine may have already.

        Nothing is while a token may have been adopted: `in_doubt` has the run then, and others are asked.

        Args:
            now: by the wall clock.
            is_other_boot: whether the computer was started anew, so that its clock may not tell how long it was off.
        """
        doubted = [run for run, held in self.runs.items() if held.may_be_adopted(now, is_other_boot=is_other_boot)]
        self.in_doubt = set(doubted)
        for run_id in sorted(self.in_doubt):
            if not self.runs[run_id].is_doubted:  # what comes meanwhile does not say that it was not adopted
                self._note(RunDoubted(now, run_id, True))
        return self._all_again(now)

    def _all_again(self, now: float) -> list[Carry]:
        effects: list[Carry] = []
        for held in list(self.runs.values()) if not self.in_doubt else ():
            with suppress(StorageUnavailable):  # `poll` goes over it again
                effects += self._again(held, now)
        return effects

    def _unwritten(self, held: HeldRun, now: float) -> list[Carry]:
        """What follows from the facts of a run, where one could not be written."""
        if held.again_at is None:
            return []
        if self.in_doubt:  # the end of it has all gone over
            held.again_at, self.problem = None, ""
            return []
        return self._again(held, now)

    def _no_doubt(self, run_id: str, now: float) -> list[Carry]:
        """It is known whether the token of a run was adopted: the last such run lets all go on."""
        if run_id not in self.in_doubt:
            return []
        if self.runs[run_id].closed is None:
            self._note(RunDoubted(now, run_id, False))
        self.in_doubt.discard(run_id)
        return self._all_again(now)

    def _again(self, held: HeldRun, now: float) -> list[Carry]:
        held.again_at, self.problem = None, ""
        if held.closed is not None:
            reason = held.closed.reason or held.closed.outcome
            return [Stop(held.part.run_id, held.active, reason)] if held.active else []
        for space in sorted(held.unwritten_returned):
            self._note(BridgeReturned(now, held.part.run_id, space))
        effects: list[Carry] = [Gone(held.part.run_id, space, by) for space, by in held.off()]
        effects += self._paused(held) if held.is_paused else self._resumed(held, now)
        for place in list(held.over):
            if held.closed is None and place in held.over:
                effects += self._after(held, place, now)
        return effects

    def put_off(self, reason: str, now: float) -> None:
        """The engine cannot write down what it was told: what follows from the facts is gone over again."""
        self.problem = reason
        for held in self.runs.values():
            held.again_at = now + AGAIN_S

    # What is to be sent, and what came of it.

    def to_send(self) -> Iterator[Send]:
        """All that others have not acknowledged yet."""
        for held in self.runs.values():
            closed = held.closed
            if closed is not None:
                reason = clipped(closed.reason, MOST_REASON_BYTES)
                for space in held.untold(self._space):
                    yield SendEnd(held.part.run_id, space, closed.outcome, reason)
                continue
            is_in_doubt = held.part.run_id in self.in_doubt
            asked = self._unasked(held) if is_in_doubt else sorted(held.asks)
            yield from [AskEpoch(held.part.run_id, space, held.part.epoch) for space in asked]
            for place, over in held.over.items() if not is_in_doubt else ():
                for road in held.roads(place, over):
                    if (place, road.segment, road.slot) not in held.handed:
                        yield SendToken(held.part.run_id, place, road, held.token(place, over, road))

    def handed_over(self, sent: SendToken, now: float) -> None:
        """The target of a token has it."""
        held = self.runs.get(sent.run_id)
        source, road = sent.source, sent.road
        if held is not None and (source, road.segment, road.slot) not in held.handed:
            self._note(HandedOver(now, sent.run_id, source.number, road.segment, road.slot, source.rounds))

    def end_told(self, sent: SendEnd, now: float) -> None:
        """A bridge has acknowledged the end of a run."""
        held = self.runs.get(sent.run_id)
        if held is not None and sent.space not in held.told:
            self._note(EndTold(now, sent.run_id, sent.space))

    def fetched(self, run_id: str, now: float) -> None:
        """The server was told all facts of a run that there are; once that is over here, it may be forgotten.

        One that the server asks for again, since another bridge is away, is the last to go; this is not written down.
        """
        held = self.runs.get(run_id)
        if held is None or held.closed is None or held.active:
            return
        if held.fetched_at is None:
            self._note(EndTold(now, run_id, SERVER_SPACE))
        else:
            held.fetched_at = max(held.fetched_at, now)

    # Time, and what others ask.

    def poll(self, now: float) -> list[Carry]:
        """Runs of which nothing has come for their lease are lost: what they have reserved is free."""
        effects: list[Carry] = []
        for held in list(self.runs.values()):
            with suppress(StorageUnavailable):  # it is due again after AGAIN_S
                if held.again_at is not None and now >= held.again_at:
                    effects += self._unwritten(held, now)
                if held.again_at is None and held.may_be_lost and now >= held.heard + held.part.lease_s:
                    reason = f"nothing came of it for {held.part.lease_s:g} s"
                    effects += self._close(held, LOST, reason, self._space, now)
        return effects

    def clock_set(self, step_s: float) -> None:
        """The wall clock was set forward by so much, or back: what is waited for here is as far away as before."""
        for held in self.runs.values():
            held.heard += step_s
            if held.again_at is not None:
                held.again_at += step_s

    def next_deadline(self) -> float | None:
        """When `poll` has something to do, by the wall clock, or None."""
        ends = [held.heard + held.part.lease_s for held in self.runs.values() if held.may_be_lost]
        again = [held.again_at for held in self.runs.values() if held.again_at is not None]
        return min(ends + again, default=None)

    def reserved_for(self, robot: str, asking: int | None = None) -> str:
        """The run that keeps a robot from doing something for a space, or for people; empty where none does.

        The bridges of the run may ask it: one whose own robot has failed may need this one in its place.
        """
        for run_id, held in self.runs.items():
            if held.closed is None and asking not in held.part.spaces and robot in held.part.robots():
                return run_id
        return ""

    def forgettable(self) -> list[str]:
        """The oldest runs that are over: all but the last MOST_KEPT of which everybody knows and the server has all.

        Of those that were over before their part came as many stay, and of the others the last MOST_UNFETCHED: else a
        bridge would keep for ever what nobody asks for.
        """
        before = [(closed.at, run_id) for run_id, closed in self._ended_before.items()]
        settled, others = list[tuple[float, str]](), list[tuple[float, str]]()
        for run_id, held in self.runs.items():
            if held.closed is None or held.active:
                continue
            if held.fetched_at is None or held.untold(self._space):
                others.append((held.closed.at, run_id))
            else:
                settled.append((held.fetched_at, run_id))
        gone = (*_but_the_last(MOST_KEPT, before), *_but_the_last(MOST_KEPT, settled))
        return [*gone, *_but_the_last(MOST_UNFETCHED, others)]

    def is_fetched(self, run_id: str) -> bool:
        """Whether the server needs nothing more of a run that is over here."""
        held = self.runs.get(run_id)
        return held is None or held.fetched_at is not None

    def forget(self, run_id: str) -> None:
        """A run is not in the journal any more."""
        self.runs.pop(run_id, None)
        self._ended_before.pop(run_id, None)

    # Within.

    def _go_on(self, held: HeldRun, place: SegmentRound, now: float) -> list[Carry]:
        """Begin a segment once all of its slots are filled."""
        segment = held.part.segments[place.number]
        if held.is_known(place) or held.closed is not None:
            return []
        tokens = [held.tokens.get((place, slot)) for slot in range(segment.slots)]
        whole = held.tokens.get((place, WHOLE))
        if whole is None and None in tokens:
            return []
        failed = whole.failed if whole is not None else next((one.failed for one in tokens if one and one.failed), "")
        if failed:
            self._note(SegmentOver(now, held.part.run_id, place.number, failed, rounds=place.rounds))
            return self._after(held, place, now)
        if held.is_paused or self.in_doubt:
            return []
        self._note(SegmentBegun(now, held.part.run_id, place.number, place.rounds))
        return [held.begin(place), *held.tells(place)]

    def _heard(self, held: HeldRun, mailbox: int) -> list[Carry]:
        """Tell the segments that hear a mailbox what has come."""
        if held.is_paused or self.in_doubt:
            return []
        return [tell for place in held.hearers(mailbox) for tell in held.tells(place)]

    def _paused(self, held: HeldRun) -> list[Carry]:
        """Have the engine begin nothing; a segment that it has not got yet it does not get."""
        pause = held.pause
        return [Pause(held.part.run_id, held.active, True, pause.by)] if pause is not None and held.active else []

    def _resumed(self, held: HeldRun, now: float) -> list[Carry]:
        """Have the engine go on with what was begun, and begin what can be."""
        effects: list[Carry] = [held.begin(place) for place in held.active]
        effects += [tell for place in held.active for tell in held.tells(place)]
        if held.pause is not None and held.active:
            effects.append(Pause(held.part.run_id, held.active, False, held.pause.by))
        for place in dict.fromkeys([place for place, _ in held.tokens]):
            if not held.part.segments[place.number].tells:
                effects += self._go_on(held, place, now)
        return effects

    def _after(self, held: HeldRun, place: SegmentRound, now: float) -> list[Carry]:
        """What follows from the end of a segment here; tokens for others are in `to_send`."""
        over, effects = held.over[place], list[Carry]()
        roads = held.roads(place, over)
        if not roads:
            outcome = over.ends or ("failed" if over.failed else "done")
            return self._close(held, outcome, over.reason or over.failed, self._space, now)
        for road in roads:
            if road.space == self._space and (place, road.segment, road.slot) not in held.handed:
                effects += self.take_token(held.token(place, over, road), self._space, now)
                if held.closed is not None:
                    return effects
                self._note(HandedOver(now, held.part.run_id, place.number, road.segment, road.slot, place.rounds))
        return effects

    @staticmethod
    def _unfit(held: HeldRun, place: SegmentRound, over: SegmentOver) -> str:
        """Why a token of a segment cannot be made; empty where it can."""
        try:
            for road in held.roads(place, over):
                held.token(place, over, road)
        except TokenInvalid as error:
            return str(error)
        return ""

    def _close(self, held: HeldRun, outcome: str, reason: str, by: int, now: float) -> list[Carry]:
        active = held.active
        self._note(RunClosed(now, held.part.run_id, outcome, reason, by))
        if self.in_doubt:
            return self._no_doubt(held.part.run_id, now)
        return [Stop(held.part.run_id, active, reason or outcome)] if active else []

    def _is_over(self, run_id: str, closed: RunClosed) -> RunRefused:
        return RunRefused(f"run {run_id} is over here: {closed.outcome}{closed.reason and f', {closed.reason}'}")

    def _note(self, fact: CarryFact) -> None:
        try:
            self._journal(fact)
        except StorageUnavailable as error:
            if (held := self.runs.get(fact.run_id)) is not None:
                held.again_at, self.problem = fact.at + AGAIN_S, str(error)
            raise
        self.problem = ""
        self._apply(fact)

    def _apply(self, fact: CarryFact) -> None:
        if isinstance(fact, PartTaken):
            self.runs[fact.run_id] = HeldRun(decode_part(bytes.fromhex(fact.content)), fact.at)
            return
        held = self.runs.get(fact.run_id)
        if held is None:
            if isinstance(fact, RunClosed):
                self._ended_before[fact.run_id] = fact
            return  # else it is of a run that was forgotten
        held.apply(fact)


def _but_the_last(kept: int, over: list[tuple[float, str]]) -> list[str]:
    """The ids of runs but for the last ones, in the order of their times."""
    over.sort(key=lambda one: one[0])
    return [run_id for _, run_id in over[: max(0, len(over) - kept)]]
