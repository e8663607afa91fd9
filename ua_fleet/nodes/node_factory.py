"""What the fleet's nodes are made of: folders, objects, variables with units and ranges, properties, methods."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from copy import copy
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.convert import data_value, node_id, raw_id, to_status
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, HAS_PROPERTY, ORGANIZES, NodeBuilder
from ua_fleet.fleet.model import GROUP_SIZE, FieldModel
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.nodes.units import UNECE_NAMESPACE, unit_id
from ua_fleet.values import ARRAY, DIMENSIONS, NodeId, QualifiedName, StatusCode

__all__ = ["STANDARD", "NodeFactory"]

STANDARD: Final = {
    name: raw_id(getattr(ObjectIds, name))
    for name in (
        "AnalogItemType",
        "AnalogUnitRangeType",
        "AnalogUnitType",
        "BaseDataVariableType",
        "BaseObjectType",
        "Duration",
        "EUInformation",
        "FiniteStateVariableType",
        "FiniteTransitionVariableType",
        "FolderType",
        "PropertyType",
        "Range",
        "UtcTime",
    )
}
"""Types of the base namespace."""


class NodeFactory:
    """Makes nodes of one fleet, and keeps what holds the value of each Variable."""

    def __init__(self, space: AddressSpace, ns: int) -> None:
        """Prepare to make nodes in a namespace; the types have to be loaded."""
        self.ns = self.names_ns = ns
        """Of the ids, and of the BrowseNames: these are in the fleet's, whatever namespace the ids are of."""
        self._within: dict[int, NodeFactory] = {}
        self.builder = NodeBuilder(space)
        self.values: dict[NodeId, HeldValue] = {}
        """What holds the value of a node."""
        self.waiting = ua.DataValue(StatusCode=to_status(StatusCode.BAD_WAITING_FOR_INITIAL_DATA))
        """The value of a node before its first one."""
        self.types: dict[int, ua.NodeId] = {kind: raw_id(kind.value, TYPES_INDEX) for kind in TypeId}
        self.now: Any = datetime.now(UTC)
        """Time of the values that stay."""
        self._groups: dict[str, list[int]] = {}

    def within(self, ns: int) -> NodeFactory:
        """The same for ids of another namespace; the nodes have their BrowseNames in the fleet's all the same."""
        if ns == self.ns:
            return self
        made = self._within.get(ns)
        if made is None:
            made = self._within[ns] = copy(self)
            made.ns = ns
        return made

    def field(
        self,
        field: FieldModel,
        browse_name: str,
        parent: ua.NodeId,
        *,
        writable: bool = False,
        historizing: bool = False,
        description: str = "",
        reference: ua.NodeId = HAS_COMPONENT,
        value: ua.DataValue | None = None,
    ) -> None:
        """A Variable for a value of a robot, with its unit and range. Without a value it waits for its first one."""
        code = field.type
        name = ("AnalogUnitRangeType" if field.range else "AnalogUnitType") if field.unit else "AnalogItemType"
        is_plain = field.unit is None and field.range is None
        held = self.builder.add_variable(
            node_id(field.key),
            QualifiedName(self.names_ns, browse_name),
            parent,
            STANDARD["BaseDataVariableType" if is_plain else name],
            data_type=raw_id(code & 0x3F),
            value=value or self.waiting,
            value_rank=(0 if code & DIMENSIONS else 1) if code & ARRAY else -1,
            array_length=field.length,
            writable=writable,
            historizing=historizing,
            description=description,
            reference=reference,
        )
        self.values[field.key] = held
        if field.range is not None:
            self._structure(
                field, "EURange", STANDARD["Range"], ua.Range(ua.Double(field.range[0]), ua.Double(field.range[1]))
            )
        if field.unit is not None:
            unit = unit_id(field.unit)
            text = ua.LocalizedText(field.unit)
            information = ua.EUInformation(ua.String(UNECE_NAMESPACE if unit >= 0 else ""), ua.Int32(unit), text, text)
            self._structure(field, "EngineeringUnits", STANDARD["EUInformation"], information)

    def _structure(self, field: FieldModel, name: str, data_type: ua.NodeId, value: Any) -> None:
        variant = ua.Variant(value, ua.VariantType.ExtensionObject)
        self.builder.add_variable(
            raw_id(f"{field.key.identifier!s}.{name}", field.key.namespace),
            QualifiedName(0, name),
            node_id(field.key),
            STANDARD["PropertyType"],
            data_type=data_type,
            value=ua.DataValue(variant, to_status(0), self.now, self.now),
            reference=HAS_PROPERTY,
        )

    def group(self, folder: str) -> ua.NodeId:
        """The group below a folder that the next child goes to."""
        used = self._groups.setdefault(folder, [])
        number = next((number for number, count in enumerate(used) if count < GROUP_SIZE), len(used))
        name = f"G{number:02d}"
        if number == len(used):
            used.append(0)
            self.builder.add_object(
                self.id(f"{folder}.{name}"),
                QualifiedName(self.names_ns, name),
                self.id(folder),
                STANDARD["FolderType"],
                reference=ORGANIZES,
            )
        used[number] += 1
        return self.id(f"{folder}.{name}")

    def leave(self, folder: str, group: ua.NodeId) -> None:
        """A child of a group is gone: another one may have its place."""
        number = str(group.Identifier).removeprefix(f"{folder}.G")
        self._groups[folder][int(number)] -= 1

    def has(self, node: ua.NodeId) -> bool:
        """Whether there is such a node, whoever made it."""
        return self.builder.has(node)

    def remove(self, node: ua.NodeId) -> None:
        """Remove a node with all that is below it."""
        for gone in self.builder.remove(node):
            identifier: Any = gone.Identifier
            self.values.pop(NodeId(int(gone.NamespaceIndex), identifier), None)
            self._groups.pop(str(identifier), None)

    def id(self, text: str) -> ua.NodeId:
        """A string NodeId in the fleet's namespace."""
        return raw_id(text, self.ns)

    def folder(self, path: str, name: str, parent: ua.NodeId) -> ua.NodeId:
        """A folder that is a member of a type."""
        node = self.id(path)
        self.builder.add_object(node, QualifiedName(TYPES_INDEX, name), parent, STANDARD["FolderType"])
        return node

    def object(
        self,
        path: str,
        name: str,
        parent: ua.NodeId,
        kind: TypeId,
        *,
        own_name: bool = False,
        description: str = "",
        display_name: str | None = None,
        **options: Any,
    ) -> ua.NodeId:
        """An Object; the names of members stand in the types' namespace, others (`own_name`) in the fleet's."""
        node = self.id(path)
        self.builder.add_object(
            node,
            QualifiedName(self.names_ns if own_name else TYPES_INDEX, name),
            parent,
            self.types[kind],
            description=description,
            display_name=display_name,
            **options,
        )
        return node

    def variable(
        self,
        key: NodeId,
        name: str,
        parent: ua.NodeId,
        data_type: ua.NodeId,
        value: ua.DataValue,
        *,
        own_name: bool = False,
        is_array: bool = False,
    ) -> None:
        """A Variable that is a member of a type, or (`own_name`) is named in the fleet."""
        self.values[key] = self.builder.add_variable(
            node_id(key),
            QualifiedName(self.names_ns if own_name else TYPES_INDEX, name),
            parent,
            STANDARD["BaseDataVariableType"],
            data_type=data_type,
            value=value,
            value_rank=1 if is_array else -1,
        )

    def standard(
        self,
        key: NodeId,
        name: str,
        parent: ua.NodeId,
        type_name: str,
        data_type: ua.NodeId,
        *,
        namespace: int = 0,
        is_property: bool = False,
    ) -> None:
        """A Variable that is a member of a standard type and whose value changes; it waits for its first one."""
        self.values[key] = self.builder.add_variable(
            node_id(key),
            QualifiedName(namespace, name),
            parent,
            STANDARD[type_name],
            data_type=data_type,
            value=self.waiting,
            reference=HAS_PROPERTY if is_property else HAS_COMPONENT,
        )

    def property(
        self,
        path: str,
        name: str,
        parent: ua.NodeId,
        type_code: int,
        value: Any,
        *,
        namespace: int = TYPES_INDEX,
        data_type: ua.NodeId | None = None,
    ) -> HeldValue:
        """A Property, and what holds its value."""
        return self.builder.add_variable(
            self.id(path),
            QualifiedName(namespace, name),
            parent,
            STANDARD["PropertyType"],
            data_type=data_type or raw_id(type_code & 0x3F),
            value=data_value(type_code, value, 0, self.now, self.now),
            value_rank=1 if type_code & ARRAY else -1,
            reference=HAS_PROPERTY,
        )

    def method(
        self, owner: str, name: str, inputs: list[ua.Argument], outputs: list[ua.Argument], description: str
    ) -> ua.NodeId:
        """A Method of the Object with the string id `owner`; what it does is linked later."""
        node = self.id(f"{owner}.{name}")
        self.builder.add_method(node, QualifiedName(TYPES_INDEX, name), self.id(owner), description=description)
        for which, arguments in (("InputArguments", inputs), ("OutputArguments", outputs)):
            if arguments:
                self.builder.add_variable(
                    self.id(f"{owner}.{name}.{which}"),
                    QualifiedName(0, which),
                    node,
                    STANDARD["PropertyType"],
                    data_type=raw_id(ObjectIds.Argument),
                    value=ua.DataValue(ua.Variant(arguments, ua.VariantType.ExtensionObject, None, True)),
                    value_rank=1,
                    array_length=len(arguments),
                    reference=HAS_PROPERTY,
                )
        return node
