"""Tasks of runs as requests to robots, and what robots say of them.

    begin -> request, again until the Action is announced -> outcome, SkillStatus -> accepted, ended

A skill is asked for no sooner than its least interval after it was last accepted: its bridge would refuse that.

A request that was made before, also by a run of the server before, is not made again: its outcome is what it was.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import structlog

from ua_fleet.errors import RobotOffline, SkillError, StorageUnavailable
from ua_fleet.fleet.model import RobotModel
from ua_fleet.fleet.skills import SkillModel, call_problems
from ua_fleet.orchestrator import OperatorAsked, TaskCancelled, TaskStarted
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.scenario import Value
from ua_fleet.scenario.facts import TaskOutcome
from ua_fleet.skill.executions import OPEN, ExecutionState, Outcome, OutcomeKind, unpack
from ua_fleet.skill.status import read_result, read_status
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, NodeId, StatusCode, is_finite, status_name

__all__ = ["START_WITHIN_S", "Requests", "TaskRequests"]

START_WITHIN_S: Final = 10.0
"""A robot that has not begun by then has refused. Immediate skills have their own timeout: they answer at their end."""
BUSY_PAUSE_S: Final = 0.5
"""Before a robot that is at something else is asked again."""
_BUSY: Final = (StatusCode.BAD_TOO_MANY_OPERATIONS, StatusCode.BAD_SERVER_TOO_BUSY)
"""What a robot refuses now it may take later."""
ASK_AGAIN_S: Final = 0.2
"""Pause before an Action that nobody has announced is looked for again."""
MOST_EXECUTIONS: Final = 10_000

_FLOATS: Final = (BuiltinType.FLOAT, BuiltinType.DOUBLE)
_ENDED: Final = {
    ExecutionState.DONE: TaskOutcome.DONE,
    ExecutionState.FAILED: TaskOutcome.FAILED,
    ExecutionState.UNKNOWN: TaskOutcome.UNKNOWN,
    ExecutionState.TIMED_OUT: TaskOutcome.TIMED_OUT,
}

_log: Any = structlog.get_logger("ua_fleet.scenarios")


class Requests(Protocol):
    """What asks robots; see `server.commands_out.SkillCommands`."""

    def request(self, topic: Topic, robot: str, values: tuple[Any, ...], timeout_s: float, execution_id: bytes) -> None:
        """Have a robot do a skill, once, and wait for nothing."""
        ...

    def halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot stop an execution."""
        ...

    def known_outcome(self, execution_id: bytes) -> Outcome | None:
        """What is known of a request; None while it is asked for, KeyError where it was never made."""
        ...


@dataclass(slots=True)
class _Waiting:
    """A task whose robot could not, or must not, be asked yet."""

    task: TaskStarted
    give_up_at: float
    next_at: float


class TaskRequests:
    """Asks robots, once for each execution. What comes of it is told by `accepted` and `ended`."""

    def __init__(
        self,
        robots: Mapping[str, RobotModel],
        requests: Requests,
        *,
        requested: Callable[[NodeId, bytes], None],
        clock: Callable[[], float],
        accepted: Callable[[str], None],
        ended: Callable[[str, TaskOutcome, str, Mapping[str, Value]], None],
    ) -> None:
        """Connect the parts.

        Args:
            robots: by their names.
            requests: asks them.
            requested: told of each skill (its node) that was asked for, with the execution's id.
            clock: monotonic seconds.
            accepted: told of executions that robots have taken.
            ended: told of their ends, with message and results.
        """
        self._robots, self._requests, self._requested, self._clock = robots, requests, requested, clock
        self._accepted, self._tell_end = accepted, ended
        self._status_topics = {robot.skill_status for robot in robots.values() if robot.skill_status is not None}
        self._skills: OrderedDict[str, SkillModel] = OrderedDict()
        """The skill of each execution that was begun here."""
        self._told_by: dict[str, Topic] = {}
        """The SkillStatus of its robot, which alone may tell of it."""
        self._waiting: dict[str, _Waiting] = {}
        self._free_at: dict[NodeId, float] = {}
        """When a skill with a least interval may be asked for again."""
        self._without_interval: set[str] = set()
        """Executions that were asked for, and of which nothing was heard yet."""
        self._shown: dict[Topic, dict[str, tuple[TaskOutcome | None, str, dict[str, Value]]]] = {}
        """The executions of each robot's last SkillStatus."""

    def add(self, robot: RobotModel) -> None:
        """A robot has come."""
        if robot.skill_status is not None:
            self._status_topics.add(robot.skill_status)

    def remove(self, robot: RobotModel) -> None:
        """A robot that does nothing is gone."""
        if robot.skill_status is not None:
            self._status_topics.discard(robot.skill_status)
            self._shown.pop(robot.skill_status, None)

    def _know(self, execution_id: str, robot_name: str, skill_name: str) -> Topic | None:
        """Listen for an execution; the SkillStatus of its robot, None where there is no such skill any more."""
        robot = self._robots.get(robot_name)
        skill = next((skill for skill in robot.skills if skill.name == skill_name), None) if robot is not None else None
        if robot is None or skill is None or robot.skill_status is None:
            return None
        self._skills[execution_id], self._told_by[execution_id] = skill, robot.skill_status
        if len(self._skills) > MOST_EXECUTIONS:
            oldest, _ = self._skills.popitem(last=False)
            del self._told_by[oldest]
        return robot.skill_status

    def follow(self, asked: OperatorAsked) -> None:
        """Nobody could tell what became of an execution; listen whether its robot can after all. Asks for nothing."""
        status = self._know(asked.execution_id, asked.robot, asked.skill)
        shown = self._shown.get(status, {}).get(asked.execution_id) if status is not None else None
        if shown is not None:
            self._take_state(asked.execution_id, *shown)

    def begin(self, task: TaskStarted) -> None:
        """Ask a robot, once: after a restart the same execution id is the same request."""
        status = self._know(task.execution_id, task.robot, task.skill)
        if status is None:
            self._ended(task.execution_id, TaskOutcome.REFUSED, f"{task.robot} has no skill {task.skill}", {})
            return
        execution_id = bytes.fromhex(task.execution_id)
        try:
            outcome = self._requests.known_outcome(execution_id)
        except KeyError:
            now = self._clock()
            begin_at = max(now, self._free_at.get(self._node_of(task.execution_id), now))
            waiting = self._waiting[task.execution_id] = _Waiting(task, begin_at + START_WITHIN_S, begin_at)
            if begin_at <= now:
                self._ask(waiting)
        else:
            if outcome is not None:
                self.concluded(execution_id, outcome)
        shown = self._shown.get(status, {}).get(task.execution_id)
        if shown is not None:
            self._take_state(task.execution_id, *shown)

    def _ask(self, waiting: _Waiting) -> None:
        task = waiting.task
        robot, skill = self._robots[task.robot], self._skills[task.execution_id]
        assert robot.skill_status is not None
        topic = Topic(robot.skill_status.space, robot.ns, skill.id)
        timeout_s = skill.timeout_s if skill.immediate else min(START_WITHIN_S, skill.timeout_s)
        now = self._clock()
        problems = call_problems(skill, task.arguments)  # what a scenario computes is known now only
        if problems:
            self._ended(task.execution_id, TaskOutcome.REFUSED, "; ".join(problems), {})
            return
        try:
            given = skill.filled(task.arguments)
            values = tuple([_typed(argument.type, given[argument.name]) for argument in skill.arguments])
            self._requests.request(topic, robot.name, values, timeout_s, bytes.fromhex(task.execution_id))
        except (RobotOffline, StorageUnavailable) as error:
            if now < waiting.give_up_at:
                waiting.next_at = now + ASK_AGAIN_S
                return
            self._ended(task.execution_id, TaskOutcome.REFUSED, str(error), {})
        except SkillError as error:
            self._ended(task.execution_id, TaskOutcome.REFUSED, str(error), {})
        else:
            self._waiting.pop(task.execution_id, None)
            if skill.limits.least_interval_s > 0:
                self._without_interval.add(task.execution_id)
            self._requested(NodeId(robot.ns, skill.id), bytes.fromhex(task.execution_id))

    def _node_of(self, execution_id: str) -> NodeId:
        return NodeId(self._told_by[execution_id].ns, self._skills[execution_id].id)

    def _begin_interval(self, execution_id: str) -> None:
        """From the first word of an execution, and not from its request, which may have been on its way for long."""
        if execution_id in self._without_interval:
            self._without_interval.discard(execution_id)
            interval_s = self._skills[execution_id].limits.least_interval_s
            self._free_at[self._node_of(execution_id)] = self._clock() + interval_s

    def cancel(self, cancelled: TaskCancelled) -> None:
        """What was not asked for yet never is; what was is halted, where the robot has a way to."""
        if self._waiting.pop(cancelled.execution_id, None) is not None:
            self._ended(cancelled.execution_id, TaskOutcome.REFUSED, "it was cancelled before it began", {})
            return
        robot, skill = self._robots.get(cancelled.robot), self._skills.get(cancelled.execution_id)
        if robot is None or skill is None or robot.skill_status is None:
            return
        topic = Topic(robot.skill_status.space, robot.ns, skill.id)
        try:
            self._requests.halt(topic, robot.name, bytes.fromhex(cancelled.execution_id))
        except (SkillError, StorageUnavailable) as error:
            _log.warning("a robot is not halted", robot=robot.name, skill=skill.name, reason=str(error))

    def heard(self, event: DataReceived) -> None:
        """Take a robot's SkillStatus; any other data is left alone."""
        if event.topic not in self._status_topics:
            return
        shown = self._shown[event.topic] = dict(_shown_in(event))
        for execution_id in shown.keys() & self._skills.keys():
            if self._told_by[execution_id] == event.topic:
                self._take_state(execution_id, *shown[execution_id])

    def concluded(self, execution_id: bytes, outcome: Outcome) -> None:
        """The outcome of a request is known."""
        hex_id = execution_id.hex()
        skill = self._skills.get(hex_id)
        if skill is None:
            return
        report = outcome.report
        message = _with_status(report.message, report.status)
        if outcome.kind is OutcomeKind.ACCEPTED:
            self._begin_interval(hex_id)
            if report.state in OPEN or report.state is ExecutionState.DONE:
                self._accepted(hex_id)
            if report.state is ExecutionState.DONE:
                values = [variant.value for variant in unpack(report.result)]
                names = [result.name for result in skill.results]
                self._ended(hex_id, TaskOutcome.DONE, message, _usable(dict(zip(names, values, strict=False))))
            elif (end := _outcome_of(report.state, report.status)) is not None:
                self._ended(hex_id, end, message, {})
        elif outcome.kind is OutcomeKind.REFUSED:
            self._ended(hex_id, _refusal(report.status), message, {})
        else:
            timed_out = outcome.kind is OutcomeKind.TIMED_OUT
            self._ended(hex_id, TaskOutcome.TIMED_OUT if timed_out else TaskOutcome.UNKNOWN, message, {})

    def poll(self) -> None:
        """Ask those who could not be asked before."""
        now = self._clock()
        for waiting in list(self._waiting.values()):
            if now >= waiting.next_at:
                self._ask(waiting)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, by the monotonic clock, or None."""
        return min((waiting.next_at for waiting in self._waiting.values()), default=None)

    def _take_state(
        self, execution_id: str, outcome: TaskOutcome | None, message: str, results: dict[str, Value]
    ) -> None:
        self._begin_interval(execution_id)
        if outcome is None:
            self._accepted(execution_id)
        else:
            self._ended(execution_id, outcome, message, results)

    def _ended(self, execution_id: str, outcome: TaskOutcome, message: str, results: Mapping[str, Value]) -> None:
        if outcome is TaskOutcome.BUSY and execution_id in self._skills:
            self._free_at[self._node_of(execution_id)] = self._clock() + BUSY_PAUSE_S
        if outcome is not TaskOutcome.UNKNOWN:  # what nobody can tell may be told later
            self._skills.pop(execution_id, None)
            self._told_by.pop(execution_id, None)
        self._waiting.pop(execution_id, None)
        self._without_interval.discard(execution_id)
        self._tell_end(execution_id, outcome, message, results)


def _typed(kind: int, value: Value) -> Value:
    """A legal value in the type of its argument: YAML writes 0 where a Double is meant."""
    if isinstance(value, bool | str):
        return value
    return float(value) if kind in _FLOATS else int(value)


def _outcome_of(state: ExecutionState, status: int) -> TaskOutcome | None:
    """What an execution has come to; None while it is under way."""
    if state is ExecutionState.FAILED and status == StatusCode.BAD_TIMEOUT:
        return TaskOutcome.TIMED_OUT
    return _refusal(status) if state is ExecutionState.REFUSED else _ENDED.get(state)


def _refusal(status: int) -> TaskOutcome:
    return TaskOutcome.BUSY if status in _BUSY else TaskOutcome.REFUSED


def _with_status(message: str, status: int) -> str:
    """What people read of an end: also its StatusCode, where that says something."""
    return f"{message} ({status_name(status)})".strip() if status else message


def _shown_in(event: DataReceived) -> Iterable[tuple[str, tuple[TaskOutcome | None, str, dict[str, Value]]]]:
    """The executions of a SkillStatus by their ids."""
    for said in read_status(event.metadata.fields, event.message.values):
        outcome, message = _outcome_of(said.state, said.status), _with_status(said.message, said.status)
        yield said.execution_id.hex(), (outcome, message, _usable(read_result(said.result)))


def _usable(results: Mapping[str, Any]) -> dict[str, Value]:
    """The results that conditions can use; whoever sent them may have sent anything."""
    return {
        name: value
        for name, value in results.items()
        if isinstance(value, str) or (isinstance(value, bool | int | float) and is_finite(value))
    }
