"""The fleet as nodes below Objects, built from the model.

Fleet
  Robots/G00/<robot>       State, Description, Capacities, LastUpdate, Data/<DataSet>, Sensors, Skills/<skill>,
                           Card, Held, HeldBy, HeldSince, HeldReason, Hold, Release
  Bridges/<bridge>         the bridge's status DataSet, Online, LastSeen, Drops/<cause>
  Capabilities/<name>
  Summaries/<number>       how a hundred robots stand (server.robots.summary_nodes)
  Discovered/Sources/G00/<source>, Discovered/Quarantine/G00/<topic>
  Traffic                  what went through the server
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.config.history import HistoryRules
from ua_fleet.counters import OF_BRIDGES
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.convert import data_value, node_id, raw_id
from ua_fleet.endpoint.node_builder import ORGANIZES, paused_collection
from ua_fleet.errors import ServerStartError
from ua_fleet.fleet.changes import SourceQuarantined, ValueChanged
from ua_fleet.fleet.model import (
    GROUP_SIZE,
    MAX_AGE_PREFIX,
    TRAFFIC_FIELDS,
    BridgeModel,
    DataSetModel,
    FieldModel,
    FleetModel,
    RobotModel,
    RobotState,
    drop_field,
)
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.history_nodes import HistoryNodes
from ua_fleet.nodes.hold_nodes import HoldNodes
from ua_fleet.nodes.mistake_nodes import MistakeNodes
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.nodeset import TypeId
from ua_fleet.nodes.skill_nodes import SkillNodeFactory
from ua_fleet.nodes.teleoperation_nodes import TeleoperationNodes
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, BuiltinType, NodeId, QualifiedName

__all__ = ["FleetNodes"]

_OBJECTS: Final = raw_id(ObjectIds.ObjectsFolder)
_UINT64: Final = int(BuiltinType.UINT64)
_ROBOTS: Final = "Fleet.Robots"
_SOURCES: Final = "Fleet.Discovered.Sources"
_QUARANTINE: Final = "Fleet.Discovered.Quarantine"


class FleetNodes:
    """The fleet's nodes, and what holds the value of each Variable."""

    def __init__(self, space: AddressSpace, model: FleetModel, history: HistoryRules | None = None) -> None:
        """Prepare to build a model's nodes; the types have to be loaded.

        Args:
            space: gets them.
            model: of the fleet.
            history: what is kept of values; without it nothing is.
        """
        self._model = model
        self.ns = model.ns
        self._parts = NodeFactory(space, model.ns)
        self.values = self._parts.values
        """What holds the value of a node; see `value`."""
        self._parents: dict[NodeId, ua.NodeId] = {}
        self._quarantined: dict[Topic, ua.NodeId] = {}
        self._capabilities: dict[str, ua.NodeId] = {}
        self._held: dict[str, tuple[str, ...]] = {}
        """What robots can do now, where that has changed."""
        self._max_ages: dict[NodeId, float] = {}
        """In ms, of the data sources that have one configured."""
        self._make_later = self._make_max_age  # one bound method for all nodes
        self._skills = SkillNodeFactory(self._parts)
        self._holds = HoldNodes(self._parts)
        self._driven = TeleoperationNodes(self._parts)
        self._rules = history
        self._history = None if history is None else HistoryNodes(space, self._parts, history)

    def build(self) -> None:
        """Make all nodes that the model names."""
        with paused_collection():
            fleet = self._parts.id("Fleet")
            self._parts.builder.add_object(
                fleet,
                QualifiedName(self.ns, "Fleet"),
                _OBJECTS,
                self._parts.types[TypeId.FLEET],
                reference=ORGANIZES,
                display_name=self._model.name,
            )
            for folder in ("Robots", "Bridges", "Capabilities"):
                self._parts.folder(f"Fleet.{folder}", folder, fleet)
            discovered = self._parts.object("Fleet.Discovered", "Discovered", fleet, TypeId.DISCOVERED)
            for folder in ("Sources", "Quarantine"):
                self._parts.folder(f"Fleet.Discovered.{folder}", folder, discovered)
            if self._history is not None:
                self._history.build(fleet)
            traffic = self._parts.object("Fleet.Traffic", "Traffic", fleet, TypeId.TRAFFIC)
            self._add_traffic("Fleet.Traffic", traffic)
            for bridge in self._model.bridges:
                self._add_bridge(bridge)
            for robot in self._model.robots:
                self._add_robot(robot)

    def value(self, key: NodeId) -> HeldValue | None:
        """What holds the value of a node, which is made now if it was not wanted before; None without such a node."""
        held = self.values.get(key)
        if held is None and self._parts.has(node_id(key)):
            held = self.values.get(key)
        return held

    def add_source(self, data_set: DataSetModel) -> None:
        """Make the nodes of a source that the model does not name: all of them, or none where one cannot be made."""
        group = self._parts.group(_SOURCES)
        if self._parts.has(node_id(data_set.key)):
            self._parts.leave(_SOURCES, group)
            raise ServerStartError(f"{data_set.topic.name} gets no nodes: {data_set.key} is another's")
        try:
            self._add_data_set(data_set, group, data_set.topic.name)
        except Exception:
            self._parts.remove(node_id(data_set.key))
            self._parents.pop(data_set.key, None)
            self._parts.leave(_SOURCES, group)
            raise

    def remove_source(self, data_set: DataSetModel) -> None:
        """Remove the nodes of a source that had been added."""
        group = self._parents.pop(data_set.key, None)
        if group is None:
            return  # they could not be made
        self._parts.remove(node_id(data_set.key))
        self._max_ages.pop(data_set.key, None)
        self._parts.leave(_SOURCES, group)

    def show_mistakes(
        self,
        mistakes: Mistakes,
        put: Callable[[ValueChanged], None],
        clock: Callable[[], float],
        wall_ticks: Callable[[], int],
    ) -> MistakeNodes:
        """Make the nodes of the server's own mistakes, and what keeps them true."""
        return MistakeNodes(self._parts, mistakes, put, clock=clock, wall_ticks=wall_ticks)

    def add_robot(self, robot: RobotModel) -> None:
        """Make the nodes of a robot that the model does not name."""
        self._add_robot(robot)

    def remove_robot(self, robot: RobotModel) -> None:
        """Remove the nodes of a robot, and the capacities that no other robot has."""
        self._parts.remove(node_id(robot.key))
        if self._history is not None:
            self._history.remove(robot)
        self._parts.leave(_ROBOTS, self._parents.pop(robot.key))
        for data_set in robot.all_data_sets():
            self._parents.pop(data_set.key, None)
            self._max_ages.pop(data_set.key, None)
        for capacity in self._held.pop(robot.name, robot.capacities):
            known = self._capabilities[capacity]
            if not self._parts.builder.is_referenced(known, self._parts.types[TypeId.PROVIDES_CAPABILITY]):
                del self._capabilities[capacity]
                self._parts.remove(known)

    def set_capacities(self, robot: RobotModel, capacities: tuple[str, ...]) -> tuple[list[str], list[str]]:
        """Show what a robot can do now, beside the value of its property; which it has gained and which lost."""
        node, provides = node_id(robot.key), self._parts.types[TypeId.PROVIDES_CAPABILITY]
        if robot.key not in self._parents:
            return [], []
        before = self._held.get(robot.name, robot.capacities)
        self._held[robot.name] = capacities
        gained = [capacity for capacity in capacities if capacity not in before]
        lost = [capacity for capacity in before if capacity not in capacities]
        for capacity in gained:
            self._parts.builder.add_reference(node, provides, self._capability(capacity))
        for capacity in lost:
            self._parts.builder.remove_reference(node, provides, self._capability(capacity))
        return gained, lost

    def add_quarantined(self, source: SourceQuarantined) -> None:
        """List a source that gets no nodes."""
        topic = source.topic.name
        group = self._quarantined[source.topic] = self._parts.group(_QUARANTINE)
        parent = self._parts.object(
            f"{_QUARANTINE}.{topic}",
            topic,
            group,
            TypeId.QUARANTINED_SOURCE,
            own_name=True,
            display_name=source.name or topic,
        )
        for name, text in (("Topic", topic), ("MessageType", source.message_type), ("Reason", source.reason)):
            self._parts.property(f"{_QUARANTINE}.{topic}.{name}", name, parent, BuiltinType.STRING, text)

    def remove_quarantined(self, topic: Topic) -> None:
        """List a source no more."""
        self._parts.remove(self._parts.id(f"{_QUARANTINE}.{topic.name}"))
        self._parts.leave(_QUARANTINE, self._quarantined.pop(topic))

    def _add_robot(self, robot: RobotModel) -> None:
        if self._history is not None:
            self._history.knows(robot)
        self._build_robot(robot)
        if self._history is not None:
            self._history.add(robot)

    def _build_robot(self, robot: RobotModel) -> None:
        prefix = f"Robots.{robot.name}"
        parent = self._parents[robot.key] = self._parts.group(_ROBOTS)
        node = self._parts.object(
            prefix,
            robot.name,
            parent,
            TypeId.ROBOT,
            own_name=True,
            description=robot.description,
            reference=ORGANIZES,
        )
        offline = data_value(int(BuiltinType.INT32), int(RobotState.OFFLINE), 0, self._parts.now, self._parts.now)
        self._parts.variable(robot.part("State"), "State", node, self._parts.types[TypeId.ROBOT_STATE], offline)
        self._parts.variable(robot.part("LastUpdate"), "LastUpdate", node, STANDARD["UtcTime"], self._parts.waiting)
        self._parts.property(f"{prefix}.Description", "Description", node, BuiltinType.STRING, robot.description)
        self._parts.property(f"{prefix}.Origin", "Origin", node, BuiltinType.STRING, robot.origin.value)
        capacities = BuiltinType.STRING | ARRAY
        held = self._parts.property(f"{prefix}.Capacities", "Capacities", node, capacities, robot.capacities)
        self._parts.values[robot.part("Capacities")] = held
        if robot.card:
            self._parts.property(f"{prefix}.Card", "Card", node, BuiltinType.NODE_ID | ARRAY, robot.card)
        self._holds.add(robot, node)
        for folder in ("Sensors", "Skills"):
            self._parts.folder(f"{prefix}.{folder}", folder, node)
        self._skills.add(robot, f"{prefix}.Skills")
        if (status := robot.skill_status_data) is not None:
            self._add_data_set(status, node, status.name)
        if robot.teleoperation is not None:
            self._driven.add(robot.teleoperation, node)
        if robot.fault is not None:
            self._add_data_set(robot.fault, node, robot.fault.name)
        data = self._parts.folder(f"{prefix}.Data", "Data", node)
        is_grouped = len(robot.data_sets) > GROUP_SIZE
        for data_set in robot.data_sets:
            self._add_data_set(data_set, self._parts.group(f"{prefix}.Data") if is_grouped else data, data_set.name)
        for capacity in robot.capacities:
            self._parts.builder.add_reference(
                node, self._parts.types[TypeId.PROVIDES_CAPABILITY], self._capability(capacity)
            )

    def _capability(self, name: str) -> ua.NodeId:
        known = self._capabilities.get(name)
        if known is None:
            known = self._parts.object(
                f"Fleet.Capabilities.{name}",
                name,
                self._parts.id("Fleet.Capabilities"),
                TypeId.CAPABILITY,
                own_name=True,
            )
            self._parts.property(f"Fleet.Capabilities.{name}.Identifier", "Identifier", known, BuiltinType.STRING, name)
            self._capabilities[name] = known
        return known

    def _add_bridge(self, bridge: BridgeModel) -> None:
        node = node_id(bridge.key)
        self._parts.builder.add_object(
            node,
            QualifiedName(self.ns, bridge.name),
            self._parts.id("Fleet.Bridges"),
            self._parts.types[TypeId.BRIDGE],
            description=bridge.description,
        )
        prefix = str(bridge.status.topic.id) if bridge.status is not None else f"Bridges.{bridge.name}"
        self._parts.property(f"{prefix}.Kind", "Kind", node, BuiltinType.STRING, bridge.kind)
        self._parts.property(f"{prefix}.Space", "Space", node, BuiltinType.UINT16, bridge.space)
        for name, kind in (("Online", BuiltinType.BOOLEAN), ("LastSeen", BuiltinType.DATETIME)):
            data_type = STANDARD["UtcTime"] if kind is BuiltinType.DATETIME else raw_id(int(kind))
            self._parts.variable(bridge.part(name), name, node, data_type, self._parts.waiting)
        for name, kind in (
            ("Connected", BuiltinType.BOOLEAN),
            ("Detail", BuiltinType.STRING),
            ("FromSpace", BuiltinType.UINT64),
            ("ToSpace", BuiltinType.UINT64),
            ("LagP99", BuiltinType.DOUBLE),
            ("OldestWaiting", BuiltinType.DOUBLE),
        ):
            self._parts.variable(bridge.part(name), name, node, raw_id(int(kind)), self._parts.waiting)
        self._add_traffic(prefix, node)

    def _add_traffic(self, prefix: str, node: ua.NodeId) -> None:
        data_type = raw_id(_UINT64)
        for name in TRAFFIC_FIELDS:
            self._parts.variable(NodeId(self.ns, f"{prefix}.{name}"), name, node, data_type, self._parts.waiting)
        drops = self._parts.folder(f"{prefix}.Drops", "Drops", node)
        for drop in OF_BRIDGES:
            key = NodeId(self.ns, f"{prefix}.{drop_field(drop.value)}")
            self._parts.variable(key, drop.value, drops, data_type, self._parts.waiting, own_name=True)

    def _add_data_set(self, data_set: DataSetModel, parent: ua.NodeId, browse_name: str) -> None:
        self._parents[data_set.key] = parent
        if data_set.is_single:
            field = data_set.fields[0]
            self._add_field(field, browse_name, parent, data_set.writable, data_set.description)
            self._add_max_age(data_set)
            return
        node = node_id(data_set.key)
        self._parts.builder.add_object(
            node,
            QualifiedName(self.ns, browse_name),
            parent,
            self._parts.types[TypeId.DATA_SET],
            description=data_set.description,
            display_name=data_set.name,
        )
        topic = data_set.topic
        # Not below `<id>.`, where a field may have any name.
        self._parts.within(topic.ns).property(f"Topics.{topic.id}", "Topic", node, BuiltinType.STRING, topic.name)
        for field in data_set.fields:
            self._add_field(field, field.name, node, data_set.writable, "")
        self._add_max_age(data_set)

    def _add_max_age(self, data_set: DataSetModel) -> None:
        """Of what others say: for how long their value counts as one of now; 0 for as long as they live."""
        if data_set.writable or not data_set.for_clients:
            return
        if data_set.max_age_s is not None:
            self._max_ages[data_set.key] = data_set.max_age_s * 1000
        self._parts.builder.add_later(node_id(data_set.key), self._make_later)

    def _make_max_age(self, owner: ua.NodeId) -> None:
        number: Any = owner.Identifier
        key = NodeId(int(owner.NamespaceIndex), number)
        path = f"{MAX_AGE_PREFIX}{number}"
        self._parts.values[NodeId(key.namespace, path)] = self._parts.within(key.namespace).property(
            path,
            "MaxAge",
            owner,
            BuiltinType.DOUBLE,
            self._max_ages.get(key, 0.0),
            data_type=STANDARD["Duration"],
        )

    def _add_field(
        self, field: FieldModel, browse_name: str, parent: ua.NodeId, writable: bool, description: str
    ) -> None:
        has_value = writable and field.initial is not None
        now = self._parts.now
        value = data_value(field.type, field.initial, 0, now, now) if has_value else None
        kept = self._rules is not None and self._rules.of(field.key) is not None
        self._parts.field(
            field, browse_name, parent, writable=writable, historizing=kept, description=description, value=value
        )
