# pyright: basic, reportMissingImports=false
"""A skill that is a ROS 2 action. The goal's id is the execution's, so that a bridge that comes later can ask for it.

The parts of an action (its three services and two topics) are used as such: rclpy's ActionClient asks only for goals
that it has sent itself.

    begin      send_goal -> accepted -> get_result -> the end
    query      get_result; a goal that the server does not know comes back at once as unknown
    cancel     cancel_goal; the end comes as the result, which says that it was canceled. A server that does not cancel
               the goal is logged with its reason
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import structlog

from ua_bridges.ros.ports import ActionPort, Goal
from ua_bridges.ros.skill_values import RequestFiller, ResponseReader
from ua_bridges.ros2.qos import Qos
from ua_bridges.ros2.skills.calls import Calls
from ua_bridges.ros2.skills.graph import Ros2Graph, find_type, part_schema
from ua_fleet.bridge.driver import Execution
from ua_fleet.bridge.executing import Ended
from ua_fleet.values import StatusCode

__all__ = ["Ros2ActionPort"]

_log = structlog.get_logger("ua_bridges.ros2")

GOAL_ANSWER_S: Final = 5.0
"""A server answers at once whether it takes a goal; after so long without an answer it is asked for the result."""
ASK_AGAIN_S: Final = 10.0
"""A server that was restarted does not answer what the one before was asked, so results are asked for again."""

_UNKNOWN, _SUCCEEDED, _CANCELED = 0, 4, 5
"""action_msgs/GoalStatus."""
_AT_IT: Final = (1, 2, 3)

_NOT_CANCELED: Final = {0: "refused", 1: "refused", 2: "it does not know the goal", 3: "the goal has ended"}
"""action_msgs/CancelGoal. A server of rclpy that refuses answers 0, without a goal."""

_FEEDBACK: Final = Qos(reliable=True, transient_local=False, depth=100)
_STATUS: Final = Qos(reliable=True, transient_local=True, depth=1)


class _Goal(Goal):
    """And when its server is asked for the result, and what it said when it was to cancel it."""

    __slots__ = ("ask_at", "is_canceling", "not_canceled")

    def __init__(self, ask_at: float) -> None:
        super().__init__()
        self.ask_at = ask_at
        self.is_canceling = False
        self.not_canceled: set[str] = set()
        """Why not, as far as it was logged."""


class Ros2ActionPort(ActionPort[Ros2Graph, _Goal]):
    """See the module."""

    def _open(self, graph: Ros2Graph) -> None:
        way, name, node = self._way, self._name, graph.node
        self._class = action = find_type(way.type, "action")
        parts = action.Impl
        self._filler = RequestFiller(self.spec, way, part_schema(f"{way.type}_Goal", action.Goal))
        self._filler.check(action.Goal())
        self._reader = ResponseReader(self.spec, way, way.success, action.Result())
        self._reports_by(action.Feedback)
        self._send = Calls(node, parts.SendGoalService, f"{name}/_action/send_goal")
        self._result = Calls(node, parts.GetResultService, f"{name}/_action/get_result")
        self._cancel = Calls(node, parts.CancelGoalService, f"{name}/_action/cancel_goal")
        for cls, topic, qos, heard in (
            (parts.FeedbackMessage, "feedback", _FEEDBACK, self._on_feedback),
            (parts.GoalStatusMessage, "status", _STATUS, self._on_status),
        ):
            node.listen(cls, f"{name}/_action/{topic}", qos, heard)

    def _request_of(self, execution: Execution) -> Any:
        request = self._class.Impl.SendGoalService.Request()
        request.goal_id.uuid = list(execution.execution_id)
        self._filler.fill(request.goal, execution.values)
        return request

    def _look(self, now: float) -> str:
        ready = self._send.is_ready and self._result.is_ready
        return "" if ready else self._no_server

    def _cannot_be_told(self, now: float) -> str:
        return "" if self._cancel.is_ready else self._no_server

    def _tell(self, execution_id: bytes, request: Any, now: float) -> None:
        self._goals[execution_id] = _Goal(now + GOAL_ANSWER_S)
        self._send.call(request, partial(self._on_goal, execution_id, now))

    def _on_goal(self, execution_id: bytes, now: float, response: Any) -> None:
        if self._executing.get(execution_id) is None:
            self._executing.unasked(execution_id, self._send.name)
        elif not response.accepted:
            self._end(execution_id, Ended(StatusCode.BAD_REQUEST_NOT_ALLOWED, (), "the action server refused the goal"))
        else:
            self._executing.progress(execution_id, 0.0)
            self._ask_for_result(execution_id, now)

    def _ask(self, execution_id: bytes, now: float) -> None:
        self._goals[execution_id] = _Goal(now)

    def _ask_for_result(self, execution_id: bytes, now: float) -> None:
        goal = self._goals.get(execution_id)
        if goal is None:
            return
        goal.ask_at = now + ASK_AGAIN_S
        request = self._class.Impl.GetResultService.Request()
        request.goal_id.uuid = list(execution_id)
        self._result.call(request, partial(self._on_result, execution_id))

    def _on_result(self, execution_id: bytes, response: Any) -> None:
        goal, opened = self._goals.get(execution_id), self._executing.get(execution_id)
        if goal is None or opened is None:
            return  # the same question asked more than once
        if response.status == _UNKNOWN:
            self._close(execution_id)
            self._executing.forget(execution_id, f"the server of {self._name} remembers no such goal")
        elif response.status == _SUCCEEDED:
            self._end(execution_id, self._reader.read(response.result, opened.arguments))
        elif goal.give_up_at is not None:
            self._end(execution_id, self._too_long("it was canceled"))
        elif response.status == _CANCELED:
            self._close(execution_id)
            self._halted(execution_id)
        else:
            said = self._reader.text(response.result) or "the action server aborted the goal"
            self._end(execution_id, Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), said))

    def _end(self, execution_id: bytes, ended: Ended) -> None:
        self._close(execution_id)
        self._executing.end(execution_id, ended)

    def _on_feedback(self, message: Any) -> None:
        self._heard_feedback(bytes(message.goal_id.uuid), message.feedback)

    def _on_status(self, message: Any) -> None:
        for status in message.status_list:
            if status.status in _AT_IT:
                self._at_it(bytes(status.goal_info.goal_id.uuid))

    def _follow(self, execution_id: bytes, goal: _Goal, now: float) -> bool:
        if now >= goal.ask_at and self._result.is_ready:
            self._ask_for_result(execution_id, now)
        return False

    def _stop(self, execution_id: bytes, now: float) -> None:
        request = self._class.Impl.CancelGoalService.Request()
        request.goal_info.goal_id.uuid = list(execution_id)
        self._cancel.call(request, partial(self._on_cancel, execution_id))

    def _on_cancel(self, execution_id: bytes, response: Any) -> None:
        goal = self._goals.get(execution_id)
        if goal is None or self._executing.get(execution_id) is None:
            return
        if response.goals_canceling:
            goal.is_canceling = True
        reason = _NOT_CANCELED.get(response.return_code, f"code {response.return_code}")
        if goal.is_canceling or reason in goal.not_canceled:
            return  # a goal that is being canceled already is answered as one that has ended
        goal.not_canceled.add(reason)
        skill = f"{self.spec.robot}.{self.spec.name}"
        _log.warning(
            "an action server does not cancel a goal; see what the robot does",
            action=self._name,
            skill=skill,
            execution_id=execution_id.hex(),
            reason=reason,
        )
