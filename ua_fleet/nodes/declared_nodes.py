"""Objects of ObjectTypes of the standard, made as their types declare them.

What a member is (NodeClass, DataType, ValueRank, TypeDefinition, reference, ModellingRule) is read from the nodes of
the type, so that this file knows no type. A mandatory member without a value in the description has the one of its
declaration.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Final, NamedTuple

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.convert import data_value, raw_id, to_status
from ua_fleet.endpoint.data_types import DataTypes
from ua_fleet.endpoint.live import LiveValue
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, NodeBuilder
from ua_fleet.endpoint.stack import AttributeIds, ObjectIds, ns0
from ua_fleet.errors import ServerStartError
from ua_fleet.operation.pubsub.description import Description, Live
from ua_fleet.values import ARRAY, QualifiedName, Variant

__all__ = ["DeclaredNodes"]

_HAS_RULE: Final = ns0(ObjectIds.HasModellingRule)
_HAS_SUBTYPE: Final = ns0(ObjectIds.HasSubtype)
_MANDATORY: Final = ns0(ObjectIds.ModellingRule_Mandatory)
_OPTIONAL: Final = ns0(ObjectIds.ModellingRule_Optional)
_RULES: Final = (_MANDATORY, _OPTIONAL)
_MEMBER_CLASSES: Final = (ua.NodeClass.Object, ua.NodeClass.Variable, ua.NodeClass.Method)


class _Member(NamedTuple):
    """A member of a type, or of a member of one."""

    name: str
    declarations: tuple[ua.NodeId, ...]
    """The most special first."""
    reference: ua.NodeId
    node_class: ua.NodeClass
    is_mandatory: bool
    type: ua.NodeId


class _Model(LiveValue):
    """A value of a description that is computed when it is read, with its StatusCode."""

    __slots__ = ("_live", "_type_code")

    def __init__(self, live: Live, variant_type: ua.VariantType, type_code: int) -> None:
        super().__init__(live.now, variant_type)
        self._live, self._type_code = live, type_code

    @property
    def value(self) -> ua.DataValue:
        """A fresh DataValue."""
        content, status = self._live.now()
        return _data_value(self._type_code, content, status)

    @value.setter
    def value(self, value: ua.DataValue | None) -> None:
        """Nothing is kept."""


class DeclaredNodes:
    """Makes such Objects."""

    def __init__(self, space: AddressSpace, builder: NodeBuilder, ns: int) -> None:
        """Make Objects with string NodeIds in a namespace."""
        self._space, self._builder, self._ns, self._types = space, builder, ns, DataTypes(space)
        self._known: dict[tuple[ua.NodeId, ...], list[_Member]] = {}
        self._with_rules: dict[ua.NodeId, list[tuple[ua.ReferenceDescription, ua.NodeId]]] = {}
        """By declaration or type; a type as general as BaseObjectType is above each of them."""
        self.live: dict[ua.NodeId, LiveValue] = {}
        """The values that are computed, for who watches them."""

    def id(self, key: str) -> ua.NodeId:
        """The NodeId of an Object."""
        return raw_id(key, self._ns)

    def add_object(self, key: str, name: str, parent: ua.NodeId, type_name: str, reference: str) -> ua.NodeId:
        """An Object without its members."""
        node, kind = self.id(key), ns0(getattr(ObjectIds, type_name))
        via = ns0(getattr(ObjectIds, reference))
        self._builder.add_object(node, QualifiedName(self._ns, name), parent, kind, reference=via)
        return node

    def add_members(self, key: str, description: Description) -> None:
        """The members of an Object that is there."""
        self._add(key, "", self._chain(ns0(getattr(ObjectIds, description.type))), description)

    def fill(self, node: ua.NodeId, description: Description) -> None:
        """Give an Object that the standard's NodeSet has its values, as far as it has members of that name."""
        for reference in list(self._space[node].references):
            if reference.IsForward:
                self._fill(reference, "", description)

    def remove_members(self, key: str) -> None:
        """Remove what is below an Object."""
        owner = self.id(key)
        for reference in list(self._space[owner].references):
            if reference.IsForward and self._is_below(owner, reference.NodeId):
                self.forget(self._builder.remove(reference.NodeId))
            elif reference.IsForward and reference.NodeClass == ua.NodeClass.Method:
                self._builder.remove_reference(owner, HAS_COMPONENT, reference.NodeId)

    def forget(self, gone: list[ua.NodeId]) -> None:
        """Nodes are gone, and with them their values."""
        for node in gone:
            self.live.pop(node, None)

    def is_watched(self, key: str) -> bool:
        """Whether anybody is told of changes below an Object."""
        owner = self.id(key)
        return self._is_watched(owner, owner)

    def _is_watched(self, owner: ua.NodeId, node: ua.NodeId) -> bool:
        """Go through what is below the owner alone: a server has hundreds of thousands of other values."""
        for reference in self._space[node].references:
            if reference.IsForward and self._is_below(owner, reference.NodeId):
                live = self.live.get(reference.NodeId)
                if (live is not None and live.is_watched) or self._is_watched(owner, reference.NodeId):
                    return True
        return False

    def _is_below(self, owner: ua.NodeId, node: ua.NodeId) -> bool:
        start = f"{owner.Identifier!s}."
        return node.NamespaceIndex == self._ns and str(node.Identifier).startswith(start)

    def _add(self, owner: str, way: str, sources: tuple[ua.NodeId, ...], description: Description) -> None:
        parent = self.id(owner)
        for member in self._members(sources):
            path = f"{way}{member.name}"
            if member.node_class == ua.NodeClass.Method:
                if member.is_mandatory or path in description.methods:
                    self._builder.add_reference(parent, HAS_COMPONENT, member.declarations[-1])
                continue
            values = description.values
            if not member.is_mandatory and path not in values and path not in description.kinds:
                prefix = f"{path}."
                if not any(each.startswith(prefix) for each in values):
                    continue
            key, kind = f"{owner}.{member.name}", member.type
            if path in description.kinds:
                kind = ns0(getattr(ObjectIds, description.kinds[path]))
            if member.node_class == ua.NodeClass.Object:
                name = QualifiedName(0, member.name)
                self._builder.add_object(self.id(key), name, parent, kind, reference=member.reference)
            else:
                self._add_variable(key, member, parent, path, description)
            self._add(key, f"{path}.", (*member.declarations, *self._chain(kind)), description)

    def _add_variable(self, key: str, member: _Member, parent: ua.NodeId, path: str, description: Description) -> None:
        data_type, rank, declared = self._declared(member)
        content = description.values.get(path, declared)
        if content is None:
            raise ServerStartError(f"{description.type}.{path} is mandatory, and nothing says its value")
        if isinstance(content, Variant):
            # asyncua 2.1.0 has String where the standard has BaseDataType; a subtype is legal in any case.
            data_type = raw_id(content.type)
        held = self._held(content, data_type, rank)
        node = self.id(key)
        self._builder.add_variable(
            node,
            QualifiedName(0, member.name),
            parent,
            member.type,
            data_type=data_type,
            value=held,
            value_rank=rank,
            reference=member.reference,
        )
        if isinstance(held, LiveValue):
            self.live[node] = held

    def _held(self, content: Any, data_type: ua.NodeId, rank: int) -> HeldValue:
        code = min(self._types.builtin_types(data_type)) | (ARRAY if rank > 0 else 0)
        if isinstance(content, Live):
            return _Model(content, ua.VariantType(code & 0x3F), code)
        value = content.value if isinstance(content, Variant) else content
        return HeldValue(_data_value(code, value, 0))

    def _fill(self, reference: ua.ReferenceDescription, way: str, description: Description) -> None:
        path = f"{way}{reference.BrowseName.Name}"
        node = self._space.get(reference.NodeId)
        if node is None or reference.NodeClass == ua.NodeClass.Method:
            return
        if path in description.values and reference.NodeClass == ua.NodeClass.Variable:
            attributes: Any = node.attributes
            rank = attributes[AttributeIds.ValueRank].value.Value.Value
            data_type = attributes[AttributeIds.DataType].value.Value.Value
            held = attributes[AttributeIds.Value] = self._held(description.values[path], data_type, rank)
            if isinstance(held, LiveValue):
                self.live[reference.NodeId] = held
        for below in node.references:
            if below.IsForward and below.NodeClass in (ua.NodeClass.Object, ua.NodeClass.Variable):
                self._fill(below, f"{path}.", description)

    def _members(self, sources: tuple[ua.NodeId, ...]) -> list[_Member]:
        """The members that an Object with these declarations and types has; a special one hides a general one."""
        known = self._known.get(sources)
        if known is None:
            found: dict[str, _Member] = {}
            for source in sources:
                for reference, rule in self._ruled(source):
                    name = str(reference.BrowseName.Name)
                    before = found.get(name)
                    if before is None:
                        found[name] = _Member(
                            name,
                            (reference.NodeId,),
                            reference.ReferenceTypeId,
                            reference.NodeClass,
                            rule == _MANDATORY,
                            self._type_of(reference),
                        )
                    else:
                        found[name] = before._replace(declarations=(*before.declarations, reference.NodeId))
            known = self._known[sources] = list(found.values())
        return known

    def _ruled(self, source: ua.NodeId) -> list[tuple[ua.ReferenceDescription, ua.NodeId]]:
        """The members that a declaration or a type has, with their ModellingRules."""
        known = self._with_rules.get(source)
        if known is None:
            known = self._with_rules[source] = [
                (reference, below.NodeId)
                for reference in self._space[source].references
                if reference.IsForward and reference.NodeClass in _MEMBER_CLASSES
                # A rule is an Object, too, to which thousands of declarations refer.
                if reference.ReferenceTypeId != _HAS_RULE
                if (node := self._space.get(reference.NodeId)) is not None
                for below in node.references
                if below.IsForward and below.ReferenceTypeId == _HAS_RULE and below.NodeId in _RULES
            ]
        return known

    def _type_of(self, reference: ua.ReferenceDescription) -> ua.NodeId:
        has_type = ns0(ObjectIds.HasTypeDefinition)
        types = [
            each.NodeId
            for each in self._space[reference.NodeId].references
            if each.IsForward and each.ReferenceTypeId == has_type
        ]
        return types[0] if types else raw_id(0)

    def _chain(self, kind: ua.NodeId) -> tuple[ua.NodeId, ...]:
        """A type, and those that it is a subtype of."""
        chain: list[ua.NodeId] = []
        current: ua.NodeId | None = kind
        while current is not None and current in self._space:
            chain.append(current)
            above = (
                each.NodeId
                for each in self._space[current].references
                if each.ReferenceTypeId == _HAS_SUBTYPE and not each.IsForward
            )
            current = next(above, None)
        return tuple(chain)

    def _declared(self, member: _Member) -> tuple[ua.NodeId, int, Any]:
        """DataType, ValueRank and value of a Variable's declaration."""
        attributes: Any = self._space[member.declarations[0]].attributes
        values = (self._space[each].attributes.get(AttributeIds.Value) for each in member.declarations)
        held_values = [held.value for held in values if held is not None and held.value is not None]
        declared = [value.Value.Value for value in held_values if value.Value is not None]
        return (
            attributes[AttributeIds.DataType].value.Value.Value,
            int(attributes[AttributeIds.ValueRank].value.Value.Value),
            next((value for value in declared if value is not None), None),
        )


def _data_value(type_code: int, content: Any, status: int) -> ua.DataValue:
    now: Any = datetime.now(UTC)
    if content is None:
        return ua.DataValue(ua.Variant(), to_status(status), now, now)
    return data_value(type_code, tuple(content) if type_code & ARRAY else content, status, now, now)
