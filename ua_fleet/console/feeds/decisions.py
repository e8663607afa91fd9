"""Feeds `decisions` (keys are their ids), `decision` (one of them, with its ranking), `resilience` (who decides)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pydantic import Field

from ua_fleet.client import DecisionTold, FleetClient, Reading, ranking_of
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import PartsDiffer, followed, show_rows, telling
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters, NoParameters
from ua_fleet.console.rankings import shown_ranking
from ua_fleet.console.shown import harmless_value, shown_moment, shown_value

__all__ = ["DECISION", "DECISIONS", "RESILIENCE", "decision_nodes"]

_FOLDER: Final = "ns=2;s=Fleet.Resilience.Decisions"
_OBJECT: Final = "ns=2;s=Fleet.Resilience"
_TEXTS: Final = ("State", "Run", "Step", "Task", "Failed", "Reason", "Chosen", "ChosenBy")
_TIMES: Final = ("StartTime", "Deadline")
_HEAD: Final = (*_TEXTS, *_TIMES)
_RANKING: Final = (
    *("Robots", "Scores", "Criteria", "Weights", "RawValues", "CriterionScores", "Missing", "Excluded", "Reasons"),
    "ConsistencyRatio",
)
_SETTINGS: Final = (
    *("Mode", "Limit", "OnLimit", "Synthesis", "Criteria", "Units", "Weights", "ConsistencyRatio"),
    *("JudgementNames", "JudgementValues"),
)
_FEW: Final = 5


class OfDecision(FeedParameters):
    """Which decision."""

    decision: str = Field(min_length=1, max_length=300)


def _head(decision: str, parts: Mapping[str, Reading]) -> dict[str, Any]:
    told = {name: harmless_value(str(parts[name].value or "")) for name in _TEXTS}
    return {
        "id": decision,
        "state": told["State"],
        "run": told["Run"],
        "step": told["Step"],
        "task": told["Task"],
        "failed": told["Failed"],
        "reason": told["Reason"],
        "chosen": told["Chosen"],
        "by": told["ChosenBy"],
        "started": shown_moment(parts["StartTime"].exact),
        "deadline": shown_moment(parts["Deadline"].exact),
    }


def _listed(decision: str, parts: Mapping[str, Reading]) -> dict[str, Any]:
    best = zip(parts["Robots"].value or (), parts["Scores"].value or (), strict=False)
    return {
        **_head(decision, parts),
        "candidates": len(parts["Robots"].value or ()),
        "best": [{"robot": robot, "score": shown_value(score)} for robot, score in best][:_FEW],
    }


def _whole(decision: str, parts: Mapping[str, Reading]) -> dict[str, Any]:
    told = {name: parts[name].exact for name in _RANKING}
    _check_lengths(decision, told)
    ranking = ranking_of(told)
    return {**_head(decision, parts), "ranking": shown_ranking(ranking)}


def _check_lengths(decision: str, told: Mapping[str, Any]) -> None:
    """Raise PartsDiffer while a ranking of another length is told Variable by Variable."""
    lengths = {name: len(told[name] or ()) for name in _RANKING if name != "ConsistencyRatio"}
    cells = lengths["Robots"] * lengths["Criteria"]
    wanted = {
        "Scores": lengths["Robots"],
        "Weights": lengths["Criteria"],
        "Reasons": lengths["Excluded"],
        "RawValues": cells,
        "CriterionScores": cells,
        "Missing": cells,
    }
    for name, length in wanted.items():
        if lengths[name] != length:
            raise PartsDiffer(f"{_FOLDER}.{decision}: {name} has {lengths[name]} elements in place of {length}")


async def decision_nodes(client: FleetClient) -> dict[str, str]:
    """NodeIds of decisions by their ids."""
    nodes = await client.browse(_FOLDER)
    return {node.browse_name: node.node_id for node in nodes if node.node_class == "Object"}


async def _run_decisions(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    async def look() -> dict[str, str]:
        return await decision_nodes(client)

    async def show(decisions: dict[str, str]) -> None:
        await show_rows(client, board, decisions, (*_HEAD, "Robots", "Scores"), _listed)

    await followed(client, look, show, telling(client, (DecisionTold,)))


async def _run_decision(client: FleetClient, parameters: OfDecision, board: Board) -> None:
    decision = parameters.decision
    node = f"{_FOLDER}.{decision}"
    await client.read(f"{node}.State")  # says so where there is none

    def whole(_key: str, parts: Mapping[str, Reading]) -> dict[str, Any]:
        return _whole(decision, parts)

    await show_rows(client, board, {"decision": node}, (*_HEAD, *_RANKING), whole)


def _settings(_key: str, parts: Mapping[str, Reading]) -> dict[str, Any]:
    told = {name: reading.exact for name, reading in parts.items()}
    return {
        "mode": told["Mode"],
        "limit_s": shown_value((told["Limit"] or 0.0) / 1000),
        "on_limit": told["OnLimit"],
        "synthesis": told["Synthesis"],
        "ratio": shown_value(told["ConsistencyRatio"]),
        "criteria": [
            {"name": harmless_value(name), "weight": shown_value(weight), "unit": harmless_value(unit)}
            for name, weight, unit in zip(
                *(told[part] or () for part in ("Criteria", "Weights", "Units")), strict=False
            )
        ],
        "judgements": {
            harmless_value(pair): shown_value(value)
            for pair, value in zip(told["JudgementNames"] or (), told["JudgementValues"] or (), strict=False)
        },
    }


async def _run_resilience(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    await show_rows(client, board, {"settings": _OBJECT}, _SETTINGS, _settings)


DECISIONS: Final = FeedKind("decisions", NoParameters, _run_decisions)
DECISION: Final = FeedKind("decision", OfDecision, _run_decision)
RESILIENCE: Final = FeedKind("resilience", NoParameters, _run_resilience)
