"""What the dashboard server is asked for: a program that is played, and all other commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from ua_bridges.ur.config import Dashboard, DashboardSkill
from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.modes import RobotMode, RuntimeState
from ua_bridges.ur.state import State, stop_of
from ua_bridges.ur.task import (
    BEGIN_S,
    CANCELLED,
    FAILED,
    SETTLED_S,
    SHOWN_S,
    Forgotten,
    Progress,
    Task,
    Told,
    stopped,
)
from ua_bridges.ur.variables import register_names
from ua_fleet.bridge.executing import Ended
from ua_fleet.errors import SkillRejected

__all__ = ["DashboardTask", "PlayTask"]


class PlayTask(Task):
    """The program that is loaded, played.

    One that has ended by itself and one that somebody has stopped look alike, unless the program changes a register in
    its last line.
    """

    moves_arm = True

    def __init__(self, way: DashboardSkill) -> None:
        self._waits = way.wait_for_end
        self._end = register_names("int", way.end_register) if way.end_register is not None else ""
        self._before: int | None = None
        """What stood in the register before it was played."""
        self._began = 0.0
        self._is_resumed = self._has_played = self._is_halted = False
        self._over_since: float | None = None

    def begin(self, link: CommandLink, state: State, now: float) -> None:
        """See RobotTask."""
        self._began, self._before = now, state.values[self._end] if self._end else None
        self.is_told = True
        link.has_control = False
        link.call("dashboard", _METHODS[Dashboard.PLAY])

    def resume(self, state: State, now: float) -> None:
        """See RobotTask."""
        self._is_resumed = True

    def look(self, link: CommandLink, state: State, now: float) -> Told:
        """See RobotTask."""
        if self._is_resumed:
            return Forgotten(_UNSEEN)
        if stop_of(state):
            return stopped(state)
        if state.runtime is not RuntimeState.STOPPED:
            self._has_played, self._over_since = True, None
            if not self._waits:
                return Ended(0)
            return Progress(0.0, "paused" if state.runtime is RuntimeState.PAUSED else "")
        # A program may be over before a state shows that it runs.
        shows_within_s = BEGIN_S if self.is_unsure else SHOWN_S
        if not state.stands or (not self._has_played and now - self._began <= shows_within_s):
            self._over_since = None
            return None
        if self._over_since is None:
            self._over_since = now
        # The values of a sample are not all of one moment.
        return self._over(state) if now - self._over_since >= SETTLED_S else None

    def _over(self, state: State) -> Told:
        """The program stands, or was never seen to run."""
        if self._end and state.values[self._end] != self._before:
            return Ended(0)
        if not self._has_played and self.is_unsure:
            return Forgotten("the dashboard server did not answer, and no program was seen to run; see the robot's log")
        if not self._waits:
            return Ended(0)  # the dashboard server has said that it began
        if self._is_halted:
            return Ended(CANCELLED, (), "halted")
        if self._end:
            return Ended(FAILED, (), "the program ended before its last line; see the robot's log")
        return Forgotten("the program has stopped: it ended, or a person stopped it; set `end_register` to know which")

    def check_can_halt(self) -> None:
        """See RobotTask."""
        if not self._waits:
            raise SkillRejected(_FINAL)

    def halt(self, link: CommandLink, state: State) -> None:
        """See RobotTask."""
        self.check_can_halt()
        self._is_halted = True
        link.stop_program()


class DashboardTask(Task):
    """Any other command, done when the controller shows what it is for."""

    moves_arm = False

    def __init__(self, way: DashboardSkill, arguments: Mapping[str, Any]) -> None:
        """Take the text.

        Raises:
            SkillRejected: it has a line break, and would be two commands.
        """
        self._way, self._text = way, []
        if way.text is not None:
            text = str(arguments[way.text] or "")
            if not text or not text.isprintable():
                raise SkillRejected(f"{way.text}: give printable text in one line, and not {text[:40]!r}")
            self._text = [text]
        self._is_resumed = False

    def begin(self, link: CommandLink, state: State, now: float) -> None:
        """See RobotTask."""
        self.is_told = True
        link.call("dashboard", _METHODS[self._way.command], *self._text)
        if self._way.command is Dashboard.STOP:
            link.has_control = False

    def resume(self, state: State, now: float) -> None:
        """See RobotTask."""
        self._is_resumed = True

    def look(self, link: CommandLink, state: State, now: float) -> Told:
        """See RobotTask."""
        command = self._way.command
        if command in _SHOWN_BY_NOTHING and (self._is_resumed or self.is_unsure):
            return Forgotten(_UNSEEN)
        if command is Dashboard.PAUSE and stop_of(state):
            return stopped(state)  # it is paused, and not by us
        if self._is_reached(state):
            return Ended(0)
        if command in (Dashboard.POWER_ON, Dashboard.BRAKE_RELEASE) and stop_of(state):
            return stopped(state)
        return Progress(0.0, f"robot mode {state.robot_mode.name}, safety mode {state.safety_mode.name}")

    def _is_reached(self, state: State) -> bool:
        command = self._way.command
        if command is Dashboard.POWER_ON:
            return state.robot_mode in (RobotMode.IDLE, RobotMode.RUNNING)
        if command is Dashboard.BRAKE_RELEASE:
            return state.robot_mode is RobotMode.RUNNING
        if command is Dashboard.POWER_OFF:
            return state.robot_mode is RobotMode.POWER_OFF
        if command in (Dashboard.UNLOCK_PROTECTIVE_STOP, Dashboard.RESTART_SAFETY):
            return state.safety_mode.may_move
        if command is Dashboard.PAUSE:
            return state.runtime is RuntimeState.PAUSED
        return command is not Dashboard.STOP or state.runtime is RuntimeState.STOPPED

    def check_can_halt(self) -> None:
        """See RobotTask."""
        raise SkillRejected(_FINAL)

    def halt(self, link: CommandLink, state: State) -> None:
        """See RobotTask."""
        self.check_can_halt()


_FINAL: Final = "a command to the dashboard server cannot be taken back"
_UNSEEN: Final = "the controller does not show whether it was done"
_SHOWN_BY_NOTHING: Final = (Dashboard.LOAD, Dashboard.POPUP, Dashboard.CLOSE_POPUP, Dashboard.CLOSE_SAFETY_POPUP)
_METHODS: Final[Mapping[Dashboard, str]] = {
    Dashboard.POWER_ON: "powerOn",
    Dashboard.POWER_OFF: "powerOff",
    Dashboard.BRAKE_RELEASE: "brakeRelease",
    Dashboard.LOAD: "loadURP",
    Dashboard.PLAY: "play",
    Dashboard.PAUSE: "pause",
    Dashboard.STOP: "stop",
    Dashboard.POPUP: "popup",
    Dashboard.CLOSE_POPUP: "closePopup",
    Dashboard.CLOSE_SAFETY_POPUP: "closeSafetyPopup",
    Dashboard.UNLOCK_PROTECTIVE_STOP: "unlockProtectiveStop",
    Dashboard.RESTART_SAFETY: "restartSafety",
}
