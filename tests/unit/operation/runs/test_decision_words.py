"""Decisions of bridges as the server reads them."""

from __future__ import annotations

import json
from typing import Any

import pytest

from ua_fleet.carrying.words import WordsInvalid
from ua_fleet.operation.runs.decision_words import decode_decision, encode_decision
from ua_fleet.orchestrator import DecisionChanged
from ua_fleet.resilience import (
    Aborted,
    Excluded,
    Ranked,
    Ranking,
    RankingChanged,
    ReplacementChosen,
    Synthesis,
    Weights,
)

RANKING = Ranking(
    Weights(("battery", "distance"), (0.75, 0.25), 2.0, 0.0),
    Synthesis.DISTRIBUTIVE,
    (Ranked("left", 1.0, (80.0, 2.0), (0.8, 0.5), ("", "not heard")),),
    (Excluded("middle", "it has a fault"),),
)


@pytest.mark.parametrize(
    ("event", "until"),
    [
        (RankingChanged("run.1.0", RANKING), 12.5),
        (ReplacementChosen("run.1.0", "left", "anna", RANKING), None),
        (Aborted("run.1.0", "the run has ended"), None),
    ],
)
def test_a_decision_arrives_as_it_was_told(event: Any, until: float | None) -> None:
    told = DecisionChanged("run.1", "0", "fetch", "middle", "it failed", event, until)
    words = json.loads(json.dumps(encode_decision(told)))
    assert decode_decision(words, "run") == DecisionChanged("run", "0", "fetch", "middle", "it failed", event, until)


def changed(**other: Any) -> dict[str, Any]:
    told = DecisionChanged("run.1", "0", "fetch", "middle", "it failed", RankingChanged("run.1.0", RANKING))
    words: dict[str, Any] = json.loads(json.dumps(encode_decision(told)))
    return words | other


@pytest.mark.parametrize(
    "words",
    [
        None,
        [],
        {},
        changed(kind="Else"),
        changed(until="soon"),
        changed(event={"decision_id": "run.1.0"}),
        changed(event={"decision_id": "run.1.0", "ranking": {"weights": 3}}),
        changed(event=7),
    ],
)
def test_what_is_no_decision_is_refused(words: Any) -> None:
    with pytest.raises(WordsInvalid):
        decode_decision(words, "run")
