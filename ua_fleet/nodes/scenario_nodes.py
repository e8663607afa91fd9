"""The nodes below Fleet that runs, decisions and faults are seen by.

Scenarios: ScenariosType     Methods, Runs/<run id>: RunType
Resilience: ResilienceType   settings, Methods, Decisions/<decision id>: DecisionType
Faults: FaultsType           Methods, <fault id>: FaultAlarmType

All have stable string NodeIds, e.g. `Fleet.Scenarios.Runs.<run id>.State`.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from asyncua import ua
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.endpoint.convert import raw_id, to_variant
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, HAS_PROPERTY, spare_collection
from ua_fleet.endpoint.stack import ns0
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.nodes.alarms import SHARED_METHODS
from ua_fleet.nodes.hold_nodes import NOT_HELD
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.operation.runs.records import DecisionRecord, RunRecord, TaskRecord
from ua_fleet.orchestrator import Hold, ResilienceSettings
from ua_fleet.resilience import Ranking
from ua_fleet.values import ARRAY, BuiltinType, NodeId, QualifiedName, Variant, ticks_from_unix_ns

__all__ = ["FAULTS", "RESILIENCE", "SCENARIOS", "ScenarioNodes", "ranking_values", "ticks_of"]

SCENARIOS: Final = "Fleet.Scenarios"
RESILIENCE: Final = "Fleet.Resilience"
FAULTS: Final = "Fleet.Faults"

_TEXT: Final = int(BuiltinType.STRING)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_NUMBER: Final = int(BuiltinType.DOUBLE)
_NUMBERS: Final = int(BuiltinType.DOUBLE | ARRAY)
_TIME: Final = int(BuiltinType.DATETIME)
_TIMES: Final = int(BuiltinType.DATETIME | ARRAY)
_NO_TIME: Final = 0
"""The DateTime that stands for none, where an array has to have one."""
_FLAGS: Final = int(BuiltinType.BOOLEAN | ARRAY)
_COUNTS: Final = int(BuiltinType.INT32 | ARRAY)
_TWO_STATE: Final = ns0(ObjectIds.TwoStateVariableType)
_CONDITION_VARIABLE: Final = ns0(ObjectIds.ConditionVariableType)
SPARED_FAULTS: Final = 20
"""After so many new faults, of 34 nodes each, garbage collection is told not to look at them."""
_OWN_FIELDS: Final = ("Robot", "FaultSource", "Reason", "Capacities")

_Values = Mapping[str, Variant]


def ticks_of(wall_s: float) -> int:
    """Seconds of the wall clock as ticks."""
    return ticks_from_unix_ns(round(wall_s * 1e9))


def _time_of(wall_s: float | None) -> Variant:
    """A DateTime; null for None."""
    return Variant(_TIME, None if wall_s is None else ticks_of(wall_s))


def ranking_values(ranking: Ranking | None) -> dict[str, Variant]:
    """A ranking as flat arrays: raw values and scores of the best candidate first, then those of the next."""
    if ranking is None:
        return {
            **{name: Variant(_TEXTS, ()) for name in ("Robots", "Criteria", "Missing", "Excluded", "Reasons")},
            **{name: Variant(_NUMBERS, ()) for name in ("Scores", "Weights", "RawValues", "CriterionScores")},
            "ConsistencyRatio": Variant(_NUMBER, 0.0),
        }
    weights, ranked = ranking.weights, ranking.ranked
    return {
        "Robots": Variant(_TEXTS, tuple([place.robot for place in ranked])),
        "Scores": Variant(_NUMBERS, tuple([place.score for place in ranked])),
        "Criteria": Variant(_TEXTS, tuple(weights.names)),
        "Weights": Variant(_NUMBERS, tuple(weights.weights)),
        "RawValues": Variant(_NUMBERS, tuple([float(value) for place in ranked for value in place.raw])),
        "CriterionScores": Variant(_NUMBERS, tuple([value for place in ranked for value in place.scores])),
        "Missing": Variant(_TEXTS, tuple([text for place in ranked for text in place.missing])),
        "Excluded": Variant(_TEXTS, tuple([left.robot for left in ranking.excluded])),
        "Reasons": Variant(_TEXTS, tuple([left.reason for left in ranking.excluded])),
        "ConsistencyRatio": Variant(_NUMBER, float(weights.consistency_ratio)),
    }


class ScenarioNodes:
    """Makes and changes these nodes. Nodes are there at once; their values follow in order with all others."""

    def __init__(
        self,
        parts: NodeFactory,
        put: Callable[[ValueChanged], None],
        wall_ticks: Callable[[], int],
        bridges: Mapping[int, str] = {},
    ) -> None:
        """Prepare to make nodes.

        Args:
            parts: of the fleet whose object is there; its values are those that `put` writes to.
            put: has a value written.
            wall_ticks: the wall clock.
            bridges: their names, by their spaces.
        """
        self._bridge_names = bridges
        self._parts, self._put, self._wall_ticks = parts, put, wall_ticks
        self._known: dict[str, tuple[str, ...]] = {}
        """Objects that were made, with the names of their variables."""
        self._last: dict[NodeId, Variant] = {}
        self._faults_made = 0

    def key(self, path: str) -> NodeId:
        """The address of a node."""
        return NodeId(self._parts.ns, path)

    def build(self) -> None:
        """Make what is always there."""
        parts, fleet = self._parts, self._parts.id("Fleet")
        scenarios = parts.object(SCENARIOS, "Scenarios", fleet, TypeId.SCENARIOS)
        parts.folder(f"{SCENARIOS}.Runs", "Runs", scenarios)
        resilience = parts.object(RESILIENCE, "Resilience", fleet, TypeId.RESILIENCE)
        parts.folder(f"{RESILIENCE}.Decisions", "Decisions", resilience)
        parts.object(FAULTS, "Faults", fleet, TypeId.FAULTS)

    def show_run(self, record: RunRecord) -> None:
        """A run, as it is now."""
        rows = record.rows()
        columns = list(zip(*rows, strict=True)) or [()] * len(TaskRecord._fields)
        ended = record.ended
        values: dict[str, Variant] = {
            "State": Variant(_TEXT, record.shown_state),
            "Scenario": Variant(_TEXT, record.scenario),
            "Text": Variant(_TEXT, record.text),
            "StartTime": Variant(_TIME, ticks_of(record.started)),
            "EndTime": Variant(_TIME, None if ended is None else ticks_of(ended)),
            "StartedBy": Variant(_TEXT, record.state.by),
            "Parameters": Variant(_TEXT, record.parameters),
            "Reason": Variant(_TEXT, record.shown_reason),
        }
        for column, (name, kind) in enumerate(
            (
                ("Steps", _TEXTS),
                ("Tasks", _TEXTS),
                ("Robots", _TEXTS),
                ("Skills", _TEXTS),
                ("States", _TEXTS),
                ("Attempts", _COUNTS),
                ("Results", _TEXTS),
                ("Messages", _TEXTS),
            )
        ):
            values[name] = Variant(kind, tuple(columns[column]))
        for name, times in (("Begun", [row.begun for row in rows]), ("Ended", [row.ended for row in rows])):
            values[name] = Variant(_TIMES, tuple([_NO_TIME if at is None else ticks_of(at) for at in times]))
        values |= self._bridges_of(record)
        self._show(f"{SCENARIOS}.Runs.{record.run_id}", record.run_id, f"{SCENARIOS}.Runs", TypeId.RUN, values)

    def _bridges_of(self, record: RunRecord) -> _Values:
        """The bridges that carry a run; one that is no longer in fleet.yaml by its space."""
        told = record.bridges
        names = [self._bridge_names.get(space, f"space {space}") for space in told]
        return {
            "Bridges": Variant(_TEXTS, tuple(names)),
            "BridgeStates": Variant(_TEXTS, tuple([one.state for one in told.values()])),
            "Tokens": Variant(_FLAGS, tuple([one.has_token for one in told.values()])),
            "BridgeMessages": Variant(_TEXTS, tuple([one.message for one in told.values()])),
        }

    def show_decision(self, record: DecisionRecord) -> None:
        """A decision, as it is now."""
        values = {
            "State": Variant(_TEXT, record.state),
            "Run": Variant(_TEXT, record.run_id),
            "Step": Variant(_TEXT, record.step),
            "Task": Variant(_TEXT, record.task),
            "Failed": Variant(_TEXT, record.failed),
            "Reason": Variant(_TEXT, record.reason),
            "Chosen": Variant(_TEXT, record.chosen),
            "ChosenBy": Variant(_TEXT, record.by),
            "StartTime": _time_of(record.opened),
            "Deadline": _time_of(record.deadline),
            **ranking_values(record.ranking),
        }
        path = f"{RESILIENCE}.Decisions.{record.id}"
        self._show(path, record.id, f"{RESILIENCE}.Decisions", TypeId.DECISION, values)

    def show_settings(self, settings: ResilienceSettings) -> None:
        """How replacements are chosen."""
        weights = settings.weights
        judgements = settings.judgements
        units = {criterion.name: criterion.unit for criterion, _ in settings.criteria}
        values = {
            "Mode": Variant(_TEXT, settings.mode.value),
            "Limit": Variant(_NUMBER, settings.limit_s * 1000),
            "OnLimit": Variant(_TEXT, settings.on_limit.value),
            "Synthesis": Variant(_TEXT, settings.synthesis.value),
            "Criteria": Variant(_TEXTS, tuple(weights.names)),
            "Units": Variant(_TEXTS, tuple([units[name] for name in weights.names])),
            "Weights": Variant(_NUMBERS, tuple(weights.weights)),
            "ConsistencyRatio": Variant(_NUMBER, float(weights.consistency_ratio)),
            "JudgementNames": Variant(_TEXTS, tuple([f"{one}/{other}" for one, other in judgements])),
            "JudgementValues": Variant(_NUMBERS, tuple([float(value) for value in judgements.values()])),
        }
        if RESILIENCE not in self._known:
            self._add_variables(RESILIENCE, values)
        self._write(RESILIENCE, values)

    def show_hold(self, robot: str, hold: Hold | None) -> None:
        """By whom a robot is held back from tasks; None: by nobody."""
        values: _Values = NOT_HELD
        if hold is not None:
            texts = {"HeldBy": Variant(_TEXT, hold.by), "HeldReason": Variant(_TEXT, hold.reason)}
            since = Variant(_TIME, ticks_of(hold.since))
            values = {"Held": Variant(int(BuiltinType.BOOLEAN), True), "HeldSince": since, **texts}
        for name in values:  # the nodes may be new, where the robot has left the fleet and come again
            self._last.pop(self.key(f"Robots.{robot}.{name}"), None)
        self._write(f"Robots.{robot}", values)

    def show_fault(self, fault_id: str, fields: _Values) -> None:
        """A fault as an alarm: the same fields as its event has."""
        path = f"{FAULTS}.{fault_id}"
        fields = {name: field for name, field in fields.items() if name != "NodeId"}
        if path not in self._known:
            node = self._parts.object(path, fault_id, self._parts.id(FAULTS), TypeId.FAULT_ALARM, own_name=True)
            self._known[path] = tuple(fields)
            for name, field in sorted(fields.items(), key=lambda item: item[0].count("/")):
                self._add_field(path, node, name, field)
            for method in SHARED_METHODS:
                self._parts.builder.add_reference(node, HAS_COMPONENT, method)
            self._faults_made += 1  # each robot has few, and they stay
            if self._faults_made % SPARED_FAULTS == 0:
                spare_collection()
        self._write(path, {name.replace("/", "."): field for name, field in fields.items()})

    def forget(self, folder: str, name: str) -> None:
        """Remove a run or a decision of a folder."""
        path = f"{folder}.{name}"
        for member in self._known.pop(path, ()):
            self._last.pop(self.key(f"{path}.{member}"), None)
        self._parts.remove(self._parts.id(path))

    def _show(self, path: str, name: str, parent: str, kind: TypeId, values: _Values) -> None:
        if path not in self._known:
            self._parts.object(path, name, self._parts.id(parent), kind, own_name=True)
            self._add_variables(path, values)
        self._write(path, values)

    def _add_variables(self, path: str, values: _Values) -> None:
        self._known[path] = tuple(values)
        for name, variant in values.items():
            self._add(f"{path}.{name}", QualifiedName(TYPES_INDEX, name), self._parts.id(path), variant)

    def _add_field(self, path: str, node: ua.NodeId, name: str, field: Variant) -> None:
        owner, _, member = name.rpartition("/")
        parent = self._parts.id(f"{path}.{owner}") if owner else node
        type_definition, reference = STANDARD["PropertyType"], HAS_PROPERTY
        if name.endswith("State") and name not in ("NormalState",):
            type_definition, reference = _TWO_STATE, HAS_COMPONENT
        elif name in ("Quality", "LastSeverity", "Comment"):
            type_definition, reference = _CONDITION_VARIABLE, HAS_COMPONENT
        namespace = TYPES_INDEX if name in _OWN_FIELDS else 0
        self._add(
            f"{path}.{name.replace('/', '.')}",
            QualifiedName(namespace, member),
            parent,
            field,
            type_definition=type_definition,
            reference=reference,
        )

    def _add(
        self,
        path: str,
        name: QualifiedName,
        parent: ua.NodeId,
        value: Variant,
        *,
        type_definition: ua.NodeId | None = None,
        reference: ua.NodeId = HAS_COMPONENT,
    ) -> None:
        kind: Any = STANDARD["UtcTime"] if value.type in (_TIME, _TIMES) else raw_id(value.type & 0x3F)
        self._last[self.key(path)] = value
        self._parts.values[self.key(path)] = self._parts.builder.add_variable(
            self._parts.id(path),
            name,
            parent,
            type_definition or STANDARD["BaseDataVariableType"],
            data_type=kind,
            value=ua.DataValue(to_variant(value.type, value.value)),
            value_rank=1 if value.type & ARRAY else -1,
            reference=reference,
        )

    def _write(self, path: str, values: _Values) -> None:
        ticks = self._wall_ticks()
        for name, variant in values.items():
            key = self.key(f"{path}.{name}")
            if self._last.get(key) != variant:
                self._last[key] = variant
                self._put(ValueChanged(key, variant.type, variant.value, 0, ticks, False))
