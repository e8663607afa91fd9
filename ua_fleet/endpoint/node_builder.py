"""Nodes straight into asyncua's address space: the one place that knows how it keeps them.

asyncua's AddNodes service looks at every reference of the parent for each child and makes a dozen objects for each
attribute. Here attributes that many nodes have in common (AccessLevel, DataType, an often used name) are one object,
which nobody writes to, and the only own objects of a Variable are its NodeId and its Value (see `server.built`). A test
compares what clients see of such nodes with what AddNodes makes.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import gc
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager
from typing import Any, Final
from weakref import WeakValueDictionary

from asyncua import ua
from asyncua.server.address_space import AddressSpace, NodeData
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.endpoint.at_once import do_at_once
from ua_fleet.endpoint.compact_nodes import BuiltNode, ExpectantNode, HeldValue, NodeKind, Shared
from ua_fleet.endpoint.convert import raw_id, to_status
from ua_fleet.errors import ServerStartError
from ua_fleet.fleet.model import MAX_AGE_PREFIX
from ua_fleet.values import QualifiedName, StatusCode

__all__ = [
    "HAS_COMPONENT",
    "HAS_PROPERTY",
    "ORGANIZES",
    "NodeBuilder",
    "nodes_of",
    "paused_collection",
    "release_collection",
    "spare_collection",
]

HAS_COMPONENT: Final = raw_id(ObjectIds.HasComponent)
HAS_PROPERTY: Final = raw_id(ObjectIds.HasProperty)
ORGANIZES: Final = raw_id(ObjectIds.Organizes)
_TYPED: Final = (ua.NodeClass.Object, ua.NodeClass.Variable)
"""What has a type definition."""
_HAS_TYPE_DEFINITION: Final = raw_id(ObjectIds.HasTypeDefinition)

READ: Final = 1
"""Bit CurrentRead of AccessLevel (OPC 10000-3 8.57)."""
WRITE: Final = 2
"""Bit CurrentWrite of AccessLevel."""
HISTORY_READ: Final = 4
"""Bit HistoryRead of AccessLevel."""
TIMESTAMP_WRITE: Final = 64
"""Bit TimestampWrite of AccessLevel: the time that a client gives is the node's, and is published."""

LAZY_PREFIX: Final = "PubSub."
"""What the string ids begin with of nodes that are made when somebody wants the references of one above."""
ALARM_PREFIX: Final = "Alarms."
"""The same of alarms."""
_LONGEST_LAZY: Final = 300
"""Characters of such an id."""
_DIGITS: Final = 5
"""Of the largest number that a data source has."""

_TRUE: Final[Any] = True


@contextmanager
def paused_collection() -> Generator[None]:
    """No garbage collection while many objects are made that stay; afterwards it never looks at them again."""
    if not gc.isenabled():  # who has paused it for longer sees to the rest
        yield
        return
    gc.collect()  # what is garbage already must not stay too
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def spare_collection() -> None:
    """Have garbage collection look no more at what is there now, after many nodes were made that stay.

    Else it would look at all of them again and again, and the event loop stand for as long. What is in a cycle now, and
    ends later, is kept too: so this is for now and then.
    """
    if gc.isenabled():
        gc.freeze()


def release_collection() -> None:
    """Let garbage collection look at everything again: what was made to stay is of no use any more.

    An address space is full of cycles, so a process that serves a second time would keep the first one for ever.
    """
    gc.unfreeze()


def nodes_of(space: AddressSpace) -> Mapping[ua.NodeId, Any]:
    """The nodes that are made, by their ids: to go through them all without looking each up, which hashes its id."""
    return space._nodes  # noqa: SLF001 - it has no accessor


class _Nodes(dict[ua.NodeId, Any]):
    """The nodes of an address space, those included that are made when somebody wants them."""

    removed = 0
    """How many have been removed: what somebody knows of nodes is good until there is one more."""
    make: Callable[[ua.NodeId], None] | None = None
    """Makes a node, if it is one that waits for being wanted."""

    def __setitem__(self, key: ua.NodeId, node: Any) -> None:
        self.removed += super().__contains__(key)
        super().__setitem__(key, node)

    def __delitem__(self, key: ua.NodeId) -> None:
        self.removed += 1
        super().__delitem__(key)

    def clear(self) -> None:
        """Remove all."""
        self.removed += 1
        super().clear()

    def __missing__(self, key: ua.NodeId) -> Any:
        text = key.Identifier
        if isinstance(text, str) and text.startswith(MAX_AGE_PREFIX):
            number = text[len(MAX_AGE_PREFIX) :]
            if len(number) <= _DIGITS and number.isascii() and number.isdecimal():
                owner = super().get(raw_id(int(number), key.NamespaceIndex))
                if isinstance(owner, BuiltNode) and owner.references and (made := super().get(key)) is not None:
                    return made
        if isinstance(text, str) and text.startswith((LAZY_PREFIX, ALARM_PREFIX)) and len(text) <= _LONGEST_LAZY:
            made = self._made_below(key, text)
            if made is not None:
                return made
        if self.make is not None:
            self.make(key)
            if (made := super().get(key)) is not None:
                return made
        raise KeyError(key)

    def _made_below(self, key: ua.NodeId, text: str) -> Any:
        """A node that is made below the nearest one above it, or below one of those that are made there."""
        reached, above = "", text.rpartition(".")[0]
        while len(above) > len(reached):
            owner = super().get(raw_id(above, key.NamespaceIndex))
            if owner is None:
                above = above.rpartition(".")[0]
            elif not isinstance(owner, BuiltNode) or not owner.references:
                return None
            elif (made := super().get(key)) is not None:
                return made
            else:
                reached, above = above, text.rpartition(".")[0]
        return None

    def get(self, key: ua.NodeId, default: Any = None) -> Any:
        """The node with an id."""
        try:
            return self[key]
        except KeyError:
            return default

    def __contains__(self, key: object) -> bool:
        return self.get(key) is not None  # type: ignore[arg-type]  # as a dict's


class NodeBuilder:
    """Adds Objects, Variables and Methods to an address space, and removes them."""

    def __init__(self, space: AddressSpace) -> None:
        self._space = space
        if not isinstance(space._nodes, _Nodes):  # noqa: SLF001 - see the module's description
            space._nodes = _Nodes(space._nodes)  # noqa: SLF001
        # Names, and lengths of arrays, are a publisher's: they go with the last node that has them.
        self._shared: WeakValueDictionary[tuple[str, Any], Shared] = WeakValueDictionary()
        self._kinds: WeakValueDictionary[Any, NodeKind] = WeakValueDictionary()
        """What the nodes of a kind have in common, by all that makes it differ."""
        self._type_references: dict[ua.NodeId, ua.ReferenceDescription] = {}
        self._parent_references: dict[ua.NodeId, dict[ua.NodeId, ua.ReferenceDescription]] = {}

    def add_object(
        self,
        node_id: ua.NodeId,
        name: QualifiedName,
        parent: ua.NodeId,
        type_definition: ua.NodeId,
        *,
        reference: ua.NodeId = HAS_COMPONENT,
        description: str = "",
        display_name: str | None = None,
    ) -> None:
        """Add an Object."""
        kind = ua.NodeClass.Object
        attributes = self._kinds.get(kind)
        if attributes is None:
            attributes = self._kinds[kind] = self._common(kind)
            attributes[AttributeIds.EventNotifier] = self._share("Byte", 0, ua.VariantType.Byte)
        names = (name, description, display_name)
        self._add(node_id, names, parent, type_definition, reference, ua.NodeClass.Object, attributes, None)

    def add_variable(
        self,
        node_id: ua.NodeId,
        name: QualifiedName,
        parent: ua.NodeId,
        type_definition: ua.NodeId,
        *,
        data_type: ua.NodeId,
        value: ua.DataValue | HeldValue,
        value_rank: int = -1,
        array_length: int = 0,
        writable: bool = False,
        historizing: bool = False,
        reference: ua.NodeId = HAS_COMPONENT,
        description: str = "",
    ) -> HeldValue:
        """Add a Variable; returns what holds its value."""
        kind = (ua.NodeClass.Variable, data_type, value_rank, array_length, writable, historizing)
        attributes = self._kinds.get(kind)
        if attributes is None:
            attributes = self._kinds[kind] = self._common(ua.NodeClass.Variable)
            level = (READ | WRITE | TIMESTAMP_WRITE if writable else READ) | (HISTORY_READ if historizing else 0)
            access = self._share("Byte", level, ua.VariantType.Byte)
            attributes[AttributeIds.AccessLevel] = access
            attributes[AttributeIds.UserAccessLevel] = access
            attributes[AttributeIds.DataType] = self._share("DataType", data_type, ua.VariantType.NodeId)
            attributes[AttributeIds.ValueRank] = self._share("Int32", value_rank, ua.VariantType.Int32)
            attributes[AttributeIds.Historizing] = self._share("Boolean", historizing, ua.VariantType.Boolean)
            if value_rank > 0:
                dimensions = [array_length] * value_rank
                attributes[AttributeIds.ArrayDimensions] = self._share(
                    "ArrayDimensions", tuple(dimensions), ua.VariantType.UInt32, dimensions
                )
        held = value if isinstance(value, HeldValue) else HeldValue(value)
        names = (name, description, None)
        self._add(node_id, names, parent, type_definition, reference, ua.NodeClass.Variable, attributes, held)
        return held

    def add_method(
        self,
        node_id: ua.NodeId,
        name: QualifiedName,
        parent: ua.NodeId,
        *,
        description: str = "",
        executable: bool = True,
    ) -> None:
        """Add a Method; what it does is linked later."""
        kind = (ua.NodeClass.Method, executable)
        attributes = self._kinds.get(kind)
        if attributes is None:
            attributes = self._kinds[kind] = self._common(ua.NodeClass.Method)
            attributes[AttributeIds.Executable] = attributes[AttributeIds.UserExecutable] = self._share(
                "Boolean", executable, ua.VariantType.Boolean
            )
        names = (name, description, None)
        self._add(node_id, names, parent, None, HAS_COMPONENT, ua.NodeClass.Method, attributes, None)

    def add_later(self, node_id: ua.NodeId, make: Callable[[ua.NodeId], None]) -> None:
        """Have `make` add the node `MaxAge.<id>` below the node with this number when somebody wants it.

        It is looked for by its own id, or by who browses its parent. Each data source has one, and few are ever read.
        """
        owner: Any = self._space[node_id]
        owner.expect(make)

    def make_when_wanted(
        self, parents: Iterable[ua.NodeId], make_all: Callable[[], None], make: Callable[[ua.NodeId], None]
    ) -> None:
        """Have nodes made when somebody wants them; for one kind of nodes of an address space.

        Args:
            parents: nodes of the standard, whose references are wanted by who looks for them.
            make_all: makes all that wait.
            make: makes the one with this id, if it waits. Both do nothing for one that is being made.
        """
        for parent in parents:
            expectant: Any = ExpectantNode(self._space[parent], make_all)
            self._space[parent] = expectant
        nodes: Any = self._space._nodes  # noqa: SLF001 - see the module's description
        nodes.make = make

    def has(self, node_id: ua.NodeId) -> bool:
        """Whether there is such a node."""
        return node_id in self._space

    def add_reference(self, source: ua.NodeId, reference: ua.NodeId, target: ua.NodeId) -> None:
        """Add a reference between two nodes that are there, in both directions."""
        from_data, to_data = self._space[source], self._space[target]
        from_data.references.append(self._describe(reference, to_data, is_forward=True))
        to_data.references.append(self._describe(reference, from_data, is_forward=False))

    def remove_reference(self, source: ua.NodeId, reference: ua.NodeId, target: ua.NodeId) -> None:
        """Remove the references that `add_reference` has added."""
        for here, there in ((source, target), (target, source)):
            references = self._space[here].references
            is_forward = here is source
            references[:] = [
                found
                for found in references
                if (found.ReferenceTypeId, found.NodeId, found.IsForward) != (reference, there, is_forward)
            ]

    def is_referenced(self, node_id: ua.NodeId, reference: ua.NodeId) -> bool:
        """Whether any node refers to this one by a reference of this type."""
        references = self._space[node_id].references
        return any(found.ReferenceTypeId == reference and not found.IsForward for found in references)

    def remove(self, node_id: ua.NodeId) -> list[ua.NodeId]:
        """Remove a node with all that was added below it, and say which these were.

        Who watches any of it is told BadNodeIdUnknown. Only these nodes and those that they refer to are looked at:
        asyncua's DeleteNodes goes through the whole address space for each node.
        """
        gone = self._tree(node_id)
        outside = {
            reference.NodeId
            for data in gone.values()
            for reference in _made(data)
            if reference.NodeId not in gone and reference.ReferenceTypeId != _HAS_TYPE_DEFINITION  # types list nobody
        }
        for other in outside:
            if (around := self._space.get(other)) is not None:
                references = _made(around)
                references[:] = [reference for reference in references if reference.NodeId not in gone]
        for removed, data in gone.items():
            self._tell_gone(removed, data)
        for removed in gone:
            del self._space[removed]
            self._parent_references.pop(removed, None)
        return list(gone)

    def _tree(self, top: ua.NodeId) -> dict[ua.NodeId, NodeData]:
        """A node and those that were added below it, itself first."""
        data = self._space.get(top)
        if data is None:
            return {}
        found, waiting = {top: data}, [data]
        while waiting:
            parent = waiting.pop()
            for reference in _made(parent):
                child = self._space.get(reference.NodeId) if reference.IsForward else None
                # The reference to the parent that a node was added to is its first one.
                if child is not None and child.nodeid not in found and (references := _made(child)):
                    first = references[0]
                    if first.NodeId == parent.nodeid and not first.IsForward:
                        found[child.nodeid] = child
                        waiting.append(child)
        return found

    def _tell_gone(self, node_id: ua.NodeId, data: NodeData) -> None:
        gone = ua.DataValue(StatusCode=to_status(StatusCode.BAD_NODE_ID_UNKNOWN))
        watched = self._space._handle_to_attribute_map  # noqa: SLF001 - the only place that knows whose handle it is
        for attribute in data.attributes.values():
            for handle, callback in list(attribute.datachange_callbacks.items()):
                if watched[handle][0] == node_id:  # else another node's that shares the attribute
                    do_at_once(callback(handle, gone))
                    self._space.delete_datachange_callback(handle)

    def _add(
        self,
        node_id: ua.NodeId,
        names: tuple[QualifiedName, str, str | None],
        parent: ua.NodeId,
        type_definition: ua.NodeId | None,
        reference: ua.NodeId,
        node_class: ua.NodeClass,
        attributes: NodeKind,
        value: HeldValue | None,
    ) -> None:
        """Add a node; `names` are its BrowseName, its description, and what it is shown as where that differs."""
        if node_id in self._space:
            raise ServerStartError(f"two nodes would have the id {node_id.to_string()}; rename one of them")
        parent_data = self._space[parent]
        name, description, display_name = names
        text = display_name if display_name is not None else name.name
        browse_name = ua.QualifiedName(name.name, name.namespace)
        named = self._share("BrowseName", name, ua.VariantType.QualifiedName, browse_name)
        shown = self._share("LocalizedText", text, ua.VariantType.LocalizedText, ua.LocalizedText(text))
        target: Any = node_id
        own_type: Any = type_definition or raw_id(0)
        parent_data.references.append(
            ua.ReferenceDescription(reference, _TRUE, target, _held(named), _held(shown), node_class, own_type)
        )
        references = [self._to_parent(reference, parent_data)]
        if type_definition is not None:
            references.append(self._to_type(type_definition))
        told = self._share("LocalizedText", description, ua.VariantType.LocalizedText, ua.LocalizedText(description))
        data: Any = BuiltNode(node_id, named, shown, told, attributes, value, references)
        self._space[node_id] = data

    def _common(self, node_class: ua.NodeClass) -> NodeKind:
        no_mask = self._share("UInt32", 0, ua.VariantType.UInt32)
        return NodeKind(
            {
                AttributeIds.NodeClass: self._share("NodeClass", node_class, ua.VariantType.Int32),
                AttributeIds.WriteMask: no_mask,
                AttributeIds.UserWriteMask: no_mask,
            }
        )

    def _share(self, kind: str, key: Any, variant_type: ua.VariantType, value: Any = None) -> Shared:
        shared = self._shared.get((kind, key))
        if shared is None:
            variant = ua.Variant(key if value is None else value, variant_type)
            shared = self._shared[kind, key] = Shared(ua.DataValue(variant))
        return shared

    def _to_parent(self, reference: ua.NodeId, parent: NodeData) -> ua.ReferenceDescription:
        of_parent = self._parent_references.setdefault(parent.nodeid, {})
        known = of_parent.get(reference)
        if known is None:
            known = of_parent[reference] = self._describe(reference, parent, is_forward=False)
        return known

    def _to_type(self, type_definition: ua.NodeId) -> ua.ReferenceDescription:
        known = self._type_references.get(type_definition)
        if known is None:
            known = self._type_references[type_definition] = self._describe(
                _HAS_TYPE_DEFINITION, self._space[type_definition], is_forward=True
            )
        return known

    def _describe(self, reference: ua.NodeId, target: NodeData, *, is_forward: bool) -> ua.ReferenceDescription:
        node_class = _held(target.attributes[AttributeIds.NodeClass])
        type_definition: Any = raw_id(0)
        if node_class in _TYPED:  # a Method that many Objects share has as many references, and no type
            type_definition = next(
                (
                    one.NodeId
                    for one in target.references
                    if one.IsForward and one.ReferenceTypeId == _HAS_TYPE_DEFINITION
                ),
                type_definition,
            )
        forward: Any = is_forward
        identifier: Any = target.nodeid
        return ua.ReferenceDescription(
            reference,
            forward,
            identifier,
            _held(target.attributes[AttributeIds.BrowseName]),
            _held(target.attributes[AttributeIds.DisplayName]),
            node_class,
            type_definition,
        )


def _made(node: Any) -> list[ua.ReferenceDescription]:
    """References as far as they are made: nothing is made to be removed."""
    is_lazy = isinstance(node, BuiltNode | ExpectantNode)
    made: list[ua.ReferenceDescription] = node.made_references if is_lazy else node.references
    return made


def _held(attribute: Any) -> Any:
    assert attribute.value is not None
    assert attribute.value.Value is not None
    return attribute.value.Value.Value
