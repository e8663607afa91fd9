"""Requests in the words that a bridge has announced: names are compared, never places."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from typing import Any

from ua_fleet.errors import LocalWireError, NotAnnounced, SkillRejected
from ua_fleet.pubsub.metadata import field_property, type_codes
from ua_fleet.skill.executions import CONTROL_BITS, Target
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ActionTarget
from ua_fleet.wire.messages import FieldMetaData
from ua_fleet.wire.packed_fields import PackedFields

__all__ = ["NamedArguments", "addressed", "fitting", "not_announced", "target_of"]


class NamedArguments(dict[str, Any]):
    """The arguments of a skill by their names, with the bytes that they were packed into in this order."""

    def __init__(self, names: Iterable[str], packed: PackedFields) -> None:
        super().__init__(zip(names, packed, strict=True))
        self.packed = packed

    def has_order(self, fields: Iterable[FieldMetaData], types: tuple[int, ...]) -> bool:
        """Whether a bridge announces them in this order, with these types."""
        return self.packed.types == types and list(self) == [field.name for field in fields]


def addressed(
    action: ActionMetaDataAnnouncement, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any]
) -> tuple[Target, tuple[int, ...], tuple[Any, ...], int]:
    """The target of a request, the types and values of its arguments, and the version of the announcement that has put
    them in order; raises SkillRejected.
    """
    _check_names(action, topic, robot, skill)
    values, types = _arranged(action, arguments), type_codes(action.request.fields)
    if isinstance(arguments, NamedArguments) and arguments.has_order(action.request.fields, types):
        values = arguments.packed
    version = action.request.configuration_version.major if values else 0
    return Target(*topic, target_of(action, robot)), types, values, version


@contextmanager
def fitting(action: ActionMetaDataAnnouncement) -> Generator[None]:
    """Values that do not fit are the caller's mistake: SkillRejected."""
    try:
        yield
    except LocalWireError as error:
        raise SkillRejected(f"{action.request.name}: {error}") from error


def _arranged(action: ActionMetaDataAnnouncement, arguments: Mapping[str, Any]) -> tuple[Any, ...]:
    """The arguments in the order that the bridge announces; raises SkillRejected with the names that differ."""
    fields, name = action.request.fields, action.request.name
    values = [arguments.get(field.name, field_property(field, "Default")) for field in fields]
    missing = [field.name for field, value in zip(fields, values, strict=True) if value is None]
    announced = {field.name for field in fields}
    unknown = [argument for argument in arguments if argument not in announced]
    if missing or unknown:
        said = [f"takes {named!r}, which is not given" for named in missing]
        said += [f"does not take {named!r}" for named in unknown]
        raise SkillRejected(f"{name} {', and '.join(said)}: the bridge's fleet.yaml and the server's differ")
    return tuple(values)


def _check_names(action: ActionMetaDataAnnouncement, topic: Topic, robot: str, skill: str) -> None:
    """The ids are in the files of both sides, and may have been given to other skills there."""
    name, targets = action.request.name, [each.name for each in action.targets if _is_robot(each)]
    if name != skill or robot not in targets:
        said = f"{name} of {', '.join(filter(None, targets)) or 'nobody'}"
        error = SkillRejected(
            f"the bridge announces {said} at {topic.name}, and the server's fleet.yaml has {skill} of {robot} there; "
            f"give both the same ids"
        )
        error.ua_status = StatusCode.BAD_CONFIGURATION_ERROR
        raise error


def _is_robot(target: ActionTarget) -> bool:
    return not target.action_target_id & CONTROL_BITS


def target_of(action: ActionMetaDataAnnouncement, robot: str) -> int:
    """The target of that name; an Action with one target is that robot's whatever the name."""
    targets = [target for target in action.targets if _is_robot(target)]
    named = [target.action_target_id for target in targets if target.name == robot or not targets[1:]]
    if not named:
        raise SkillRejected(f"{action.request.name} has no target {robot!r}")
    return named[0]


def not_announced(topic: Topic) -> NotAnnounced:
    """The error where nobody has announced an Action."""
    return NotAnnounced(
        f"no bridge announces the Action {topic.name}; check that the bridge of space {topic.space} runs, "
        "and where PubSub is JSON that `actions: true` stands there"
    )
