"""What the bridge publishes of its robots' executions: one SkillStatus for each robot, as data like any other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ua_fleet.bridge.core import NODE_ONLY, BridgeCore
from ua_fleet.bridge.driver import ExecutionProgressed, Skill, SourceFound, SourceLost
from ua_fleet.pubsub.metadata import PropertyValue, make_field
from ua_fleet.skill.executions import ExecutionState, Target, unpack
from ua_fleet.skill.journal import RecordedExecution
from ua_fleet.skill.status import ROBOT_PROPERTY, SKILL_STATUS_FIELDS, ExecutionStatus, SkillStatus, result_text
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["StatusBoard"]

_FIRST, *_OTHERS = SKILL_STATUS_FIELDS
_AT_IT = (ExecutionState.RUNNING, ExecutionState.SUSPENDED)


class StatusBoard:
    """The SkillStatus of all robots of a bridge."""

    def __init__(self, core: BridgeCore, definitions: Mapping[Topic, str]) -> None:
        """Begin with no robots.

        Args:
            core: publishes.
            definitions: what robots are, as JSON in the form of `fleet.yaml`, by the topics of their SkillStatus.
        """
        self._core, self._definitions = core, definitions
        self._robots: dict[Topic, tuple[str, SkillStatus]] = {}
        """Name of the robot and what is shown of it, by the topic of its SkillStatus."""
        self._targets: dict[Target, tuple[Skill, Topic]] = {}

    def offer(self, skills: Iterable[Skill], now: float, wall_ticks: int) -> None:
        """These are the skills now. A robot without any is no longer heard of."""
        self._targets.clear()
        names: dict[Topic, str] = {}
        for skill in skills:
            for target in skill.targets:
                self._targets[Target(*skill.topic, target.id)] = skill, target.status
                names.setdefault(target.status, target.name)
        for topic in self._robots.keys() - names.keys():
            del self._robots[topic]
            self._core.from_space(SourceLost(topic), now=now, wall_ticks=wall_ticks)
        for topic, name in names.items():
            known = self._robots.get(topic)
            if known is None or known[0] != name:
                self._robots[topic] = name, known[1] if known is not None else SkillStatus()
                source = SourceFound(topic, f"{name} skill status", self._fields(topic))
                self._core.from_space(source, now=now, wall_ticks=wall_ticks)
                self._publish(topic, now, wall_ticks)

    def _fields(self, topic: Topic) -> tuple[FieldMetaData, ...]:
        """They are for the server's nodes, not for another robot's space; the first one says what the robot is."""
        properties: dict[str, PropertyValue] = {NODE_ONLY: True}
        if (definition := self._definitions.get(topic)) is not None:
            properties[ROBOT_PROPERTY] = definition
        made = make_field(_FIRST.name, _FIRST.builtin_type, properties=properties)
        return _FIRST._replace(properties=made.properties), *_OTHERS

    def names_of(self, target: Target) -> tuple[str, str] | None:
        """Robot and skill of a target that executes."""
        found = self._targets.get(target)
        return None if found is None else (self._robots[found[1]][0], found[0].name)

    def show(self, execution: RecordedExecution, now: float, wall_ticks: int) -> None:
        """An execution is new or has a new state."""
        found = self._targets.get(execution.target)
        if found is None:
            return
        (skill, topic), report = found, execution.report
        before = self._robots[topic][1].get(execution.execution_id)
        progress = 1.0 if report.state is ExecutionState.DONE else before.progress if before is not None else 0.0
        results = {
            field.name: _plain(result.value)
            for field, result in zip(skill.response, unpack(report.result), strict=False)
        }
        status = ExecutionStatus(
            execution.execution_id,
            skill.name,
            report.state,
            progress,
            result_text(results),
            report.message,
            report.status,
        )
        self._show(topic, status, now, wall_ticks)

    def progressed(self, target: Target, fact: ExecutionProgressed, now: float, wall_ticks: int) -> None:
        """A robot says how far an execution is."""
        found = self._targets.get(target)
        before = None if found is None else self._robots[found[1]][1].get(fact.execution_id)
        if found is not None and before is not None and before.state in _AT_IT:
            self._show(found[1], before._replace(progress=fact.progress, message=fact.message), now, wall_ticks)

    def _show(self, topic: Topic, status: ExecutionStatus, now: float, wall_ticks: int) -> None:
        if self._robots[topic][1].show(status):
            self._publish(topic, now, wall_ticks)

    def _publish(self, topic: Topic, now: float, wall_ticks: int) -> None:
        _, values = self._robots[topic][1].fields()
        self._core.tell(topic, values, wall_ticks, now=now)


def _plain(value: Any) -> Any:
    """A value that JSON has, or its text."""
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
