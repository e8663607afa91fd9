"""What is known of the executions of skills: facts in, changes of nodes and transitions out; without I/O or clock.

    requested      a request of this server was recorded, and is on its way
    concluded      its outcome: accepted, refused, timed out or unknown
    DataReceived   SkillStatus, the robot's own word, which overrules all that was assumed
    SourceSilent   what SkillStatus drives is Bad_NoCommunication, with the last values, until it is heard again

Nothing of this is coalesced or dropped. The first SkillStatus after a start shows how things are, and tells no events
of it: they were told before. An execution that this run has asked for has its events in any case.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.operation.skills.executions import STATUS_OF, KnownExecution, SkillKeys, answered, heard
from ua_fleet.operation.skills.program import ProgramState
from ua_fleet.operation.skills.tracked import SkillChange, SkillTransitioned, TrackedSkill
from ua_fleet.pubsub.events import (
    DataReceived,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SubscriberEvent,
)
from ua_fleet.skill.executions import OPEN, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.skill.status import read_status
from ua_fleet.topics import Topic
from ua_fleet.values import NodeId, StatusCode

__all__ = ["KnownExecution", "SkillChange", "SkillKeys", "SkillTracker", "SkillTransitioned"]

MOST_ASKED: Final = 1000
"""Requests whose outcome may still be told, or corrected."""
_S: Final = ExecutionState
_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)
_LAST_USABLE: Final = int(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE)


class SkillTracker:
    """The skills of a fleet. Times are ticks of the wall clock."""

    def __init__(self, model: FleetModel) -> None:
        self._robots: dict[Topic, dict[str, TrackedSkill]] = {}
        """Skills by name, by the topic of their robot's SkillStatus."""
        self._skills: dict[NodeId, TrackedSkill] = {}
        self._topics: dict[NodeId, Topic] = {}
        self._asked: dict[bytes, TrackedSkill] = {}
        """Executions that this run has asked for, and whose outcome is not known yet."""
        self._synchronised: set[Topic] = set()
        """Whose SkillStatus was heard."""
        self._busy: dict[Topic, tuple[str, ...]] = {}
        """The skills that robots are told to be at, where there are any."""
        self._touched: set[Topic] = set()
        for robot in model.robots:
            self.add(robot)

    def add(self, robot: RobotModel) -> None:
        """Know a robot from now on."""
        if robot.skill_status is None:
            return
        skills = self._robots.setdefault(robot.skill_status, {})
        for model in robot.skills:
            skill = skills[model.name] = TrackedSkill(robot, model)
            self._skills[skill.keys.object] = skill
            self._topics[skill.keys.object] = robot.skill_status

    def remove(self, robot: RobotModel) -> None:
        """Forget a robot."""
        if robot.skill_status is None:
            return
        gone = set(self._robots.pop(robot.skill_status, {}).values())
        for skill in gone:
            del self._skills[skill.keys.object], self._topics[skill.keys.object]
        self._asked = {key: skill for key, skill in self._asked.items() if skill not in gone}
        self._synchronised.discard(robot.skill_status)
        self._busy.pop(robot.skill_status, None)

    def knows(self, topic: Topic) -> bool:
        """Whether this is a robot's SkillStatus."""
        return topic in self._robots

    def under_way(self, key: NodeId) -> int:
        """Executions of a skill that are not over."""
        return self._skills[key].under_way

    @property
    def all_under_way(self) -> int:
        """Executions of all skills that are not over."""
        return sum(skill.under_way for skill in self._skills.values())

    def open_executions(self, key: NodeId) -> list[bytes]:
        """Their ids, the oldest first."""
        return self._skills[key].ids(OPEN)

    def running_executions(self, key: NodeId) -> list[bytes]:
        """The ids of those in which the robot does not stand."""
        return self._skills[key].ids(OPEN - {_S.SUSPENDED})

    def suspended_executions(self, key: NodeId) -> list[bytes]:
        """The ids of those in which it does."""
        return self._skills[key].ids(frozenset({_S.SUSPENDED}))

    def is_silent(self, key: NodeId) -> bool:
        """Whether the robot's SkillStatus was heard, and is not any more."""
        return self._skills[key].status >> 31 == 1 and self._topics[key] in self._synchronised

    def state(self, key: NodeId) -> ProgramState:
        """The state that a skill shows."""
        return self._skills[key].state

    def execution(self, key: NodeId, execution_id: bytes) -> KnownExecution | None:
        """What is known of an execution."""
        return self._skills[key].executions.get(execution_id)

    def actions(self) -> Iterator[Topic]:
        """The Actions of all skills."""
        for status, skills in self._robots.items():
            for skill in skills.values():
                yield Topic(status.space, skill.keys.ns, skill.keys.id)

    def take_busy_changes(self) -> list[tuple[Topic, tuple[str, ...]]]:
        """Robots, by their SkillStatus, that are at other skills than at the last call, with these."""
        changes: list[tuple[Topic, tuple[str, ...]]] = []
        for topic in self._touched:
            known = self._robots.get(topic, {})
            skills = tuple([name for name, skill in known.items() if skill.under_way])
            if skills != self._busy.get(topic, ()):
                self._busy[topic] = skills
                changes.append((topic, skills))
        self._touched.clear()
        return changes

    def requested(self, key: NodeId, execution_id: bytes, ticks: int) -> list[SkillChange]:
        """A request of this server was recorded and sent; said again after a restart, it changes nothing."""
        skill = self._skills[key]
        self._asked[execution_id] = skill
        if len(self._asked) > MOST_ASKED:
            del self._asked[next(iter(self._asked))]
        self._touched.add(self._topics[key])
        if execution_id in skill.executions:
            return []
        return [
            *self._known_here(skill, ticks),
            *skill.take(KnownExecution(execution_id, _S.RUNNING, began=ticks), ticks),
        ]

    def concluded(self, execution_id: bytes, outcome: RequestOutcome, ticks: int) -> list[SkillChange]:
        """The outcome of a request, also a corrected one; nothing where another run has asked for it."""
        skill = self._asked.get(execution_id)
        if skill is None:
            return []
        self._touched.add(self._topics[skill.keys.object])
        report = outcome.report
        if outcome.kind is not OutcomeKind.UNKNOWN:
            del self._asked[execution_id]
        known = skill.executions.get(execution_id)
        if known is not None and known.is_over and known.state is not _S.UNKNOWN:
            return []  # SkillStatus was faster
        execution = known or KnownExecution(execution_id, _S.RUNNING, began=ticks)
        if report.state in OPEN:
            if known is not None and not known.is_over:
                return []
            return skill.take(replace(execution, state=_S.RUNNING, status=0, message=report.message, ended=None), ticks)
        is_done = report.state is _S.DONE
        return skill.take(
            replace(
                execution,
                state=report.state,
                status=report.status if is_done or report.status else STATUS_OF[report.state],
                message=report.message,
                progress=1.0 if is_done else execution.progress,
                results=answered(skill.model, outcome) if is_done else {},
                ended=ticks,
            ),
            ticks,
        )

    def reset(self, key: NodeId, ticks: int) -> list[SkillChange]:
        """Make a halted skill Ready."""
        return self._skills[key].reset(ticks)

    def expire(self, key: NodeId, ticks: int) -> list[SkillChange]:
        """Give up executions of a skill whose end must have been lost, so that they do not keep others out for ever."""
        self._touched.add(self._topics[key])
        return self._skills[key].expire(ticks)

    def apply(self, event: SubscriberEvent, ticks: int) -> list[SkillChange]:
        """What an event of a robot's SkillStatus changes."""
        if isinstance(event, DataReceived):
            if (event.message.status or 0) >> 31:
                return self._all(event.topic, event.message.status or 0, ticks)
            return self._status(event, ticks)
        if isinstance(event, SourceSilent):
            return self._all(event.topic, _NO_COMMUNICATION, ticks)
        if isinstance(event, SourceReturned):
            return self._all(event.topic, 0, ticks)
        if isinstance(event, SourceStale):
            return self._all(event.topic, _LAST_USABLE, ticks)
        if isinstance(event, SourceRefused):
            return self._all(event.topic, int(StatusCode.BAD_SECURITY_CHECKS_FAILED), ticks)
        return []

    def _known_here(self, skill: TrackedSkill, ticks: int) -> list[ValueChanged]:
        """What this server has asked for is shown before the robot has said anything, though nothing attests it yet."""
        if skill.status == StatusCode.BAD_WAITING_FOR_INITIAL_DATA:
            return skill.set_status(_LAST_USABLE, ticks)
        return []

    def _all(self, topic: Topic, status: int, ticks: int) -> list[SkillChange]:
        skills = self._robots.get(topic, {}).values()
        return [change for skill in skills for change in skill.set_status(status, ticks)]

    def _status(self, event: DataReceived, ticks: int) -> list[SkillChange]:
        skills = self._robots.get(event.topic, {})
        changes = self._all(event.topic, 0, ticks)
        is_first = event.topic not in self._synchronised
        self._synchronised.add(event.topic)
        self._touched.add(event.topic)
        when = event.message.timestamp or ticks
        told = list(read_status(event.metadata.fields, event.message.values))
        listed = frozenset(said.execution_id for said in told)
        for each in skills.values():
            each.listed = listed
        for said in told:
            skill = skills.get(said.skill)
            if skill is None:
                continue
            known = skill.executions.get(said.execution_id)
            execution = heard(skill.model, said, known, when)
            if execution is not None:
                changes += skill.take(execution, when, quiet=is_first and known is None)
        return changes
