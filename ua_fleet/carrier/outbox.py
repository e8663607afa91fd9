"""What a bridge has to tell other bridges of carried runs: each is asked by an Action until it has acknowledged it.

Nothing here is journaled: what is not acknowledged follows from the holder's facts, and the same words said twice
change nothing.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from ua_fleet.bridge.carry import CarryGround
from ua_fleet.carrying import AskEpoch, Carry, Holder, Send, SendToken
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.errors import RobotOffline, UaFleetError
from ua_fleet.operation.skills.commands import JOURNALED_PACE, SkillCommands
from ua_fleet.pubsub.carry_action import CARRY, Word, carry_topic
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.skill.executions import EXECUTION_ID_BYTES, OutcomeKind, RequestOutcome, unpack
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.values import Quality, StatusCode, quality_of
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

__all__ = ["Outbox"]

INSTANCE: Final = "token"
"""Second part of the RequestorId."""
ANSWER_S: Final = 2.0
FIRST_PAUSE_S: Final = 0.1
LONGEST_PAUSE_S: Final = 5.0
MOST_REMEMBERED: Final = 200

Key = tuple[str, str, int, int]
Told = Callable[[Callable[[Holder, float], list[Carry] | None]], None]


@dataclass(slots=True)
class _Unsaid:
    sent: Send
    told: Told
    next_at: float = 0.0
    pause_s: float = FIRST_PAUSE_S
    is_asked: bool = False
    reason: str = ""


class Outbox:
    """The words of one bridge that others have not acknowledged."""

    def __init__(self, space: int, ns: int, names: Mapping[int, str], ground: CarryGround, log: Any) -> None:
        """Begin with nothing; `names` are those of the bridges by their spaces."""
        self._ns, self._names, self._ground, self._log = ns, names, ground, log
        self._unsaid: dict[Key, _Unsaid] = {}
        self._asked: dict[bytes, Key] = {}
        self._commands = SkillCommands(
            MemoryJournal(),
            send=ground.send,
            want=ground.subscriber.want_action,
            sooner=ground.sooner,
            wall_ticks=ground.wall_ticks,
            must_be_verified=ground.must_be_verified,
            clock=ground.loop.time,
            log=log,
            space=space,
            instance=INSTANCE,
            pace=JOURNALED_PACE,
            told=self._concluded,
            most_remembered=MOST_REMEMBERED,
        )

    def want(self, space: int) -> None:
        """Know a bridge before there is something to say to it."""
        if space in self._names:
            self._commands.want(carry_topic(space, self._ns))

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Learn of an Action."""
        self._commands.announced(announcement)
        for unsaid in self._unsaid.values():
            if _space(unsaid.sent) == announcement.publisher_id and not unsaid.is_asked:
                unsaid.next_at = 0.0  # it is there, and can be asked now
                self._ground.sooner()

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take a response."""
        self._commands.receive(event, now)

    def say(self, words: Iterable[Send], told: Told) -> None:
        """Say what is not acknowledged, and is not being said or paused."""
        now, wanted = self._ground.loop.time(), {_key(sent): sent for sent in words}
        for key in [key for key in self._unsaid if key not in wanted]:
            del self._unsaid[key]
        for key, sent in wanted.items():
            unsaid = self._unsaid.setdefault(key, _Unsaid(sent, told))
            if not unsaid.is_asked and now >= unsaid.next_at:
                self._say(key, unsaid, now)

    def put_off(self, reason: str) -> None:
        """Nothing can be said now: what is due is said later."""
        now = self._ground.loop.time()
        for unsaid in self._unsaid.values():
            if not unsaid.is_asked and now >= unsaid.next_at:
                self._later(unsaid, reason, now)

    def _say(self, key: Key, unsaid: _Unsaid, now: float) -> None:
        sent, space = unsaid.sent, _space(unsaid.sent)
        if isinstance(sent, SendToken):
            word, content = Word.TOKEN, sent.content
        elif isinstance(sent, AskEpoch):
            word, content = Word.EPOCH, encode_words(run=sent.run_id)
        else:
            word, content = Word.END, encode_words(run=sent.run_id, outcome=sent.outcome, reason=sent.reason)
        execution_id = secrets.token_bytes(EXECUTION_ID_BYTES)
        try:
            name, arguments = self._names.get(space, ""), {"Word": int(word), "Content": content}
            self._commands.request(carry_topic(space, self._ns), name, CARRY, arguments, ANSWER_S, execution_id)
        except RobotOffline:
            self._later(unsaid, f"the bridge of space {space} is not heard", now)
        except UaFleetError as error:
            self._later(unsaid, str(error), now)
        else:
            unsaid.is_asked, self._asked[execution_id] = True, key

    def _later(self, unsaid: _Unsaid, reason: str, now: float) -> None:
        if unsaid.reason != reason:
            what = _what(unsaid.sent)
            said = f"the {what} of a carried run is kept, and said again"
            self._log.warning(said, run_id=unsaid.sent.run_id, reason=reason)
        unsaid.is_asked, unsaid.reason, unsaid.next_at = False, reason, now + unsaid.pause_s
        unsaid.pause_s = min(2 * unsaid.pause_s, LONGEST_PAUSE_S)

    def _concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        key = self._asked.pop(execution_id, None)
        unsaid = None if key is None else self._unsaid.get(key)
        if key is None or unsaid is None:
            return
        report = outcome.report
        if outcome.kind is OutcomeKind.ACCEPTED and quality_of(report.status) is Quality.GOOD:
            sent = unsaid.sent
            del self._unsaid[key]
            if isinstance(sent, SendToken):
                unsaid.told(lambda holder, now: holder.handed_over(sent, now))
            elif isinstance(sent, AskEpoch):
                told = _epoch_in(report.result)
                if told.epoch > sent.epoch and not told.left_out and not told.outcome:
                    self._unsaid[key] = unsaid  # it is asked again, and not at once
                    why = f"the bridge of space {sent.space} has epoch {told.epoch}, and this one {sent.epoch} still"
                    self._later(unsaid, why, self._ground.loop.time())
                unsaid.told(lambda holder, now: holder.told_epoch(sent, now=now, **told._asdict()))
            else:
                unsaid.told(lambda holder, now: holder.end_told(sent, now))
        else:
            said = report.message or f"the bridge of space {_space(unsaid.sent)} does not answer"
            self._later(unsaid, said, self._ground.loop.time())
            self._refused(unsaid, report.status, outcome.kind)

    @staticmethod
    def _refused(unsaid: _Unsaid, status: int, kind: OutcomeKind) -> None:
        """A bridge that does not take a token may know of an epoch after ours; one that has forgotten a run has not."""
        sent = unsaid.sent
        if kind is not OutcomeKind.UNKNOWN and isinstance(sent, SendToken):
            unsaid.told(lambda holder, _now: holder.refused(sent))
        elif status == StatusCode.BAD_NOT_FOUND and isinstance(sent, AskEpoch):
            unsaid.told(lambda holder, now: holder.told_epoch(sent, None, now))

    def waits(self, run_id: str = "") -> str:
        """Why something is not acknowledged, of one run or of all; empty where nothing waits."""
        for unsaid in self._unsaid.values():
            if unsaid.reason and run_id in ("", unsaid.sent.run_id):
                what = _what(unsaid.sent)
                return f"carried run {unsaid.sent.run_id}: its {what} is kept here: {unsaid.reason}"
        return ""

    def poll(self, now: float) -> None:
        """Do what is due."""
        self._commands.poll(now)

    def is_due(self, now: float) -> bool:
        """Whether something is to be said again."""
        return any(not unsaid.is_asked and now >= unsaid.next_at for unsaid in self._unsaid.values())

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        deadlines = [unsaid.next_at for unsaid in self._unsaid.values() if not unsaid.is_asked]
        if (due := self._commands.next_deadline()) is not None:
            deadlines.append(due)
        return min(deadlines, default=None)


def _what(sent: Send) -> str:
    if isinstance(sent, AskEpoch):
        return "question whether its token was adopted"
    return "token" if isinstance(sent, SendToken) else "end"


class _Epoch(NamedTuple):
    """What a bridge says that was asked for the epoch of a run."""

    epoch: int
    left_out: bool
    """Whether who has asked has no part of it."""
    doubt: bool
    """Whether it was away itself."""
    outcome: str
    """How the run is over there; empty where it goes on."""
    reason: str


def _epoch_in(result: bytes) -> _Epoch:
    (packed,) = unpack(result)
    words = decode_words(bytes(packed.value or b""))
    outcome, reason = (str(words.get(name, "")) for name in ("outcome", "reason"))
    left_out, doubt = bool(words.get("left_out", True)), bool(words.get("doubt"))
    return _Epoch(int(words.get("epoch", 0)), left_out, doubt, outcome, reason)


def _space(sent: Send) -> int:
    return sent.road.space if isinstance(sent, SendToken) else sent.space


def _key(sent: Send) -> Key:
    if isinstance(sent, SendToken):
        return sent.run_id, str(sent.source), sent.road.segment, sent.road.slot
    return sent.run_id, "epoch" if isinstance(sent, AskEpoch) else "end", sent.space, 0
