"""A skill that is an actionlib action, by its five topics. The goal's id is the execution's.

So a bridge that comes later finds it.

    begin      goal; at once it stands in the status array, which the server publishes several times a second
    end        result, published once, to those that are linked then
    query      the status array: at it, or ended within the last seconds; else the server does not know it
    cancel     cancel with the id; the end comes as any other

actionlib's own client would do the same, but makes its goals' ids itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

from ua_bridges.ros.ports import ActionPort, Goal, Listened
from ua_bridges.ros.skill_values import RequestFiller, ResponseReader
from ua_bridges.ros.skills import ActionSkill, SkillSpec
from ua_bridges.ros.topic_mapping import QosConfig
from ua_bridges.ros1.skills.graph import Ros1Graph, ros1_name
from ua_fleet.bridge.driver import DriverEvent, Execution
from ua_fleet.bridge.executing import Ended, Executing, Open, ended_text
from ua_fleet.values import StatusCode

__all__ = ["Ros1ActionPort"]

UNKNOWN_S: Final = 2.0
"""A goal that is not in the status arrays for so long is not known to the server, which shows each at once."""
RESULT_S: Final = 2.0
"""The result of a goal comes on another link than its status; so long it may come later."""
_MOST_REMEMBERED: Final = 100
"""Ended goals, to tell a second answer from that of another client's goal."""

_PREEMPTED, _SUCCEEDED, _REJECTED, _RECALLED = 2, 3, 5, 8
"""actionlib_msgs/GoalStatus."""
_AT_IT: Final = (0, 1, 6, 7)
_QOS: Final = QosConfig()
_ID_TYPE: Final = "actionlib_msgs/GoalID"


class _Goal(Goal):
    """And what the status arrays say of it."""

    __slots__ = ("result_by", "status", "text", "unknown_since", "was_canceled", "was_seen")

    def __init__(self) -> None:
        super().__init__()
        self.was_seen = False
        self.unknown_since: float | None = None
        """The server does not have it in its status array."""
        self.status, self.text = -1, ""
        """How it ended by the status array, whose result has not come."""
        self.result_by: float | None = None
        self.was_canceled = False


class Ros1ActionPort(ActionPort[Ros1Graph, _Goal]):
    """See the module."""

    def __init__(
        self, spec: SkillSpec, way: ActionSkill, executing: Executing, put: Callable[[DriverEvent], None]
    ) -> None:
        super().__init__(spec, way, executing, put)
        self._type = ros1_name(way.type)
        self._missing = dict.fromkeys(("status", "result"), self._no_server)
        """Why one of the topics that are needed is not there."""
        self._ended: dict[bytes, None] = {}

    def _open(self, graph: Ros1Graph) -> None:
        way, name = self._way, self._name
        goal = graph.load(f"{self._type}Goal")
        self._goal_class, self._action_goal_class = goal.cls, graph.load(f"{self._type}ActionGoal").cls
        self._id_class = graph.load(_ID_TYPE).cls
        self._filler = RequestFiller(self.spec, way, goal.schema)
        self._filler.check(goal.cls())
        self._reader = ResponseReader(self.spec, way, way.success, graph.load(f"{self._type}Result").cls())
        self._reports_by(lambda: graph.load(f"{self._type}Feedback").cls())
        self._tells = graph.speak(f"{name}/goal", f"{self._type}ActionGoal", _QOS)
        self._cancels = graph.speak(f"{name}/cancel", _ID_TYPE, _QOS)

    def listened(self) -> tuple[Listened, ...]:
        """See SkillPort."""
        topics = (
            ("status", "actionlib_msgs/GoalStatusArray", self._on_status),
            ("result", f"{self._type}ActionResult", self._on_result),
            ("feedback", f"{self._type}ActionFeedback", self._on_feedback),
        )
        return tuple(
            [
                Listened(f"{self._name}/{topic}", ros_type, _QOS, heard, self._source_of(topic))
                for topic, ros_type, heard in topics
            ]
        )

    def _source_of(self, topic: str) -> Callable[[str], None]:
        def source(problem: str) -> None:
            if topic in self._missing:
                wrong_type = problem if "carries" in problem else self._no_server
                self._missing[topic] = wrong_type if problem else ""

        return source

    def _request_of(self, execution: Execution) -> Any:
        message = self._action_goal_class()
        message.goal_id.id = execution.execution_id.hex()
        message.goal = self._filler.fill(self._goal_class(), execution.values)
        return message

    def _look(self, now: float) -> str:
        return next((why for why in self._missing.values() if why), "") or self._tells.look(now)

    def _cannot_be_told(self, now: float) -> str:
        return self._cancels.look(now)

    def _tell(self, execution_id: bytes, request: Any, now: float) -> None:
        self._goals[execution_id] = _Goal()
        self._tells.publish(request)

    def _ask(self, execution_id: bytes, now: float) -> None:
        self._goals[execution_id] = _Goal()

    def _on_status(self, message: Any) -> None:
        now = time.monotonic()
        statuses = {status.goal_id.id: status for status in message.status_list}
        for execution_id, goal in list(self._goals.items()):
            status = statuses.get(execution_id.hex())
            if status is None:
                self._not_known(execution_id, goal, now)
                continue
            goal.was_seen, goal.unknown_since = True, None
            if status.status in _AT_IT:
                self._at_it(execution_id)
            elif goal.result_by is None:
                goal.status, goal.text, goal.result_by = int(status.status), str(status.text), now + RESULT_S

    def _not_known(self, execution_id: bytes, goal: _Goal, now: float) -> None:
        if goal.result_by is not None:
            return
        if goal.unknown_since is None:
            goal.unknown_since = now
        elif now >= goal.unknown_since + UNKNOWN_S:
            lost = "no longer knows the goal; it may have been restarted" if goal.was_seen else "knows no such goal"
            self._close(execution_id)
            self._executing.forget(execution_id, f"the server of {self._name} {lost}")

    def _on_result(self, message: Any) -> None:
        execution_id = _execution_id(message.status.goal_id.id)
        goal = self._goals.get(execution_id)
        if goal is not None:
            self._finish(execution_id, goal, int(message.status.status), str(message.status.text), message.result)
        elif execution_id in self._ended:  # else it is the goal of another client
            self._executing.unasked(execution_id, self._name)

    def _finish(self, execution_id: bytes, goal: _Goal, status: int, text: str, result: Any | None) -> None:
        opened = self._executing.get(execution_id)
        self._close(execution_id)
        if opened is None:
            return
        said = (self._reader.text(result) if result is not None else "") or ended_text(text)
        if status == _SUCCEEDED:
            if result is None:
                self._done_without_result(execution_id)
            else:
                ended = self._reader.read(result, opened.arguments)
                self._executing.end(execution_id, ended._replace(message=ended.message or said))
        elif goal.give_up_at is not None:
            self._executing.end(execution_id, self._too_long("it was canceled"))
        elif goal.was_canceled and status in (_PREEMPTED, _RECALLED):
            self._halted(execution_id)
        elif status == _REJECTED:
            said = said or "the action server refused the goal"
            self._executing.end(execution_id, Ended(StatusCode.BAD_REQUEST_NOT_ALLOWED, (), said))
        else:
            reason = "another goal took its place" if status in (_PREEMPTED, _RECALLED) else "it was aborted"
            self._executing.end(execution_id, Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), said or reason))

    def _done_without_result(self, execution_id: bytes) -> None:
        """A result is published once; a bridge that was away then knows no more than the status array."""
        if self._way.success is not None:
            self._executing.forget(
                execution_id, "it ended while the bridge was not connected, and its result is not known"
            )
        elif self.spec.config.results:
            said = "it is done; its results came while the bridge was not connected"
            self._executing.end(execution_id, Ended(StatusCode.UNCERTAIN, (), said))
        else:
            self._executing.end(execution_id, Ended(StatusCode.GOOD))

    def _close(self, execution_id: bytes) -> None:
        super()._close(execution_id)
        self._ended[execution_id] = None
        if len(self._ended) > _MOST_REMEMBERED:
            del self._ended[next(iter(self._ended))]

    def _on_feedback(self, message: Any) -> None:
        self._heard_feedback(_execution_id(message.status.goal_id.id), message.feedback)

    def _follow(self, execution_id: bytes, goal: _Goal, now: float) -> bool:
        if goal.result_by is None or now < goal.result_by:
            return False
        self._finish(execution_id, goal, goal.status, goal.text, None)
        return True

    def _stop(self, execution_id: bytes, now: float) -> None:
        goal = self._goals.get(execution_id)
        if goal is not None:
            goal.was_canceled = True
            self._cancels.publish(self._id_class(id=execution_id.hex()))

    def _give_up(self, opened: Open, now: float) -> None:
        """See ActionPort. What was asked about and never seen, nobody knows."""
        goal = self._goals.get(opened.execution_id)
        if goal is None or goal.was_seen:
            super()._give_up(opened, now)
            return
        self._have_stopped(opened.execution_id, now)
        self._close(opened.execution_id)
        self._executing.forget(opened.execution_id, f"the server of {self._name} never reported it")


def _execution_id(goal_id: str) -> bytes:
    """The execution that a goal's id names; empty for other clients' ids."""
    try:
        return bytes.fromhex(goal_id)
    except ValueError:
        return b""
