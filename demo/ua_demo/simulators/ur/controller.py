"""The controller: its modes, its program, its inputs and outputs. Pure: each `step` is one cycle of 2 ms.

Power      POWER_OFF -power on-> BOOTING -> IDLE -brake release-> RUNNING; any -power off, emergency stop-> POWER_OFF
Safety     NORMAL -protective or safeguard stop-> the program is paused; unlocked or reset, `play` lets it go on
           NORMAL -emergency stop, violation or fault-> the program is stopped and the arm without power
Program    STOPPED -script or play-> PLAYING -pause-> PAUSED -play-> PLAYING; its end, `stop` or an error-> STOPPED
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from ua_bridges.ur.modes import RobotMode, RobotStatus, RuntimeState, SafetyMode, SafetyStatus

from ua_demo.simulators.ur.arm import Arm
from ua_demo.simulators.ur.kinematics import Model
from ua_demo.simulators.ur.motion import Motion, MotionImpossible
from ua_demo.simulators.ur.urscript import Machine, ScriptError, read_program
from ua_demo.simulators.ur.urscript.nodes import Statement

__all__ = ["PERIOD_S", "Controller", "LogLine", "Refused", "Registers", "Settings"]

PERIOD_S: Final = 0.002
REGISTERS: Final = 48
_STOPPING_RAD_S2: Final = 20.0
"""How a safety stop brakes."""
_ENDING_RAD_S2: Final = 4.0
"""How the arm brakes where a program ends in the middle of a move."""
_LOG_LINES: Final = 1000
_MOST_RECORDED: Final = 100_000


class Refused(Exception):
    """The controller does not do it now; the text says why."""


@dataclass(frozen=True)
class Settings:
    """What this controller is."""

    model: Model
    version: tuple[int, int, int, int] = (5, 12, 4, 1101661)
    serial: str = "20245500001"
    boot_s: float = 1.0
    """From `power on` to IDLE."""
    brake_s: float = 0.5
    """From `brake release` to RUNNING."""
    unlock_after_s: float = 5.0
    """A protective stop is not unlocked before."""
    programs: Mapping[str, str] = field(default_factory=dict[str, str])
    """URScript of the programs that `load` finds, by their names such as `pick.urp`."""
    on_started: Callable[[str], None] = lambda _name: None
    """Called with the name of each program that begins."""


@dataclass
class Registers:
    """General purpose registers of one direction."""

    ints: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    doubles: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    bits: list[bool] = field(default_factory=lambda: [False] * 128)


@dataclass(frozen=True)
class LogLine:
    """What the log tab of a teach pendant would show."""

    time: float
    kind: str
    """`message` (textmsg), `exception` (a program's error), `safety`, `info`."""
    text: str
    line: int = 0
    """Of the program, where it is an exception."""


class Controller:
    """See the module."""

    def __init__(self, settings: Settings, functions: Callable[[Controller], Mapping[str, Callable[..., Any]]]) -> None:
        """`functions` makes what programs may call."""
        self.settings = settings
        self.arm = Arm(settings.model)
        self.time = 0.0
        self.robot_mode = RobotMode.POWER_OFF
        self.safety_mode = SafetyMode.NORMAL
        self.safety_reason = ""
        self.runtime = RuntimeState.STOPPED
        self.remote_control = True
        self.speed_slider = 1.0
        self.digital_inputs = 0
        self.digital_outputs = 0
        """Bits 0 to 7 standard, 8 to 15 configurable, 16 and 17 tool; the inputs alike."""
        self.analog_inputs = [0.0, 0.0]
        self.analog_outputs = [0.0, 0.0]
        """V or A, as `analog_domains` says."""
        self.analog_domains = [1, 1]
        """0 current, 1 voltage."""
        self.inputs, self.outputs = Registers(), Registers()
        self.payload, self.payload_cog, self.payload_inertia = 0.0, [0.0, 0.0, 0.0], [0.0] * 6
        self.popup: str | None = None
        self.safety_popup: str | None = None
        self.loaded: str | None = None
        self.log: deque[LogLine] = deque(maxlen=_LOG_LINES)
        self.watchdog: Watchdog | None = None
        self.interrupted: Motion | None = None
        """The move that a pause broke off; a program that goes on begins it again."""
        self._functions = functions(self)
        self._program: Machine | None = None
        self._beside: list[Machine] = []
        self._due: tuple[float, RobotMode] | None = None
        self._stopped_at = 0.0
        self.recorded: dict[str, list[Any]] = {}
        """All that was written to the inputs that are recorded."""
        self.jitter_s = 0.0
        """How late the last cycle was, `actual_execution_time`."""

    # What is to be seen

    @property
    def program_name(self) -> str:
        """The program that runs or is paused; else the one that is loaded."""
        return self._program.name if self._program is not None else self.loaded or ""

    @property
    def is_playing(self) -> bool:
        """Whether a program runs."""
        return self.runtime is RuntimeState.PLAYING

    @property
    def is_at_rest(self) -> bool:
        """Whether a cycle changes nothing but the time."""
        return not (self.is_playing or self._beside or self._due is not None) and self.arm.is_steady

    @property
    def status_bits(self) -> RobotStatus:
        """`robot_status_bits`."""
        bits = RobotStatus(0)
        if self.robot_mode >= RobotMode.POWER_ON:
            bits |= RobotStatus.POWER_ON
        if self.is_playing:
            bits |= RobotStatus.PROGRAM_RUNNING
        return bits

    @property
    def safety_bits(self) -> SafetyStatus:
        """`safety_status_bits`."""
        bits = _SAFETY_BITS[self.safety_mode]
        return bits if self.safety_mode.may_move else bits | SafetyStatus.STOPPED_DUE_TO_SAFETY

    @property
    def speed_scaling(self) -> float:
        """`speed_scaling`: what of its speed the arm may have now."""
        return self.speed_slider if self.is_playing else 0.0

    def say(self, kind: str, text: str, line: int = 0) -> None:
        """A line for the log."""
        self.log.append(LogLine(self.time, kind, text, line))

    # Power

    def power_on(self) -> None:
        """Give the arm power.

        Raises:
            Refused: the safety system does not allow it.
        """
        self._check_safety()
        if self.robot_mode is RobotMode.POWER_OFF:
            self.robot_mode = RobotMode.BOOTING
            self._due = (self.time + self.settings.boot_s, RobotMode.IDLE)

    def release_brakes(self) -> None:
        """Release the brakes; gives the arm power first where it has none.

        Raises:
            Refused: the safety system does not allow it.
        """
        self._check_safety()
        if self.robot_mode in (RobotMode.POWER_OFF, RobotMode.BOOTING):
            self.robot_mode = RobotMode.BOOTING
            self._due = (self.time + self.settings.boot_s + self.settings.brake_s, RobotMode.RUNNING)
        elif self.robot_mode is RobotMode.IDLE:
            self._due = (self.time + self.settings.brake_s, RobotMode.RUNNING)

    def power_off(self) -> None:
        """Take the power from the arm."""
        self.stop_program("the power is off")
        self.arm.freeze()
        self.robot_mode, self._due = RobotMode.POWER_OFF, None

    def start_up(self) -> None:
        """Be ready at once, as a robot that was switched on before."""
        self.robot_mode, self._due = RobotMode.RUNNING, None

    def _check_safety(self) -> None:
        if not self.safety_mode.may_move:
            raise Refused(f"safety mode {self.safety_mode.name}")

    # Safety

    def stop_for_safety(self, mode: SafetyMode, reason: str) -> None:
        """A stop by the safety system; `reason` is for people."""
        self.say("safety", f"{mode.name}: {reason}")
        self.safety_mode, self.safety_reason, self._stopped_at = mode, reason, self.time
        self.safety_popup = reason
        if mode in (SafetyMode.PROTECTIVE_STOP, SafetyMode.SAFEGUARD_STOP):
            self._pause()
            self.arm.halt_joints(_STOPPING_RAD_S2)
        else:
            self.power_off()

    def unlock_protective_stop(self) -> None:
        """Let the arm move again.

        Raises:
            Refused: there is no such stop, or it was too short ago.
        """
        if self.safety_mode is not SafetyMode.PROTECTIVE_STOP:
            raise Refused("there is no protective stop")
        if self.time - self._stopped_at < self.settings.unlock_after_s:
            raise Refused(
                f"Cannot unlock protective stop until {self.settings.unlock_after_s:g}s after occurrence."
                " Always inspect cause of protective stop before unlocking"
            )
        self._back_to_normal()

    def reset_safety(self) -> None:
        """What people at the robot do: release the emergency stop, close the gate, restart the safety system."""
        self._back_to_normal()

    def _back_to_normal(self) -> None:
        self.safety_mode, self.safety_reason, self.safety_popup = SafetyMode.NORMAL, "", None

    # Programs

    def start_script(self, source: str) -> None:
        """Run a program that a client sent; it takes the place of the one that runs. What is wrong is logged."""
        try:
            program = read_program(source)
        except ScriptError as error:
            self.say("exception", f"syntax error: {error.reason}", error.line)
            return
        if program.is_secondary:
            self._beside.append(Machine(program.name, program.statements, self._functions))
            return
        self.stop_program("another program was sent")
        self._start(program.name, program.statements)

    def load(self, name: str) -> None:
        """Load a program.

        Raises:
            Refused: there is none of this name.
        """
        if name not in self.settings.programs:
            raise Refused(f"there is no program {name}")
        self.stop_program("another program is loaded")
        self.loaded = name

    def play(self) -> None:
        """Go on with a paused program, or begin the loaded one.

        Raises:
            Refused: the arm may not move, or there is no program.
        """
        self._check_ready()
        if self.runtime is RuntimeState.PAUSED:
            self.runtime = RuntimeState.PLAYING
            return
        if self.loaded is None:
            raise Refused("no program is loaded")
        try:
            program = read_program(self.settings.programs[self.loaded])
        except ScriptError as error:
            self.say("exception", f"syntax error: {error.reason}", error.line)
            raise Refused(str(error)) from error
        self.stop_program("it is begun anew")
        self._start(self.loaded, program.statements)

    def _check_ready(self) -> None:
        self._check_safety()
        if self.robot_mode is not RobotMode.RUNNING:
            raise Refused(f"robot mode {self.robot_mode.name}")

    def _start(self, name: str, statements: tuple[Statement, ...]) -> None:
        try:
            self._check_ready()
        except Refused as refusal:
            self.say("exception", f"the program {name} was not started: {refusal}")
            return
        self._program = Machine(name, statements, self._functions)
        self.runtime, self.interrupted = RuntimeState.PLAYING, None
        self.say("info", f"program {name} started")
        self.settings.on_started(name)

    def pause_program(self) -> None:
        """Pause the program.

        Raises:
            Refused: none runs.
        """
        if not self.is_playing:
            raise Refused("no program runs")
        self._pause()
        if self.arm.motion is not None:
            self.arm.halt_joints(_ENDING_RAD_S2)

    def _pause(self) -> None:
        if self.is_playing:
            self.runtime = RuntimeState.PAUSED
            self.interrupted = self.arm.motion

    def stop_program(self, why: str) -> None:
        """End the program, where one runs or is paused."""
        if self._program is None:
            return
        self.say("info", f"program {self._program.name} stopped: {why}")
        self._program.stop()
        self._ended()

    def _ended(self) -> None:
        self._program, self.runtime, self.watchdog, self.interrupted = None, RuntimeState.STOPPED, None, None
        if self.arm.motion is not None:
            self.arm.halt_joints(_ENDING_RAD_S2)

    # Inputs from RTDE

    def touched(self, variable: str, value: Any = None) -> None:
        """An RTDE client wrote an input."""
        if variable in self.recorded and len(self.recorded[variable]) < _MOST_RECORDED:
            self.recorded[variable].append(value)
        if self.watchdog is not None and self.watchdog.variable == variable:
            self.watchdog.last = self.time

    # The clock

    def step(self) -> None:
        """One cycle."""
        self.time += PERIOD_S
        if self._due is not None and self.time >= self._due[0]:
            self.robot_mode, self._due = self._due[1], None
        self._look_at_watchdog()
        if self.is_playing:
            self._step_program()
        for machine in list(self._beside):
            self._guarded(machine)
            if machine.is_over:
                self._beside.remove(machine)
        try:
            self.arm.step(PERIOD_S, self.speed_slider)
        except MotionImpossible as stop:
            self.stop_for_safety(SafetyMode.PROTECTIVE_STOP, str(stop))

    def _step_program(self) -> None:
        program = self._program
        if program is None:
            return
        self._guarded(program)
        if program.is_over and self._program is program:
            self.say("info", f"program {program.name} ended")
            self._ended()

    def _guarded(self, machine: Machine) -> None:
        try:
            machine.step()
        except ScriptError as error:
            self.say("exception", f"runtime exception: {error.reason}", error.line)
        except MotionImpossible as stop:
            self.stop_for_safety(SafetyMode.PROTECTIVE_STOP, str(stop))

    def _look_at_watchdog(self) -> None:
        watchdog = self.watchdog
        if watchdog is None or not self.is_playing or self.time - watchdog.last <= watchdog.period_s:
            return
        self.watchdog = None
        why = f"RTDE watchdog: {watchdog.variable} was not written for {watchdog.period_s:g} s"
        if watchdog.action == "pause":
            self.say("info", why)
            self.pause_program()
        elif watchdog.action == "stop":
            self.stop_program(why)


@dataclass
class Watchdog:
    """rtde_set_watchdog."""

    variable: str
    period_s: float
    action: str
    last: float


_SAFETY_BITS: Final = {
    SafetyMode.NORMAL: SafetyStatus.NORMAL,
    SafetyMode.REDUCED: SafetyStatus.NORMAL | SafetyStatus.REDUCED,
    SafetyMode.PROTECTIVE_STOP: SafetyStatus.PROTECTIVE_STOPPED,
    SafetyMode.RECOVERY: SafetyStatus.RECOVERY,
    SafetyMode.SAFEGUARD_STOP: SafetyStatus.SAFEGUARD_STOPPED,
    SafetyMode.SYSTEM_EMERGENCY_STOP: SafetyStatus.SYSTEM_EMERGENCY_STOPPED | SafetyStatus.EMERGENCY_STOPPED,
    SafetyMode.ROBOT_EMERGENCY_STOP: SafetyStatus.ROBOT_EMERGENCY_STOPPED | SafetyStatus.EMERGENCY_STOPPED,
    SafetyMode.VIOLATION: SafetyStatus.VIOLATION,
    SafetyMode.FAULT: SafetyStatus.FAULT,
    SafetyMode.VALIDATE_JOINT_ID: SafetyStatus(0),
    SafetyMode.UNDEFINED: SafetyStatus(0),
}
