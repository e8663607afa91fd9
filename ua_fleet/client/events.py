# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""What a server tells of runs, steps, decisions and faults, as events of its Server object."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC
from typing import Any, Final

from asyncua import Client, ua
from asyncua.common.subscription import Subscription

from ua_fleet.client.convert import plain_value
from ua_fleet.client.subscriptions import Feed, Subscriptions
from ua_fleet.client.translated import translated
from ua_fleet.errors import NotConnected
from ua_fleet.topics import TYPES_URI

__all__ = [
    "DecisionTold",
    "FaultTold",
    "RankedRobot",
    "RankingInfo",
    "RunTold",
    "StepTold",
    "Told",
    "ranking_of",
    "told_by",
]

_FAULT, _RUN, _STEP, _DECISION = 1025, 1026, 1027, 1028
"""Event types; see nodesets/UaFleet.NodeIds.csv."""
_OWN: Final = (
    *("RunId", "Scenario", "State"),
    *("Fact", "Task", "Robot", "Skill", "Outcome", "Detail"),
    *("DecisionId", "DecisionState", "Failed", "Reason", "Chosen", "ChosenBy"),
    *("Robots", "Scores", "Criteria", "Weights", "RawValues", "CriterionScores", "Missing", "Excluded", "Reasons"),
    *("ConsistencyRatio", "FaultSource", "Capacities"),
)
"""Fields of ours that any of these types has."""
_STANDARD: Final = ("EventType", "Message", "ConditionName", "ActiveState/Id", "AckedState/Id", "Time")
_QUEUE: Final = 10_000
"""Events that may wait for a slow consumer; then the oldest is dropped, and counted in `FleetClient.dropped`."""


@dataclass(frozen=True, slots=True)
class RankedRobot:
    """One candidate's place in a ranking."""

    robot: str
    score: float
    """The scores of all candidates together are 1."""
    raw: tuple[float, ...]
    """Its value of each criterion as it counts, in the criterion's unit."""
    scores: tuple[float, ...]
    """What each of these is worth, before its weight."""
    missing: tuple[str, ...] = ()
    """For each of these: empty, or why the value is not known, and what counts in its place."""


@dataclass(frozen=True, slots=True)
class RankingInfo:
    """Who could take a task over, the best first, and why."""

    criteria: tuple[str, ...]
    weights: tuple[float, ...]
    consistency_ratio: float
    ranked: tuple[RankedRobot, ...]
    excluded: tuple[tuple[str, str], ...]
    """Robots that are no candidates, with the reason."""


@dataclass(frozen=True, slots=True)
class RunTold:
    """A run has begun, was paused, or has ended."""

    run_id: str
    scenario: str
    state: str
    message: str
    at: float
    """Seconds since 1970."""


@dataclass(frozen=True, slots=True)
class StepTold:
    """A fact of a run's journal about one of its steps."""

    run_id: str
    fact: str
    """E.g. `TaskAssigned` or `TaskOver`."""
    task: str
    robot: str
    skill: str
    outcome: str
    detail: Mapping[str, Any]
    """The fact itself."""
    at: float
    """Seconds since 1970."""


@dataclass(frozen=True, slots=True)
class DecisionTold:
    """A ranking was made or has changed, or a decision has ended."""

    run_id: str
    decision_id: str
    state: str
    """`open`, `chosen` or `aborted`."""
    task: str
    failed: str
    """The robot that cannot do it."""
    reason: str
    chosen: str
    chosen_by: str
    ranking: RankingInfo
    at: float
    """Seconds since 1970."""


@dataclass(frozen=True, slots=True)
class FaultTold:
    """A fault was found, seen by somebody, or is over."""

    fault_id: str
    robot: str
    source: str
    reason: str
    active: bool
    acknowledged: bool
    at: float
    """Seconds since 1970."""
    capacities: tuple[str, ...] = ()
    """What it takes away; empty: all."""


Told = RunTold | StepTold | DecisionTold | FaultTold


class _Events(Feed[Told]):
    """The subscription's handler, and what it hands on. A wait for the next event may be cancelled."""

    def __init__(self, types: Mapping[ua.NodeId, int], endpoint: str) -> None:
        super().__init__(_QUEUE)
        self._types, self._endpoint = types, endpoint

    def __aiter__(self) -> AsyncIterator[Told]:
        return self

    async def __anext__(self) -> Told:
        told = await self.next()
        if told is None:
            raise NotConnected(f"the connection to {self._endpoint} was lost")
        return told

    def event_notification(self, event: Any) -> None:
        """Called by asyncua with each event."""
        kind = self._types.get(event.EventType)
        if kind is not None:
            self.put(_told(kind, event))


@asynccontextmanager
async def told_by(client: Client, endpoint: str, subscriptions: Subscriptions) -> AsyncGenerator[AsyncIterator[Told]]:
    """Subscribe; all that the server tells from then on, until the context is left.

    Args:
        client: connected.
        endpoint: of the server, for messages.
        subscriptions: of the connection.
    """
    with translated(endpoint):
        index = await client.get_namespace_index(TYPES_URI)
        types = {ua.NodeId(ua.Int32(kind), ua.Int16(index)): kind for kind in (_FAULT, _RUN, _STEP, _DECISION)}
    events, wanted = _Events(types, endpoint), _filter(list(types), index)

    def begin(subscription: Subscription) -> Awaitable[object]:
        return subscription.subscribe_events(ua.ObjectIds.Server, evfilter=wanted, queuesize=_QUEUE)

    async with subscriptions.open(events, 50, begin):
        yield events


def _filter(types: Sequence[ua.NodeId], index: int) -> ua.EventFilter:
    wanted = ua.EventFilter()
    paths = [[ua.QualifiedName(part, 0) for part in name.split("/")] for name in _STANDARD]
    paths += [[ua.QualifiedName(name, index)] for name in _OWN]
    wanted.SelectClauses = [_operand(path) for path in paths]
    element = ua.ContentFilterElement()
    element.FilterOperator = ua.FilterOperator.InList
    element.FilterOperands = [
        _operand([ua.QualifiedName("EventType", 0)]),
        *(ua.LiteralOperand(Value=ua.Variant(one)) for one in types),
    ]
    wanted.WhereClause.Elements.append(element)
    return wanted


def _operand(path: list[ua.QualifiedName]) -> ua.SimpleAttributeOperand:
    return ua.SimpleAttributeOperand(
        TypeDefinitionId=ua.NodeId(ua.Int32(ua.ObjectIds.BaseEventType)),
        BrowsePath=path,
        AttributeId=ua.AttributeIds.Value,
    )


def _told(kind: int, event: Any) -> Told:
    if kind == _RUN:
        return RunTold(event.RunId, event.Scenario, event.State, event.Message.Text or "", _seconds(event))
    if kind == _STEP:
        detail: dict[str, Any] = (
            json.loads(event.Detail) if event.Detail.startswith("{") else {"question": event.Detail}
        )
        return StepTold(
            event.RunId, event.Fact, event.Task, event.Robot, event.Skill, event.Outcome, detail, _seconds(event)
        )
    if kind == _DECISION:
        return DecisionTold(
            event.RunId,
            event.DecisionId,
            event.DecisionState,
            event.Task,
            event.Failed,
            event.Reason,
            event.Chosen,
            event.ChosenBy,
            ranking_of(vars(event)),
            _seconds(event),
        )
    return FaultTold(
        event.ConditionName,
        event.Robot,
        event.FaultSource,
        event.Reason,
        bool(getattr(event, "ActiveState/Id")),
        bool(getattr(event, "AckedState/Id")),
        _seconds(event),
        tuple(event.Capacities or ()),
    )


def ranking_of(told: Mapping[str, Any]) -> RankingInfo:
    """A ranking of its flat arrays, by the names that events, nodes and Methods have for them."""
    criteria = tuple(plain_value(told["Criteria"] or []))
    width = len(criteria)
    columns = told["RawValues"] or [], told["CriterionScores"] or [], told["Missing"] or []
    ranked = tuple(
        RankedRobot(robot, score, *(tuple(column[at * width : (at + 1) * width]) for column in columns))
        for at, (robot, score) in enumerate(zip(told["Robots"] or [], told["Scores"] or [], strict=True))
    )
    excluded = tuple(zip(told["Excluded"] or [], told["Reasons"] or [], strict=True))
    return RankingInfo(criteria, tuple(told["Weights"] or []), float(told["ConsistencyRatio"]), ranked, excluded)


def _seconds(event: Any) -> float:
    time = event.Time
    return float((time if time.tzinfo is not None else time.replace(tzinfo=UTC)).timestamp())
