"""What is done on the controller, each as a task (see `task`), and which of them a skill of `fleet.yaml` is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from ua_bridges.ur.config import Dashboard, DashboardSkill, MoveJ, MoveL, ScriptSkill, SetSkill, StopSkill
from ua_bridges.ur.dashboard_tasks import DashboardTask, PlayTask
from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.modes import RobotMode, RuntimeState
from ua_bridges.ur.outputs import Output, find_output
from ua_bridges.ur.state import State, remark_of, stop_of
from ua_bridges.ur.task import (
    BEGIN_S,
    CANCELLED,
    FAILED,
    SETTLED_S,
    SHOWN_S,
    Forgotten,
    Progress,
    RobotTask,
    Task,
    Told,
    stopped,
)
from ua_bridges.ur.variables import register_names
from ua_fleet.bridge.configured import ConfiguredSkill
from ua_fleet.bridge.executing import Ended
from ua_fleet.bridge.templates import CommandTemplate, Language
from ua_fleet.config.base import Model
from ua_fleet.errors import SkillFailed, SkillRejected

__all__ = ["keeps_from_moving", "make_task", "refusal_of"]

_ARRIVED_RAD: Final = 0.005
_ARRIVED_M: Final = 0.001
_TURNED_RAD: Final = 0.01
_PROGRAM: Final = "ua_fleet"
_LOCAL: Final = "the robot is in local control: switch remote control on at the teach pendant"
_PAUSED: Final = "a program is paused on the controller: let it go on, or stop it, first"


def _turn_between(first: Sequence[float], second: Sequence[float]) -> float:
    """The angle between two attitudes that are given as rotation vectors."""
    quaternions: list[list[float]] = []
    for vector in (first, second):
        angle = math.hypot(*vector)
        scale = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
        quaternions.append([math.cos(angle / 2), *[part * scale for part in vector]])
    one, other = quaternions
    return 2 * math.acos(min(abs(sum(a * b for a, b in zip(one, other, strict=True))), 1.0))


class MoveTask(Task):
    """A moveJ or moveL of ur-rtde's control program, asynchronous."""

    moves_arm = True

    def __init__(self, way: MoveJ | MoveL, arguments: Mapping[str, Any]) -> None:
        """Take the numbers.

        Raises:
            SkillRejected: one of them is no number.
        """

        def number(given: float | str) -> float:
            value = float(arguments[given] if isinstance(given, str) else given)
            if not math.isfinite(value):
                raise SkillRejected(f"{given}: {value} is no number for a robot")
            return value

        self._is_linear = isinstance(way, MoveL)
        places = way.pose if isinstance(way, MoveL) else way.joints
        self._target = [number(given) for given in places]
        self._speed, self._acceleration = number(way.speed), number(way.acceleration)
        if self._speed <= 0 or self._acceleration <= 0:
            raise SkillRejected("speed and acceleration have to be more than 0")
        self._way = 0.0
        self._before: int | None = None
        """Number of the operation before this one; None where it is followed by its place alone."""
        self._began = 0.0
        self._stands_since: float | None = None
        self._is_halted = False

    def _left(self, state: State) -> float:
        if self._is_linear:
            return math.dist(self._target[:3], state.pose[:3]) + _turn_between(self._target[3:], state.pose[3:]) / 10
        return max(abs(end - now) for end, now in zip(self._target, state.joints, strict=True))

    def _is_there(self, state: State) -> bool:
        if self._is_linear:
            far = math.dist(self._target[:3], state.pose[:3])
            return far <= _ARRIVED_M and _turn_between(self._target[3:], state.pose[3:]) <= _TURNED_RAD
        return self._left(state) <= _ARRIVED_RAD

    def begin(self, link: CommandLink, state: State, now: float) -> None:
        """See RobotTask."""
        link.take_control(is_playing=state.runtime is RuntimeState.PLAYING)
        _, self._before = link.operation()
        self._way, self._began = self._left(state), now
        self.is_told = True
        # False is no refusal: it waits no longer for the program, which may have begun. Its operation tells.
        link.call(
            "control", "moveL" if self._is_linear else "moveJ", self._target, self._speed, self._acceleration, True
        )

    def resume(self, state: State, now: float) -> None:
        """See RobotTask."""
        self._way, self._began, self._before = self._left(state), now, None

    def look(self, link: CommandLink, state: State, now: float) -> Told:
        """See RobotTask."""
        if stop_of(state):
            return stopped(state)
        if self._before is not None and link.has_control:
            is_running, number = link.operation()
            if is_running or (number == self._before and now - self._began < BEGIN_S):
                return self._progress(state)
            if number == self._before:
                return Ended(FAILED, (), "the control program did not begin the move; see the robot's log")
        else:
            self._before = None
        if not state.stands:
            self._stands_since = None
            return self._progress(state)
        if self._stands_since is None:
            self._stands_since = now
        if self._is_there(state):
            return Ended(0)
        if now - self._stands_since < SETTLED_S:
            return None
        if self._is_halted:
            return Ended(CANCELLED, (), "halted")
        if self._before is None:
            return Forgotten("the arm stands, and not where the move leads; see what the robot did")
        return Ended(FAILED, (), "the move was stopped before its end; see the robot's log")

    def _progress(self, state: State) -> Progress:
        done = 1 - self._left(state) / self._way if self._way > 0 else 0.0
        return Progress(min(max(done, 0.0), 0.99))

    def halt(self, link: CommandLink, state: State) -> None:
        """See RobotTask."""
        self._is_halted = True
        if not link.stop_move(_HALT_RAD_S2):
            link.stop_program()


_HALT_RAD_S2: Final = 2.0


class ScriptTask(Task):
    """URScript of `fleet.yaml`, in a program that says in two registers that it has begun and that it is done."""

    moves_arm = True

    def __init__(
        self, skill: ConfiguredSkill[Any], way: ScriptSkill, arguments: Mapping[str, Any], register: int, mark: int
    ) -> None:
        """Write the program.

        Raises:
            SkillRejected: an argument that cannot be written in URScript.
        """
        types = {name: argument.type for name, argument in skill.config.arguments.items()}
        body = CommandTemplate(way.body, types, Language.URSCRIPT).render(arguments)
        self._results = [way.results[name] for name in skill.config.results]
        self._begun, self._done = register_names("int", register), register_names("int", register + 1)
        self._mark = mark
        lines = [
            f"def {_PROGRAM}_{mark}():",
            f"  write_output_integer_register({register}, {mark})",
            *[f"  {line}" for line in body.splitlines()],
            f"  write_output_integer_register({register + 1}, {mark})",
            "end",
        ]
        self._program = "\n".join(lines) + "\n"
        self._began = 0.0
        self._was_begun = False
        self._is_halted = False
        self._is_resumed = False
        self._ended: tuple[Ended, float] | None = None
        """How it ended, and until when the controller may show that its program runs."""

    def begin(self, link: CommandLink, state: State, now: float) -> None:
        """See RobotTask."""
        if state.runtime is RuntimeState.PLAYING or link.has_begun_one():
            link.take_control(is_playing=True)  # refused where the program that runs is somebody else's
        self.is_told = True
        link.send_script(self._program)
        self._began = now

    def resume(self, state: State, now: float) -> None:
        """See RobotTask."""
        self._began, self._is_resumed = now, True

    def look(self, link: CommandLink, state: State, now: float) -> Told:
        """See RobotTask."""
        self._was_begun = self._was_begun or state.values[self._begun] == self._mark
        if self._ended is None and state.values[self._done] == self._mark:
            values = [state.values[register_names(each.register_type, each.place)] for each in self._results]
            self._ended = Ended(0, tuple(values)), now + SHOWN_S
        if self._ended is not None:  # told when the robot is free: what comes next finds no program that runs
            ended, until = self._ended
            return ended if state.runtime is not RuntimeState.PLAYING or now >= until else None
        if stop_of(state) and self._was_begun:
            return stopped(state)
        if not self._was_begun:
            if self._is_resumed:
                return Forgotten("the controller's registers tell nothing of it; see what the robot did")
            if now - self._began < BEGIN_S:
                return None
            return Ended(FAILED, (), "the controller did not begin the program; see its log")
        if state.values[self._begun] != self._mark:
            return Ended(FAILED, (), "another program took its place")
        if state.runtime is not RuntimeState.STOPPED or not state.stands:
            return Progress(0.0, "paused" if state.runtime is RuntimeState.PAUSED else "")
        if self._is_halted:
            return Ended(CANCELLED, (), "halted")
        return Ended(FAILED, (), "the program ended before its last line; see the robot's log")

    def halt(self, link: CommandLink, state: State) -> None:
        """See RobotTask."""
        self._is_halted = True
        link.stop_program()


class SetTask(Task):
    """An output, done when the controller shows it."""

    moves_arm = False

    def __init__(self, way: SetSkill, arguments: Mapping[str, Any]) -> None:
        """Take the value.

        Raises:
            SkillRejected: the output does not take it.
        """
        output = find_output(way.output)
        assert output is not None
        self._output: Output = output
        self._value = arguments[way.value] if isinstance(way.value, str) else way.value
        try:
            self._call = output.call(self._value)
        except ValueError as error:
            raise SkillRejected(f"{way.output}: {error}") from error
        self._began = 0.0
        self._is_resumed = False

    def begin(self, link: CommandLink, state: State, now: float) -> None:
        """See RobotTask."""
        method, arguments = self._call
        self.is_told = True
        if not link.call("io", method, *arguments):
            raise SkillFailed(f"the controller did not take {method}")
        self._began = now

    def resume(self, state: State, now: float) -> None:
        """See RobotTask."""
        self._began, self._is_resumed = now, True

    def look(self, link: CommandLink, state: State, now: float) -> Told:
        """See RobotTask."""
        if self._output.is_seen(self._value, state.values):
            return Ended(0)
        if self._is_resumed:
            return Forgotten(f"{self._output.name} has another value; see whether it was set in between")
        if now - self._began < BEGIN_S:
            return None
        return Ended(FAILED, (), f"{self._output.name} did not change")

    def check_can_halt(self) -> None:
        """See RobotTask."""
        raise SkillRejected("an output that is set cannot be halted")

    def halt(self, link: CommandLink, state: State) -> None:
        """See RobotTask."""
        self.check_can_halt()


class StopTask(Task):
    """Stop what the robot does."""

    moves_arm = False

    def __init__(self, way: StopSkill) -> None:
        self._way = way
        self._is_slowed = self._is_ended = False
        """Whether a move was slowed down, and a program ended."""
        self._moves_since: float | None = None
        self._began = 0.0

    def begin(self, link: CommandLink, state: State, now: float) -> None:
        """See RobotTask."""
        self.is_told, self._began = True, now
        self._is_slowed = link.stop_move(self._way.deceleration)
        if not self._is_slowed:
            self._end_program(link, state)

    def _end_program(self, link: CommandLink, state: State) -> None:
        """Have any program stopped, also where the state shows none: it may be late."""
        self._is_ended = True
        try:
            link.stop_program()
        except SkillFailed:
            if state.runtime is not RuntimeState.STOPPED or link.has_begun_one():
                raise
            self._is_ended = False  # there is none

    def resume(self, state: State, now: float) -> None:
        """See RobotTask."""
        self._began = now

    def look(self, link: CommandLink, state: State, now: float) -> Told:
        """See RobotTask."""
        if state.taken_s < self._began:
            return None  # of before, and late
        if state.stands and not (self._is_ended and state.runtime is not RuntimeState.STOPPED):
            return Ended(0)
        if self._moves_since is None:
            self._moves_since = now
        elif self._is_slowed and not self._is_ended and now - self._moves_since >= SETTLED_S:
            self._end_program(link, state)  # another one than ur-rtde's moves the arm
        return Progress(0.0)

    def check_can_halt(self) -> None:
        """See RobotTask."""
        raise SkillRejected("a stop cannot be stopped")

    def halt(self, link: CommandLink, state: State) -> None:
        """See RobotTask."""
        self.check_can_halt()


def refusal_of(task: RobotTask, state: State, remote_control: bool | None) -> str:
    """Why a task cannot be begun now; the empty text where it can."""
    if remote_control is False:
        return _LOCAL
    if not task.moves_arm:
        return ""
    wrong = keeps_from_moving(state, remote_control)
    # The dashboard server's `play` has a program that is paused go on.
    return "" if wrong == _PAUSED and isinstance(task, PlayTask) else wrong


def keeps_from_moving(state: State, remote_control: bool | None) -> str:
    """Why the arm cannot be moved now; the empty text where it can."""
    if remote_control is False:
        return _LOCAL
    wrong = stop_of(state) or remark_of(state, remote_control)
    if wrong:
        return wrong
    if state.robot_mode is not RobotMode.RUNNING:
        return f"robot mode {state.robot_mode.name}: switch the power on and release the brakes first"
    # A program that is sent would take its place.
    return _PAUSED if state.runtime is RuntimeState.PAUSED else ""


def make_task(skill: ConfiguredSkill[Any], values: Sequence[Any], register: int, mark: int) -> RobotTask:
    """The task of an execution.

    Raises:
        SkillRejected: an argument that the robot cannot be given.
    """
    arguments = dict(zip(skill.arguments, values, strict=True))
    via: Any = skill.via
    way: Model = via.way
    if isinstance(way, MoveJ | MoveL):
        return MoveTask(way, arguments)
    if isinstance(way, ScriptSkill):
        return ScriptTask(skill, way, arguments, register, mark)
    if isinstance(way, DashboardSkill):
        return PlayTask(way) if way.command is Dashboard.PLAY else DashboardTask(way, arguments)
    if isinstance(way, SetSkill):
        return SetTask(way, arguments)
    assert isinstance(way, StopSkill)
    return StopTask(way)
