"""The fleet as nodes below Objects, built from the model.

Fleet
  Robots/G00/<robot>       State, Description, Capacities, LastUpdate, Data/<DataSet>, Sensors, Skills
  Bridges/<bridge>         the bridge's status DataSet, Online, LastSeen, Drops/<cause>
  Capabilities/<name>
  Discovered/Sources/G00/<source>, Discovered/Quarantine/G00/<topic>
  Traffic                  what went through the server
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace, AttributeValue
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.counters import Drop
from ua_fleet.fleet.changes import SourceQuarantined
from ua_fleet.fleet.model import (
    GROUP_SIZE,
    TRAFFIC_FIELDS,
    BridgeModel,
    DataSetModel,
    FieldModel,
    FleetModel,
    RobotModel,
    RobotState,
    drop_field,
)
from ua_fleet.server.convert import data_value, node_id, raw_id, to_status
from ua_fleet.server.nodes import HAS_PROPERTY, ORGANIZES, NodeBuilder, paused_collection
from ua_fleet.server.nodeset import TYPES_INDEX, TypeId
from ua_fleet.server.units import UNECE_NAMESPACE, unit_id
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, NodeId, QualifiedName, StatusCode

__all__ = ["FleetNodes"]

_STANDARD: Final = {
    name: raw_id(getattr(ObjectIds, name))
    for name in (
        "AnalogItemType",
        "AnalogUnitRangeType",
        "AnalogUnitType",
        "BaseDataVariableType",
        "EUInformation",
        "FolderType",
        "PropertyType",
        "Range",
        "UtcTime",
    )
}
_OBJECTS: Final = raw_id(ObjectIds.ObjectsFolder)
_UINT64: Final = int(BuiltinType.UINT64)


class FleetNodes:
    """The fleet's nodes, and what holds the value of each Variable."""

    def __init__(self, space: AddressSpace, model: FleetModel) -> None:
        """Prepare to build a model's nodes; the types have to be loaded."""
        self._model = model
        self._ns = model.ns
        self._builder = NodeBuilder(space)
        self.values: dict[NodeId, AttributeValue] = {}
        """What holds the value of a node."""
        self._waiting = ua.DataValue(StatusCode=to_status(StatusCode.BAD_WAITING_FOR_INITIAL_DATA))
        self._groups: dict[str, list[int]] = {}
        self._parents: dict[NodeId, ua.NodeId] = {}
        self._capabilities: dict[str, ua.NodeId] = {}
        self._types: dict[int, ua.NodeId] = {kind: raw_id(kind.value, TYPES_INDEX) for kind in TypeId}

    def build(self) -> None:
        """Make all nodes that the model names."""
        with paused_collection():
            self._now: Any = datetime.now(UTC)
            fleet = self._id("Fleet")
            self._builder.add_object(
                fleet,
                QualifiedName(self._ns, "Fleet"),
                _OBJECTS,
                self._types[TypeId.FLEET],
                reference=ORGANIZES,
                display_name=self._model.name,
            )
            for folder in ("Robots", "Bridges", "Capabilities"):
                self._folder(f"Fleet.{folder}", folder, fleet)
            discovered = self._object("Fleet.Discovered", "Discovered", fleet, TypeId.DISCOVERED)
            for folder in ("Sources", "Quarantine"):
                self._folder(f"Fleet.Discovered.{folder}", folder, discovered)
            traffic = self._object("Fleet.Traffic", "Traffic", fleet, TypeId.TRAFFIC)
            self._add_traffic("Fleet.Traffic", traffic)
            for bridge in self._model.bridges:
                self._add_bridge(bridge)
            for robot in self._model.robots:
                self._add_robot(robot)

    def add_source(self, data_set: DataSetModel) -> None:
        """Make the nodes of a source that the model does not name."""
        self._add_data_set(data_set, self._group("Fleet.Discovered.Sources"), data_set.topic.name)

    async def remove_source(self, data_set: DataSetModel) -> None:
        """Remove the nodes of a source that had been added."""
        for field in data_set.fields:
            del self.values[field.key]
            for part in ("EURange", "EngineeringUnits"):
                await self._builder.remove(self._id(f"{field.key.identifier!s}.{part}"), node_id(field.key))
            if not data_set.is_single:
                await self._builder.remove(node_id(field.key), node_id(data_set.key))
        await self._builder.remove(self._id(f"Topics.{data_set.topic.id}"), node_id(data_set.key))
        await self._builder.remove(node_id(data_set.key), self._parents.pop(data_set.key))

    def add_quarantined(self, source: SourceQuarantined) -> None:
        """List a source that gets no nodes."""
        topic = source.topic.name
        parent = self._object(
            f"Fleet.Discovered.Quarantine.{topic}",
            topic,
            self._group("Fleet.Discovered.Quarantine"),
            TypeId.QUARANTINED_SOURCE,
            own_name=True,
            display_name=source.name or topic,
        )
        for name, text in (("Topic", topic), ("MessageType", source.message_type), ("Reason", source.reason)):
            self._property(f"Fleet.Discovered.Quarantine.{topic}.{name}", name, parent, BuiltinType.STRING, text)

    def _add_robot(self, robot: RobotModel) -> None:
        prefix = f"Robots.{robot.name}"
        node = self._object(
            prefix,
            robot.name,
            self._group("Fleet.Robots"),
            TypeId.ROBOT,
            own_name=True,
            description=robot.description,
            reference=ORGANIZES,
        )
        offline = data_value(int(BuiltinType.INT32), int(RobotState.OFFLINE), 0, self._now, self._now)
        self._variable(robot.part("State"), "State", node, self._types[TypeId.ROBOT_STATE], offline)
        self._variable(robot.part("LastUpdate"), "LastUpdate", node, _STANDARD["UtcTime"], self._waiting)
        self._property(f"{prefix}.Description", "Description", node, BuiltinType.STRING, robot.description)
        capacities = BuiltinType.STRING | ARRAY
        self._property(f"{prefix}.Capacities", "Capacities", node, capacities, robot.capacities)
        for folder in ("Sensors", "Skills"):
            self._folder(f"{prefix}.{folder}", folder, node)
        data = self._folder(f"{prefix}.Data", "Data", node)
        is_grouped = len(robot.data_sets) > GROUP_SIZE
        for data_set in robot.data_sets:
            self._add_data_set(data_set, self._group(f"{prefix}.Data") if is_grouped else data, data_set.name)
        for capacity in robot.capacities:
            self._builder.add_reference(node, self._types[TypeId.PROVIDES_CAPABILITY], self._capability(capacity))

    def _capability(self, name: str) -> ua.NodeId:
        known = self._capabilities.get(name)
        if known is None:
            known = self._object(
                f"Fleet.Capabilities.{name}", name, self._id("Fleet.Capabilities"), TypeId.CAPABILITY, own_name=True
            )
            self._property(f"Fleet.Capabilities.{name}.Identifier", "Identifier", known, BuiltinType.STRING, name)
            self._capabilities[name] = known
        return known

    def _add_bridge(self, bridge: BridgeModel) -> None:
        node = node_id(bridge.key)
        self._builder.add_object(
            node,
            QualifiedName(self._ns, bridge.name),
            self._id("Fleet.Bridges"),
            self._types[TypeId.BRIDGE],
            description=bridge.description,
        )
        prefix = str(bridge.status.topic.id) if bridge.status is not None else f"Bridges.{bridge.name}"
        self._property(f"{prefix}.Kind", "Kind", node, BuiltinType.STRING, bridge.kind)
        self._property(f"{prefix}.Space", "Space", node, BuiltinType.UINT16, bridge.space)
        for name, kind in (("Online", BuiltinType.BOOLEAN), ("LastSeen", BuiltinType.DATETIME)):
            data_type = _STANDARD["UtcTime"] if kind is BuiltinType.DATETIME else raw_id(int(kind))
            self._variable(bridge.part(name), name, node, data_type, self._waiting)
        for name, kind in (
            ("Connected", BuiltinType.BOOLEAN),
            ("Detail", BuiltinType.STRING),
            ("FromSpace", BuiltinType.UINT64),
            ("ToSpace", BuiltinType.UINT64),
        ):
            self._variable(bridge.part(name), name, node, raw_id(int(kind)), self._waiting)
        self._add_traffic(prefix, node)

    def _add_traffic(self, prefix: str, node: ua.NodeId) -> None:
        data_type = raw_id(_UINT64)
        for name in TRAFFIC_FIELDS:
            self._variable(NodeId(self._ns, f"{prefix}.{name}"), name, node, data_type, self._waiting)
        drops = self._folder(f"{prefix}.Drops", "Drops", node)
        for drop in Drop:
            key = NodeId(self._ns, f"{prefix}.{drop_field(drop.value)}")
            self._variable(key, drop.value, drops, data_type, self._waiting, own_name=True)

    def _add_data_set(self, data_set: DataSetModel, parent: ua.NodeId, browse_name: str) -> None:
        self._parents[data_set.key] = parent
        if data_set.is_single:
            field = data_set.fields[0]
            self._add_field(field, browse_name, parent, data_set.writable, data_set.description)
            return
        node = node_id(data_set.key)
        self._builder.add_object(
            node,
            QualifiedName(self._ns, browse_name),
            parent,
            self._types[TypeId.DATA_SET],
            description=data_set.description,
            display_name=data_set.name,
        )
        topic = data_set.topic
        # Not below `<id>.`, where a field may have any name.
        self._property(f"Topics.{topic.id}", "Topic", node, BuiltinType.STRING, topic.name)
        for field in data_set.fields:
            self._add_field(field, field.name, node, data_set.writable, "")

    def _add_field(
        self, field: FieldModel, browse_name: str, parent: ua.NodeId, writable: bool, description: str
    ) -> None:
        code = field.type
        has_value = writable and field.initial is not None
        value = data_value(code, field.initial, 0, self._now, self._now) if has_value else self._waiting
        name = ("AnalogUnitRangeType" if field.range else "AnalogUnitType") if field.unit else "AnalogItemType"
        is_plain = field.unit is None and field.range is None
        held = self._builder.add_variable(
            node_id(field.key),
            QualifiedName(self._ns, browse_name),
            parent,
            _STANDARD["BaseDataVariableType" if is_plain else name],
            data_type=raw_id(code & 0x3F),
            value=value,
            value_rank=(0 if code & DIMENSIONS else 1) if code & ARRAY else -1,
            array_length=field.length,
            writable=writable,
            description=description,
        )
        self.values[field.key] = held
        if field.range is not None:
            self._structure(
                field, "EURange", _STANDARD["Range"], ua.Range(ua.Double(field.range[0]), ua.Double(field.range[1]))
            )
        if field.unit is not None:
            unit = unit_id(field.unit)
            text = ua.LocalizedText(field.unit)
            information = ua.EUInformation(ua.String(UNECE_NAMESPACE if unit >= 0 else ""), ua.Int32(unit), text, text)
            self._structure(field, "EngineeringUnits", _STANDARD["EUInformation"], information)

    def _structure(self, field: FieldModel, name: str, data_type: ua.NodeId, value: Any) -> None:
        variant = ua.Variant(value, ua.VariantType.ExtensionObject)
        self._builder.add_variable(
            self._id(f"{field.key.identifier!s}.{name}"),
            QualifiedName(0, name),
            node_id(field.key),
            _STANDARD["PropertyType"],
            data_type=data_type,
            value=ua.DataValue(variant, to_status(0), self._now, self._now),
            reference=HAS_PROPERTY,
        )

    def _group(self, folder: str) -> ua.NodeId:
        """The group below a folder that the next child goes to."""
        used = self._groups.setdefault(folder, [0])
        number, place = divmod(used[0], GROUP_SIZE)
        used[0] += 1
        name = f"G{number:02d}"
        if place == 0:
            self._builder.add_object(
                self._id(f"{folder}.{name}"),
                QualifiedName(self._ns, name),
                self._id(folder),
                _STANDARD["FolderType"],
                reference=ORGANIZES,
            )
        return self._id(f"{folder}.{name}")

    def _id(self, text: str) -> ua.NodeId:
        return raw_id(text, self._ns)

    def _folder(self, path: str, name: str, parent: ua.NodeId) -> ua.NodeId:
        node = self._id(path)
        self._builder.add_object(node, QualifiedName(TYPES_INDEX, name), parent, _STANDARD["FolderType"])
        return node

    def _object(
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
        node = self._id(path)
        self._builder.add_object(
            node,
            QualifiedName(self._ns if own_name else TYPES_INDEX, name),
            parent,
            self._types[kind],
            description=description,
            display_name=display_name,
            **options,
        )
        return node

    def _variable(
        self,
        key: NodeId,
        name: str,
        parent: ua.NodeId,
        data_type: ua.NodeId,
        value: ua.DataValue,
        *,
        own_name: bool = False,
    ) -> None:
        self.values[key] = self._builder.add_variable(
            node_id(key),
            QualifiedName(self._ns if own_name else TYPES_INDEX, name),
            parent,
            _STANDARD["BaseDataVariableType"],
            data_type=data_type,
            value=value,
        )

    def _property(self, path: str, name: str, parent: ua.NodeId, type_code: int, value: Any) -> None:
        self._builder.add_variable(
            self._id(path),
            QualifiedName(TYPES_INDEX, name),
            parent,
            _STANDARD["PropertyType"],
            data_type=raw_id(type_code & 0x3F),
            value=data_value(type_code, value, 0, self._now, self._now),
            value_rank=1 if type_code & ARRAY else -1,
            reference=HAS_PROPERTY,
        )
