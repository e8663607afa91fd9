"""What the service says, as nodes and events: each output in its order."""

from __future__ import annotations

import secrets
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Final

from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.stack import ObjectIds, ns0
from ua_fleet.nodes.alarms import Comment, alarm_fields, alarm_message, severity_of
from ua_fleet.nodes.dialogs import DialogNodes
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.published_events import PublishedEvents
from ua_fleet.nodes.scenario_events import Told, decision_event, fact_event, hold_event, question_event
from ua_fleet.nodes.scenario_nodes import FAULTS, RESILIENCE, SCENARIOS, ScenarioNodes, ticks_of
from ua_fleet.operation.runs.records import DecisionRecord, RunRecord
from ua_fleet.orchestrator import (
    BridgesFollowed,
    DecisionChanged,
    Fault,
    FaultChanged,
    Hold,
    HoldChanged,
    OperatorAsked,
    Output,
    ResilienceSettings,
    RunChanged,
    TaskWaiting,
)
from ua_fleet.scenario.asking import question_about
from ua_fleet.scenario.facts import TaskOver, Then
from ua_fleet.scenario.state import TaskPhase
from ua_fleet.values import BuiltinType, NodeId, Variant, unix_ns_from_ticks

__all__ = ["ScenarioView"]

MOST_EVENT_IDS: Final = 32
"""Of each alarm: who acknowledges names the event that was seen."""
MOST_DECISIONS: Final = 100
"""Decisions that are shown; open ones always are."""


class ScenarioView:
    """Keeps the records, the nodes and the events of runs, decisions and faults."""

    def __init__(
        self,
        nodes: ScenarioNodes,
        events: ServerEvents,
        projection: Projection,
        wall_ticks: Callable[[], int],
        published: PublishedEvents | None = None,
        dialogs: DialogNodes | None = None,
    ) -> None:
        """Connect the parts; the projection makes the events in one order with the values of the nodes.

        `published` publishes events on PubSub too; `dialogs` shows what people have to decide as conditions.
        """
        self._nodes, self._events, self._projection, self._wall_ticks = nodes, events, projection, wall_ticks
        self._published, self.dialogs = published, dialogs
        self.runs: dict[str, RunRecord] = {}
        self.decisions: OrderedDict[str, DecisionRecord] = OrderedDict()
        self._event_ids: dict[str, deque[bytes]] = {}
        self._comments: dict[str, Comment] = {}
        self._faults: dict[str, Fault] = {}
        self._alarms: dict[str, tuple[Told, int]] = {}
        """What was told last of each fault that is retained, and when."""
        self._over_since: dict[str, int] = {}
        """Since when faults are not active any more."""

    def restored(self, records: Iterable[RunRecord], holds: Iterable[Hold]) -> None:
        """Show the runs and the held robots of the journal."""
        for hold in holds:
            self._nodes.show_hold(hold.robot, hold)
        for record in records:
            self.runs[record.run_id] = record
            self._nodes.show_run(record)

    def show_questions(self) -> None:
        """Show what bridges asked people when the server ended: the folder of alarms is there."""
        for record in self.runs.values():
            for step in record.state.in_phase(TaskPhase.ASKED):
                self._show_question(record, step)

    def show_settings(self, settings: ResilienceSettings) -> None:
        """Show how replacements are chosen."""
        self._nodes.show_settings(settings)

    def show(self, output: Output) -> None:
        """Show something that has happened."""
        self._show(output)
        if self.dialogs is not None:
            self.dialogs.take(output, self.runs, self.decisions)
        if isinstance(output, RunChanged) and isinstance(output.fact, TaskOver) and output.fact.then is Then.ASK:
            self._show_question(self.runs[output.run_id], output.fact.step)

    def _show_question(self, record: RunRecord, step: str) -> None:
        """Show what a bridge of a carried run asks people; of other runs, the orchestrator here says it."""
        state = record.state
        if state.carried and state.outcome is None and state.phase(step) is TaskPhase.ASKED:
            task = state.tasks[step]
            known = task.name, task.robot, question_about(task), task.skill, task.execution_id
            self.show(OperatorAsked(record.run_id, step, *known))

    def _show(self, output: Output) -> None:
        match output:
            case RunChanged(run_id=run_id, fact=fact):
                record = self.runs.get(run_id)
                if record is None:
                    record = self.runs[run_id] = RunRecord(run_id)
                record.apply(fact)
                self._nodes.show_run(record)
                self._tell_of_run(record, fact_event(record, fact))
            case TaskWaiting(run_id=run_id, waits=waits):
                if (record := self.runs.get(run_id)) is not None:
                    record.show_waiting(waits)
                    self._nodes.show_run(record)
            case BridgesFollowed(run_id=run_id, bridges=bridges):
                if (record := self.runs.get(run_id)) is not None:
                    record.show_bridges(bridges)
                    self._nodes.show_run(record)
            case OperatorAsked(run_id=run_id):
                record = self.runs[run_id]
                self._tell_of_run(record, question_event(record, output))
            case DecisionChanged():
                self._show_decision(output)
            case FaultChanged(fault=fault):
                self._faults[fault.id] = fault
                self._show_fault(fault)
            case HoldChanged(hold=hold, is_held=is_held):
                self._nodes.show_hold(hold.robot, hold if is_held else None)
                robot = self._nodes.key(f"Robots.{hold.robot}")
                told = hold_event(output)
                self._projection.then(partial(self._emit, told, robot, hold.robot, self._wall_ticks()))
            case _:
                pass

    def forget_run(self, run_id: str) -> None:
        """A run is no longer kept."""
        if self.runs.pop(run_id, None) is not None:
            self._projection.then(partial(self._nodes.forget, f"{SCENARIOS}.Runs", run_id))

    def fault_of(self, condition: NodeId) -> str | None:
        """The fault that a ConditionId stands for."""
        path = condition.identifier
        fault_id = path.removeprefix(f"{FAULTS}.") if isinstance(path, str) else ""
        return fault_id if self._nodes.key(f"{FAULTS}.{fault_id}") == condition and fault_id in self._faults else None

    def has_told(self, fault_id: str, event_id: bytes) -> bool:
        """Whether this was an event of a fault."""
        return event_id in self._event_ids.get(fault_id, ())

    def is_acknowledged(self, fault_id: str) -> bool:
        """Whether somebody has seen it."""
        return self._faults[fault_id].acknowledged

    def comment(self, fault_id: str, text: str, by: str, *, tell: bool) -> None:
        """Somebody says something of a fault."""
        self._comments[fault_id] = Comment(text, by, self._wall_ticks())
        if tell:
            self._show_fault(self._faults[fault_id])

    # Within.

    def _show_decision(self, changed: DecisionChanged) -> None:
        decision_id = changed.event.decision_id
        decision = self.decisions.get(decision_id)
        if decision is None:
            decision = self.decisions[decision_id] = DecisionRecord.of(changed)
        self.decisions.move_to_end(decision_id)
        decision.apply(changed, unix_ns_from_ticks(self._wall_ticks()) / 1e9)
        self._nodes.show_decision(decision)
        record = self.runs[changed.run_id]
        record.show_decision(decision, changed.until)
        self._nodes.show_run(record)
        told = decision_event(record, decision, changed)
        source = self._nodes.key(f"{RESILIENCE}.Decisions.{decision_id}")
        self._projection.then(partial(self._emit, told, source, decision_id, self._wall_ticks()))
        while len(self.decisions) > MOST_DECISIONS:
            oldest = next((one for one, known in self.decisions.items() if known.state != "open"), None)
            if oldest is None:
                break
            del self.decisions[oldest]
            self._projection.then(partial(self._nodes.forget, f"{RESILIENCE}.Decisions", oldest))

    def _show_fault(self, fault: Fault) -> None:
        event_id = secrets.token_bytes(16)
        self._event_ids.setdefault(fault.id, deque(maxlen=MOST_EVENT_IDS)).append(event_id)
        ticks = self._wall_ticks()
        condition = self._nodes.key(f"{FAULTS}.{fault.id}")
        if fault.active:
            self._over_since.pop(fault.id, None)
        since = ticks_of(fault.since) if fault.active else self._over_since.setdefault(fault.id, ticks)
        fields = alarm_fields(fault, condition, event_id, self._comments.get(fault.id, Comment()), ticks, since)
        self._nodes.show_fault(fault.id, fields)
        told = Told(TypeId.FAULT_ALARM, alarm_message(fault), severity_of(fault), fields)
        if fields["Retain"].value:
            self._alarms[fault.id] = told, ticks
        else:
            self._alarms.pop(fault.id, None)
        robot = self._nodes.key(f"Robots.{fault.robot}")
        self._projection.then(partial(self._emit, told, robot, fault.robot, ticks))

    def _tell_of_run(self, record: RunRecord, told: Told) -> None:
        source = self._nodes.key(f"{SCENARIOS}.Runs.{record.run_id}")
        self._projection.then(partial(self._emit, told, source, record.run_id, self._wall_ticks()))

    def refresh(
        self, subscription_id: int, item_id: int | None, others: Callable[[int, int | None], Iterator[None]]
    ) -> Iterator[None]:
        """Tell one subscription, or one of its items, all that is retained (ConditionRefresh, OPC 10000-9 5.5.7).

        `others` tells it of the conditions that are no faults. Each step tells of one at most, so that the caller can
        let others have their turn in between.
        """
        now = self._wall_ticks()
        self._frame(ObjectIds.RefreshStartEventType, subscription_id, item_id, now)
        yield
        for fault_id in list(self._alarms):
            if fault_id not in self._alarms:
                continue  # it is over since the refresh began
            told, ticks = self._alarms[fault_id]
            robot = self._faults[fault_id].robot
            self._emit(told, self._nodes.key(f"Robots.{robot}"), robot, ticks, subscription_id, item_id)
            yield
        yield from others(subscription_id, item_id)
        if self.dialogs is not None:
            yield from self.dialogs.refresh(subscription_id, item_id)
        yield
        self._frame(ObjectIds.RefreshEndEventType, subscription_id, item_id, now)

    def _frame(self, kind: int, subscription_id: int, item_id: int | None, ticks: int) -> None:
        self._events.emit(
            ns0(kind),
            source=NodeId(0, int(ObjectIds.Server)),
            source_name="Server",
            message="Refresh",
            severity=1,
            ticks=ticks,
            fields={},
            subscription_id=subscription_id,
            item_id=item_id,
        )

    def _emit(
        self,
        told: Told,
        source: NodeId,
        name: str,
        ticks: int,
        subscription_id: int | None = None,
        item_id: int | None = None,
    ) -> None:
        fields = told.fields
        if self._published is not None and subscription_id is None:
            event_id = secrets.token_bytes(16)
            fields = {"EventId": Variant(int(BuiltinType.BYTE_STRING), event_id), **fields}
            self._published.tell(told, event_id, source, name, ticks)
        self._events.emit(
            raw_id(told.kind.value, TYPES_INDEX),
            source=source,
            source_name=name,
            message=told.message,
            severity=told.severity,
            ticks=ticks,
            fields=fields,
            subscription_id=subscription_id,
            item_id=item_id,
        )
