"""What programs may call: the functions of URScript that the simulated controller has.

A generator is a function that takes time; the program goes on when it is over. Names and arguments are those of the
URScript manual; what is not here ends a program with "there is no function".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping
from typing import Any

from ua_bridges.ur.modes import SafetyMode

from ua_demo.simulators.ur.controller import PERIOD_S, REGISTERS, Controller, Registers, Watchdog
from ua_demo.simulators.ur.kinematics import frame_of, inverted, pose_of, product
from ua_demo.simulators.ur.motion import Motion
from ua_demo.simulators.ur.urscript import Pose, ScriptError, Value
from ua_demo.simulators.ur.urscript.values import items_of, shown

__all__ = ["functions_of"]

Steps = Generator[None, None, None]
_LIMIT_RAD = math.radians(363.0)
"""Joint position limits as delivered."""
_STOPPED_RAD_S2, _STOPPED_M_S2 = 2.0, 10.0


def functions_of(controller: Controller) -> Mapping[str, Callable[..., Any]]:
    """All functions by name."""
    found: dict[str, Callable[..., Any]] = {}
    for group in (_Moves(controller), _Signals(controller), _State(controller)):
        names = (name for name in dir(group) if not name.startswith("_"))
        found.update({name: getattr(group, name) for name in names})
    return {**found, **_MATHEMATICS}


def _six(value: Value) -> list[float]:
    items = items_of(value)
    if items is not None and len(items) == 6 and all(isinstance(item, (int, float)) for item in items):
        return [float(item) for item in items]
    raise ScriptError(f"six numbers were expected, and there is {shown(value)}")


def _number(value: Value, least: float = -math.inf, most: float = math.inf) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
        raise ScriptError(f"a number of {least:g} to {most:g} was expected, and there is {shown(value)}")
    return float(value)


def _place(value: Value, count: int, first: int = 0) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not first <= value < first + count:
        raise ScriptError(f"an integer of {first} to {first + count - 1} was expected, and there is {shown(value)}")
    return value


class _Group:
    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._arm = controller.arm


class _Moves(_Group):
    """Everything that the arm does."""

    def _joints(self, target: Value) -> list[float]:
        if isinstance(target, Pose):
            return self._solved(target, None, 1e-8, 1e-8)
        q = _six(target)
        if max(abs(angle) for angle in q) > _LIMIT_RAD:
            raise ScriptError("a joint position beyond the limits of the arm")
        return q

    def _solved(self, pose: Value, near: Value | None, position_error: float, rotation_error: float) -> list[float]:
        q = self._arm.inverse(_six(pose), None if near is None else _six(near), position_error, rotation_error)
        if q is None:
            raise ScriptError("get_inverse_kin: the pose is out of reach")
        return q

    def _done(self, begin: Callable[[], Motion]) -> Steps:
        """Begin a motion and wait for its end; again where a pause broke it off."""
        while True:
            motion = begin()
            while self._arm.motion is motion:
                yield
            if self._controller.interrupted is not motion:
                return

    def movej(self, q: Value, a: Value = 1.4, v: Value = 1.05, t: Value = 0, r: Value = 0) -> Steps:
        joints = self._joints(q)
        speed, acceleration = _number(v, 1e-6), _number(a, 1e-6)
        _number(r, 0)
        return self._done(lambda: self._arm.move_joints(joints, speed, acceleration, _number(t, 0)))

    def movel(self, pose: Value, a: Value = 1.2, v: Value = 0.25, t: Value = 0, r: Value = 0) -> Steps:
        target = _six(pose) if isinstance(pose, Pose) else self._arm.forward(self._joints(pose), None)
        speed, acceleration = _number(v, 1e-6), _number(a, 1e-6)
        _number(r, 0)
        frame = frame_of(target)
        return self._done(lambda: self._arm.move_tool(frame, speed, acceleration, _number(t, 0)))

    def movep(self, pose: Value, a: Value = 1.2, v: Value = 0.25, r: Value = 0) -> Steps:
        return self.movel(pose, a, v, 0, r)

    def stopj(self, a: Value = _STOPPED_RAD_S2) -> Steps:
        return self._halted(lambda: self._arm.halt_joints(_number(a, 1e-6)))

    def stopl(self, a: Value = _STOPPED_M_S2, aRot: Value = 0) -> Steps:  # noqa: N803 - URScript's name
        return self._halted(lambda: self._arm.halt_tool(_number(a, 1e-6)))

    def _halted(self, begin: Callable[[], Motion]) -> Steps:
        motion = begin()
        while self._arm.motion is motion:
            yield

    def speedj(self, qd: Value, a: Value = 0.5, t: Value = 0) -> Steps:
        motion = self._arm.speed_joints(_six(qd), _number(a, 1e-6))
        return self._for(_number(t, 0), lambda: motion.reached, motion)

    def speedl(self, xd: Value, a: Value = 0.5, t: Value = 0, aRot: Value = 0) -> Steps:  # noqa: N803 - URScript's name
        motion = self._arm.speed_tool(_six(xd), _number(a, 1e-6))
        return self._for(_number(t, 0), lambda: motion.reached, motion)

    def _for(self, seconds: float, reached: Callable[[], bool], motion: Motion) -> Steps:
        until = self._controller.time + seconds - PERIOD_S / 2
        yield
        while self._arm.motion is motion and (self._controller.time < until if seconds else not reached()):
            yield

    def servoj(
        self,
        q: Value,
        a: Value = 0,
        v: Value = 0,
        t: Value = 0.002,
        lookahead_time: Value = 0.1,
        gain: Value = 300,
    ) -> Steps:
        duration = _number(t, PERIOD_S)
        motion = self._arm.servo(self._joints(q), duration)
        return self._for(duration, lambda: motion.done, motion)

    def get_inverse_kin(
        self,
        x: Value,
        qnear: Value | None = None,
        maxPositionError: Value = 1e-8,  # noqa: N803 - URScript's name
        maxOrientationError: Value = 1e-8,  # noqa: N803 - URScript's name
    ) -> list[float]:
        return self._solved(x, qnear, _number(maxPositionError, 0), _number(maxOrientationError, 0))

    def get_inverse_kin_has_solution(
        self,
        x: Value,
        qnear: Value | None = None,
        maxPositionError: Value = 1e-8,  # noqa: N803 - URScript's name
        maxOrientationError: Value = 1e-8,  # noqa: N803 - URScript's name
    ) -> bool:
        near = None if qnear is None else _six(qnear)
        errors = _number(maxPositionError, 0), _number(maxOrientationError, 0)
        return self._arm.inverse(_six(x), near, *errors) is not None

    def get_forward_kin(self, q: Value | None = None, tcp: Value | None = None) -> Pose:
        joints = self._arm.q if q is None else _six(q)
        return Pose(self._arm.forward(joints, None if tcp is None else _six(tcp)))

    def is_within_safety_limits(self, pose: Value) -> bool:
        if isinstance(pose, Pose):
            return self._arm.inverse(_six(pose)) is not None
        return max(abs(angle) for angle in _six(pose)) <= _LIMIT_RAD

    def is_steady(self) -> bool:
        return self._arm.is_steady

    def set_tcp(self, pose: Value) -> None:
        self._arm.set_tcp(_six(pose))

    def get_tcp_offset(self) -> Pose:
        return Pose(self._arm.tcp_offset)

    def get_actual_joint_positions(self) -> list[float]:
        return list(self._arm.q)

    def get_target_joint_positions(self) -> list[float]:
        return list(self._arm.q)

    def get_actual_joint_speeds(self) -> list[float]:
        return list(self._arm.qd)

    def get_actual_tcp_pose(self) -> Pose:
        return Pose(self._arm.tcp_pose())

    def get_target_tcp_pose(self) -> Pose:
        return Pose(self._arm.tcp_pose())

    def get_actual_tcp_speed(self) -> list[float]:
        return list(self._arm.tcp_speed())

    def get_target_tcp_speed(self) -> list[float]:
        return list(self._arm.tcp_speed())

    def get_actual_tool_flange_pose(self) -> Pose:
        return Pose(self._arm.flange_pose())

    def get_actual_joint_positions_history(self, steps: Value = 0) -> list[float]:
        history = self._arm.history
        return list(history[-1 - min(_place(steps, 2**31), len(history) - 1)])


class _Signals(_Group):
    """Inputs, outputs and registers."""

    def _set_bit(self, bit: int, value: Value) -> None:
        if not isinstance(value, bool):
            raise ScriptError(f"True or False was expected, and there is {shown(value)}")
        mask = 1 << bit
        outputs = self._controller.digital_outputs
        self._controller.digital_outputs = outputs | mask if value else outputs & ~mask

    def set_standard_digital_out(self, n: Value, b: Value) -> None:
        self._set_bit(_place(n, 8), b)

    def set_configurable_digital_out(self, n: Value, b: Value) -> None:
        self._set_bit(8 + _place(n, 8), b)

    def set_tool_digital_out(self, n: Value, b: Value) -> None:
        self._set_bit(16 + _place(n, 2), b)

    def set_digital_out(self, n: Value, b: Value) -> None:
        place = _place(n, 10)
        self._set_bit(place if place < 8 else place + 8, b)

    def _bit(self, bits: int, bit: int) -> bool:
        return bool(bits >> bit & 1)

    def get_standard_digital_in(self, n: Value) -> bool:
        return self._bit(self._controller.digital_inputs, _place(n, 8))

    def get_configurable_digital_in(self, n: Value) -> bool:
        return self._bit(self._controller.digital_inputs, 8 + _place(n, 8))

    def get_tool_digital_in(self, n: Value) -> bool:
        return self._bit(self._controller.digital_inputs, 16 + _place(n, 2))

    def get_digital_in(self, n: Value) -> bool:
        place = _place(n, 10)
        return self._bit(self._controller.digital_inputs, place if place < 8 else place + 8)

    def get_standard_digital_out(self, n: Value) -> bool:
        return self._bit(self._controller.digital_outputs, _place(n, 8))

    def get_digital_out(self, n: Value) -> bool:
        place = _place(n, 10)
        return self._bit(self._controller.digital_outputs, place if place < 8 else place + 8)

    def set_standard_analog_out(self, n: Value, f: Value) -> None:
        place, part = _place(n, 2), _number(f, 0, 1)
        low, high = (0.0, 10.0) if self._controller.analog_domains[place] else (0.004, 0.020)
        self._controller.analog_outputs[place] = low + part * (high - low)

    def get_standard_analog_in(self, n: Value) -> float:
        return self._controller.analog_inputs[_place(n, 2)]

    def _registers(self, is_input: bool) -> Registers:
        return self._controller.inputs if is_input else self._controller.outputs

    def read_input_integer_register(self, address: Value) -> int:
        return self._controller.inputs.ints[_place(address, REGISTERS)]

    def read_input_float_register(self, address: Value) -> float:
        return self._controller.inputs.doubles[_place(address, REGISTERS)]

    def read_input_boolean_register(self, address: Value) -> bool:
        return self._controller.inputs.bits[_place(address, 128)]

    def read_output_integer_register(self, address: Value) -> int:
        return self._controller.outputs.ints[_place(address, REGISTERS)]

    def read_output_float_register(self, address: Value) -> float:
        return self._controller.outputs.doubles[_place(address, REGISTERS)]

    def read_output_boolean_register(self, address: Value) -> bool:
        return self._controller.outputs.bits[_place(address, 128)]

    def write_output_integer_register(self, address: Value, value: Value) -> None:
        number = _number(value, -(2**31), 2**31 - 1)
        self._controller.outputs.ints[_place(address, REGISTERS)] = int(number)

    def write_output_float_register(self, address: Value, value: Value) -> None:
        self._controller.outputs.doubles[_place(address, REGISTERS)] = _number(value)

    def write_output_boolean_register(self, address: Value, value: Value) -> None:
        if not isinstance(value, bool):
            raise ScriptError(f"True or False was expected, and there is {shown(value)}")
        self._controller.outputs.bits[_place(address, 128)] = value

    def rtde_set_watchdog(self, variable_name: Value, min_frequency: Value, action: Value = "pause") -> None:
        if action not in ("ignore", "pause", "stop"):
            raise ScriptError(f"a watchdog's action is ignore, pause or stop, and not {shown(action)}")
        period_s = 1 / _number(min_frequency, 1e-3)
        self._controller.watchdog = Watchdog(str(variable_name), period_s, str(action), self._controller.time)


class _State(_Group):
    """The program itself, and what it says of the robot."""

    def sync(self) -> Steps:
        yield

    def sleep(self, t: Value) -> Steps:
        until = self._controller.time + _number(t, 0) - PERIOD_S / 2
        while self._controller.time < until:
            yield

    def halt(self) -> Steps:
        self._controller.stop_program("halt")
        yield

    def textmsg(self, s1: Value, s2: Value = "") -> None:
        self._controller.say("message", shown(s1) + shown(s2))

    def popup(
        self,
        s: Value,
        title: Value = "Popup",
        warning: Value = False,
        error: Value = False,
        blocking: Value = False,
    ) -> Steps:
        self._controller.popup = shown(s)
        while blocking is True and self._controller.popup:
            yield

    def protective_stop(self) -> None:
        self._controller.stop_for_safety(SafetyMode.PROTECTIVE_STOP, "a program asked for it")

    def get_steptime(self) -> float:
        return PERIOD_S

    def set_payload(self, m: Value, cog: Value | None = None) -> None:
        self._controller.payload = _number(m, 0)
        if cog is not None:
            self._set_cog(cog)

    def set_target_payload(
        self, m: Value, cog: Value, inertia: Value | None = None, transition_time: Value = 0
    ) -> None:
        self.set_payload(m, cog)
        if inertia is not None:
            self._controller.payload_inertia = _six(inertia)

    def _set_cog(self, cog: Value) -> None:
        items = items_of(cog)
        if items is None or len(items) != 3:
            raise ScriptError(f"three numbers were expected, and there is {shown(cog)}")
        self._controller.payload_cog = [_number(item) for item in items]

    def get_target_payload(self) -> float:
        return self._controller.payload

    def get_target_payload_cog(self) -> list[float]:
        return list(self._controller.payload_cog)

    def get_target_payload_inertia(self) -> list[float]:
        return list(self._controller.payload_inertia)

    def set_gravity(self, d: Value) -> None:
        """Without dynamics there is nothing to do."""

    def force_mode_set_damping(self, damping: Value) -> None:
        """Without forces there is nothing to do; ur-rtde's program says it at its beginning."""

    def force_mode_set_gain_scaling(self, scaling: Value) -> None:
        """As for damping."""


def _checked(function: Callable[..., float]) -> Callable[..., float]:
    def call(*numbers: Value) -> float:
        try:
            return function(*[_number(number) for number in numbers])
        except (ValueError, OverflowError, ZeroDivisionError, TypeError) as error:
            raise ScriptError(str(error)) from error

    return call


def _pose_trans(p_from: Value, p_from_to: Value) -> Pose:
    return Pose(pose_of(product(frame_of(_six(p_from)), frame_of(_six(p_from_to)))))


def _pose_inv(p_from: Value) -> Pose:
    return Pose(pose_of(inverted(frame_of(_six(p_from)))))


def _pose_sub(p_to: Value, p_from: Value) -> Pose:
    end, start = frame_of(_six(p_to)), frame_of(_six(p_from))
    way = [one - other for one, other in zip(end.position, start.position, strict=True)]
    turn = pose_of(product(end, inverted(start)))[3:]
    return Pose([*way, *turn])


def _pose_add(p_1: Value, p_2: Value) -> Pose:
    first, second = _six(p_1), _six(p_2)
    turn = pose_of(product(frame_of([0, 0, 0, *second[3:]]), frame_of([0, 0, 0, *first[3:]])))[3:]
    return Pose([*[one + other for one, other in zip(first[:3], second[:3], strict=True)], *turn])


def _norm(a: Value) -> float:
    items = items_of(a)
    return abs(_number(a)) if items is None else math.hypot(*[_number(item) for item in items])


def _length(v: Value) -> int:
    items = v if isinstance(v, str) else items_of(v)
    if items is None:
        raise ScriptError(f"a list or a text was expected, and there is {shown(v)}")
    return len(items)


def _point_dist(p_from: Value, p_to: Value) -> float:
    return math.dist(_six(p_from)[:3], _six(p_to)[:3])


def _log(base: float, number: float) -> float:
    return math.log(number, base)


def _ceil(f: Value) -> int:
    return math.ceil(_number(f, -(2**31), 2**31))


def _floor(f: Value) -> int:
    return math.floor(_number(f, -(2**31), 2**31))


def _texts(*parts: Value) -> str:
    return "".join(shown(part) for part in parts)


_MATHEMATICS: Mapping[str, Callable[..., Any]] = {
    **{name: _checked(getattr(math, name)) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt")},
    "pow": _checked(math.pow),
    "log": _checked(_log),
    "ceil": _ceil,
    "floor": _floor,
    "d2r": _checked(math.radians),
    "r2d": _checked(math.degrees),
    "norm": _norm,
    "length": _length,
    "point_dist": _point_dist,
    "pose_trans": _pose_trans,
    "pose_inv": _pose_inv,
    "pose_sub": _pose_sub,
    "pose_add": _pose_add,
    "to_str": shown,
    "str_cat": _texts,
}
