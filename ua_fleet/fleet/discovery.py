"""Sources that `fleet.yaml` does not name: which of them get nodes, and which."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ua_fleet.fleet.changes import Change, Noticed, SourceAdded, SourceQuarantined, SourceReleased, SourceRemoved
from ua_fleet.fleet.model import DataSetModel, FieldModel, UnknownSources
from ua_fleet.pubsub.metadata import field_property, type_code
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, NodeId
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData

__all__ = ["Discovery", "data_set_from_metadata"]

MAX_FIELDS: Final = 500
"""Most fields of a source that gets nodes."""
MAX_NAME: Final = 128
"""Longest name that is shown; what is longer is cut."""
_NO_METADATA: Final = DataSetMetaData("", (), ConfigurationVersion(0, 0))
_TYPES: Final = frozenset(BuiltinType) - {BuiltinType.NULL, BuiltinType.DATA_VALUE, BuiltinType.DIAGNOSTIC_INFO}


def data_set_from_metadata(topic: Topic, metadata: DataSetMetaData) -> DataSetModel | str:
    """The nodes for a source with this metadata, or why there are none."""
    fields = metadata.fields
    if not fields:
        return "it announces no fields"
    if len(fields) > MAX_FIELDS:
        return f"it announces {len(fields)} fields, more than {MAX_FIELDS}"
    if any(field.builtin_type not in _TYPES for field in fields):
        return "it announces a field of a type that no Variable has"
    names = [field.name[:MAX_NAME] for field in fields]
    if len(set(names)) < len(names) or not all(names):
        return "the names of its fields are empty or not unique"
    name = metadata.name[:MAX_NAME] or topic.name
    if len(fields) == 1:
        only = _field(NodeId(topic.ns, topic.id), names[0], fields[0])
        return DataSetModel(topic, name, (only,), metadata.description.text or "")
    models = tuple(
        _field(NodeId(topic.ns, f"{topic.id}.{short}"), short, field)
        for short, field in zip(names, fields, strict=True)
    )
    return DataSetModel(topic, name, models, metadata.description.text or "", is_single=False)


def _field(key: NodeId, name: str, field: FieldMetaData) -> FieldModel:
    code = type_code(field)
    dimensions = field.array_dimensions
    is_fixed = code & ARRAY and not code & DIMENSIONS and len(dimensions) == 1
    return FieldModel(key, name, code, length=dimensions[0] if is_fixed else 0)


def message_type_of(metadata: DataSetMetaData) -> str:
    """The property RosType, or an empty text."""
    for field in metadata.fields:
        found = field_property(field, "RosType")
        if isinstance(found, str):
            return found[:MAX_NAME]
    return ""


class Discovery:
    """Applies the policy for unknown sources, within its bounds."""

    def __init__(self, policy: UnknownSources, max_sources: int, namespaces: Sequence[int]) -> None:
        """Make it for a fleet whose namespaces have these indices."""
        self._policy = policy
        self._max_sources = max_sources
        self._namespaces = tuple(namespaces)
        self._known: dict[Topic, tuple[DataSetMetaData, DataSetModel | None]] = {}
        self._is_full = False

    def meet(self, topic: Topic, metadata: DataSetMetaData) -> tuple[DataSetModel | None, list[Change]]:
        """The nodes that a source has from now on, and what that changes."""
        if self._policy is UnknownSources.IGNORE:
            return None, []
        known = self._known.get(topic)
        if known is not None and known[0] is metadata:
            return known[1], []
        if known is None and len(self._known) >= self._max_sources:
            return None, self._refuse(topic)
        before = known[1] if known is not None else None
        late: list[Change] = []
        if known is not None and known[0] is _NO_METADATA:
            known = None
            late.append(SourceReleased(topic))
        made = self._make(topic, metadata)
        if isinstance(made, DataSetModel):
            self._known[topic] = metadata, made
            if made == before:
                return before, []
            text = f"{topic.name} ({made.name}) is not in fleet.yaml: it gets nodes"
            added: list[Change] = [SourceAdded(made), Noticed(False, text, topic)]
            return made, [SourceRemoved(before), *added] if before is not None else [*late, *added]
        self._known[topic] = metadata, None
        changes: list[Change] = [SourceRemoved(before)] if before is not None else late
        if known is None or before is not None:
            name = metadata.name[:MAX_NAME]
            changes.append(SourceQuarantined(topic, name, message_type_of(metadata), made))
            changes.append(Noticed(True, f"{topic.name} ({name}) has no nodes: {made}", topic))
        return None, changes

    def unannounced(self, topic: Topic) -> list[Change]:
        """A source sends data and never says what it is: it is listed, with what to do about it."""
        if self._policy is UnknownSources.IGNORE or topic in self._known:
            return []
        if len(self._known) >= self._max_sources:
            return self._refuse(topic)
        self._known[topic] = _NO_METADATA, None
        why = "it announces no metadata; state its fields in `sources` of fleet.yaml"
        return [
            SourceQuarantined(topic, "", "", why),
            Noticed(True, f"{topic.name} has no nodes: {why}", topic),
        ]

    def forget(self, topic: Topic) -> list[Change]:
        """A robot has this source from now on."""
        known = self._known.pop(topic, None)
        if known is None:
            return []
        self._is_full = False
        return [SourceReleased(topic) if known[1] is None else SourceRemoved(known[1])]

    def _refuse(self, topic: Topic) -> list[Change]:
        if self._is_full:
            return []
        self._is_full = True
        text = f"more than {self._max_sources} unknown sources; raise server.max_discovered_sources"
        return [Noticed(True, text, topic)]

    def _make(self, topic: Topic, metadata: DataSetMetaData) -> DataSetModel | str:
        if topic.ns not in self._namespaces:
            there = ", ".join(str(index) for index in self._namespaces)
            return f"its namespace index is none of the fleet's ({there})"
        if self._policy is UnknownSources.QUARANTINE:
            return "fleet.yaml does not name it (server.unknown_sources: quarantine)"
        return data_set_from_metadata(topic, metadata)
