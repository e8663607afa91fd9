"""What the address space keeps of a node that we make, and of a value: the same for asyncua, in a third of its memory.

Asyncua has a dict of a dozen attributes for each node, and a dict of watchers for each of these. A fleet has tens of
thousands of nodes of a few kinds, so here the attributes that nodes of a kind have in common are one dict for all.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from asyncua import ua
from asyncua.server.address_space import NodeData
from asyncua.ua.attribute_ids import AttributeIds

__all__ = ["BuiltNode", "ExpectantNode", "HeldValue", "NodeKind", "Shared"]


class HeldValue:
    """The value of an attribute and who watches it; asyncua's AttributeValue."""

    __slots__ = ("_watchers", "encoded", "value", "value_callback", "value_setter")

    def __init__(self, value: ua.DataValue | None) -> None:
        self.value = value
        self.value_callback: Callable[..., ua.DataValue] | None = None
        self.value_setter: Callable[..., None] | None = None
        self._watchers: dict[int, Callable[..., Any]] | None = None
        self.encoded: tuple[ua.DataValue, bytes] | None = None
        """The value that was encoded last, and its bytes; of no use once there is another one."""

    @property
    def datachange_callbacks(self) -> dict[int, Callable[..., Any]]:
        """Who is told of a change, by handle."""
        if self._watchers is None:
            self._watchers = {}
        return self._watchers

    @property
    def is_watched(self) -> bool:
        """Whether anybody is told of a change."""
        return bool(self._watchers)

    @property
    def is_watched_by_several(self) -> bool:
        """Whether more than one is told of a change."""
        return self._watchers is not None and len(self._watchers) > 1


class Shared(HeldValue):
    """The value of an attribute that several nodes have, for as long as one of them is there."""

    __slots__ = ("__weakref__",)


class NodeKind(dict[AttributeIds, HeldValue]):
    """The attributes that the nodes of a kind have in common, for as long as one of them is there."""

    __slots__ = ("__weakref__",)


class ExpectantNode:
    """asyncua's NodeData of a node below which nodes come and go that are made when somebody wants its references."""

    __slots__ = ("_make", "attributes", "call", "made_references", "nodeid")

    def __init__(self, node: NodeData, make: Callable[[], None]) -> None:
        """Take the place of a node; `make` makes what waits to be made."""
        self._make = make
        self.nodeid, self.attributes, self.call = node.nodeid, node.attributes, node.call
        self.made_references = node.references
        """Its references as far as they are made."""

    @property
    def references(self) -> list[ua.ReferenceDescription]:
        """Its references; what waits is made now."""
        self._make()
        return self.made_references

    @references.setter
    def references(self, references: list[ua.ReferenceDescription]) -> None:
        self.made_references = references


class BuiltNode(Mapping[AttributeIds, HeldValue]):
    """A node; asyncua's NodeData. It is the mapping of its attributes itself, so that none has to be kept."""

    __slots__ = (
        "_browse_name",
        "_description",
        "_display_name",
        "_id",
        "_more",
        "_references",
        "_shared",
        "_value",
        "call",
        "nodeid",
    )

    def __init__(
        self,
        nodeid: ua.NodeId,
        browse_name: HeldValue,
        display_name: HeldValue,
        description: HeldValue,
        shared: Mapping[AttributeIds, HeldValue],
        value: HeldValue | None,
        references: list[ua.ReferenceDescription],
    ) -> None:
        """Make a node.

        Args:
            nodeid: its id.
            browse_name: its BrowseName, which others may have too; nobody writes to it.
            display_name: its DisplayName, in the same way.
            description: its Description, in the same way.
            shared: the other attributes, which it has in common with nodes of its kind.
            value: of a Variable, what holds its value.
            references: its own.
        """
        self.nodeid = nodeid
        self.call: Callable[..., Any] | None = None
        self._browse_name, self._display_name, self._description = browse_name, display_name, description
        self._shared = shared
        self._value = value
        self._id: HeldValue | None = None
        self._references = references
        self._more: Callable[[ua.NodeId], None] | None = None

    @property
    def references(self) -> list[ua.ReferenceDescription]:
        """Its references; what is made when it is wanted is made now."""
        if self._more is not None:
            more, self._more = self._more, None
            more(self.nodeid)
        return self._references

    @property
    def made_references(self) -> list[ua.ReferenceDescription]:
        """Its references as far as they are made."""
        return self._references

    def expect(self, more: Callable[[ua.NodeId], None]) -> None:
        """Have `more` add nodes below this one when somebody wants its references."""
        self._more = more

    @property
    def attributes(self) -> BuiltNode:
        """Its attributes by their ids."""
        return self

    def __eq__(self, other: object) -> bool:
        return self is other  # not any other node with the same attributes

    def __hash__(self) -> int:
        return id(self)

    def get(self, key: AttributeIds, default: Any = None) -> Any:
        """What holds an attribute."""
        if key == AttributeIds.Value:
            return default if self._value is None else self._value
        found = self._shared.get(key)
        if found is not None:
            return found
        if key == AttributeIds.BrowseName:
            return self._browse_name
        if key == AttributeIds.DisplayName:
            return self._display_name
        if key == AttributeIds.Description:
            return self._description
        if key == AttributeIds.NodeId:
            if self._id is None:
                self._id = HeldValue(ua.DataValue(ua.Variant(self.nodeid, ua.VariantType.NodeId)))
            return self._id
        return default

    def __getitem__(self, key: AttributeIds) -> HeldValue:
        found: HeldValue | None = self.get(key)
        if found is None:
            raise KeyError(key)
        return found

    def __contains__(self, key: object) -> bool:
        return self.get(key) is not None  # type: ignore[arg-type]  # what is no attribute's id is not found

    def __iter__(self) -> Iterator[AttributeIds]:
        yield from (AttributeIds.NodeId, AttributeIds.BrowseName, AttributeIds.DisplayName, AttributeIds.Description)
        if self._value is not None:
            yield AttributeIds.Value
        yield from self._shared

    def __len__(self) -> int:
        return 4 + (self._value is not None) + len(self._shared)
