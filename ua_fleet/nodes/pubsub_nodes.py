"""The information model of PubSub below the standard's Object PublishSubscribe (OPC 10000-14 clause 9).

PublishSubscribe (i=14443)
  Status, Diagnostics, SupportedTransportProfiles, PubSubCapablities
  PublishedDataSets
    <connection>
      <DataSet>                  ConfigurationVersion, DataSetMetaData, PublishedData
  <connection>                   of the server, and of each bridge that has announced its own; further ones of theirs
    Status, Address, ..., Diagnostics
    <WriterGroup>
      <DataSetWriter>
    <ReaderGroup>
      <DataSetReader>

A fleet has tens of thousands of DataSetWriters and DataSetReaders. So those of a group are made when somebody browses
the group, and the members of each when somebody browses or reads there; of MOST_OPEN Objects they are kept at a time.
What anybody watches stays.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.live import LiveValue
from ua_fleet.endpoint.node_builder import NodeBuilder
from ua_fleet.endpoint.stack import ObjectIds, ns0
from ua_fleet.nodes.declared_nodes import DeclaredNodes
from ua_fleet.operation.pubsub.connections import ShownConnection
from ua_fleet.operation.pubsub.description import Description
from ua_fleet.operation.pubsub.difference import Part, difference
from ua_fleet.pubsub.components import CONNECTION, Component, parent_of
from ua_fleet.topics import Topic

__all__ = ["PubSubNodes"]

MOST_OPEN: Final = 256
"""DataSetWriters, DataSetReaders and PublishedDataSets whose members are kept."""
_MOST_LOOKED_AT: Final = 8
"""Objects of which it is looked, when another one is opened, whether they can be closed."""
_ROOT: Final = ns0(ObjectIds.PublishSubscribe)
_DATA_SETS: Final = ns0(ObjectIds.PublishSubscribe_PublishedDataSets)
_DATA_SET_TO_WRITER: Final = ns0(ObjectIds.DataSetToWriter)
_TYPES: Final[Mapping[tuple[str, int], tuple[str, str]]] = {
    ("W", 2): ("WriterGroupType", "HasWriterGroup"),
    ("W", 3): ("DataSetWriterType", "HasDataSetWriter"),
    ("R", 2): ("ReaderGroupType", "HasReaderGroup"),
    ("R", 4): ("DataSetReaderType", "HasDataSetReader"),
}
"""ObjectType, and the reference to it, by the first letter and the length of a component's name."""


class _Tree:
    """What is made of one connection."""

    def __init__(self, connection: ShownConnection) -> None:
        self.connection = connection
        self.shown: Part | None = None
        self.groups: dict[Component, Part] = {}
        self.members: dict[Component, dict[Component, Part]] = {}
        """Of the groups that somebody has browsed."""
        self.data_sets: dict[Topic, Part] | None = None
        """None until somebody has browsed them."""

    def key(self, component: Component) -> str:
        """The string id of a component's Object."""
        rest = component[1:]
        return f"{self.connection.key}.{component[0]}{'.'.join(map(str, rest))}" if component else self.connection.key

    @property
    def data_set_folder(self) -> str:
        """The string id of the folder with the PublishedDataSets."""
        return f"{self.connection.key}.D"

    def data_set_key(self, topic: Topic) -> str:
        """The string id of a PublishedDataSet."""
        return f"{self.data_set_folder}.{topic.ns}.{topic.id}"


class PubSubNodes:
    """Makes these nodes, and keeps them as their connections are."""

    def __init__(
        self,
        space: AddressSpace,
        builder: NodeBuilder,
        ns: int,
        connections: Sequence[ShownConnection],
        *,
        most_open: int = MOST_OPEN,
    ) -> None:
        """Prepare to make nodes.

        Args:
            space: has the standard's nodes.
            builder: of it.
            ns: namespace of the ids.
            connections: what is shown.
            most_open: Objects whose members are kept although nobody watches them.
        """
        self._space, self._builder, self._most_open = space, builder, most_open
        self._declared = DeclaredNodes(space, builder, ns)
        self._trees = [_Tree(connection) for connection in connections]
        self._open: dict[str, Callable[[ua.NodeId], None]] = {}
        """By their string ids: the Objects whose members are made, and what makes them.

        The first was made first, or was found to be watched first.
        """

    def fill_root(self, node: ua.NodeId, description: Description) -> None:
        """Give an Object that the standard has its values."""
        self._declared.fill(node, description)

    def refresh(self) -> None:
        """Make what is new, and remove what is gone. To be called each second.

        Raises:
            Exception: of the last connection that cannot be shown. The others are.
        """
        failed: Exception | None = None
        for tree in self._trees:
            try:
                self._refresh_tree(tree)
            except Exception as error:  # noqa: BLE001 - what one bridge announces must not keep others from being shown
                self._discard(tree)  # its nodes may be there in part, and would be made again
                failed = error
        if failed is not None:
            raise failed

    def _refresh_tree(self, tree: _Tree) -> None:
        part = tree.connection.connection()
        if part != tree.shown:
            self._remove_connection(tree)
            if part is not None:
                self._add_connection(tree, part)
        if tree.shown is None:
            return
        self._refresh_groups(tree)
        if tree.data_sets is not None:
            self._refresh_data_sets(tree)

    def component(self, node: ua.NodeId, member: str) -> tuple[ShownConnection, Component] | None:
        """What a member of an Object belongs to, e.g. the Object `Status`; None where it is none of these nodes."""
        key = str(node.Identifier).removesuffix(f".{member}")
        for tree in self._trees:
            if key == tree.connection.key:
                return tree.connection, CONNECTION
            start = f"{tree.connection.key}."
            if key.startswith(start) and (component := _component(key.removeprefix(start))):
                return tree.connection, component
        return None

    async def tell(self) -> None:
        """Tell who watches of changes."""
        for live in [live for live in self._declared.live.values() if live.is_watched]:
            await live.tell()

    @property
    def watched(self) -> list[LiveValue]:
        """The values that somebody watches."""
        return [live for live in self._declared.live.values() if live.is_watched]

    @property
    def open(self) -> int:
        """Objects whose members are kept."""
        return len(self._open)

    def _add_connection(self, tree: _Tree, part: Part) -> None:
        key = tree.connection.key
        self._declared.add_object(key, part.name, _ROOT, "PubSubConnectionType", "HasPubSubConnection")
        self._declared.add_members(key, tree.connection.describe(CONNECTION))
        tree.shown = part
        if not tree.connection.has_data_sets:
            return
        folder = tree.data_set_folder
        node = self._declared.add_object(folder, part.name, _DATA_SETS, "DataSetFolderType", "Organizes")
        self._builder.add_later(node, lambda _node: self._make_data_sets(tree))

    def _remove_connection(self, tree: _Tree) -> None:
        if tree.shown is not None:
            self._discard(tree)

    def _discard(self, tree: _Tree) -> None:
        folders = (tree.data_set_folder,) if tree.connection.has_data_sets else ()
        for key in (tree.connection.key, *folders):
            self._remove(key)
        tree.shown, tree.data_sets = None, None
        tree.groups, tree.members = {}, {}

    def _refresh_groups(self, tree: _Tree) -> None:
        groups = dict(tree.connection.groups())
        gone, new = difference(tree.groups, groups)
        for group in gone:
            self._remove(tree.key(group))
            tree.members.pop(group, None)
        for group in new:
            node = self._add(tree, group, groups[group])
            self._declared.add_members(tree.key(group), tree.connection.describe(group))
            self._builder.add_later(node, partial(self._make_members, tree, group))
        tree.groups = groups
        for group in list(tree.members):
            self._refresh_members(tree, group)

    def _make_members(self, tree: _Tree, group: Component, _node: ua.NodeId) -> None:
        tree.members[group] = {}
        self._refresh_members(tree, group)

    def _refresh_members(self, tree: _Tree, group: Component) -> None:
        members = dict(tree.connection.members(group))
        gone, new = difference(tree.members[group], members)
        for component in gone:
            self._remove(tree.key(component))
        for component in new:
            node = self._add(tree, component, members[component])
            self._make_later(node, tree.key(component), partial(tree.connection.describe, component))
        tree.members[group] = members

    def _add(self, tree: _Tree, component: Component, part: Part) -> ua.NodeId:
        above = parent_of(component)
        assert above is not None
        type_name, reference = _TYPES[str(component[0]), len(component)]
        return self._declared.add_object(
            tree.key(component), part.name, self._declared.id(tree.key(above)), type_name, reference
        )

    def _make_data_sets(self, tree: _Tree) -> None:
        tree.data_sets = {}
        self._refresh_data_sets(tree)

    def _refresh_data_sets(self, tree: _Tree) -> None:
        assert tree.data_sets is not None
        data_sets = dict(tree.connection.data_sets())
        gone, new = difference(tree.data_sets, data_sets)
        for topic in gone:
            self._remove(tree.data_set_key(topic))
        folder = self._declared.id(tree.data_set_folder)
        for topic in new:
            key, describe = tree.data_set_key(topic), partial(tree.connection.describe_data_set, topic)
            kind = describe().type
            node = self._declared.add_object(key, data_sets[topic].name, folder, kind, "HasComponent")
            self._make_later(node, key, describe, partial(self._refer, tree, topic))
        tree.data_sets = data_sets

    def _refer(self, tree: _Tree, topic: Topic) -> None:
        """Let a PublishedDataSet refer to its DataSetWriters."""
        node = self._declared.id(tree.data_set_key(topic))
        for component in tree.connection.writers_of(topic):
            written = self._declared.id(tree.key(component))
            if self._builder.has(written) and not self._builder.is_referenced(written, _DATA_SET_TO_WRITER):
                self._builder.add_reference(node, _DATA_SET_TO_WRITER, written)

    def _make_later(
        self,
        node: ua.NodeId,
        key: str,
        describe: Callable[[], Description],
        refer: Callable[[], None] = lambda: None,
    ) -> None:
        """Have an Object's members made when somebody wants its references."""

        def make(_node: ua.NodeId) -> None:
            self._open[key] = make
            self._declared.add_members(key, describe())
            refer()
            self._close_some(key)

        self._builder.add_later(node, make)

    def _close_some(self, newest: str) -> None:
        """Remove the members of the Objects that were made first and that nobody watches.

        Few are looked at each time, and those that stay go to the end: somebody may watch thousands.
        """
        for key in list(islice(self._open, _MOST_LOOKED_AT)):
            if len(self._open) <= self._most_open:
                return
            make = self._open.pop(key)
            if key == newest or self._declared.is_watched(key):
                self._open[key] = make
            else:
                self._declared.remove_members(key)
                self._builder.add_later(self._declared.id(key), make)

    def _remove(self, key: str) -> None:
        start = f"{key}."
        for each in [each for each in self._open if each == key or each.startswith(start)]:
            del self._open[each]
        self._declared.forget(self._builder.remove(self._declared.id(key)))


def _component(rest: str) -> Component | None:
    """The component whose string id ends so."""
    letter, numbers = rest[:1], rest[1:].split(".")
    if letter not in ("W", "R") or not all(each.isascii() and each.isdecimal() for each in numbers):
        return None
    component: Component = (letter, *[int(each) for each in numbers])
    return component if (letter, len(component)) in _TYPES else None
