"""A skill that is an action: its goal has the id of the execution, so that a bridge that comes later finds it.

How goals, results and cancels travel is the affair of each ROS.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Final, Generic, TypeVar

from ua_bridges.ros.ports.port import Graph_contra, SkillPort
from ua_bridges.ros.skill_values import Condition, ResponseReader
from ua_bridges.ros.skills import ActionSkill, SkillSpec
from ua_bridges.ros.topic_mapping import absolute
from ua_fleet.bridge.driver import DriverEvent
from ua_fleet.bridge.executing import Executing, Open

__all__ = ["ActionPort", "Goal"]

CANCEL_S: Final = 2.0
"""So long an overdue goal has time to end after it was canceled."""


class Goal:
    """A goal whose end is not known."""

    __slots__ = ("give_up_at",)

    def __init__(self) -> None:
        self.give_up_at: float | None = None
        """It took too long and was canceled."""


AnyGoal = TypeVar("AnyGoal", bound=Goal)


class ActionPort(SkillPort[Graph_contra], Generic[Graph_contra, AnyGoal]):
    """See the module."""

    _reader: ResponseReader

    def __init__(
        self, spec: SkillSpec, way: ActionSkill, executing: Executing, put: Callable[[DriverEvent], None]
    ) -> None:
        super().__init__(spec, executing, put)
        self._way, self._name = way, absolute(way.name)
        self._no_server = f"there is no action server {self._name}; start the robot's node"
        self._goals: dict[bytes, AnyGoal] = {}
        self._progress: Condition | None = None

    def _reports_by(self, feedback: Callable[[], Any]) -> None:
        """`fleet.yaml` may say how progress is read; `feedback` makes an empty message of its type."""
        if self._way.progress is not None:
            self._progress = Condition(self._way.progress, self.spec.arguments, feedback())

    def _heard_feedback(self, execution_id: bytes, feedback: Any) -> None:
        """Every client of an action hears of all goals."""
        opened = self._executing.get(execution_id) if execution_id in self._goals else None
        if opened is not None and self._progress is not None:
            fraction = self._progress.fraction(feedback, opened.arguments)
            if fraction is not None:
                self._executing.progress(execution_id, fraction)

    def _at_it(self, execution_id: bytes) -> None:
        """The server says that it works on a goal. The first time is told."""
        opened = self._executing.get(execution_id) if execution_id in self._goals else None
        if opened is not None and opened.told is None:
            self._executing.progress(execution_id, 0.0)

    def turn(self, now: float) -> None:
        """See SkillPort."""
        super().turn(now)
        for execution_id, goal in list(self._goals.items()):
            if self._executing.get(execution_id) is None:
                del self._goals[execution_id]
            elif not self._follow(execution_id, goal, now) and goal.give_up_at is not None and now >= goal.give_up_at:
                untold = self._have_stopped(execution_id, now)
                said = self._untold(untold) if untold else "it was canceled, and does not end; see what the robot does"
                self._close(execution_id)
                self._executing.end(execution_id, self._too_long(said))

    @abstractmethod
    def _follow(self, execution_id: bytes, goal: AnyGoal, now: float) -> bool:
        """Do what is due for an open goal; whether that has ended it."""

    def _close(self, execution_id: bytes) -> None:
        """The end of a goal is known."""
        self._goals.pop(execution_id, None)

    def _give_up(self, opened: Open, now: float) -> None:
        """The goal is canceled, and has a moment to end."""
        goal = self._goals.get(opened.execution_id)
        if goal is None:
            super()._give_up(opened, now)
        elif goal.give_up_at is None:
            goal.give_up_at = now + CANCEL_S
            self._have_stopped(opened.execution_id, now)
