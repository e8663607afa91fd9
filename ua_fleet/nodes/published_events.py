"""The events of runs, steps and decisions as one DataSet: a PubSub message for each (OPC 10000-14 6.2.3.8).

All three types have one list of fields, as PublishedEvents selects them; a field that a type does not have is null.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from ua_fleet.fleet.commands import Publication
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.nodes.scenario_events import Told
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, LocalizedText, NodeId, Variant

__all__ = ["EVENTS_NAME", "EVENT_FIELDS", "PublishedEvents"]

EVENTS_NAME: Final = "ScenarioEvents"
PUBLISHED: Final = (TypeId.RUN_EVENT, TypeId.STEP_EVENT, TypeId.DECISION_EVENT)
_BASE: Final = {
    "EventId": BuiltinType.BYTE_STRING,
    "EventType": BuiltinType.NODE_ID,
    "SourceNode": BuiltinType.NODE_ID,
    "SourceName": BuiltinType.STRING,
    "Time": BuiltinType.DATETIME,
    "Message": BuiltinType.LOCALIZED_TEXT,
    "Severity": BuiltinType.UINT16,
}
_OWN: Final = (
    *("RunId", "Scenario", "State"),
    *("Fact", "Step", "Task", "Robot", "Skill", "Outcome", "Detail"),
    *("DecisionId", "DecisionState", "Failed", "Reason", "Chosen", "ChosenBy"),
)
EVENT_FIELDS: Final = (
    *[make_field(name, kind) for name, kind in _BASE.items()],
    *[make_field(name, BuiltinType.STRING) for name in _OWN],
)
_NULL: Final = Variant(int(BuiltinType.NULL), None)


class PublishedEvents:
    """Makes the messages of the DataSet and has them sent."""

    def __init__(self, topic: Topic, publish: Callable[[Publication], None]) -> None:
        """`publish` sends one message."""
        self.topic, self._publish = topic, publish

    def tell(self, told: Told, event_id: bytes, source: NodeId, source_name: str, ticks: int) -> None:
        """Publish an event as clients are told it; one of another type is left out."""
        if told.kind not in PUBLISHED:
            return
        base = {
            "EventId": event_id,
            "EventType": NodeId(TYPES_INDEX, told.kind.value),
            "SourceNode": source,
            "SourceName": source_name,
            "Time": ticks,
            "Message": LocalizedText(told.message),
            "Severity": told.severity,
        }
        fields: Mapping[str, Variant] = told.fields
        own = [fields.get(name, _NULL) for name in _OWN]
        types = (*[int(_BASE[name]) for name in base], *[variant.type for variant in own])
        self._publish(Publication(self.topic, types, (*base.values(), *[variant.value for variant in own]), ticks))
