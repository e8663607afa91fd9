"""What people have to decide as DialogConditions (OPC 10000-9 5.6): which robot takes over, what became of a task.

Below `Fleet.Alarms`, `Dialogs.decision.<decision id>` and `Dialogs.question.<run id>.<step>`. They are projections: an
answer goes to the runs, as Confirm and Answer do, and the dialog ends when the run's journal says so, whoever answered.
So they outlive a restart as the runs do.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.convert import node_id, raw_id, to_variant
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, HAS_PROPERTY, ORGANIZES
from ua_fleet.endpoint.stack import ObjectIds, ns0
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.nodes.alarm_nodes import ALARMS
from ua_fleet.nodes.condition_fields import flag, node, number, status_field, string, text, time_of, two_state
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.projection import Projection
from ua_fleet.operation.runs.records import DecisionRecord, RunRecord
from ua_fleet.orchestrator import DecisionChanged, OperatorAsked, Output, RunChanged
from ua_fleet.scenario.state import TaskPhase
from ua_fleet.values import ARRAY, BuiltinType, LocalizedText, NodeId, QualifiedName, Variant

__all__ = ["ANSWERS", "Dialog", "DialogNodes"]

ANSWERS: Final = ("done", "retry", "fail", "replace")
"""What may be said of a task that nobody knows the end of; see `Scenarios.Answer`."""
MOST_DIALOGS: Final = 100
"""Dialogs that are shown; active ones always are."""
_SEVERITY: Final = 700
_NONE: Final = -1
_NULL: Final = NodeId(0, 0)
_KIND: Final = int(ObjectIds.DialogConditionType)
_METHODS: Final = (
    ObjectIds.ConditionType_Enable,
    ObjectIds.ConditionType_Disable,
    ObjectIds.DialogConditionType_Respond,
)
_TEXTS: Final = int(BuiltinType.LOCALIZED_TEXT | ARRAY)
_CONDITION_VARIABLES: Final = ("Quality", "LastSeverity", "Comment")


@dataclass(slots=True)
class Dialog:
    """One question to people."""

    id: str
    source: NodeId
    """The run or the decision."""
    source_name: str
    prompt: str
    options: tuple[str, ...]
    run_id: str
    step: str = ""
    """Of a question of a run; empty for a decision."""
    decision_id: str = ""
    active: bool = True
    last_response: int = _NONE
    event_id: bytes = b""
    ticks: int = 0
    shown: dict[str, Variant] = field(default_factory=dict[str, Variant])


class DialogNodes:
    """Shows dialogs, and makes their events."""

    def __init__(
        self, parts: NodeFactory, events: ServerEvents, projection: Projection, wall_ticks: Callable[[], int]
    ) -> None:
        """Prepare to show dialogs; the folder of alarms has to be there when the first one comes."""
        self._parts, self._events, self._projection, self._wall_ticks = parts, events, projection, wall_ticks
        self._dialogs: OrderedDict[NodeId, Dialog] = OrderedDict()

    def dialog_of(self, owner: ua.NodeId) -> Dialog | None:
        """The dialog of an Object that Methods are called of."""
        identifier: Any = owner.Identifier
        return self._dialogs.get(NodeId(int(owner.NamespaceIndex), identifier))

    def take(self, output: Output, runs: Mapping[str, RunRecord], decisions: Mapping[str, DecisionRecord]) -> None:
        """Something has happened to runs; the records have taken it in."""
        match output:
            case DecisionChanged():
                self._take_decision(output, decisions.get(output.event.decision_id))
            case OperatorAsked(run_id=run_id, step=step):
                prompt = f"{output.task}: {output.question}" if output.task else output.question
                self._open(f"question.{run_id}.{step}", f"Scenarios.Runs.{run_id}", run_id, prompt, ANSWERS, step=step)
            case RunChanged(run_id=run_id):
                run = runs.get(run_id)
                for dialog in [one for one in self._active() if one.run_id == run_id and one.step]:
                    if run is None or run.ended is not None or run.state.phase(dialog.step) is not TaskPhase.ASKED:
                        self._close(dialog, dialog.last_response)
            case _:
                pass

    def refresh(self, subscription_id: int, item_id: int | None) -> Iterator[None]:
        """Tell one subscription, or one of its items, the dialogs that are active, a step for each."""
        for dialog in self._active():
            yield
            if dialog.active:
                self._emit(dialog, dict(dialog.shown), subscription_id, item_id)

    # Within.

    def _active(self) -> list[Dialog]:
        return [dialog for dialog in self._dialogs.values() if dialog.active]

    def _take_decision(self, changed: DecisionChanged, record: DecisionRecord | None) -> None:
        dialog_id = f"decision.{changed.event.decision_id}"
        ranked = record.ranking.ranked if record is not None and record.ranking is not None else ()
        options = tuple(place.robot for place in ranked)
        if record is not None and record.state == "open" and options:
            prompt = f"{record.task}: who takes over from {record.failed or 'nobody'}? {record.reason}"
            path = f"Resilience.Decisions.{record.id}"
            self._open(dialog_id, path, changed.run_id, prompt, options, decision_id=record.id)
        elif (dialog := self._dialogs.get(self._key(dialog_id))) is not None and dialog.active:
            chosen = record.chosen if record is not None else ""
            self._close(dialog, dialog.options.index(chosen) if chosen in dialog.options else _NONE)

    def _open(
        self,
        dialog_id: str,
        source: str,
        run_id: str,
        prompt: str,
        options: tuple[str, ...],
        *,
        step: str = "",
        decision_id: str = "",
    ) -> None:
        key = self._key(dialog_id)
        before = self._dialogs.pop(key, None)
        shown = {} if before is None else before.shown
        owner = NodeId(self._parts.ns, f"Fleet.{source}")
        dialog = Dialog(dialog_id, owner, run_id, prompt, options, run_id, step, decision_id, shown=shown)
        self._dialogs[key] = dialog
        self._tell(dialog)
        while len(self._dialogs) > MOST_DIALOGS:
            oldest = next((one for one, known in self._dialogs.items() if not known.active), None)
            if oldest is None:
                break
            del self._dialogs[oldest]
            self._projection.then(partial(self._parts.remove, node_id(oldest)))

    def _close(self, dialog: Dialog, response: int) -> None:
        dialog.active, dialog.last_response = False, response
        self._tell(dialog)

    def _tell(self, dialog: Dialog) -> None:
        dialog.event_id, dialog.ticks = secrets.token_bytes(16), self._wall_ticks()
        fields = dict(_fields(dialog))
        if not dialog.shown:
            self._make(dialog, fields)
        for name, variant in fields.items():
            if dialog.shown.get(name) != variant:
                key = self._member(dialog, name)
                self._projection.write(ValueChanged(key, variant.type, variant.value, 0, dialog.ticks, False))
        dialog.shown = fields
        self._projection.then(partial(self._emit, dialog, fields))

    def _emit(
        self, dialog: Dialog, fields: dict[str, Variant], subscription_id: int | None = None, item_id: int | None = None
    ) -> None:
        self._events.emit(
            ns0(_KIND),
            source=dialog.source,
            source_name=dialog.source_name,
            message=dialog.prompt,
            severity=_SEVERITY,
            ticks=fields["Time"].value,
            fields={"NodeId": node(self._key(dialog.id)), **fields},
            subscription_id=subscription_id,
            item_id=item_id,
        )

    def _key(self, dialog_id: str) -> NodeId:
        return NodeId(self._parts.ns, f"Dialogs.{dialog_id}")

    def _member(self, dialog: Dialog, name: str) -> NodeId:
        return NodeId(self._parts.ns, f"Dialogs.{dialog.id}.{name.replace('/', '.')}")

    def _make(self, dialog: Dialog, fields: Mapping[str, Variant]) -> None:
        builder, owner = self._parts.builder, node_id(self._key(dialog.id))
        name = QualifiedName(self._parts.ns, dialog.id)
        builder.add_object(owner, name, self._parts.id(ALARMS), ns0(_KIND), reference=ORGANIZES)
        if builder.has(node_id(dialog.source)):
            builder.add_reference(node_id(dialog.source), ns0(ObjectIds.HasCondition), owner)
        for path in sorted(fields, key=lambda path: path.count("/")):
            above, _, member = path.rpartition("/")
            kind, reference = STANDARD["PropertyType"], HAS_PROPERTY
            if member.endswith("State"):
                kind, reference = ns0(ObjectIds.TwoStateVariableType), HAS_COMPONENT
            elif member in _CONDITION_VARIABLES:
                kind, reference = ns0(ObjectIds.ConditionVariableType), HAS_COMPONENT
            value = fields[path]
            is_time = value.type == int(BuiltinType.DATETIME)
            key = self._member(dialog, path)
            self._parts.values[key] = builder.add_variable(
                node_id(key),
                QualifiedName(0, member),
                node_id(self._member(dialog, above)) if above else owner,
                kind,
                data_type=STANDARD["UtcTime"] if is_time else raw_id(value.type & 0x3F),
                value=ua.DataValue(to_variant(value.type, value.value)),
                value_rank=1 if value.type & ARRAY else -1,
                reference=reference,
            )
        for method in _METHODS:
            builder.add_reference(owner, HAS_COMPONENT, ns0(method))


def _fields(dialog: Dialog) -> Iterator[tuple[str, Variant]]:
    """The fields of a dialog's event, and the values of its members."""
    yield "EventId", Variant(int(BuiltinType.BYTE_STRING), dialog.event_id)
    yield "EventType", node(NodeId(0, _KIND))
    yield "SourceNode", node(dialog.source)
    yield "SourceName", string(dialog.source_name)
    yield "Time", time_of(dialog.ticks)
    yield "ReceiveTime", time_of(dialog.ticks)
    yield "Message", text(dialog.prompt)
    yield "Severity", number(BuiltinType.UINT16, _SEVERITY)
    yield "ConditionClassId", node(NodeId(0, int(ObjectIds.SystemConditionClassType)))
    yield "ConditionClassName", text("SystemConditionClass")
    yield "ConditionName", string(dialog.id)
    yield "BranchId", node(_NULL)
    yield "Retain", flag(dialog.active)
    yield from two_state("EnabledState", True, "Enabled", "Disabled")
    yield from status_field("Quality", number(BuiltinType.STATUS_CODE, 0), dialog.ticks)
    yield from status_field("LastSeverity", number(BuiltinType.UINT16, _SEVERITY), dialog.ticks)
    yield from status_field("Comment", text(""), None)
    yield "ClientUserId", string("")
    yield from two_state("DialogState", dialog.active, "Active", "Inactive")
    yield "Prompt", text(dialog.prompt)
    yield "ResponseOptionSet", Variant(_TEXTS, tuple([LocalizedText(option) for option in dialog.options]))
    yield "DefaultResponse", number(BuiltinType.INT32, 0 if dialog.decision_id else _NONE)
    yield "OkResponse", number(BuiltinType.INT32, 0 if dialog.decision_id else _NONE)
    yield "CancelResponse", number(BuiltinType.INT32, _NONE)
    yield "LastResponse", number(BuiltinType.INT32, dialog.last_response)
