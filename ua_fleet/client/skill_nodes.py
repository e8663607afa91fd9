# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Skills as their nodes describe them: of one robot or of all, in few requests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from asyncua import ua

from ua_fleet.client.batches import Batches
from ua_fleet.client.convert import plain_value

__all__ = ["KnownSkill", "SkillArgument", "SkillInfo", "SkillNode", "read_skills", "skill_nodes"]

_FOLDER: Final = ua.NodeId(ua.Int32(ua.ObjectIds.FolderType))


@dataclass(frozen=True, slots=True)
class SkillArgument:
    """An argument of a skill."""

    name: str
    type_name: str
    description: str
    default: Any = None
    """None: it has to be given."""


@dataclass(frozen=True, slots=True)
class SkillInfo:
    """A skill as it can be called."""

    robot: str
    name: str
    node_id: str
    description: str
    arguments: tuple[SkillArgument, ...]
    timeout_s: float
    state: str | None
    """Ready, Running, Suspended or Halted; None while the robot is not heard."""


@dataclass(slots=True)
class KnownSkill:
    """A skill whose nodes were read."""

    info: SkillInfo
    start: ua.NodeId
    types: dict[str, ua.VariantType]
    members: dict[str, ua.NodeId]
    """Methods and Variables of the skill, by their names."""
    arguments: dict[str, ua.NodeId]
    """Variables that say what there is to say of its arguments, by their names."""
    said: dict[ua.NodeId, Any]
    """What stands below Start: which arguments there are, and their defaults."""


class SkillNode(NamedTuple):
    """Where a skill stands."""

    robot: str
    name: str
    node: ua.NodeId


async def skill_nodes(batches: Batches, folders: Sequence[tuple[str, ua.NodeId]]) -> list[SkillNode]:
    """The skills in some robots' folders, each given with its robot's name; folders in them hold nothing but order."""
    found: list[SkillNode] = []
    while folders:
        answers = await batches.browse([node for _, node in folders], classes=int(ua.NodeClass.Object))
        inner: list[tuple[str, ua.NodeId]] = []
        for (robot, _), children in zip(folders, answers, strict=True):
            for child in children:
                if child.TypeDefinition == _FOLDER:
                    inner.append((robot, child.NodeId))
                else:
                    found.append(SkillNode(robot, str(child.BrowseName.Name), child.NodeId))
        folders = inner
    return found


async def read_skills(batches: Batches, skills: Sequence[SkillNode]) -> list[KnownSkill]:
    """What these skills are and how they stand; those whose nodes are no skill's, or have just gone, are left out."""
    members = [_by_name(children) for children in await batches.browse([skill.node for skill in skills])]
    there = [
        (skill, parts)
        for skill, parts in zip(skills, members, strict=True)
        if {"Start", "Timeout", "CurrentState"} <= parts.keys()
    ]
    starts = [_by_name(children) for children in await batches.browse([parts["Start"] for _, parts in there])]
    texts = await batches.read([skill.node for skill, _ in there], ua.AttributeIds.Description)
    # Of each skill its timeout, its state, and what stands below Start: the arguments and their defaults.
    wanted = [
        [parts["Timeout"], parts["CurrentState"], *below.values()]
        for (_, parts), below in zip(there, starts, strict=True)
    ]
    values = iter(await batches.read([node for nodes in wanted for node in nodes]))
    known: list[KnownSkill] = []
    for (skill, parts), below, text in zip(there, starts, texts, strict=True):
        timeout, state = next(values), next(values)
        told = {name: next(values) for name in below}
        if not isinstance(_value(timeout), int | float):
            continue  # it was unregistered meanwhile
        one = _known(skill, parts, _value(timeout) / 1000, state, told, _text(_value(text)))
        one.arguments.update({name: below[name] for name in one.types if name in below})
        one.said.update({node: _value(told[name]) for name, node in below.items()})
        known.append(one)
    return known


async def is_as_known(batches: Batches, known: KnownSkill) -> bool:
    """Whether a skill has the arguments and defaults still that it had when it was read."""
    said = await batches.read(list(known.said))
    return [_value(one) for one in said] == list(known.said.values())


def _known(
    skill: SkillNode,
    members: dict[str, ua.NodeId],
    timeout_s: float,
    state: ua.DataValue,
    told: dict[str, ua.DataValue],
    description: str,
) -> KnownSkill:
    types: dict[str, ua.VariantType] = {}
    arguments = list(_arguments(told, types))
    is_heard = state.StatusCode is None or state.StatusCode.value == 0
    shown = _text(_value(state)) if is_heard and _value(state) is not None else None
    info = SkillInfo(skill.robot, skill.name, skill.node.to_string(), description, tuple(arguments), timeout_s, shown)
    return KnownSkill(info, members["Start"], types, members, {}, {})


def _arguments(told: dict[str, ua.DataValue], types: dict[str, ua.VariantType]) -> Iterator[SkillArgument]:
    declared: list[Any] = _value(told["InputArguments"]) or [] if "InputArguments" in told else []
    for argument in declared:
        name = str(argument.Name)
        default = plain_value(_value(told[name])) if name in told else None
        types[name] = ua.VariantType(argument.DataType.Identifier)
        yield SkillArgument(name, types[name].name, _text(argument.Description), default)


def _by_name(children: Sequence[ua.ReferenceDescription]) -> dict[str, ua.NodeId]:
    return {str(child.BrowseName.Name): child.NodeId for child in children}


def _text(text: Any) -> str:
    return str(getattr(text, "Text", None) or "")


def _value(data: ua.DataValue) -> Any:
    return None if data.Value is None else data.Value.Value
