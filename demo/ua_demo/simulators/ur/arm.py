"""The arm: its joints, its tool, and the one motion that it makes. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

from ua_demo.simulators.ur.kinematics import Frame, Model, flange, frame_of, inverse, jacobian, pose_of, product
from ua_demo.simulators.ur.motion import Halt, JointMove, JointSpeed, LinearMove, Motion, Servo, ToolSpeed

__all__ = ["HOME", "Arm"]

HOME: Final = (0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0)
"""Where arms stand when they are delivered: upright."""
_HISTORY: Final = 500


class Arm:
    """See the module. Units as in `kinematics`."""

    def __init__(self, model: Model, q: Sequence[float] = HOME) -> None:
        self.model = model
        self.q: list[float] = list(q)
        self.qd: list[float] = [0.0] * 6
        self.qdd: list[float] = [0.0] * 6
        self.target_q: list[float] = list(q)
        """Where the present motion leads; the present position while none has an end."""
        self.tcp_offset: list[float] = [0.0] * 6
        self._tool = frame_of(self.tcp_offset)
        self.motion: Motion | None = None
        self.history: deque[list[float]] = deque([self.q], maxlen=_HISTORY)
        self._seen: tuple[list[float], list[float], list[float], list[float]] | None = None

    # What it is asked

    def move_joints(self, target: Sequence[float], speed: float, acceleration: float, duration: float) -> Motion:
        """See motion.JointMove."""
        return self._begin(JointMove(self.q, target, speed, acceleration, duration))

    def move_tool(self, target: Frame, speed: float, acceleration: float, duration: float) -> Motion:
        """See motion.LinearMove."""
        return self._begin(LinearMove(self.model, self._tool, self.q, target, speed, acceleration, duration))

    def speed_joints(self, speeds: Sequence[float], acceleration: float) -> JointSpeed:
        """See motion.JointSpeed."""
        motion = JointSpeed(speeds, acceleration)
        self._begin(motion)
        return motion

    def speed_tool(self, speeds: Sequence[float], acceleration: float) -> ToolSpeed:
        """See motion.ToolSpeed."""
        motion = ToolSpeed(self.model, self._tool, speeds, acceleration)
        self._begin(motion)
        return motion

    def servo(self, target: Sequence[float], duration: float) -> Motion:
        """See motion.Servo."""
        return self._begin(Servo(target, duration))

    def halt_joints(self, deceleration: float) -> Motion:
        """See motion.Halt.of_joints."""
        return self._begin(Halt.of_joints(self.qd, deceleration))

    def halt_tool(self, deceleration: float) -> Motion:
        """See motion.Halt.of_tool."""
        return self._begin(Halt.of_tool(self.qd, math.hypot(*self.tcp_speed()[:3]), deceleration))

    def _begin(self, motion: Motion) -> Motion:
        self.motion = motion
        return motion

    def freeze(self) -> None:
        """Stand still at once: the power is off and the brakes are on."""
        self.motion, self.qd, self.qdd = None, [0.0] * 6, [0.0] * 6

    # The clock

    def step(self, dt: float, scaling: float) -> None:
        """Go on for `dt` seconds; `scaling` (0 to 1) slows what a program asked for, but no stop.

        Raises:
            MotionImpossible: there is no way on; the motion is over.
        """
        motion, before = self.motion, self.qd
        if motion is None:
            self.qdd = [0.0] * 6
            self.history.append(self.q)
            return
        scaled = dt if isinstance(motion, Halt) else dt * scaling
        try:
            self.q, self.qd = motion.step(self.q, self.qd, scaled)
        except Exception:
            self.motion = None
            raise
        if scaled < dt:
            self.qd = [speed * scaling for speed in self.qd]
        if motion.done:
            self.motion = None
            self.qd = [0.0] * 6
        self.qdd = [(after - earlier) / dt for after, earlier in zip(self.qd, before, strict=True)]
        self.history.append(self.q)

    # What is to be seen

    def set_tcp(self, pose: Sequence[float]) -> None:
        """The tool's centre as seen from the flange."""
        self.tcp_offset = list(pose)
        self._tool = frame_of(pose)
        self._seen = None

    def _look(self) -> tuple[list[float], list[float], list[float], list[float]]:
        if self._seen is None or self._seen[0] is not self.q or self._seen[1] is not self.qd:
            tip, rows = jacobian(self.model, self.q, self._tool)
            if any(self.qd):
                speed = [sum(part * value for part, value in zip(row, self.qd, strict=True)) for row in rows]
            else:
                speed = [0.0] * 6
            self._seen = (self.q, self.qd, pose_of(tip), speed)
        return self._seen

    def tcp_pose(self) -> list[float]:
        """Where the tool's centre is."""
        return self._look()[2]

    def tcp_speed(self) -> list[float]:
        """The tool's speed, m/s and rad/s."""
        return self._look()[3]

    def flange_pose(self) -> list[float]:
        """Where the flange is."""
        return pose_of(flange(self.model, self.q))

    def forward(self, q: Sequence[float], tcp: Sequence[float] | None) -> list[float]:
        """Where the tool's centre would be."""
        return pose_of(product(flange(self.model, q), self._tool if tcp is None else frame_of(tcp)))

    def inverse(
        self,
        pose: Sequence[float],
        near: Sequence[float] | None = None,
        position_error: float = 1e-8,
        rotation_error: float = 1e-8,
    ) -> list[float] | None:
        """Joints for a pose of the tool's centre; None where it is out of reach."""
        return inverse(
            self.model,
            frame_of(pose),
            self.q if near is None else near,
            self._tool,
            position_error=position_error,
            rotation_error=rotation_error,
        )

    @property
    def is_steady(self) -> bool:
        """Whether it stands still."""
        return self.motion is None and not any(self.qd)
