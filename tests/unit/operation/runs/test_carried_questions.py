"""What the server keeps and shows of the decisions of a carried run."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, cast

from tests.unit.operation.runs.test_decision_words import RANKING
from ua_fleet.operation.runs.carried_questions import MOST_OVER, CarriedQuestions
from ua_fleet.operation.runs.decision_words import encode_decision
from ua_fleet.orchestrator import DecisionChanged
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.resilience import Aborted, DecisionEvent, RankingChanged, ReplacementChosen
from ua_fleet.skill.executions import RequestOutcome


def _ask_nobody(space: int, word: Word, content: bytes, told: Callable[[RequestOutcome], None]) -> bool:
    del space, word, content, told
    return False


class Questions:
    """Those of a server whose bridges say what a test says."""

    def __init__(self) -> None:
        self.shown: list[tuple[str, type]] = []
        self.questions = CarriedQuestions({}, _ask_nobody, self._show)

    def _show(self, changed: DecisionChanged) -> None:
        self.shown.append((changed.event.decision_id, type(changed.event)))

    def told(self, *events: DecisionEvent) -> list[tuple[str, type]]:
        """What is shown of what a bridge has told."""
        self.shown.clear()
        told = [DecisionChanged("run.1", "0", "fetch", "middle", "it failed", event) for event in events]
        words: list[Any] = [json.loads(json.dumps(encode_decision(one))) for one in told]
        self.questions.take("run", words)
        return list(self.shown)

    @property
    def kept(self) -> int:
        return len(cast("Any", self.questions)._shown["run"])


def asked(number: int) -> RankingChanged:
    return RankingChanged(f"run.1.{number}", RANKING)


def chosen(number: int) -> ReplacementChosen:
    return ReplacementChosen(f"run.1.{number}", "left", "automatic", RANKING)


def test_decisions_that_are_over_are_not_kept_until_the_run_ends() -> None:
    questions = Questions()
    questions.told(asked(0))
    for number in range(1, 1000):
        assert len(questions.told(asked(number), chosen(number))) == 2
    assert questions.kept == MOST_OVER + 1, "one is open"
    last = [chosen(number) for number in range(992, 1000)]
    assert questions.told(*last) == [], "a bridge tells its last ones again with each page"
    assert questions.told(chosen(1)) == [], "also one that was forgotten here: it is over"
    assert questions.told(chosen(0)) == [("run.1.0", ReplacementChosen)]


def test_what_is_open_when_a_run_ends_is_decided_by_nobody() -> None:
    questions = Questions()
    questions.told(asked(0), asked(1), *[chosen(number) for number in range(2, 200)])
    questions.told(chosen(1))
    questions.shown.clear()
    questions.questions.end("run")
    assert questions.shown == [("run.1.0", Aborted)]
