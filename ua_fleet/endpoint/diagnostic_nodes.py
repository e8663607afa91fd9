"""Variables that tell a structure, with a Variable for each of its fields, made when somebody browses it."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.data_types import DataTypes
from ua_fleet.endpoint.live import Guard, LiveValue
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, NodeBuilder
from ua_fleet.endpoint.stack import AttributeIds, ObjectIds, ns0
from ua_fleet.values import QualifiedName

__all__ = ["SERVER_NAMESPACE", "DiagnosticNodes"]

SERVER_NAMESPACE: Final = 1
"""Of the server's ApplicationUri, in which SessionIds are."""


class DiagnosticNodes:
    """Adds such Variables for what comes and goes, each with all that is added for the same `key`."""

    def __init__(self, space: AddressSpace) -> None:
        self._space, self._types = space, DataTypes(space)
        self.builder = NodeBuilder(space)
        self._live: dict[str, list[LiveValue]] = {}
        """The values that are told of changes, by what they are of."""

    def hold(self, key: str, live: LiveValue) -> None:
        """Have who watches a value told of its changes."""
        self._live.setdefault(key, []).append(live)

    def watched(self) -> Iterator[LiveValue]:
        """The values that somebody watches."""
        for values in list(self._live.values()):
            yield from [live for live in values if live.is_watched]

    def remove(self, key: str, node_id: ua.NodeId) -> None:
        """Remove a node with all below it, and forget the values that were added for `key`."""
        self.builder.remove(node_id)
        self._live.pop(key, None)

    def add_structure(
        self,
        key: str,
        path: str,
        name: QualifiedName,
        parent: ua.NodeId,
        type_id: int,
        make: Callable[[], Any],
        guard: Guard,
        encoded: Callable[[Any], Any] = lambda made: made,
    ) -> ua.NodeId:
        """A Variable of a structure.

        Args:
            key: what it is of.
            path: its NodeId behind the key.
            name: its BrowseName.
            parent: it is a component of this node.
            type_id: its VariableType, of the base namespace.
            make: gives an object with the fields.
            guard: who may read it.
            encoded: makes asyncua's object of that one.
        """
        live = LiveValue(lambda: encoded(make()), ua.VariantType.ExtensionObject, guard)
        data_type = self._value_of(ns0(type_id), AttributeIds.DataType)
        return self.add_variable(key, path, name, parent, type_id, (data_type, -1), live)

    def add_fields(
        self, key: str, path: str, node_id: ua.NodeId, type_id: int, make: Callable[[], Any], guard: Guard
    ) -> None:
        """Have the fields of a structure made when somebody browses it.

        It is the last thing that is done to it: a reference to it would be a browse.
        """

        def make_fields(owner: ua.NodeId) -> None:
            for reference in list(self._space[ns0(type_id)].references):
                if reference.IsForward and reference.ReferenceTypeId == HAS_COMPONENT:
                    self._add_field(key, path, owner, reference, make, guard)

        self.builder.add_later(node_id, make_fields)

    def _add_field(
        self,
        key: str,
        structure: str,
        owner: ua.NodeId,
        declared: ua.ReferenceDescription,
        make: Callable[[], Any],
        guard: Guard,
    ) -> None:
        field = str(declared.BrowseName.Name)
        data_type = self._value_of(declared.NodeId, AttributeIds.DataType)
        rank = int(self._value_of(declared.NodeId, AttributeIds.ValueRank))
        builtin = self._types.builtin_types(data_type)
        live = LiveValue(lambda: getattr(make(), field), ua.VariantType(min(builtin)), guard)
        name, type_id = QualifiedName(0, field), ObjectIds.BaseDataVariableType
        self.add_variable(key, f"{structure}.{field}", name, owner, type_id, (data_type, rank), live)

    def add_variable(
        self,
        key: str,
        path: str,
        name: QualifiedName,
        parent: ua.NodeId,
        type_id: int,
        value_type: tuple[ua.NodeId, int],
        live: LiveValue,
    ) -> ua.NodeId:
        """A Variable of a DataType and ValueRank."""
        node_id = raw_id(f"{key}.{path}", SERVER_NAMESPACE)
        data_type, rank = value_type
        held: HeldValue = live
        self.builder.add_variable(node_id, name, parent, ns0(type_id), data_type=data_type, value=held, value_rank=rank)
        self.hold(key, live)
        return node_id

    def _value_of(self, node_id: ua.NodeId, attribute: AttributeIds) -> Any:
        variant = self._space.read_attribute_value(node_id, attribute).Value
        assert variant is not None
        return variant.Value
