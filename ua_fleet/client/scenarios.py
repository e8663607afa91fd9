# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Scenarios, faults and decisions of a server, by its Methods and nodes."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import aclosing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from asyncua import ua

from ua_fleet.client.events import RankingInfo, ranking_of
from ua_fleet.client.methods import NotDone, call_method, text, texts

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = [
    "DecisionInfo",
    "DryRunInfo",
    "FaultInfo",
    "Forecast",
    "JudgementsContradict",
    "NotDone",
    "Problem",
    "RunInfo",
    "ScenarioClient",
    "ScenarioInfo",
    "ScenarioRefused",
    "WouldHappen",
]

_NOT_VALID: Final = 2
"""ReturnStatus of what the server would refuse."""
_RANKING: Final = (
    *("Robots", "Scores", "Criteria", "Weights", "RawValues", "CriterionScores", "Missing", "Excluded", "Reasons"),
    "ConsistencyRatio",
)
"""Outputs of Preview and JudgeDecision."""
_OVER: Final = ("done", "failed", "aborted")
_ACKNOWLEDGE: Final = f"i={ua.ObjectIds.AcknowledgeableConditionType_Acknowledge}"
_ADD_COMMENT: Final = f"i={ua.ObjectIds.ConditionType_AddComment}"


@dataclass(frozen=True, slots=True)
class ScenarioInfo:
    """A scenario of the server's folder."""

    name: str
    description: str
    problems: int


@dataclass(frozen=True, slots=True)
class Problem:
    """A mistake in a scenario."""

    line: int
    text: str


@dataclass(frozen=True, slots=True)
class WouldHappen:
    """Something that a run would come to."""

    at_s: float
    """Since the start of the run."""
    step: str
    text: str


@dataclass(frozen=True, slots=True)
class DryRunInfo:
    """What a run would come to if every robot did at once what it is asked."""

    outcome: str
    """done, failed or aborted; empty where it would not end."""
    reason: str
    timeline: tuple[WouldHappen, ...]


@dataclass(frozen=True, slots=True)
class RunInfo:
    """A run as it is now; the tuples have an item for each task whose turn has come.

    `reason` says while it goes on what its tasks wait for, and in the end why it has ended.
    """

    run_id: str
    state: str
    scenario: str
    started: str | None
    """ISO 8601."""
    started_by: str
    reason: str
    tasks: tuple[str, ...]
    robots: tuple[str, ...]
    states: tuple[str, ...]
    results: tuple[str, ...]
    skills: tuple[str, ...]
    messages: tuple[str, ...] = ()

    @property
    def is_over(self) -> bool:
        """Whether it has ended."""
        return self.state in _OVER


@dataclass(frozen=True, slots=True)
class FaultInfo:
    """A fault of a robot."""

    fault_id: str
    robot: str
    source: str
    reason: str
    active: bool
    acknowledged: bool
    capacities: tuple[str, ...] = ()
    """What it takes away; empty: all."""
    since: str | None = None
    """Since when it is active, or is not any more; ISO 8601."""


@dataclass(frozen=True, slots=True)
class DecisionInfo:
    """A decision as it is now."""

    decision_id: str
    state: str
    task: str
    failed: str
    reason: str
    chosen: str
    chosen_by: str
    robots: tuple[str, ...]
    scores: tuple[float, ...]
    excluded: tuple[str, ...]
    reasons: tuple[str, ...]
    consistency_ratio: float
    missing: tuple[tuple[str, ...], ...] = ()
    """For each of the robots: which of its values are not known, why, and what counts in their place."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """Who would take over a task."""

    run_id: str
    task: str
    best: str
    explanation: str


class ScenarioRefused(NotDone):
    """A scenario was not stored, since it has problems."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__(_NOT_VALID, problems[0].text)


class JudgementsContradict(NotDone):
    """Judgements that no ranking is made of."""

    def __init__(self, message: str, consistency_ratio: float) -> None:
        self.consistency_ratio = consistency_ratio
        super().__init__(_NOT_VALID, message)


class ScenarioClient:
    """What people do with scenarios. Methods raise NotDone with the server's reason."""

    def __init__(self, client: FleetClient) -> None:
        self._client = client

    async def scenarios(self) -> list[ScenarioInfo]:
        """The scenarios that the server has."""
        names, descriptions, problems = await self._call("Scenarios", "List")
        return [ScenarioInfo(*row) for row in zip(names, descriptions, problems, strict=True)]

    async def validate(self, scenario: str, *, carried: bool = False) -> list[Problem]:
        """What is wrong with a scenario, given by its name or as a text.

        With `carried` also what keeps bridges from carrying a run of it.
        """
        method = "ValidateCarried" if carried else "Validate"
        _, texts, lines = await self._call("Scenarios", method, text(scenario))
        return [Problem(line, text) for line, text in zip(lines, texts, strict=True)]

    async def text(self, name: str) -> tuple[str, str]:
        """The text of a scenario of the server's folder, and its version."""
        stored, version = await self._call("Scenarios", "Text", text(name))
        return str(stored), str(version)

    async def store(self, name: str, scenario: str, version: str = "") -> str:
        """Put a text into the server's folder, in the place of the version that was read; the version that it has now.

        Raises:
            ScenarioRefused: all its problems, with their lines.
            NotDone: somebody has changed it since.
        """
        returned = await call_method(
            self._client, "Fleet.Scenarios", "Store", text(name), text(scenario), text(version)
        )
        stored, problems, lines = returned.outputs if returned.outputs else ("", (), ())
        if problems:
            raise ScenarioRefused([Problem(line, told) for line, told in zip(lines, problems, strict=True)])
        returned.check()
        return str(stored)

    async def delete(self, name: str, version: str) -> None:
        """Remove a scenario of the server's folder; NotDone where somebody has changed it since it was read."""
        await self._call("Scenarios", "Delete", text(name), text(version))

    async def run(self, scenario: str, parameters: Mapping[str, str] | None = None, *, carried: bool = False) -> str:
        """Start a run; its id. With `carried` bridges carry it, and the server only follows."""
        given = parameters or {}
        names, values = texts(list(given)), texts(list(given.values()))
        (run_id,) = await self._call("Scenarios", "RunCarried" if carried else "Run", text(scenario), names, values)
        return str(run_id)

    async def dry_run(
        self, scenario: str, parameters: Mapping[str, str] | None = None, values: Mapping[str, str] | None = None
    ) -> DryRunInfo:
        """What a run would come to; no robot hears of it.

        Args:
            scenario: its name, or a text.
            parameters: of the run.
            values: of robots (`ur3.battery`) and results of tasks (`fetch.weight`), for conditions.
        """
        given = [texts(list(part)) for pairs in (parameters or {}, values or {}) for part in (pairs, pairs.values())]
        outcome, reason, times, steps, told = await self._call("Scenarios", "DryRun", text(scenario), *given)
        timeline = tuple([WouldHappen(*row) for row in zip(times, steps, told, strict=True)])
        return DryRunInfo(outcome, reason, timeline)

    async def tell_event(self, name: str) -> None:
        """Say that an event has happened; the steps of all runs that wait for it go on."""
        await self._call("Scenarios", "TellEvent", text(name))

    async def pause(self, run_id: str) -> None:
        """Let a run start no further task."""
        await self._call("Scenarios", "Pause", text(run_id))

    async def resume(self, run_id: str) -> None:
        """Let a run go on."""
        await self._call("Scenarios", "Resume", text(run_id))

    async def abort(self, run_id: str, reason: str) -> None:
        """End a run."""
        await self._call("Scenarios", "Abort", text(run_id), text(reason))

    async def answer(self, run_id: str, step: str, answer: str) -> None:
        """Say what became of a task: done, retry, fail or replace."""
        await self._call("Scenarios", "Answer", text(run_id), text(step), text(answer))

    async def adopt(self, run_id: str, bridge: str, done: Sequence[str] = (), *, is_off: bool = True) -> str:
        """Say that a bridge of a carried run is off, and which tasks its robots have done; the bridge that goes on.

        The server refuses it where nobody says that it `is_off`.
        """
        tasks = ua.Variant(list(done), ua.VariantType.String, None, True)
        said = ua.Variant(is_off, ua.VariantType.Boolean)
        (heir,) = await self._call("Scenarios", "Adopt", text(run_id), text(bridge), said, tasks)
        return str(heir)

    async def run_info(self, run_id: str) -> RunInfo:
        """A run as it is now; NodeNotFound where there is none."""
        names = ("State", "Scenario", "StartTime", "StartedBy", "Reason")
        arrays = ("Tasks", "Robots", "States", "Results", "Skills", "Messages")
        state, scenario, started, by, reason, *columns = await self._read(f"Scenarios.Runs.{run_id}", (*names, *arrays))
        return RunInfo(run_id, state, scenario, started, by, reason, *(tuple(column or ()) for column in columns))

    async def runs(self) -> list[RunInfo]:
        """The runs that are under way, and the last ones that have ended."""
        return [await self.run_info(run_id) for run_id in await self._below("Scenarios.Runs")]

    async def follow(self, run_id: str) -> AsyncGenerator[RunInfo]:
        """A run now, and whenever something about it changes, until it has ended."""
        path = f"ns=2;s=Fleet.Scenarios.Runs.{run_id}"
        before: RunInfo | None = None
        watched = [f"{path}.{name}" for name in ("State", "States", "Robots", "Reason")]
        async with aclosing(self._client.watch(watched)) as changes:
            async for _ in changes:
                info = await self.run_info(run_id)
                if info != before:
                    before = info
                    yield info
                if info.is_over:
                    return

    async def faults(self) -> list[FaultInfo]:
        """Faults that are active, or that nobody has acknowledged."""
        found: list[FaultInfo] = []
        names = ("Robot", "FaultSource", "Reason", "ActiveState.Id", "AckedState.Id", "Capacities")
        for fault_id in await self._below("Faults"):
            robot, source, reason, active, seen, capacities = await self._read(f"Faults.{fault_id}", names)
            retain, since = await self._read(f"Faults.{fault_id}", ("Retain", "ActiveState.TransitionTime"))
            if retain:
                found.append(FaultInfo(fault_id, robot, source, reason, active, seen, tuple(capacities or ()), since))
        return found

    async def raise_fault(self, robot: str, reason: str, capacities: Sequence[str] = ()) -> None:
        """Say that a robot cannot work; others take its tasks over, as the mode has it.

        Args:
            robot: its name.
            reason: for people.
            capacities: what it cannot do any more; empty: anything.

        Raises:
            NotDone: it has not such a capacity, or the server refuses.
        """
        if capacities:
            reading = await self._client.read(f"ns=2;s=Robots.{robot}.Capacities")
            unknown = [name for name in capacities if name not in (reading.value or ())]
            if unknown:
                known = ", ".join(reading.value or ()) or "none"
                raise NotDone(_NOT_VALID, f"{robot} lacks the capacity {', '.join(unknown)}; it has: {known}")
            reason = f"{', '.join(capacities)}: {reason}"
        await self._call("Faults", "RaiseFault", text(robot), text(reason))

    async def clear_fault(self, robot: str) -> None:
        """Say that a robot can work again, or, by the id of a fault, that this one is over; not where the cause can be
        seen to be there still.
        """
        await self._call("Faults", "ClearFault", text(robot))

    async def acknowledge(self, fault_id: str, comment: str) -> None:
        """Say that a fault was seen; NodeNotFound where there is none."""
        await self._call_alarm(fault_id, _ACKNOWLEDGE, comment)

    async def comment(self, fault_id: str, comment: str) -> None:
        """Say something of a fault; NodeNotFound where there is none."""
        await self._call_alarm(fault_id, _ADD_COMMENT, comment)

    async def _call_alarm(self, fault_id: str, method: str, comment: str) -> None:
        (event_id,) = await self._read(f"Faults.{fault_id}", ("EventId",))
        await self._client.call(
            f"ns=2;s=Fleet.Faults.{fault_id}",
            method,
            ua.Variant(bytes.fromhex(event_id), ua.VariantType.ByteString),
            ua.Variant(ua.LocalizedText(comment), ua.VariantType.LocalizedText),
        )

    async def decisions(self) -> list[DecisionInfo]:
        """Decisions that are open, and the last that were made."""
        names = ("State", "Task", "Failed", "Reason", "Chosen", "ChosenBy")
        arrays = ("Robots", "Scores", "Missing", "Excluded", "Reasons")
        found: list[DecisionInfo] = []
        for decision_id in await self._below("Resilience.Decisions"):
            path = f"Resilience.Decisions.{decision_id}"
            state, task, failed, reason, chosen, by = await self._read(path, names)
            robots, scores, missing, excluded, reasons, ratio = await self._read(path, (*arrays, "ConsistencyRatio"))
            found.append(
                DecisionInfo(
                    decision_id,
                    state,
                    task,
                    failed,
                    reason,
                    chosen,
                    by,
                    robots=tuple(robots or ()),
                    scores=tuple(scores or ()),
                    missing=_by_robot(len(robots or ()), missing or ()),
                    excluded=tuple(excluded or ()),
                    reasons=tuple(reasons or ()),
                    consistency_ratio=ratio,
                )
            )
        return found

    async def confirm(self, decision_id: str, robot: str) -> str:
        """Choose who takes over: `taken`, or `repeated` where it was this robot before."""
        (outcome,) = await self._call("Resilience", "Confirm", text(decision_id), text(robot))
        return str(outcome)

    async def what_if(self, robot: str) -> list[Forecast]:
        """Who would take over each task that a robot has ahead."""
        columns = await self._call("Resilience", "WhatIf", text(robot))
        return [Forecast(*row) for row in zip(*columns, strict=True)]

    async def set_mode(self, mode: str, *, limit_s: float | None = None, on_limit: str = "") -> None:
        """Say who chooses a replacement from now on.

        Args:
            mode: operator, automatic or abort.
            limit_s: how long an operator may think; None leaves it.
            on_limit: what happens then, best_if_known, best or abort; empty leaves it.
        """
        seconds = ua.Variant(float(limit_s or 0.0), ua.VariantType.Double)
        await self._call("Resilience", "SetMode", text(mode), seconds, text(on_limit))

    async def set_judgements(self, judgements: Mapping[str, float]) -> dict[str, float]:
        """Compare the criteria in pairs, `{"battery/distance": 2}`; the weight of each that follows."""
        numbers = ua.Variant([float(value) for value in judgements.values()], ua.VariantType.Double, None, True)
        outputs = await self._call("Resilience", "SetJudgements", texts(list(judgements)), numbers)
        _, criteria, weights = outputs
        return dict(zip(criteria, weights, strict=True))

    async def preview(self, decision_id: str, judgements: Mapping[str, float] | None = None) -> RankingInfo:
        """The ranking of an open decision with other judgements; nothing changes by it.

        Raises:
            JudgementsContradict: these judgements do, with their consistency ratio.
        """
        return await self._ranked("Preview", decision_id, judgements or {})

    async def judge_decision(self, decision_id: str, judgements: Mapping[str, float] | None = None) -> RankingInfo:
        """Have one open decision ranked with these judgements, or without any by those of all. Raises as `preview`."""
        return await self._ranked("JudgeDecision", decision_id, judgements or {})

    async def _ranked(self, method: str, decision_id: str, judgements: Mapping[str, float]) -> RankingInfo:
        numbers = ua.Variant([float(value) for value in judgements.values()], ua.VariantType.Double, None, True)
        given = text(decision_id), texts(list(judgements)), numbers
        returned = await call_method(self._client, "Fleet.Resilience", method, *given)
        if returned.status == _NOT_VALID and returned.outputs:
            raise JudgementsContradict(returned.message, float(returned.outputs[-1] or 0.0))
        return ranking_of(dict(zip(_RANKING, returned.check(), strict=True)))

    async def _call(self, owner: str, name: str, *arguments: ua.Variant) -> list[Any]:
        return (await call_method(self._client, f"Fleet.{owner}", name, *arguments)).check()

    async def _read(self, path: str, names: Sequence[str]) -> list[Any]:
        readings = await self._client.read([f"ns=2;s=Fleet.{path}.{name}" for name in names])
        return [reading.value for reading in readings]

    async def _below(self, folder: str) -> list[str]:
        nodes = await self._client.browse(f"ns=2;s=Fleet.{folder}")
        return [node.browse_name for node in nodes if node.node_class == "Object"]


def _by_robot(robots: int, missing: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    width = len(missing) // robots if robots else 0
    return tuple(tuple(filter(None, missing[at * width : (at + 1) * width])) for at in range(robots))
