"""Tasks of runs as requests to robots, and what robots say of them.

    prepare -> recorded with the facts -> begin -> request, again until the Action is announced
    outcome, SkillStatus -> accepted, ended

A request to a silent robot that nobody has answered is no end: when the robot is heard again, it is asked what became
of it. What was taken back is halted, as soon as there is somebody who can be told.

A skill is asked for no sooner than its least interval after it was last accepted: its bridge would refuse that.

A request that was made before, also by a run of the server before, is not made again: its outcome is what it was.
"""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from ua_fleet.errors import RobotOffline, SkillError, StorageUnavailable
from ua_fleet.fleet.model import RobotModel
from ua_fleet.fleet.skills import SkillModel, call_problems
from ua_fleet.operation.log import Log, MistakeLog
from ua_fleet.operation.runs.outcomes import is_no_answer, outcome_of, refusal, shown_in, usable, with_status
from ua_fleet.operation.runs.task_calls import START_WITHIN_S, Recorded, Requests, call_of
from ua_fleet.orchestrator import OperatorAsked, TaskCancelled, TaskFollowed, TaskStarted
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.scenario import Value
from ua_fleet.scenario.facts import TaskOutcome
from ua_fleet.skill.executions import (
    OPEN,
    ExecutionState,
    OutcomeKind,
    RequestOutcome,
    named_results,
)
from ua_fleet.topics import Topic
from ua_fleet.values import NodeId

__all__ = ["TaskRequests"]

BUSY_PAUSE_S: Final = 0.5
"""Before a robot that is at something else is asked again."""
UNREACHED_PAUSE_S: Final = 2.0
"""Before a robot that its bridge does not reach is asked again."""
_PAUSES_S: Final = {TaskOutcome.BUSY: BUSY_PAUSE_S, TaskOutcome.UNREACHED: UNREACHED_PAUSE_S}
ASK_AGAIN_S: Final = 0.2
"""Pause before an Action that nobody has announced is looked for again."""
HALT_WITHIN_S: Final = 60.0
"""So long each attempt to halt what was taken back goes on while nobody announces the Action; `orchestrator.halts` has
another one made as long as the robot has not stopped."""
MOST_EXECUTIONS: Final = 10_000


@dataclass(slots=True)
class _Waiting:
    """A task whose robot could not, or must not, be asked yet."""

    task: TaskStarted
    give_up_at: float
    next_at: float


@dataclass(slots=True)
class _Halt:
    """A task that was taken back, and whose robot could not be told yet."""

    cancelled: TaskCancelled
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
        is_silent: Callable[[str], bool],
        accepted: Callable[[str], None],
        ended: Callable[[str, TaskOutcome, str, Mapping[str, Value]], None],
        mistakes: MistakeLog,
        log: Log,
    ) -> None:
        """Connect the parts.

        Args:
            robots: by their names.
            requests: asks them.
            requested: told of each skill (its node) that was asked for, with the execution's id.
            clock: monotonic seconds.
            is_silent: whether nothing is heard of a robot.
            accepted: told of executions that robots have taken.
            ended: told of their ends, with message and results.
            mistakes: counts what has cost a task.
            log: is told of robots that cannot be halted.
        """
        self._robots, self._requests, self._requested, self._clock = robots, requests, requested, clock
        self._accepted, self._tell_end, self._is_silent = accepted, ended, is_silent
        self._mistakes, self._log = mistakes, log
        self._robot_of_status = {robot.skill_status: robot.name for robot in robots.values() if robot.skill_status}
        self._skills: OrderedDict[str, SkillModel] = OrderedDict()
        """The skill of each execution that was begun here."""
        self._told_by: dict[str, Topic] = {}
        """The SkillStatus of its robot, which alone may tell of it."""
        self._waiting: dict[str, _Waiting] = {}
        self._halts: dict[str, _Halt] = {}
        self._unstopped: set[str] = set()
        """Executions of which it was said that they could not be halted."""
        self._unanswered: dict[str, str] = {}
        """The robots of executions that were asked for, and of which nothing was heard before they fell silent."""
        self._free_at: dict[NodeId, float] = {}
        """When a skill with a least interval may be asked for again."""
        self._without_interval: set[str] = set()
        """Executions that were asked for, and of which nothing was heard yet."""
        self._shown: dict[Topic, dict[str, tuple[TaskOutcome | None, str, dict[str, Value]]]] = {}
        """The executions of each robot's last SkillStatus."""
        self._lost: set[Topic] = set()
        """SkillStatus that is not heard: what it said last may be so no more."""

    def add(self, robot: RobotModel) -> None:
        """A robot has come."""
        if robot.skill_status is not None:
            self._robot_of_status[robot.skill_status] = robot.name

    def remove(self, robot: RobotModel) -> None:
        """A robot is gone. Nobody is asked for what waits, and nobody hears the end of what was asked for."""
        if robot.skill_status is None:
            return
        reason = f"{robot.name} is no robot of the fleet any more"
        for execution_id in [key for key, topic in self._told_by.items() if topic == robot.skill_status]:
            with self._mistakes.guard("tasks", execution_id=execution_id):
                if execution_id in self._waiting:
                    self._ended(execution_id, TaskOutcome.REFUSED, reason, {})
                else:
                    text = f"{reason}, and was asked for it before: nobody hears what became of it"
                    self._ended(execution_id, TaskOutcome.UNKNOWN, text, {})
        self.replace(robot)

    def replace(self, robot: RobotModel) -> None:
        """A robot comes again at once, with another definition."""
        if robot.skill_status is None:
            return
        self._robot_of_status.pop(robot.skill_status, None)
        self._shown.pop(robot.skill_status, None)
        self._lost.discard(robot.skill_status)

    def _know(self, execution_id: str, robot_name: str, skill_name: str) -> Topic | None:
        """Listen for an execution; the SkillStatus of its robot, None where there is no such skill any more."""
        robot, skill = self._skill(robot_name, skill_name)
        if robot is None or skill is None or robot.skill_status is None:
            return None
        self._skills[execution_id], self._told_by[execution_id] = skill, robot.skill_status
        if len(self._skills) > MOST_EXECUTIONS:
            oldest, _ = self._skills.popitem(last=False)
            del self._told_by[oldest]
            self._unstopped.discard(oldest)
        return robot.skill_status

    def _skill(self, robot_name: str, skill_name: str) -> tuple[RobotModel | None, SkillModel | None]:
        robot = self._robots.get(robot_name)
        found = [skill for skill in robot.skills if skill.name == skill_name] if robot is not None else []
        return robot, found[0] if found else None

    def follow(self, asked: OperatorAsked | TaskFollowed) -> None:
        """Listen whether a robot tells what became of an execution. Asks for nothing to be begun."""
        status = self._know(asked.execution_id, asked.robot, asked.skill)
        execution_id = bytes.fromhex(asked.execution_id)
        may_be_unasked = isinstance(asked, TaskFollowed) and asked.may_be_unasked
        try:
            outcome = self._requests.known_outcome(execution_id)
        except KeyError:
            if may_be_unasked:
                self._ended(asked.execution_id, TaskOutcome.REFUSED, "the robot was never asked for it", {})
                return
            outcome = None
        if outcome is not None and (may_be_unasked or self._is_unanswered(outcome, asked.robot)):
            self.concluded(execution_id, outcome)  # what nobody has answered is asked when the robot is heard
        self._take_shown(status, asked.execution_id)

    def _take_shown(self, status: Topic | None, execution_id: str) -> None:
        """What the robot has said of it last."""
        if status is None or status in self._lost:
            return
        shown = self._shown.get(status, {}).get(execution_id)
        if shown is not None and execution_id in self._skills:
            self._take_state(execution_id, *shown)

    def robot_heard(self, robot_name: str) -> None:
        """A robot is heard again: it is asked for what nobody has answered."""
        for execution_id in [key for key, robot in self._unanswered.items() if robot == robot_name]:
            del self._unanswered[execution_id]
            try:
                self._requests.inquire(bytes.fromhex(execution_id))
            except KeyError:
                self._ended(execution_id, TaskOutcome.UNKNOWN, "its request is forgotten", {})

    def begin(self, task: TaskStarted, *, is_taken_back: bool = False) -> None:
        """Ask a robot, once: after a restart the same execution id is the same request.

        What is taken back by what follows is not asked for any more: it had to wait until it could be written down.
        """
        status = self._know(task.execution_id, task.robot, task.skill)
        if status is None:
            self._end_without_skill(task)
            return
        execution_id = bytes.fromhex(task.execution_id)
        try:
            outcome = self._requests.known_outcome(execution_id)
        except KeyError:
            now = self._clock()
            begin_at = max(now, self._free_at.get(self._node_of(task.execution_id), now))
            waiting = self._waiting[task.execution_id] = _Waiting(task, begin_at + START_WITHIN_S, begin_at)
            if begin_at <= now and not is_taken_back:
                self._ask(waiting)
            self._requests.leave(execution_id)  # what was prepared, and not sent
        else:
            if outcome is not None:
                self.concluded(execution_id, outcome)
        self._take_shown(status, task.execution_id)

    def _end_without_skill(self, task: TaskStarted) -> None:
        """Nobody can be asked for it now; who was asked before the skill left the fleet may be at it still."""
        reason = f"{task.robot} has no skill {task.skill}"
        try:
            outcome = self._requests.known_outcome(bytes.fromhex(task.execution_id))
        except KeyError:
            outcome = None
        else:
            if outcome is None or outcome.kind is not OutcomeKind.REFUSED:
                text = f"{reason} in fleet.yaml any more, and was asked for it before: nobody hears what became of it"
                self._ended(task.execution_id, TaskOutcome.UNKNOWN, text, {})
                return
        self._ended(task.execution_id, TaskOutcome.REFUSED, reason, {})

    def prepare(self, tasks: Iterable[TaskStarted]) -> list[Recorded]:
        """The records of requests for tasks whose robots can be asked at once.

        They are written down with what they follow from; the others are recorded when their robots are asked.
        """
        prepared: dict[str, Recorded | None] = {}
        for task in tasks:
            if task.execution_id not in prepared:
                with self._mistakes.guard("tasks", execution_id=task.execution_id), contextlib.suppress(SkillError):
                    prepared[task.execution_id] = self._prepared(task)
        return [record for record in prepared.values() if record is not None]

    def _prepared(self, task: TaskStarted) -> Recorded | None:
        robot, skill = self._skill(task.robot, task.skill)
        if robot is None or skill is None or robot.skill_status is None:
            return None
        now = self._clock()
        if self._free_at.get(NodeId(robot.skill_status.ns, skill.id), now) > now:
            return None
        try:
            self._requests.known_outcome(bytes.fromhex(task.execution_id))
        except KeyError:
            if not call_problems(skill, task.arguments):
                return self._requests.prepare(*call_of(task, robot, skill))
        return None

    def recorded(self, records: Iterable[Recorded], left_out: Iterable[bytes]) -> None:
        """These records are on the disk now, and these that were left are not any more."""
        self._requests.recorded(records, left_out)

    @property
    def left(self) -> tuple[bytes, ...]:
        """Requests that were recorded and not sent, to be deleted with what is written next."""
        return self._requests.left

    def _ask(self, waiting: _Waiting) -> None:
        task = waiting.task
        robot, skill = self._robots[task.robot], self._skills[task.execution_id]
        now = self._clock()
        problems = call_problems(skill, task.arguments)  # what a scenario computes is known now only
        if problems:
            self._ended(task.execution_id, TaskOutcome.REFUSED, "; ".join(problems), {})
            return
        try:
            self._requests.request(*call_of(task, robot, skill))
        except (RobotOffline, StorageUnavailable) as error:
            if now < waiting.give_up_at or self._is_silent(task.robot):
                waiting.next_at = now + ASK_AGAIN_S
                return
            self._ended(task.execution_id, TaskOutcome.UNREACHED, str(error), {})
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
        """What was not asked for yet never is; what was is halted, where the robot has a way to.

        Said again for what has not stopped, also by the process after a restart: then it is listened to as well.
        """
        execution_id = cancelled.execution_id
        if self._waiting.pop(execution_id, None) is not None:
            self._ended(execution_id, TaskOutcome.REFUSED, "it was cancelled before it began", {})
            return
        if execution_id not in self._skills:
            status = self._know(execution_id, cancelled.robot, cancelled.skill)
            with contextlib.suppress(KeyError):  # then nobody knows whether the robot was asked
                outcome = self._requests.known_outcome(bytes.fromhex(execution_id))
                if outcome is not None:
                    self.concluded(bytes.fromhex(execution_id), outcome)
            self._take_shown(status, execution_id)
        if execution_id in self._skills and execution_id not in self._halts:
            self._halt(_Halt(cancelled, self._clock() + HALT_WITHIN_S, 0.0))

    def _halt(self, halt: _Halt) -> None:
        execution_id = halt.cancelled.execution_id
        self._halts.pop(execution_id, None)
        robot, skill = self._robots.get(halt.cancelled.robot), self._skills.get(execution_id)
        if robot is None or skill is None or robot.skill_status is None:
            return
        topic = Topic(robot.skill_status.space, robot.ns, skill.id)
        try:
            self._requests.halt(topic, robot.name, bytes.fromhex(execution_id))
        except (RobotOffline, StorageUnavailable) as error:
            now = self._clock()
            if now < halt.give_up_at:
                halt.next_at = now + ASK_AGAIN_S
                self._halts[execution_id] = halt
            else:
                self._not_halted(execution_id, robot.name, error)
        except SkillError as error:
            self._not_halted(execution_id, robot.name, error)

    def _not_halted(self, execution_id: str, robot: str, error: Exception) -> None:
        """It is tried again for as long as whoever has ordered it wants to: said once."""
        if execution_id not in self._unstopped:
            self._unstopped.add(execution_id)
            skill = self._skills[execution_id].name
            self._log.warning("a robot is not halted", robot=robot, skill=skill, reason=str(error))

    def robot_of(self, topic: Topic) -> str | None:
        """The robot whose SkillStatus this is; None where it is any other data."""
        return self._robot_of_status.get(topic)

    def show(self, event: DataReceived) -> None:
        """Know a robot's SkillStatus; `take_shown` does what follows from it."""
        self._shown[event.topic] = dict(shown_in(event))
        self._lost.discard(event.topic)

    def lose(self, topic: Topic) -> None:
        """A SkillStatus is not heard any more, or nothing says that its last value is of now."""
        self._lost.add(topic)

    def find(self, topic: Topic) -> None:
        """The last value of a SkillStatus is of now again."""
        self._lost.discard(topic)

    def under_way(self, topic: Topic) -> frozenset[str]:
        """The executions that a robot is at, as its SkillStatus says; none where that is not heard."""
        shown = {} if topic in self._lost else self._shown.get(topic, {})
        return frozenset([execution_id for execution_id, (outcome, *_) in shown.items() if outcome is None])

    def take_shown(self, topic: Topic) -> None:
        """Do what follows from a robot's SkillStatus."""
        shown = self._shown.get(topic, {})
        for execution_id in shown.keys() & self._skills.keys():
            if self._told_by.get(execution_id) == topic:
                with self._mistakes.guard("tasks", execution_id=execution_id):
                    self._take_state(execution_id, *shown[execution_id])

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """The outcome of a request is known."""
        hex_id = execution_id.hex()
        skill = self._skills.get(hex_id)
        if skill is None:
            return
        report = outcome.report
        robot = self._robot_of(hex_id)
        if self._is_unanswered(outcome, robot):
            self._unanswered[hex_id] = robot
            return
        message = with_status(report.message, report.status)
        if outcome.kind is OutcomeKind.ACCEPTED:
            self._begin_interval(hex_id)
            if report.state in OPEN or report.state is ExecutionState.DONE:
                self._accepted(hex_id)
            if report.state is ExecutionState.DONE:
                results = named_results(outcome, [result.name for result in skill.results])
                self._ended(hex_id, TaskOutcome.DONE, message, usable(results))
            elif (end := outcome_of(report.state, report.status)) is not None:
                self._ended(hex_id, end, message, {})
        elif outcome.kind is OutcomeKind.REFUSED:
            self._ended(hex_id, refusal(report.status), message, {})
        else:
            # It came too late, so that it never begins: its bridge was away, and the robot may well be there again.
            timed_out = outcome.kind is OutcomeKind.TIMED_OUT
            self._ended(hex_id, TaskOutcome.UNREACHED if timed_out else TaskOutcome.UNKNOWN, message, {})

    def poll(self, *, may_begin: bool = True) -> None:
        """Ask and halt those who could not be told before.

        Args:
            may_begin: whether all that was decided was carried out: else what waits may have been taken back since.
        """
        now = self._clock()
        for execution_id, halt in list(self._halts.items()):
            if now >= halt.next_at:
                with self._mistakes.guard("tasks", execution_id=execution_id):
                    self._halt(halt)
        for execution_id, waiting in list(self._waiting.items()) if may_begin else ():
            # The end of one task may end its run, and so cancel the others that were to be asked now.
            if now >= waiting.next_at and self._waiting.get(execution_id) is waiting:
                try:
                    self._ask(waiting)
                except Exception as error:  # noqa: BLE001 - costs this task, and none of the others
                    self._mistakes.caught("tasks", error, execution_id=execution_id)
                    self.failed(execution_id, error)

    def failed(self, execution_id: str, error: Exception) -> None:
        """A mistake of ours while a robot was to be asked: nobody knows what it was told."""
        text = f"the server could not ask the robot ({type(error).__name__}); see its log"
        with self._mistakes.guard("tasks", execution_id=execution_id):
            self._ended(execution_id, TaskOutcome.UNKNOWN, text, {})
        self._waiting.pop(execution_id, None)  # also where that has failed, too

    def next_deadline(self, *, may_begin: bool = True) -> float | None:
        """When `poll` is to be called next, by the monotonic clock, or None."""
        due = [waiting.next_at for waiting in self._waiting.values()] if may_begin else []
        due += [halt.next_at for halt in self._halts.values()]
        return min(due, default=None)

    def _is_unanswered(self, outcome: RequestOutcome, robot: str) -> bool:
        """Whether nobody has answered a request since its robot is silent."""
        return outcome.kind is OutcomeKind.UNKNOWN and is_no_answer(outcome.report) and self._is_silent(robot)

    def _robot_of(self, execution_id: str) -> str:
        return self._robot_of_status.get(self._told_by[execution_id], "")

    def _take_state(
        self, execution_id: str, outcome: TaskOutcome | None, message: str, results: dict[str, Value]
    ) -> None:
        self._begin_interval(execution_id)
        self._unanswered.pop(execution_id, None)
        if outcome is None:
            self._accepted(execution_id)
        else:
            self._ended(execution_id, outcome, message, results)

    def _ended(self, execution_id: str, outcome: TaskOutcome, message: str, results: Mapping[str, Value]) -> None:
        pause_s = _PAUSES_S.get(outcome)
        if pause_s is not None and execution_id in self._skills:
            self._free_at[self._node_of(execution_id)] = self._clock() + pause_s
        if outcome is not TaskOutcome.UNKNOWN:  # what nobody can tell may be told later
            self._skills.pop(execution_id, None)
            self._told_by.pop(execution_id, None)
            self._unstopped.discard(execution_id)
        self._waiting.pop(execution_id, None)
        self._requests.leave(bytes.fromhex(execution_id))  # is forgotten by the commit of what follows from its end
        self._halts.pop(execution_id, None)
        self._unanswered.pop(execution_id, None)
        self._without_interval.discard(execution_id)
        self._tell_end(execution_id, outcome, message, results)
