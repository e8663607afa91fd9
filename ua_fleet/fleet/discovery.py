"""Sources that `fleet.yaml` does not name: which of them get nodes, and which."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ua_fleet.fleet.changes import Change, Noticed, SourceAdded, SourceQuarantined, SourceReleased, SourceRemoved
from ua_fleet.fleet.model import DataSetModel, FieldModel, UnknownSources
from ua_fleet.fleet.turnover import MINUTE, LinePerMinute, PerMinute
from ua_fleet.pubsub.metadata import field_property, type_code
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, NodeId
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData

__all__ = ["Discovery", "data_set_from_metadata"]

MAX_FIELDS: Final = 500
"""Most fields of a source that gets nodes."""
MAX_NAME: Final = 128
"""Longest name that is shown; what is longer is cut."""
FIELDS_OF_ONE: Final = 20
"""Fields that unknown sources have, for each that there may be. A field takes 2 kB with its nodes."""
CHANGES_OF_ONE: Final = 5
"""Changes of its fields that one unknown source may make in a minute."""
CHANGES_OF_ALL: Final = 30
"""Those of all unknown sources. With the most fields each takes 50 ms."""
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


class _Known:
    """A source that was met."""

    __slots__ = ("aside_since", "changes", "is_listed", "metadata", "model")

    def __init__(self) -> None:
        self.metadata: DataSetMetaData | None = None
        """The last that was looked at."""
        self.model: DataSetModel | None = None
        """Its nodes, where it has any."""
        self.is_listed = False
        """Whether it is shown among those without nodes."""
        self.changes = PerMinute(CHANGES_OF_ONE)
        self.aside_since: int | None = None
        """When it has changed once too often, and was put aside."""

    def withdraw(self, topic: Topic) -> list[Change]:
        """Take back what is shown of it."""
        changes: list[Change] = []
        if self.is_listed:
            changes.append(SourceReleased(topic))
        if self.model is not None:
            changes.append(SourceRemoved(self.model))
        self.is_listed, self.model = False, None
        return changes


class Discovery:
    """Applies the policy for unknown sources, within its bounds.

    Nodes cost time when they are made and memory while they are there, and a source may announce others again and
    again. So one source changes its fields `CHANGES_OF_ONE` times a minute and all together do `CHANGES_OF_ALL` times,
    and they have `FIELDS_OF_ONE` fields for each source that there may be. What is beyond is listed with the reason.
    """

    def __init__(self, policy: UnknownSources, max_sources: int, namespaces: Sequence[int]) -> None:
        """Make it for a fleet whose namespaces have these indices."""
        self._policy = policy
        self._max_sources = max_sources
        self._namespaces = tuple(namespaces)
        self._known: dict[Topic, _Known] = {}
        self._fields = 0
        """Of all sources that have nodes."""
        self._changes = PerMinute(CHANGES_OF_ALL)
        self._changed, self._put_aside = LinePerMinute(), LinePerMinute()
        self._is_full = False

    def meet(self, topic: Topic, metadata: DataSetMetaData, now: int) -> tuple[DataSetModel | None, list[Change]]:
        """The nodes that a source has from now on, and what that changes."""
        if self._policy is UnknownSources.IGNORE:
            return None, []
        known = self._known.get(topic)
        if known is None:
            if len(self._known) >= self._max_sources:
                return None, self._refuse(topic)
            known = self._known[topic] = _Known()
        elif known.aside_since is not None:
            if 0 <= now - known.aside_since < MINUTE:
                return None, []
        elif known.metadata is metadata:
            return known.model, []
        made = self._make(topic, metadata, known)
        if known.aside_since is None and made == known.model:
            known.metadata = metadata
            return known.model, []
        if known.aside_since is None and isinstance(made, str) and known.model is None and known.metadata is not None:
            known.metadata = metadata
            return None, []
        is_first = known.metadata is None and known.aside_since is None
        if not is_first and not self._may_change(known, now):
            return None, self._aside(topic, metadata, known, now)
        known.metadata, known.aside_since = metadata, None
        changes = self._withdraw(topic, known)
        if isinstance(made, str):
            return None, changes + self._list(topic, metadata, known, made, now, is_first=is_first)
        known.model = made
        self._fields += len(made.fields)
        changes.append(SourceAdded(made))
        name = f"{topic.name} ({made.name})"
        text = f"{name} is not in fleet.yaml: it gets nodes"
        text = text if is_first else self._changed.say(f"{name} is another than before: it gets other nodes", now)
        return made, [*changes, Noticed(False, text, topic)] if text else changes

    def unannounced(self, topic: Topic) -> list[Change]:
        """A source sends data and never says what it is: it is listed, with what to do about it."""
        if self._policy is UnknownSources.IGNORE or topic in self._known:
            return []
        if len(self._known) >= self._max_sources:
            return self._refuse(topic)
        known = self._known[topic] = _Known()
        known.is_listed = True
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
        return self._withdraw(topic, known)

    def _may_change(self, known: _Known, now: int) -> bool:
        is_own = known.aside_since is not None or known.changes.take(now)
        return is_own and self._changes.take(now)

    def _aside(self, topic: Topic, metadata: DataSetMetaData, known: _Known, now: int) -> list[Change]:
        """Leave a source alone for a minute."""
        was_aside = known.aside_since is not None
        known.aside_since = now
        if was_aside:
            return []
        changes = self._withdraw(topic, known)
        why = (
            f"it changes its fields too often: more than {CHANGES_OF_ONE} times in a minute, "
            f"or {CHANGES_OF_ALL} times with other unknown sources; it is looked at again after a minute"
        )
        known.is_listed = True
        changes.append(SourceQuarantined(topic, metadata.name[:MAX_NAME], message_type_of(metadata), why))
        if text := self._put_aside.say(f"{topic.name} has no nodes: {why}", now):
            changes.append(Noticed(True, text, topic))
        return changes

    def _list(
        self, topic: Topic, metadata: DataSetMetaData, known: _Known, why: str, now: int, *, is_first: bool
    ) -> list[Change]:
        """Show a source among those without nodes."""
        known.is_listed = True
        name = metadata.name[:MAX_NAME]
        text = f"{topic.name} ({name}) has no nodes: {why}"
        text = text if is_first else self._changed.say(text, now)
        changes: list[Change] = [SourceQuarantined(topic, name, message_type_of(metadata), why)]
        return [*changes, Noticed(True, text, topic)] if text else changes

    def _withdraw(self, topic: Topic, known: _Known) -> list[Change]:
        if known.model is not None:
            self._fields -= len(known.model.fields)
        return known.withdraw(topic)

    def _refuse(self, topic: Topic) -> list[Change]:
        if self._is_full:
            return []
        self._is_full = True
        text = f"more than {self._max_sources} unknown sources; raise server.max_discovered_sources"
        return [Noticed(True, text, topic)]

    def _make(self, topic: Topic, metadata: DataSetMetaData, known: _Known) -> DataSetModel | str:
        if topic.ns not in self._namespaces:
            there = ", ".join(str(index) for index in self._namespaces)
            return f"its namespace index is none of the fleet's ({there})"
        if self._policy is UnknownSources.QUARANTINE:
            return "fleet.yaml does not name it (server.unknown_sources: quarantine)"
        made = data_set_from_metadata(topic, metadata)
        own = 0 if known.model is None else len(known.model.fields)
        most = FIELDS_OF_ONE * self._max_sources
        if isinstance(made, DataSetModel) and self._fields - own + len(made.fields) > most:
            return f"unknown sources have {most} fields already; raise server.max_discovered_sources"
        return made
