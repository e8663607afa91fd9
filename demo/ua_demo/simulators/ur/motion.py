"""Motions: where the arm is after each step of the controller. Pure.

    JointMove     movej: all joints start and stop together, the leading one keeps speed and acceleration
    LinearMove    movel: the tool's centre goes straight, and turns about one axis
    JointSpeed    speedj: speeds up to a joint speed and keeps it
    ToolSpeed     speedl: the same for the tool's speed
    Servo         servoj: towards a joint position that is soon replaced by the next one
    Halt          stopj, stopl: slows down along the path that it has

There are no blends: the arm stops at every waypoint, and no dynamics: it is always where the profile says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Protocol

from ua_demo.simulators.ur.kinematics import (
    Frame,
    Model,
    flange,
    inverse,
    jacobian,
    product,
    rotation_between,
    rotation_of,
    solve,
)

__all__ = [
    "Halt",
    "JointMove",
    "JointSpeed",
    "LinearMove",
    "Motion",
    "MotionImpossible",
    "Profile",
    "Servo",
    "ToolSpeed",
]

FASTEST_JOINT: Final = 2 * math.pi
"""rad/s. An arm that had to be faster than this stops itself: it is near a singularity."""


class MotionImpossible(Exception):
    """The arm cannot go there, or not so: the controller stops it."""


class Profile:
    """A trapezoid: speed up, keep the speed, slow down; or a triangle where the way is too short for that."""

    def __init__(self, length: float, speed: float, acceleration: float, duration: float = 0.0) -> None:
        """Lengths in m or rad. With `duration` the speed is the one that takes so long, as `t` in URScript."""
        if duration > 0:
            root = (acceleration * duration) ** 2 - 4 * acceleration * length
            if root < 0:
                acceleration, root = 4 * length / duration**2, 0.0
            speed = (acceleration * duration - math.sqrt(root)) / 2
        speed = min(speed, math.sqrt(length * acceleration))
        self.length, self._speed, self._acceleration = length, speed, acceleration
        self._rising = speed / acceleration if acceleration > 0 else 0.0
        cruising = (length - speed * self._rising) / speed if speed > 0 else 0.0
        self._falling_from = self._rising + cruising
        self.duration = self._falling_from + self._rising

    def at(self, time: float) -> tuple[float, float]:
        """Way and speed after so many seconds."""
        if time >= self.duration:
            return self.length, 0.0
        if time < self._rising:
            return self._acceleration * time * time / 2, self._acceleration * time
        if time < self._falling_from:
            return self._speed * (time - self._rising / 2), self._speed
        left = self.duration - time
        return self.length - self._acceleration * left * left / 2, self._acceleration * left


class Motion(Protocol):
    """What moves the arm."""

    done: bool

    def step(self, q: list[float], qd: list[float], dt: float) -> tuple[list[float], list[float]]:
        """Joint positions and speeds one step later.

        Raises:
            MotionImpossible: there is no way on.
        """
        ...


class JointMove:
    """See the module."""

    def __init__(
        self, start: Sequence[float], target: Sequence[float], speed: float, acceleration: float, duration: float = 0.0
    ) -> None:
        ways = [end - begin for begin, end in zip(start, target, strict=True)]
        longest = max(abs(way) for way in ways)
        self._start, self._target = list(start), list(target)
        self._direction = [way / longest for way in ways] if longest > 0 else [0.0] * 6
        self.profile = Profile(longest, speed, acceleration, duration)
        self._time = 0.0
        self.done = longest == 0

    def step(self, q: list[float], qd: list[float], dt: float) -> tuple[list[float], list[float]]:
        """See Motion."""
        self._time += dt
        if self._time >= self.profile.duration:
            self.done = True
            return list(self._target), [0.0] * 6
        way, speed = self.profile.at(self._time)
        return (
            [start + way * part for start, part in zip(self._start, self._direction, strict=True)],
            [speed * part for part in self._direction],
        )


class LinearMove:
    """See the module. Speed and acceleration are the tool's in m/s; for a turn on the spot they are in rad/s."""

    def __init__(
        self,
        model: Model,
        tool: Frame,
        start: Sequence[float],
        target: Frame,
        speed: float,
        acceleration: float,
        duration: float = 0.0,
    ) -> None:
        self._model, self._tool = model, tool
        self._from = product(flange(model, start), tool)
        self._way = [end - begin for begin, end in zip(self._from.position, target.position, strict=True)]
        self._turn = rotation_between(self._from, target)
        length = math.hypot(*self._way)
        self.profile = Profile(length if length > 1e-6 else math.hypot(*self._turn), speed, acceleration, duration)
        self._time = 0.0
        self.done = self.profile.length < 1e-9
        if not self.done and inverse(model, target, start, tool) is None:
            raise MotionImpossible("the target of a linear move is out of reach")

    def step(self, q: list[float], qd: list[float], dt: float) -> tuple[list[float], list[float]]:
        """See Motion."""
        if dt <= 0:
            return q, [0.0] * 6
        self._time += dt
        way, _ = self.profile.at(self._time)
        part = way / self.profile.length
        x, y, z = (begin + part * length for begin, length in zip(self._from.position, self._way, strict=True))
        turned = Frame(rotation_of([part * angle for angle in self._turn]), (0.0, 0.0, 0.0))
        wanted = Frame(product(turned, self._from).rotation, (x, y, z))
        found = inverse(self._model, wanted, q, self._tool, rounds=12)
        if found is None:
            raise MotionImpossible("a linear move leads through a place that the arm cannot reach")
        speeds = [(new - old) / dt for new, old in zip(found, q, strict=True)]
        if max(abs(value) for value in speeds) > FASTEST_JOINT:
            raise MotionImpossible("a linear move leads too close to a singularity")
        if self._time >= self.profile.duration:
            self.done = True
            speeds = [0.0] * 6
        return found, speeds


def _approached(now: float, wanted: float, most: float) -> float:
    return now + min(max(wanted - now, -most), most)


class JointSpeed:
    """See the module; it ends only when another motion takes over."""

    def __init__(self, speeds: Sequence[float], acceleration: float) -> None:
        self._speeds, self._acceleration = list(speeds), acceleration
        self.done = False
        self.reached = False

    def step(self, q: list[float], qd: list[float], dt: float) -> tuple[list[float], list[float]]:
        """See Motion."""
        most = self._acceleration * dt
        speeds = [_approached(now, wanted, most) for now, wanted in zip(qd, self._speeds, strict=True)]
        self.reached = speeds == self._speeds
        return [value + speed * dt for value, speed in zip(q, speeds, strict=True)], speeds


class ToolSpeed:
    """See the module; it ends only when another motion takes over."""

    def __init__(self, model: Model, tool: Frame, speeds: Sequence[float], acceleration: float) -> None:
        self._model, self._tool, self._speeds, self._acceleration = model, tool, list(speeds), acceleration
        self.done = False
        self.reached = False

    def step(self, q: list[float], qd: list[float], dt: float) -> tuple[list[float], list[float]]:
        """See Motion."""
        _, rows = jacobian(self._model, q, self._tool)
        now = [sum(part * speed for part, speed in zip(row, qd, strict=True)) for row in rows]
        most = self._acceleration * dt
        wanted = [_approached(old, new, most) for old, new in zip(now, self._speeds, strict=True)]
        self.reached = wanted == self._speeds
        speeds = solve(rows, wanted, damping=1e-4)
        if max(abs(value) for value in speeds) > FASTEST_JOINT:
            raise MotionImpossible("the wanted tool speed leads too close to a singularity")
        return [value + speed * dt for value, speed in zip(q, speeds, strict=True)], speeds


class Servo:
    """See the module. It is where it shall be after `duration` seconds, unless a joint would be too fast."""

    def __init__(self, target: Sequence[float], duration: float) -> None:
        self._target, self._left = list(target), duration
        self.done = False

    def step(self, q: list[float], qd: list[float], dt: float) -> tuple[list[float], list[float]]:
        """See Motion."""
        if dt <= 0:
            return q, [0.0] * 6
        left = max(self._left, dt)
        self._left -= dt
        speeds = [
            min(max((end - now) / left, -FASTEST_JOINT), FASTEST_JOINT)
            for now, end in zip(q, self._target, strict=True)
        ]
        reached = [value + speed * dt for value, speed in zip(q, speeds, strict=True)]
        self.done = max(abs(end - now) for now, end in zip(reached, self._target, strict=True)) < 1e-6
        return reached, [0.0] * 6 if self.done else speeds


class Halt:
    """See the module."""

    def __init__(self, qd: Sequence[float], duration: float) -> None:
        self._speeds, self._duration, self._time = list(qd), duration, 0.0
        self.done = not any(qd)

    @classmethod
    def of_joints(cls, qd: Sequence[float], deceleration: float) -> Halt:
        """The leading joint slows down with so many rad/s²."""
        return cls(qd, max(abs(speed) for speed in qd) / deceleration)

    @classmethod
    def of_tool(cls, qd: Sequence[float], tool_speed: float, deceleration: float) -> Halt:
        """The tool slows down from `tool_speed` m/s with so many m/s²."""
        return cls(qd, tool_speed / deceleration) if tool_speed > 1e-6 else cls.of_joints(qd, deceleration)

    def step(self, q: list[float], qd: list[float], dt: float) -> tuple[list[float], list[float]]:
        """See Motion."""
        before = max(1 - self._time / self._duration, 0.0) if self._duration > 0 else 0.0
        self._time += dt
        after = max(1 - self._time / self._duration, 0.0) if self._duration > 0 else 0.0
        self.done = after == 0
        mean = (before + after) / 2
        return (
            [value + mean * speed * dt for value, speed in zip(q, self._speeds, strict=True)],
            [after * speed for speed in self._speeds],
        )
