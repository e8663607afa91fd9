"""Decisions of a bridge about who takes a task over, as it tells the server of them: JSON, with their rankings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ua_fleet.carrying.words import WordsInvalid
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

__all__ = ["decode_decision", "encode_decision"]


def encode_decision(changed: DecisionChanged) -> dict[str, Any]:
    """What was said of a decision, for JSON."""
    return {**dataclasses.asdict(changed), "kind": type(changed.event).__name__}


def decode_decision(words: Any, run_id: str) -> DecisionChanged:
    """The same, of a run of the server.

    Raises:
        WordsInvalid: a bridge has said something else.
    """
    try:
        until = words["until"]
        return DecisionChanged(
            run_id,
            str(words["step"]),
            str(words["task"]),
            str(words["failed"]),
            str(words["reason"]),
            _event(words["kind"], words["event"]),
            None if until is None else float(until),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise WordsInvalid(f"a decision of a carried run cannot be read: {error!r}") from error


def _event(kind: str, event: Mapping[str, Any]) -> RankingChanged | ReplacementChosen | Aborted:
    decision_id = str(event["decision_id"])
    if kind == Aborted.__name__:
        return Aborted(decision_id, str(event["reason"]))
    ranking = _ranking(event["ranking"])
    if kind == ReplacementChosen.__name__:
        return ReplacementChosen(decision_id, str(event["robot"]), str(event["by"]), ranking)
    if kind == RankingChanged.__name__:
        return RankingChanged(decision_id, ranking)
    raise ValueError(f"there is no event {kind[:80]!r} of decisions")


def _ranking(ranking: Mapping[str, Any]) -> Ranking:
    weights = ranking["weights"]
    return Ranking(
        Weights(
            _texts(weights["names"]),
            _numbers(weights["weights"]),
            float(weights["lambda_max"]),
            float(weights["consistency_ratio"]),
        ),
        Synthesis(ranking["synthesis"]),
        tuple(
            [
                Ranked(
                    str(one["robot"]),
                    float(one["score"]),
                    _numbers(one["raw"]),
                    _numbers(one["scores"]),
                    _texts(one["missing"]),
                )
                for one in ranking["ranked"]
            ]
        ),
        tuple([Excluded(str(one["robot"]), str(one["reason"])) for one in ranking["excluded"]]),
    )


def _texts(values: Any) -> tuple[str, ...]:
    return tuple([str(value) for value in values])


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple([float(value) for value in values])
