"""The Methods of Scenarios, Resilience and Faults; see `ua_fleet.nodes.method_factory` for what they have in common."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any, Final, TypeVar

import structlog

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.origin import origin
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.endpoint.stack import Refusal, StatusCodes
from ua_fleet.endpoint.turns import TURN_S, Places
from ua_fleet.endpoint.users import Role, User
from ua_fleet.errors import JudgementsInvalid, ScenarioError, ScenarioInvalid, UaFleetError
from ua_fleet.nodes.carried_methods import said_by_bridges
from ua_fleet.nodes.method_factory import (
    NOT_FOUND,
    NOT_POSSIBLE,
    NOT_VALID,
    MethodArgument,
    MethodFactory,
    Noted,
    NotValid,
    caller,
)
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.scenario_nodes import FAULTS, RESILIENCE, SCENARIOS, ScenarioNodes, ranking_values
from ua_fleet.nodes.scenario_view import ScenarioView
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.library import MOST_BYTES, ScenarioUnknown, version_of
from ua_fleet.operation.runs.run_commands import RunCommands
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.orchestrator import FaultForecast
from ua_fleet.resilience import DecisionMode, OnLimit, Ranking
from ua_fleet.values import ARRAY, BuiltinType

__all__ = ["ScenarioMethods"]

_log: Any = structlog.get_logger("ua_fleet.scenarios")

MOST_FORECASTS: Final = 500
"""Tasks that one WhatIf looks at."""
MOST_FORECAST_S: Final = 2.0
"""Time that it takes for that; a Method call has 3 s."""
MOST_EXPLAINED: Final = 50
"""Robots of a ranking that are explained, and as many of those that are no candidates."""
MOST_PAIR: Final = 100

Result = TypeVar("Result")
_TEXT: Final = int(BuiltinType.STRING)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_NUMBER: Final = int(BuiltinType.DOUBLE)
_NUMBERS: Final = int(BuiltinType.DOUBLE | ARRAY)
_COUNTS: Final = int(BuiltinType.INT32 | ARRAY)
_FLAG: Final = int(BuiltinType.BOOLEAN)
_SCENARIO: Final = MethodArgument("Scenario", _TEXT, "name of a scenario of the folder, or the text of one")
_RUN_ID: Final = MethodArgument("RunId", _TEXT, "the run")
_ROBOT: Final = MethodArgument("Robot", _TEXT, "name of a robot")
_ROBOT_OR_FAULT: Final = MethodArgument("Robot", _TEXT, "name of a robot: all its faults; or id of one, e.g. ur3.robot")
_PARAMETERS: Final = (
    MethodArgument("ParameterNames", _TEXTS, "parameters of the scenario; the others have their defaults"),
    MethodArgument("ParameterValues", _TEXTS, "their values, e.g. 20, true, left"),
)
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


class ScenarioMethods:
    """Answers the Methods."""

    def __init__(
        self,
        server: HardenedServer,
        parts: NodeFactory,
        nodes: ScenarioNodes,
        view: ScenarioView,
        service: ScenarioService,
        carried: CarriedRuns,
    ) -> None:
        """Prepare to answer; `build` makes the Methods.

        Args:
            server: whose Methods they are.
            parts: of the fleet.
            nodes: with the objects that have them.
            view: of runs and faults.
            service: does what is asked for.
            carried: does it for runs that bridges carry.
        """
        self._server, self._nodes, self._view, self._service = server, nodes, view, service
        self._carried = carried
        self._methods = MethodFactory(server, parts, _code_of)
        self._background = Places()
        """Of what computes for long, one for each user."""

    def build(self) -> None:
        """Make the Methods and let them be called."""
        observer, operator, engineer = Role.OBSERVER, Role.OPERATOR, Role.ENGINEER
        add = self._methods.add
        add(SCENARIOS, "List", observer, self._list, (), (
            MethodArgument("Names", _TEXTS, "the scenarios of the folder"),
            MethodArgument("Descriptions", _TEXTS, "what they are for"),
            MethodArgument("Problems", _COUNTS, "how many problems each has, as Validate tells them"),
        ))  # fmt: skip
        stored = MethodArgument("Name", _TEXT, "name of the scenario: letters, digits, _ and -")
        version = MethodArgument("Version", _TEXT, "the version that was read; empty for a scenario that is new")
        add(SCENARIOS, "Text", observer, self._text, (stored,), (
            MethodArgument("Text", _TEXT, "as it stands in the file"),
            MethodArgument("Version", _TEXT, "differs when the text differs"),
        ))  # fmt: skip
        add(SCENARIOS, "Store", engineer, self._store, (
            stored, MethodArgument("Text", _TEXT, "written as it stands, comments too"), version
        ), (
            MethodArgument("NewVersion", _TEXT, "of the text that was stored"),
            MethodArgument("Problems", _TEXTS, "all that is wrong with it; then nothing was stored"),
            MethodArgument("Lines", _COUNTS, "the line of each problem; 0 where it has none"),
        ))  # fmt: skip
        add(SCENARIOS, "Delete", engineer, self._delete, (stored, version), ())
        add(SCENARIOS, "Validate", operator, self._validate, (_SCENARIO,), (
            MethodArgument("Valid", _FLAG, "whether it can be run"),
            MethodArgument("Problems", _TEXTS, "all that is wrong with it"),
            MethodArgument("Lines", _COUNTS, "the line of each problem; 0 where it has none"),
        ))  # fmt: skip
        add(SCENARIOS, "Run", operator, self._run, (_SCENARIO, *_PARAMETERS), (_RUN_ID,))
        add(SCENARIOS, "Pause", operator, self._pause, (_RUN_ID,), ())
        add(SCENARIOS, "Resume", operator, self._resume, (_RUN_ID,), ())
        add(SCENARIOS, "Abort", operator, self._abort, (_RUN_ID, MethodArgument("Reason", _TEXT, "for people")), ())
        add(SCENARIOS, "Answer", operator, self._answer, (
            _RUN_ID,
            MethodArgument("Step", _TEXT, "key of the step, or name of its task"),
            MethodArgument("Answer", _TEXT, "done, retry, fail, or replace: another robot is looked for"),
        ), ())  # fmt: skip
        add(SCENARIOS, "DryRun", operator, self._dry_run, (
            _SCENARIO,
            *_PARAMETERS,
            MethodArgument("ValueNames", _TEXTS, "in place of those of now, and results: ur3.battery, fetch.weight"),
            MethodArgument("Values", _TEXTS, "these values"),
        ), (
            MethodArgument("Outcome", _TEXT, "done, failed, aborted; empty where it would not end"),
            MethodArgument("Reason", _TEXT, "why"),
            MethodArgument("Times", _NUMBERS, "seconds since the start"),
            MethodArgument("Steps", _TEXTS, "keys of the steps"),
            MethodArgument("Texts", _TEXTS, "what would happen then"),
        ))  # fmt: skip
        add(
            SCENARIOS,
            "TellEvent",
            operator,
            self._tell_event,
            (MethodArgument("Name", _TEXT, "name of the event"),),
            (),
        )
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

    async def _aside(self, work: Callable[..., Result], *arguments: Any) -> Result:
        """Do something that computes for long in a thread: one for each user at a time, until it is really done.

        A call that has taken too long ends, and its thread goes on; with one for each call a user would have them all.
        """
        place = self._background.of(_whom())
        await place.acquire()
        running = asyncio.ensure_future(asyncio.to_thread(work, *arguments))

        def done(ended: asyncio.Future[Result]) -> None:
            place.release()
            if not ended.cancelled():
                ended.exception()  # told to the caller, if it still waits

        running.add_done_callback(done)
        return await asyncio.shield(running)

    # Scenarios.

    async def _list(self) -> Sequence[Any]:
        listed = await self._aside(self._service.runs.listed)
        return (
            [one.name for one in listed],
            [one.description for one in listed],
            [one.problems for one in listed],
        )

    async def _text(self, name: str) -> Sequence[Any]:
        return await self._aside(self._service.library.stored, name)

    async def _store(self, name: str, text: str, version: str) -> Sequence[Any]:
        checked = await self._aside(self._service.library.store, name, text, version, self._service.fleet)
        if checked.problems:
            problems, lines = [str(one) for one in checked.problems], [one.line for one in checked.problems]
            raise NotValid(problems[0], ("", problems, lines))
        stored = version_of(text)
        _log.info("scenario stored", scenario=name, by=caller().name, version=stored, instead_of=version)
        return stored, [], []

    async def _delete(self, name: str, version: str) -> Sequence[Any]:
        await self._aside(self._service.library.delete, name, version)
        _log.info("scenario deleted", scenario=name, by=caller().name, version=version)
        return ()

    async def _validate(self, scenario: str) -> Sequence[Any]:
        _, problems = await self._aside(self._service.check, _short(scenario, MOST_BYTES))
        return not problems, [str(problem) for problem in problems], [problem.line for problem in problems]

    async def _run(self, scenario: str, names: list[str], values: list[str]) -> Sequence[Any]:
        valid = await self._aside(self._service.runs.valid, _short(scenario, MOST_BYTES))
        return (self._service.runs.start(valid, names, values, caller().name),)

    def _of(self, run_id: str) -> CarriedRuns | RunCommands:
        """Who has a run."""
        return self._carried if self._carried.has(run_id) else self._service.runs

    async def _pause(self, run_id: str) -> Sequence[Any]:
        self._of(run_id).pause(run_id, caller().name)
        return ()

    async def _resume(self, run_id: str) -> Sequence[Any]:
        self._of(run_id).resume(run_id, caller().name)
        return ()

    async def _abort(self, run_id: str, reason: str) -> Sequence[Any]:
        self._of(run_id).abort(run_id, reason, caller().name)
        return ()

    async def _answer(self, run_id: str, step: str, answer: str) -> Sequence[Any]:
        by = caller().name
        if self._carried.has(run_id):
            await said_by_bridges(partial(self._carried.answer, run_id, step, answer, by))
        else:
            self._service.runs.answer(run_id, step, answer, by)
        return ()

    async def _dry_run(
        self, scenario: str, names: list[str], values: list[str], given_names: list[str], given: list[str]
    ) -> Sequence[Any]:
        text = _short(scenario, MOST_BYTES)
        run = await self._aside(self._service.runs.rehearse, text, names, values, given_names, given)
        return (
            "" if run.outcome is None else run.outcome.value,
            run.reason,
            [moment.at for moment in run.timeline],
            [moment.step for moment in run.timeline],
            [moment.text for moment in run.timeline],
        )

    async def _tell_event(self, name: str) -> Sequence[Any]:
        self._service.runs.tell_event(name)
        return ()

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
        async with self._background.of(_whom()):
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
        weights = settings.weights()
        return float(weights.consistency_ratio), list(weights.names), list(weights.weights)

    async def _preview(self, decision_id: str, pairs: list[str], values: list[float]) -> Sequence[Any]:
        async with self._background.of(_whom()):  # it ranks all robots, in the event loop: one for each user at a time
            with _as_outputs():
                return _ranking_outputs(
                    self._service.decisions.preview(decision_id, _judgements(pairs, values) or None)
                )

    async def _judge_decision(self, decision_id: str, pairs: list[str], values: list[float]) -> Sequence[Any]:
        async with self._background.of(_whom()):
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


def _whom() -> str:
    """Whose place a call takes: the user's, or that of an address without one."""
    session, user = current_session.get(), caller()
    return f"at {origin(session.address)}" if user.anonymous and session is not None else user.name


def _short(text: str, most: int) -> str:
    if len(text) > most:
        raise ScenarioInvalid([f"a scenario has at most {most} characters"])
    return text


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


def _code_of(error: UaFleetError) -> int:
    if isinstance(error, ScenarioUnknown):
        return NOT_FOUND
    if isinstance(error, ScenarioInvalid | JudgementsInvalid):
        return NOT_VALID
    return NOT_POSSIBLE


def _may_speak_for_robots(user: User) -> bool:
    """Operators, and bridges, whose robots speak through them."""
    return bool(user.bridge) or user.role.covers(Role.OPERATOR)
