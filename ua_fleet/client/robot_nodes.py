# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""What a robot has: its data and its skills, with all that a page or a form needs, read in few requests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from asyncua import ua

from ua_fleet.client.browsing import variables_below
from ua_fleet.client.details import ValueDetails, type_names, value_details
from ua_fleet.client.skill_nodes import KnownSkill, read_skills, skill_nodes
from ua_fleet.client.translated import NodeNotFound, translated

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["ArgumentNode", "DataNode", "RobotNodes", "SkillNodes", "robot_nodes"]

_WRITE: Final = 2
"""CurrentWrite of an access level (OPC 10000-3 8.57)."""
_HISTORY_READ: Final = 4
_FOLDERS: Final = ("Data", "Sensors")
_EXECUTIONS: Final = ("ExecutionId", "Skill", "State", "Progress", "Result", "Message", "Status")
"""Fields of SkillStatus, arrays of the last executions."""


@dataclass(frozen=True, slots=True)
class DataNode:
    """A Variable below a robot's data."""

    node_id: str
    path: tuple[str, ...]
    """Browse names from the robot's folder down, e.g. `pose`, `x`."""
    folder: str
    """`Data` or `Sensors`."""
    type_name: str
    details: ValueDetails
    writable: bool
    """Whether this user may write it."""
    description: str
    has_history: bool = False
    """Whether this user may read what the server has kept of it."""


@dataclass(frozen=True, slots=True)
class ArgumentNode:
    """An argument of a skill, as a form asks for it."""

    name: str
    type_name: str
    description: str
    default: Any
    """None: it has to be given."""
    details: ValueDetails


@dataclass(frozen=True, slots=True)
class SkillNodes:
    """A skill, with the NodeIds of its Variables and Methods by their names."""

    name: str
    node_id: str
    description: str
    arguments: tuple[ArgumentNode, ...]
    timeout_s: float
    members: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class RobotNodes:
    """A robot's nodes."""

    name: str
    node_id: str
    data: tuple[DataNode, ...]
    skills: tuple[SkillNodes, ...]
    executions: Mapping[str, str] = field(default_factory=dict[str, str])
    """NodeIds of the arrays that tell its last executions, by their names; empty where it tells none."""


async def robot_nodes(client: FleetClient, robot: str) -> RobotNodes:
    """What a robot has.

    Raises:
        NodeNotFound: there is no such robot.
        NotConnected: the connection was lost.
    """
    with translated(client.endpoint):
        node = (await client.robots()).get(robot)
        if node is None:
            raise NodeNotFound(f"there is no robot {robot!r}; look with: ua-fleet robot list")
        (children,) = await client.batches.browse([node], classes=int(ua.NodeClass.Object))
        folders = {str(child.BrowseName.Name): child.NodeId for child in children}
        data: list[DataNode] = []
        for folder in _FOLDERS:
            if folder in folders:
                data += await _data(client, folder, folders[folder])
        skills = await _skills(client, robot, folders["Skills"]) if "Skills" in folders else ()
        executions: dict[str, str] = {}
        if "SkillStatus" in folders:
            (arrays,) = await client.batches.browse([folders["SkillStatus"]], classes=int(ua.NodeClass.Variable))
            names = {str(one.BrowseName.Name): one.NodeId.to_string() for one in arrays}
            executions = {name: names[name] for name in _EXECUTIONS if name in names}
        return RobotNodes(robot, node.to_string(), tuple(data), tuple(skills), executions)


async def _data(client: FleetClient, folder: str, node: ua.NodeId) -> list[DataNode]:
    batches = client.batches
    found = await variables_below(batches, {folder: node})
    ids = [one.node for one in found]
    types = await type_names(batches, ids)
    details = await value_details(batches, ids)
    levels = await batches.read(ids, ua.AttributeIds.UserAccessLevel)
    texts = await batches.read(ids, ua.AttributeIds.Description)
    return [
        DataNode(
            one.node.to_string(),
            one.path,
            folder,
            type_name,
            detail,
            bool(int(_value(level) or 0) & _WRITE),
            str(getattr(_value(text), "Text", None) or ""),
            bool(int(_value(level) or 0) & _HISTORY_READ),
        )
        for one, type_name, detail, level, text in zip(found, types, details, levels, texts, strict=True)
        if type_name is not None
    ]


async def _skills(client: FleetClient, robot: str, folder: ua.NodeId) -> list[SkillNodes]:
    known = await read_skills(client.batches, await skill_nodes(client.batches, [(robot, folder)]))
    asked = [node for skill in known for node in skill.arguments.values()]
    details = dict(zip(asked, await value_details(client.batches, asked), strict=True))
    return [
        SkillNodes(
            skill.info.name,
            skill.info.node_id,
            skill.info.description,
            tuple(
                ArgumentNode(
                    one.name,
                    one.type_name,
                    one.description,
                    one.default,
                    _details(skill, one.name, details),
                )
                for one in skill.info.arguments
            ),
            skill.info.timeout_s,
            {name: node.to_string() for name, node in skill.members.items()},
        )
        for skill in known
    ]


def _details(skill: KnownSkill, argument: str, details: Mapping[ua.NodeId, ValueDetails]) -> ValueDetails:
    node = skill.arguments.get(argument)
    return details.get(node, ValueDetails()) if node is not None else ValueDetails()


def _value(data: ua.DataValue) -> Any:
    return None if data.Value is None else data.Value.Value
