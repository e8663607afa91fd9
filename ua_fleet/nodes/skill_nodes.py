"""Skills as nodes: instances of SkillType, each with a Start of its own.

<skill>                     numeric id: DataSetWriterId of the Action
  Start                     InputArguments are the skill's own; each is described by a Variable (HasArgumentDescription)
                            with its unit and range, whose value is the default
  Suspend, Resume, Halt, Reset      the Methods of the type, which all skills share (OPC 10000-3 6.4.4.2)
  CurrentState, LastTransition, Progress, ExecutionId, Message, LastStatus
  LastResult/<result>       typed
  Capacities, Timeout, Immediate, Limits
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from typing import Final

from asyncua import ua
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.endpoint.convert import data_value, node_id, raw_id, to_status
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, HAS_PROPERTY
from ua_fleet.fleet.model import GROUP_SIZE, FieldModel, RobotModel
from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.operation.skills.tracker import SkillKeys
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.values import ARRAY, BuiltinType, NodeId, QualifiedName

__all__ = ["SHARED_METHODS", "SkillNodeFactory"]

SHARED_METHODS: Final = {
    name: raw_id(identifier, TYPES_INDEX)
    for name, identifier in (("Suspend", 71002), ("Resume", 71003), ("Halt", 71004), ("Reset", 71005))
}
"""The Methods of SkillType; see nodesets/UaFleet.NodeIds.csv."""

_ARGUMENT: Final = raw_id(ObjectIds.Argument)
_HAS_ARGUMENT_DESCRIPTION: Final = raw_id(ObjectIds.HasArgumentDescription)
_EXECUTION_ID: Final = ua.Argument(
    Name=ua.String("ExecutionId"),
    DataType=raw_id(int(BuiltinType.STRING)),
    ValueRank=ua.Int32(-1),
    ArrayDimensions=[],
    Description=ua.LocalizedText("Id of the execution, 32 hexadecimal digits."),
)
_UINT32: Final = int(BuiltinType.UINT32)
_DOUBLE: Final = int(BuiltinType.DOUBLE)


class SkillNodeFactory:
    """Makes the nodes of skills."""

    def __init__(self, parts: NodeFactory) -> None:
        self._parts = parts

    def add(self, robot: RobotModel, folder: str) -> None:
        """Make the nodes of a robot's skills below a folder."""
        is_grouped = len(robot.skills) > GROUP_SIZE
        for skill in robot.skills:
            parent = self._parts.group(folder) if is_grouped else self._parts.id(folder)
            SkillNodeFactory(self._parts.within(robot.ns)).add_skill(skill, SkillKeys(robot.ns, skill.id), parent)

    def add_skill(self, skill: SkillModel, keys: SkillKeys, parent: ua.NodeId) -> None:
        """Make the nodes of one skill below a node."""
        parts, node = self._parts, node_id(keys.object)
        parts.builder.add_object(
            node,
            QualifiedName(parts.names_ns, skill.name),
            parent,
            parts.types[TypeId.SKILL],
            description=skill.description,
        )
        self._add_start(skill, keys, node)
        for method in SHARED_METHODS.values():
            parts.builder.add_reference(node, HAS_COMPONENT, method)
        self._add_program(keys, node)
        for name, kind in (
            ("Progress", BuiltinType.DOUBLE),
            ("ExecutionId", BuiltinType.STRING),
            ("Message", BuiltinType.STRING),
            ("LastStatus", BuiltinType.STATUS_CODE),
        ):
            parts.variable(keys.part(name), name, node, raw_id(int(kind)), parts.waiting)
        self._add_last_result(skill, keys, node)
        prefix = str(skill.id)
        string_array, boolean = int(BuiltinType.STRING | ARRAY), int(BuiltinType.BOOLEAN)
        duration = STANDARD["Duration"]
        parts.property(f"{prefix}.Capacities", "Capacities", node, string_array, skill.capacities)
        timeout_ms = skill.timeout_s * 1000
        parts.property(f"{prefix}.Timeout", "Timeout", node, _DOUBLE, timeout_ms, data_type=duration)
        parts.property(f"{prefix}.Immediate", "Immediate", node, boolean, skill.immediate)
        self._add_limits(skill, f"{prefix}.Limits", node)

    def _add_limits(self, skill: SkillModel, prefix: str, node: ua.NodeId) -> None:
        parts, limits = self._parts, skill.limits
        folder = parts.folder(prefix, "Limits", node)
        duration = STANDARD["Duration"]
        interval_ms = limits.least_interval_s * 1000
        parts.property(f"{prefix}.LeastInterval", "LeastInterval", folder, _DOUBLE, interval_ms, data_type=duration)
        for name, value in (
            ("LargestMessage", limits.largest_message_bytes),
            ("RequestsAtOnce", limits.requests_at_once),
            ("MostRequestors", limits.most_requestors),
        ):
            parts.property(f"{prefix}.{name}", name, folder, _UINT32, value)
        uint16_array = int(BuiltinType.UINT16 | ARRAY)
        parts.property(f"{prefix}.VisibleTo", "VisibleTo", folder, uint16_array, limits.visible_to)

    def _add_start(self, skill: SkillModel, keys: SkillKeys, node: ua.NodeId) -> None:
        start = node_id(keys.part("Start"))
        spaces = skill.limits.visible_to
        self._parts.builder.add_method(
            start,
            QualifiedName(0, "Start"),
            node,
            description=skill.description,
            executable=spaces is None or SERVER_SPACE in spaces,
        )
        if skill.arguments:
            self._arguments(keys, "InputArguments", start, [_argument(argument) for argument in skill.arguments])
        self._arguments(keys, "OutputArguments", start, [_EXECUTION_ID])
        now = self._parts.now
        for argument in skill.arguments:
            kind = argument.type if argument.default is not None else 0
            self._parts.field(
                _field(keys.argument(argument.name), argument),
                argument.name,
                start,
                description=argument.description,
                reference=_HAS_ARGUMENT_DESCRIPTION,
                value=data_value(kind, argument.typed_default, 0, now, now),
            )

    def _arguments(self, keys: SkillKeys, name: str, start: ua.NodeId, arguments: list[ua.Argument]) -> None:
        now = self._parts.now
        variant = ua.Variant(arguments, ua.VariantType.ExtensionObject, None, True)
        self._parts.builder.add_variable(
            self._parts.id(f"{keys.id}.Start.{name}"),
            QualifiedName(0, name),
            start,
            STANDARD["PropertyType"],
            data_type=_ARGUMENT,
            value=ua.DataValue(variant, to_status(0), now, now),
            value_rank=1,
            array_length=len(arguments),
            reference=HAS_PROPERTY,
        )

    def _add_program(self, keys: SkillKeys, node: ua.NodeId) -> None:
        """What every ProgramStateMachineType has (OPC 10000-10 5.2.2)."""
        parts = self._parts
        for name, type_name, members in (
            ("CurrentState", "FiniteStateVariableType", (("Id", BuiltinType.NODE_ID), ("Number", BuiltinType.UINT32))),
            (
                "LastTransition",
                "FiniteTransitionVariableType",
                (
                    ("Id", BuiltinType.NODE_ID),
                    ("Number", BuiltinType.UINT32),
                    ("TransitionTime", BuiltinType.DATETIME),
                ),
            ),
        ):
            parts.standard(keys.part(name), name, node, type_name, raw_id(int(BuiltinType.LOCALIZED_TEXT)))
            for member, kind in members:
                data_type = STANDARD["UtcTime"] if kind is BuiltinType.DATETIME else raw_id(int(kind))
                key = keys.part(f"{name}.{member}")
                parts.standard(key, member, node_id(keys.part(name)), "PropertyType", data_type, is_property=True)
        for name, kind, value in (
            ("Deletable", BuiltinType.BOOLEAN, False),
            ("AutoDelete", BuiltinType.BOOLEAN, False),
            ("RecycleCount", BuiltinType.INT32, 0),
        ):
            parts.property(f"{keys.id}.{name}", name, node, int(kind), value, namespace=0)

    def _add_last_result(self, skill: SkillModel, keys: SkillKeys, node: ua.NodeId) -> None:
        parts, result = self._parts, node_id(keys.part("LastResult"))
        parts.builder.add_object(result, QualifiedName(TYPES_INDEX, "LastResult"), node, STANDARD["BaseObjectType"])
        for name, data_type in (("ExecutionId", raw_id(int(BuiltinType.STRING))), ("EndTime", STANDARD["UtcTime"])):
            key = keys.part(f"LastResult.{name}")
            parts.standard(key, name, result, "PropertyType", data_type, is_property=True, namespace=TYPES_INDEX)
        for declared in skill.results:
            field = _field(keys.result(declared.name), declared)
            parts.field(field, declared.name, result, description=declared.description)


def _field(key: NodeId, argument: ArgumentModel) -> FieldModel:
    return FieldModel(key, argument.name, argument.type, argument.unit, argument.range)


def _argument(argument: ArgumentModel) -> ua.Argument:
    return ua.Argument(
        Name=ua.String(argument.name),
        DataType=raw_id(argument.type & 0x3F),
        ValueRank=ua.Int32(-1),
        ArrayDimensions=[],
        Description=ua.LocalizedText(_described(argument)),
    )


def _described(argument: ArgumentModel) -> str:
    """All that a call dialog shows of an argument, in one line."""
    notes: list[str] = []
    unit = f" {argument.unit}" if argument.unit else ""
    if argument.range is not None:
        notes.append(f"{argument.range[0]:g} to {argument.range[1]:g}{unit}")
    elif unit:
        notes.append(f"in{unit}")
    if argument.default is not None:
        notes.append(f"usually {argument.default}")
    text = argument.description.rstrip(".")
    return "; ".join([text, *notes] if text else notes)
