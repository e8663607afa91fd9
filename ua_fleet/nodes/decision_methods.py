"""The Methods of Resilience and Faults: who takes tasks over, and what robots cannot do."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any, Final

import structlog

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.stack import Refusal, StatusCodes
from ua_fleet.endpoint.turns import TURN_S, Places
from ua_fleet.endpoint.users import Role, User
from ua_fleet.errors import JudgementsInvalid, ScenarioError, ScenarioInvalid
from ua_fleet.nodes.carried_methods import said_by_bridges
from ua_fleet.nodes.method_factory import MethodArgument, MethodFactory, Noted, NotValid, caller
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.run_calls import code_of, whose_place
from ua_fleet.nodes.scenario_nodes import FAULTS, RESILIENCE, ranking_values
from ua_fleet.nodes.scenario_view import ScenarioView
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.orchestrator import FaultForecast
from ua_fleet.resilience import DecisionMode, OnLimit, Ranking
from ua_fleet.values import ARRAY, BuiltinType

__all__ = ["DecisionMethods"]

_log: Any = structlog.get_logger("ua_fleet.scenarios")

MOST_FORECASTS: Final = 500
"""Tasks that one WhatIf looks at."""
MOST_FORECAST_S: Final = 2.0
"""Time that it takes for that; a Method call has 3 s."""
MOST_EXPLAINED: Final = 50
"""Robots of a ranking that are explained, and as many of those that are no candidates."""
MOST_PAIR: Final = 100


_TEXT: Final = int(BuiltinType.STRING)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_NUMBER: Final = int(BuiltinType.DOUBLE)
_NUMBERS: Final = int(BuiltinType.DOUBLE | ARRAY)
_ROBOT: Final = MethodArgument("Robot", _TEXT, "name of a robot")
_ROBOT_OR_FAULT: Final = MethodArgument("Robot", _TEXT, "name of a robot: all its faults; or id of one, e.g. ur3.robot")
_WEIGHTS: Final = (
    MethodArgument("ConsistencyRatio", _NUMBER, "of the judgements (Saaty)"),
    MethodArgument("Criteria", _TEXTS, "the criteria"),
    MethodArgument("Weights", _NUMBERS, "their weights; together 1"),
)
_RANKING: Final = (
    MethodArgument("Robots", _TEXTS, "the candidates, the best first"),
    MethodArgument("Scores", _NUMBERS, "of each; together 1"),
    MethodArgument("Criteria", _TEXTS, "the criteria that count for this task"),
    MethodArgument("Weights", _NUMBERS, "their weights; together 1"),
    MethodArgument("RawValues", _NUMBERS, "values of the best candidate first, by criterion, then of the next"),
    MethodArgument("CriterionScores", _NUMBERS, "what each of them is worth"),
    MethodArgument("Missing", _TEXTS, "for each of them: empty, or why it is not known"),
    MethodArgument("Excluded", _TEXTS, "robots that are no candidates"),
    MethodArgument("Reasons", _TEXTS, "why"),
    MethodArgument("ConsistencyRatio", _NUMBER, "of the judgements (Saaty); above 0.1 they are refused"),
)


class DecisionMethods:
    """Answers the Methods."""

    def __init__(
        self,
        server: HardenedServer,
        parts: NodeFactory,
        view: ScenarioView,
        service: ScenarioService,
        carried: CarriedRuns,
        background: Places,
    ) -> None:
        """Prepare to answer; `build` makes the Methods.

        Args:
            server: whose Methods they are.
            parts: of the fleet.
            view: of runs and faults.
            service: does what is asked for.
            carried: does it for runs that bridges carry.
            background: of what computes for long, a place for each user.
        """
        self._server, self._view, self._service = server, view, service
        self._carried, self._background = carried, background
        self._methods = MethodFactory(server, parts, code_of)

    def build(self) -> None:
        """Make the Methods and let them be called."""
        observer, operator, engineer = Role.OBSERVER, Role.OPERATOR, Role.ENGINEER
        add = self._methods.add
        decision = MethodArgument("DecisionId", _TEXT, "the decision")
        add(RESILIENCE, "Confirm", operator, self._confirm, (decision, _ROBOT), (
            MethodArgument("Outcome", _TEXT, "taken, or repeated where this robot was chosen before"),
        ))  # fmt: skip
        add(RESILIENCE, "WhatIf", observer, self._what_if, (_ROBOT,), (
            MethodArgument("Runs", _TEXTS, "run of each task that the robot has ahead"),
            MethodArgument("Tasks", _TEXTS, "name of each task"),
            MethodArgument("Best", _TEXTS, "who would take it over; empty for nobody"),
            MethodArgument("Explanations", _TEXTS, "the ranking, and who is no candidate, and why"),
        ))  # fmt: skip
        judgements = (
            MethodArgument("Pairs", _TEXTS, "pairs of criteria, e.g. battery/distance; each pair once"),
            MethodArgument("Values", _NUMBERS, "how many times more important the first is, 1/9 to 9"),
        )
        add(RESILIENCE, "SetJudgements", engineer, self._set_judgements, judgements, _WEIGHTS)
        add(RESILIENCE, "Preview", observer, self._preview, (decision, *judgements), _RANKING)
        add(RESILIENCE, "JudgeDecision", operator, self._judge_decision, (decision, *judgements), _RANKING)
        add(RESILIENCE, "SetMode", engineer, self._set_mode, (
            MethodArgument("Mode", _TEXT, "operator, automatic or abort"),
            MethodArgument("LimitSeconds", _NUMBER, "how long an operator may think; 0 leaves it"),
            MethodArgument("OnLimit", _TEXT, "what happens then: best_if_known, best or abort; empty leaves it"),
        ), ())  # fmt: skip
        reason = MethodArgument("Reason", _TEXT, "what is wrong; mobile: the drive is hot takes mobile alone away")
        for name, work, inputs in (
            ("RaiseFault", self._raise_fault, (_ROBOT, reason)),
            ("ClearFault", self._clear_fault, (_ROBOT_OR_FAULT,)),
        ):
            method = add(FAULTS, name, operator, work, inputs, ())
            self._server.context.method_rules[method] = _may_speak_for_robots

    # Resilience.

    async def _confirm(self, decision_id: str, robot: str) -> Sequence[Any]:
        known = self._view.decisions.get(decision_id)
        if known is not None and known.state == "chosen":
            if known.chosen == robot:
                return ("repeated",)
            raise ScenarioError(f"{decision_id}: {known.by} has chosen {known.chosen} before")
        by = caller().name
        if known is not None and self._carried.has(known.run_id):
            return (await said_by_bridges(partial(self._carried.confirm, known.run_id, decision_id, robot, by)),)
        return (self._service.decisions.confirm(decision_id, robot, by).value,)

    async def _what_if(self, robot: str) -> Sequence[Any] | Noted:
        forecasts: list[FaultForecast] = []
        async with self._background.of(whose_place()):
            turn = time.monotonic()
            until = turn + MOST_FORECAST_S
            ahead, found = self._service.decisions.what_if(robot)
            # Each of them ranks all robots: others have their turn between two.
            for forecast in islice(found, MOST_FORECASTS):
                forecasts.append(forecast)
                if (now := time.monotonic()) > until:
                    break
                if now - turn > TURN_S:
                    await asyncio.sleep(0)
                    turn = time.monotonic()
        outputs = (
            [forecast.run_id for forecast in forecasts],
            [forecast.task for forecast in forecasts],
            [forecast.ranking.best or "" for forecast in forecasts],
            [_explained(forecast) for forecast in forecasts],
        )
        if len(forecasts) == ahead:
            return outputs
        return Noted(outputs, f"{len(forecasts)} of {ahead} tasks were looked at; the others are left out")

    async def _set_judgements(self, pairs: list[str], values: list[float]) -> Sequence[Any]:
        judgements = _judgements(pairs, values)
        settings = replace(self._service.settings, judgements=judgements)
        self._service.decisions.set_settings(settings, caller().name)
        self._view.show_settings(settings)
        _log.info("judgements set", by=caller().name)
        weights = settings.weights
        return float(weights.consistency_ratio), list(weights.names), list(weights.weights)

    async def _preview(self, decision_id: str, pairs: list[str], values: list[float]) -> Sequence[Any]:
        async with self._background.of(
            whose_place()
        ):  # it ranks all robots, in the event loop: one for each user at a time
            with _as_outputs():
                return _ranking_outputs(
                    self._service.decisions.preview(decision_id, _judgements(pairs, values) or None)
                )

    async def _judge_decision(self, decision_id: str, pairs: list[str], values: list[float]) -> Sequence[Any]:
        async with self._background.of(whose_place()):
            with _as_outputs():
                judgements = _judgements(pairs, values)
                ranking = self._service.decisions.judge(decision_id, judgements or None, caller().name)
        _log.info("judgements of a decision set", decision_id=decision_id, by=caller().name, is_reset=not judgements)
        return _ranking_outputs(ranking)

    async def _set_mode(self, mode: str, limit_s: float, on_limit: str) -> Sequence[Any]:
        settings = self._service.settings
        if mode not in tuple(DecisionMode) or on_limit not in ("", *OnLimit) or not 0 <= limit_s < 1e9:
            raise ScenarioInvalid(
                [f"modes are {', '.join(DecisionMode)}; at the limit: {', '.join(OnLimit)}; a limit is not negative"]
            )
        settings = replace(
            settings,
            mode=DecisionMode(mode),
            limit_s=limit_s or settings.limit_s,
            on_limit=OnLimit(on_limit) if on_limit else settings.on_limit,
        )
        self._service.decisions.set_settings(settings, caller().name)
        self._view.show_settings(settings)
        _log.info("mode set", mode=mode, by=caller().name)
        return ()

    # Faults.

    async def _raise_fault(self, robot: str, reason: str) -> Sequence[Any]:
        self._check_robot(robot)
        self._service.fault_reports.raise_fault(robot, reason)
        return ()

    async def _clear_fault(self, robot: str) -> Sequence[Any]:
        self._check_robot(robot.partition(".")[0])
        self._service.fault_reports.clear_fault(robot)
        return ()

    def _check_robot(self, robot: str) -> None:
        bridge = caller().bridge
        if bridge and self._service.bridge_of(robot) != bridge:
            raise Refusal(StatusCodes.BadUserAccessDenied, f"{robot} is no robot of {bridge}")


def _judgements(pairs: list[str], values: list[float]) -> dict[tuple[str, str], float]:
    """Judgements as Methods take them; raises JudgementsInvalid where they are not well formed."""
    if len(pairs) != len(values):
        raise JudgementsInvalid([f"{len(pairs)} pairs were given with {len(values)} values"])
    judgements: dict[tuple[str, str], float] = {}
    for pair, value in zip(pairs, values, strict=True):
        one, _, other = [part.strip() for part in pair.partition("/")]
        if not one or not other:
            raise JudgementsInvalid([f"{pair[:MOST_PAIR]!r} is no pair of criteria; write them as one/other"])
        if (one, other) in judgements:
            raise JudgementsInvalid([f"{pair[:MOST_PAIR]} was given twice"])
        judgements[one, other] = value
    return judgements


def _ranking_outputs(ranking: Ranking | None, consistency_ratio: float = 0.0) -> list[Any]:
    """The fields of a ranking in the order of `_RANKING`."""
    fields = ranking_values(ranking)
    values = [fields[argument.name].value for argument in _RANKING]
    return values if ranking is not None else [*values[:-1], consistency_ratio]


@contextmanager
def _as_outputs() -> Generator[None]:
    """Tell the consistency ratio of judgements that contradict each other, too."""
    try:
        yield
    except JudgementsInvalid as error:
        raise NotValid(str(error), _ranking_outputs(None, error.consistency_ratio or 0.0)) from error


def _explained(forecast: FaultForecast) -> str:
    ranking = forecast.ranking
    ranked = [
        f"{place.robot} {place.score:.3f}" + "".join(f" ({text})" for text in place.missing if text)
        for place in ranking.ranked[:MOST_EXPLAINED]
    ]
    left = [f"{excluded.robot} {excluded.reason}" for excluded in ranking.excluded[:MOST_EXPLAINED]]
    more = len(ranking.ranked) + len(ranking.excluded) - len(ranked) - len(left)
    return "; ".join([*ranked, *left, *([f"and {more} more"] if more else [])])


def _may_speak_for_robots(user: User) -> bool:
    """Operators, and bridges, whose robots speak through them."""
    return bool(user.bridge) or user.role.covers(Role.OPERATOR)
