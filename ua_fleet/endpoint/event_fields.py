"""The fields of events that clients select: which there are, and what an event has of them (OPC 10000-4 7.22.3)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.indexrange import IndexRange, apply_range, parse_range
from ua_fleet.endpoint.kept_events import PastEvent
from ua_fleet.endpoint.stack import GOOD, AttributeIds, ObjectIds, Refusal, StatusCodes, ns0, status

__all__ = ["EventField", "EventFields", "field_of"]

_BASE: Final = ns0(ObjectIds.BaseEventType)
_HAS_SUBTYPE: Final = ns0(ObjectIds.HasSubtype)
_PARTS: Final = frozenset(
    ns0(reference) for reference in (ObjectIds.HasComponent, ObjectIds.HasOrderedComponent, ObjectIds.HasProperty)
)
_LAST_ATTRIBUTE: Final = max(int(attribute) for attribute in AttributeIds)
_DEEPEST: Final = 10
"""Names in a BrowsePath; no event of this server has a field that is deeper than three."""
_NO_FIELD: Final = ua.Variant()


class EventField:
    """A selected field, ready to be looked up in each event."""

    __slots__ = ("index_range", "name")

    def __init__(self, name: str, index_range: IndexRange | None) -> None:
        self.name = name
        """Its BrowsePath, as names; empty for one that no event has."""
        self.index_range = index_range

    def of(self, event: Any) -> ua.Variant:
        """What an event has of it; null for nothing."""
        if isinstance(event, PastEvent):
            variant = event.variant(self.name)
        else:
            known: dict[str, Any] = event.data_types
            value = getattr(event, self.name, None) if self.name in known else None
            if value is None:
                return _NO_FIELD
            variant = ua.Variant(value, known[self.name])
        if self.index_range is not None:
            return apply_range(ua.DataValue(variant), self.index_range).Value or _NO_FIELD
        return variant


def field_of(clause: ua.SimpleAttributeOperand) -> EventField:
    """The field of a select clause; one of a clause that is wrong is null in every event."""
    try:
        index_range = parse_range(clause.IndexRange)
    except Refusal:
        return EventField("", None)
    if not clause.BrowsePath:
        # Without a path it is an attribute of the event's ConditionId (OPC 10000-9 5.5.2.13).
        return EventField("NodeId" if clause.AttributeId == AttributeIds.NodeId else "", index_range)
    if clause.AttributeId != AttributeIds.Value:
        return EventField("", None)
    return EventField("/".join([part.Name or "" for part in clause.BrowsePath]), index_range)


class EventFields:
    """The fields that the server's EventTypes declare; each type is looked at once."""

    def __init__(self, aspace: AddressSpace) -> None:
        self._aspace = aspace
        self._below: dict[ua.NodeId, dict[str, ua.NodeId]] = {}
        self._subtypes: dict[ua.NodeId, list[ua.NodeId]] = {}
        self._event_types: dict[ua.NodeId, bool] = {}

    def check(self, clause: ua.SimpleAttributeOperand) -> ua.StatusCode:
        """The SelectClauseResult: Good, or why the clause selects nothing of any event."""
        code = self._wrong(clause)
        return GOOD if code is None else status(code)

    def check_all(self, clauses: Sequence[ua.SimpleAttributeOperand]) -> list[ua.StatusCode]:
        """The results of all select clauses."""
        return [self.check(clause) for clause in clauses]

    def _wrong(self, clause: ua.SimpleAttributeOperand) -> int | None:
        event_type = clause.TypeDefinitionId
        if event_type is None or event_type.is_null():
            event_type = _BASE
        if self._aspace.get(event_type) is None:
            return StatusCodes.BadNodeIdUnknown
        if not self._is_event_type(event_type):
            return StatusCodes.BadTypeDefinitionInvalid
        names = [part.Name for part in clause.BrowsePath or ()]
        if not all(names):
            return StatusCodes.BadBrowseNameInvalid
        if not 1 <= clause.AttributeId <= _LAST_ATTRIBUTE:
            return StatusCodes.BadAttributeIdInvalid
        try:
            parse_range(clause.IndexRange)
        except Refusal as error:
            return error.ua_status
        if not names:
            return None if clause.AttributeId == AttributeIds.NodeId else StatusCodes.BadAttributeIdInvalid
        # A subtype's event has its own fields, too, and BaseEventType stands for any (OPC 10000-4 7.22.3).
        found = self._find(event_type, names) if len(names) <= _DEEPEST else None
        if found is None:
            return StatusCodes.BadNodeIdUnknown
        if clause.AttributeId != AttributeIds.Value or not self._is_variable(found):
            return StatusCodes.BadAttributeIdInvalid
        return None

    def _find(self, event_type: ua.NodeId, names: Sequence[str | None]) -> ua.NodeId | None:
        current: ua.NodeId | None = event_type
        while current is not None:
            if (found := self._walk(current, names)) is not None:
                return found
            current = self._supertype(current)
        waiting = list(self._types_below(event_type))
        while waiting:
            subtype = waiting.pop()
            if (found := self._walk(subtype, names)) is not None:
                return found
            waiting += self._types_below(subtype)
        return None

    def _walk(self, start: ua.NodeId, names: Sequence[str | None]) -> ua.NodeId | None:
        current: ua.NodeId | None = start
        for name in names:
            current = self._parts(current).get(name or "") if current is not None else None
        return current

    def _parts(self, node_id: ua.NodeId) -> dict[str, ua.NodeId]:
        known = self._below.get(node_id)
        if known is None:
            known = self._below[node_id] = {
                reference.BrowseName.Name or "": reference.NodeId
                for reference in self._references(node_id)
                if reference.IsForward and reference.ReferenceTypeId in _PARTS
            }
        return known

    def _types_below(self, node_id: ua.NodeId) -> list[ua.NodeId]:
        known = self._subtypes.get(node_id)
        if known is None:
            known = self._subtypes[node_id] = [
                reference.NodeId
                for reference in self._references(node_id)
                if reference.IsForward and reference.ReferenceTypeId == _HAS_SUBTYPE
            ]
        return known

    def _references(self, node_id: ua.NodeId) -> Sequence[Any]:
        node = self._aspace.get(node_id)
        return node.references if node is not None else ()

    def _supertype(self, node_id: ua.NodeId) -> ua.NodeId | None:
        if node_id == _BASE:
            return None
        for reference in self._references(node_id):
            if not reference.IsForward and reference.ReferenceTypeId == _HAS_SUBTYPE:
                supertype: ua.NodeId = reference.NodeId
                return supertype
        return None

    def _is_event_type(self, node_id: ua.NodeId) -> bool:
        known = self._event_types.get(node_id)
        if known is None:
            current: ua.NodeId | None = node_id
            for _ in range(50):
                if current is None or current == _BASE:
                    break
                current = self._supertype(current)
            known = current == _BASE
            if known:  # what clients make up is not kept
                self._event_types[node_id] = known
        return known

    def _is_variable(self, node_id: ua.NodeId) -> bool:
        variant = self._aspace.read_attribute_value(node_id, AttributeIds.NodeClass).Value
        return variant is not None and variant.Value == ua.NodeClass.Variable
