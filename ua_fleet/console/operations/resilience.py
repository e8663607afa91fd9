"""Faults, and decisions about who takes over."""

from __future__ import annotations

from typing import Any, Final

from pydantic import Field

from ua_fleet.client import FleetClient, JudgementsContradict, ScenarioClient
from ua_fleet.console.operations.kinds import OperationKind, OperationParameters
from ua_fleet.console.rankings import shown_ranking
from ua_fleet.console.shown import harmless_value, shown_value

__all__ = ["RESILIENCE_OPERATIONS"]


class Raised(OperationParameters):
    """A robot that cannot work, or not with these capacities."""

    robot: str = Field(min_length=1, max_length=200)
    reason: str = Field(min_length=1, max_length=500)
    capacities: list[str] = Field(default_factory=list[str], max_length=100)


class Cleared(OperationParameters):
    """A fault that is over, by its id, or all of a robot."""

    fault: str = Field(min_length=1, max_length=300)


class Judged(OperationParameters):
    """An open decision, and pairwise comparisons of its criteria, `{"battery/distance": 2}`; none: those that count."""

    decision: str = Field(min_length=1, max_length=300)
    judgements: dict[str, float] = Field(default_factory=dict[str, float], max_length=500)


class Confirmed(OperationParameters):
    """Who is to take over."""

    decision: str = Field(min_length=1, max_length=300)
    robot: str = Field(min_length=1, max_length=200)


class FailedRobotParameters(OperationParameters):
    """A robot."""

    robot: str = Field(min_length=1, max_length=200)


class ModeSet(OperationParameters):
    """Who chooses from now on."""

    mode: str = Field(pattern="^(operator|automatic|abort)$")
    limit_s: float | None = Field(default=None, ge=0, lt=1e9)
    on_limit: str = Field(default="", pattern="^(|best_if_known|best|abort)$")


class JudgementsSet(OperationParameters):
    """How the criteria of the fleet compare."""

    judgements: dict[str, float] = Field(min_length=1, max_length=500)


async def _raise(client: FleetClient, asked: Raised) -> None:
    await ScenarioClient(client).raise_fault(asked.robot, asked.reason, asked.capacities)


async def _clear(client: FleetClient, asked: Cleared) -> None:
    await ScenarioClient(client).clear_fault(asked.fault)


async def _preview(client: FleetClient, asked: Judged) -> dict[str, Any]:
    """A slider passes contradictions on its way, so that they are an answer here and no error."""
    try:
        ranking = await ScenarioClient(client).preview(asked.decision, asked.judgements)
    except JudgementsContradict as error:
        ratio = shown_value(error.consistency_ratio)
        return {"ranking": None, "ratio": ratio, "problem": harmless_value(str(error))}
    return {"ranking": shown_ranking(ranking), "ratio": shown_value(ranking.consistency_ratio), "problem": ""}


async def _judge(client: FleetClient, asked: Judged) -> dict[str, Any]:
    return {"ranking": shown_ranking(await ScenarioClient(client).judge_decision(asked.decision, asked.judgements))}


async def _confirm(client: FleetClient, asked: Confirmed) -> dict[str, Any]:
    return {"outcome": await ScenarioClient(client).confirm(asked.decision, asked.robot)}


async def _what_if(client: FleetClient, asked: FailedRobotParameters) -> list[dict[str, Any]]:
    forecasts = await ScenarioClient(client).what_if(asked.robot)
    return [
        {"run": one.run_id, "task": one.task, "best": one.best, "explanation": harmless_value(one.explanation)}
        for one in forecasts
    ]


async def _mode(client: FleetClient, asked: ModeSet) -> None:
    await ScenarioClient(client).set_mode(asked.mode, limit_s=asked.limit_s, on_limit=asked.on_limit)


async def _set_judgements(client: FleetClient, asked: JudgementsSet) -> dict[str, Any]:
    weights = await ScenarioClient(client).set_judgements(asked.judgements)
    return {"weights": {harmless_value(name): shown_value(weight) for name, weight in weights.items()}}


RESILIENCE_OPERATIONS: Final = (
    OperationKind("fault.raise", Raised, _raise, "Faults.RaiseFault", "operator"),
    OperationKind("fault.clear", Cleared, _clear, "Faults.ClearFault", "operator"),
    OperationKind("resilience.preview", Judged, _preview, "Resilience.Preview", "observer"),
    OperationKind("resilience.judge", Judged, _judge, "Resilience.JudgeDecision", "operator"),
    OperationKind("resilience.confirm", Confirmed, _confirm, "Resilience.Confirm", "operator"),
    OperationKind("resilience.what_if", FailedRobotParameters, _what_if, "Resilience.WhatIf", "observer"),
    OperationKind("resilience.mode", ModeSet, _mode, "Resilience.SetMode", "engineer"),
    OperationKind("resilience.set_judgements", JudgementsSet, _set_judgements, "Resilience.SetJudgements", "engineer"),
)
