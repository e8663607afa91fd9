"""What bridges that carry runs ask people, and what people say: through the server, to the bridge that has asked.

A bridge tells its decisions with its facts; the server shows those that are new, or say something else. What a person
says goes to all bridges of the run, since the one that has asked may have told nobody yet; one of them takes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from ua_fleet.carrying.words import encode_words
from ua_fleet.operation.runs.decision_words import decode_decision
from ua_fleet.orchestrator import DecisionChanged
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.resilience import Aborted, RankingChanged
from ua_fleet.skill.executions import OutcomeKind, RequestOutcome, unpack
from ua_fleet.values import Quality, quality_of

__all__ = ["MOST_OVER", "Ask", "BridgesAnswered", "CarriedQuestions", "is_good"]

MOST_OVER: Final = 64
"""Decisions of a run that are over and still known: more than the last ones that a bridge tells again with each page.
One that is told again after that is not shown, since it is over."""

BridgesAnswered = Callable[[str, str], None]
"""Told once what became of it: why no bridge has taken it, or an empty text and what the bridge has answered."""


class Ask(Protocol):
    """Asks a bridge."""

    def __call__(self, space: int, word: Word, content: bytes, told: Callable[[RequestOutcome], None]) -> bool:
        """Whether it could be asked."""
        ...


def is_good(outcome: RequestOutcome) -> bool:
    """Whether a bridge has done what it was asked for."""
    return outcome.kind is OutcomeKind.ACCEPTED and quality_of(outcome.report.status) is Quality.GOOD


@dataclass(slots=True)
class _Round:
    """One thing that a person has said, at all bridges of a run."""

    left: set[int]
    said: BridgesAnswered
    refusals: dict[int, str] = field(default_factory=dict[int, str])
    is_over: bool = False


class CarriedQuestions:
    """The questions of all carried runs."""

    def __init__(self, names: Mapping[int, str], ask: Ask, show: Callable[[DecisionChanged], None]) -> None:
        """Begin with none.

        Args:
            names: of bridges, by their spaces.
            ask: asks one of them.
            show: shows what became of a decision.
        """
        self._names, self._ask, self._show = names, ask, show
        self._shown: dict[str, dict[str, DecisionChanged]] = {}
        """The decisions of each run by their ids, as they were told last: those that are open, and the last others."""

    def answer(
        self, run_id: str, spaces: Iterable[int], step: str, answer: str, by: str, said: BridgesAnswered
    ) -> None:
        """A person says what became of a task."""
        self._tell(spaces, Word.ANSWER, encode_words(run=run_id, step=step, answer=answer, by=by), said)

    def confirm(
        self, run_id: str, spaces: Iterable[int], decision: str, robot: str, by: str, said: BridgesAnswered
    ) -> None:
        """A person chooses who takes a task over."""
        self._tell(spaces, Word.CONFIRM, encode_words(run=run_id, decision=decision, robot=robot, by=by), said)

    def _tell(self, spaces: Iterable[int], word: Word, content: bytes, said: BridgesAnswered) -> None:
        asked = sorted(spaces)
        tried = _Round(set(asked), said)
        for space in asked:

            def told(outcome: RequestOutcome, space: int = space) -> None:
                self._told(tried, space, outcome)

            if not self._ask(space, word, content, told):
                self._refused(tried, space, "it is not heard")

    def _told(self, tried: _Round, space: int, outcome: RequestOutcome) -> None:
        if not is_good(outcome):
            self._refused(tried, space, outcome.report.message or "it does not answer")
        elif not tried.is_over:
            tried.is_over = True
            (packed,) = unpack(outcome.report.result)
            tried.said("", bytes(packed.value or b"").decode("utf-8", "replace"))

    def _refused(self, tried: _Round, space: int, why: str) -> None:
        tried.left.discard(space)
        tried.refusals[space] = why
        if not tried.left and not tried.is_over:
            tried.is_over = True
            reasons = "; ".join(f"{self._names[one]}: {text}" for one, text in sorted(tried.refusals.items()))
            tried.said(f"no bridge of the run has taken it: {reasons}", "")

    def take(self, run_id: str, told: Iterable[Any]) -> None:
        """A bridge has told its decisions; raises WordsInvalid where they are none."""
        shown = self._shown.setdefault(run_id, {})
        for words in told:
            changed = decode_decision(words, run_id)
            decision_id = changed.event.decision_id
            before = shown.get(decision_id)
            if changed != before and (before is not None or isinstance(changed.event, RankingChanged)):
                self._show(changed)
            shown.pop(decision_id, None)  # it is the last one now
            shown[decision_id] = changed
        over = [each for each, changed in shown.items() if not isinstance(changed.event, RankingChanged)]
        for decision_id in over[: max(0, len(over) - MOST_OVER)]:
            del shown[decision_id]

    def end(self, run_id: str) -> None:
        """A run has ended: nobody has to decide anything for it."""
        for changed in self._shown.pop(run_id, {}).values():
            if isinstance(changed.event, RankingChanged):
                event = Aborted(changed.event.decision_id, "the run has ended")
                self._show(DecisionChanged(run_id, changed.step, changed.task, changed.failed, changed.reason, event))
