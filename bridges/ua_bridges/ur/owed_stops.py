"""What has to stop on the controller and was not told so: told again each second, or once a longer try has failed.

The dashboard server is a port of its own, which may be away while the arm and the state go on.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from typing import Final

import structlog

from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.modes import RuntimeState
from ua_bridges.ur.state import State
from ua_bridges.ur.task import SHOWN_S, RobotTask
from ua_fleet.errors import SkillError, SkillRejected

__all__ = ["OwedStops"]

_AGAIN_S: Final = 1.0

_log = structlog.get_logger(__name__)


class OwedStops:
    """Of one controller. `now` is float seconds of the monotonic clock."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._halts: dict[bytes, RobotTask] = {}
        """By execution id: while the execution is under way."""
        self._orphans: list[RobotTask] = []
        """Of executions that are over for who asked: until the controller shows that nothing runs."""
        self._failed_at: float | None = None
        """When a program failed that may be paused; None where nothing of it is left."""
        self._halt_again_at = self._stop_again_at = 0.0

    def keeps_from_beginning(self) -> bool:
        """Whether what has to stop may still move the arm: what is begun meanwhile would be stopped for it."""
        return bool(self._orphans)

    def halt(self, execution_id: bytes, task: RobotTask, link: CommandLink, state: State | None, now: float) -> None:
        """Have an execution stop, now or as soon as the controller can be told."""
        if execution_id in self._halts:
            return  # it is told again in any case, and who asks often does not have it told more often
        if state is None or not self._told(task, link, state):
            self._halts[execution_id] = task
            self._halt_again_at = now + _AGAIN_S

    def give_up(self, execution_id: bytes, task: RobotTask, link: CommandLink, state: State, now: float) -> bool:
        """Have one stop that is over for who asked for it; whether the controller was told."""
        was_owed = self._halts.pop(execution_id, None) is not None
        try:
            task.check_can_halt()
        except SkillRejected:
            return False
        if was_owed and now < self._halt_again_at:  # tried within the last second
            self._orphans.append(task)
            return False
        if not (was_told := self._told(task, link, state)):
            self._orphans.append(task)
            self._halt_again_at = now + _AGAIN_S
        return was_told

    def has_failed(self, link: CommandLink, now: float) -> None:
        """A safety stop has ended a task and pauses its program: that is stopped, or somebody may let it go on."""
        self._failed_at, self._stop_again_at = now, now + _AGAIN_S
        with suppress(SkillError):  # nothing runs any more, or it is told again
            link.stop_program()
            self._failed_at = None

    def may_be_paused(self, now: float) -> None:
        """The bridge's own program has ended, or the controller will show that it is paused: then it is stopped."""
        self._failed_at = self._stop_again_at = now

    def settle(self, under_way: Collection[bytes], link: CommandLink, state: State, now: float) -> None:
        """Tell what is to be told again; with each sample.

        Args:
            under_way: ids of the executions that have not ended.
            link: to the controller.
            state: what it says.
            now: the time.
        """
        if state.runtime is RuntimeState.STOPPED:
            self._orphans.clear()
        if now >= self._halt_again_at and (self._halts or self._orphans):
            self._halts = {
                execution_id: task
                for execution_id, task in self._halts.items()
                if execution_id in under_way and not self._told(task, link, state)
            }
            self._orphans = [task for task in self._orphans if not self._told(task, link, state)]
            self._halt_again_at = now + _AGAIN_S
        if self._failed_at is None:
            return
        if state.runtime is RuntimeState.PAUSED:
            if now >= self._stop_again_at:
                self._stop_paused(link, now)
        elif now > self._failed_at + SHOWN_S:  # until then it may not be shown yet
            self._failed_at = None

    def _stop_paused(self, link: CommandLink, now: float) -> None:
        try:
            link.stop_program()
        except SkillError as error:
            _log.warning("a failed program is still paused", controller=self._address, reason=str(error))
            self._stop_again_at = now + _AGAIN_S
        else:
            self._failed_at = None

    def _told(self, task: RobotTask, link: CommandLink, state: State) -> bool:
        try:
            task.halt(link, state)
        except SkillError as error:
            _log.warning("the robot was not halted; it is told again", controller=self._address, reason=str(error))
            return False
        return True
