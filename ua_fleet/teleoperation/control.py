"""One robot that is driven by hand: lease, watch and ramp together. Pure; time is an argument.

    IDLE      nobody holds it, and nothing is written
    HELD      a lease is held: each period a value is written, zero before its first setpoint
    STOPPING  a lease has ended: it is braked to zero, whoever holds it next; then HELD, or zero a few times and IDLE

    IDLE, STOPPING --acquire-->   a lease is held; its setpoints count once the robot is at zero
    any with a lease --release, silence, take-over, a setpoint that is none, the newest one too old,
                       the robot away, this process standing-->  STOPPING

Once a stop has begun it goes to its end: the setpoints of a new lease are taken, and followed from zero on. So two who
command never mix, and the time of a stop does not depend on who comes next. The zero at its end is always written, and
for a period: a step that is late catches up no further than that. So is the one with which a lease begins.

The process may stand for a while (SIGSTOP, a debugger, a machine without a core to spare). The output then goes on
along its profile by as many periods as went by, and what has become too old meanwhile has stopped it. Where it stood
longer than `robot_timeout_s` the robot has stopped by itself, and the output is zero at once: a ramp that goes on from
where it was would set a standing robot in motion.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final

from ua_fleet.counters import Drop
from ua_fleet.errors import LeaseRefused
from ua_fleet.printing import harmless
from ua_fleet.teleoperation.leases import Lease, Leases
from ua_fleet.teleoperation.messages import MOST_NAME_CHARACTERS, SETPOINT_DROPS, Granted, Setpoint, State, Status
from ua_fleet.teleoperation.model import COUNTER_PERIOD_S, TeleoperationModel
from ua_fleet.teleoperation.ramp import Ramp
from ua_fleet.teleoperation.watch import Echoes, Watch
from ua_fleet.values import StatusCode

__all__ = ["ZEROS_AT_END", "Control"]

ZEROS_AT_END: Final = 5
"""How often zero is written when the robot is at rest and nobody holds it; then it is left alone."""


class Control:
    """The teleoperation of one robot. The owner calls `step` and `publish` when they are due."""

    def __init__(self, model: TeleoperationModel, next_number: Callable[[], int]) -> None:
        """Begin with nobody; `next_number` as in Leases."""
        self.model = model
        self._leases = Leases(model.robot, next_number)
        self._echoes = Echoes(model.deadman_s)
        self._watch: Watch | None = None
        self._ramp = Ramp([limits for _, limits in model.axes], model.period_s)
        self._is_stopping = False
        self._is_beginning = False
        """Whether the zero is still to be written before which a robot that has stopped by itself does not follow."""
        self._zeros = 0
        """How often zero is still to be written."""
        self._step_at: float | None = None
        """When the next step is due; None while nothing is written."""
        self._publish_at: float | None = None
        """When the next status is due; None while it does not change."""
        self.drops: Counter[Drop] = Counter()
        """Setpoints that were dropped, by cause."""

    @property
    def lease(self) -> Lease | None:
        """The lease that is held."""
        return self._leases.held

    @property
    def state(self) -> State:
        """What is done now."""
        if self._is_stopping:
            return State.STOPPING
        return State.IDLE if self._leases.held is None else State.HELD

    @property
    def last_end(self) -> str:
        """Why the last lease ended, for people; empty where none has."""
        return self._leases.last_end

    @property
    def ends(self) -> int:
        """How many leases have ended."""
        return self._leases.ends

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing more is to be written before the next lease."""
        return self._step_at is None

    @property
    def driven_by(self) -> str:
        """Whose the robot is, in words, so that it can do nothing else; empty where it is nobody's, and stands."""
        if (lease := self._leases.held) is not None:
            return f"it is driven by hand, by {lease.holder}"
        return "it is being stopped, since it was driven by hand" if self._step_at is not None else ""

    def acquire(self, holder: str, session: str, now: float, *, take_over: bool = False, busy: str = "") -> Granted:
        """Give the robot to somebody.

        Args:
            holder: the name that others see.
            session: what the lease ends with.
            now: the time.
            take_over: whether the lease of another one ends for it.
            busy: why the robot cannot be driven now, e.g. since it executes a skill; empty where it can.

        Raises:
            LeaseRefused: another one drives it, it is busy, or a name is empty or too long.
            StorageUnavailable: as `next_number`.
        """
        self.expire(now)
        for name, text in (("Holder", holder), ("Session", session)):
            if not 0 < len(text) <= MOST_NAME_CHARACTERS:
                said = f"{name} has {len(text)} characters; 1 to {MOST_NAME_CHARACTERS} are legal"
                raise LeaseRefused(StatusCode.BAD_INVALID_ARGUMENT, said)
            if not text.isprintable():
                said = f"{name} has characters that cannot be shown"
                raise LeaseRefused(StatusCode.BAD_INVALID_ARGUMENT, said)
        if busy:
            raise LeaseRefused(StatusCode.BAD_INVALID_STATE, f"{self.model.robot} cannot be driven: {busy}")
        was_held = self._leases.held is not None
        lease, taken_from = self._leases.grant(holder, session, now, take_over=take_over)
        if was_held:
            self._stop()
        self._watch = Watch(lease.number, len(self.model.axes), self._echoes)
        if self._step_at is None:
            self._step_at, self._is_beginning = now, True
        self._publish_at = now  # others see it at once
        return Granted(lease.number, self._echoes.count(now), taken_from, self.model)

    def renew(self, number: int, now: float) -> None:
        """The holder of a lease is there; LeaseRefused where it is not held."""
        self.expire(now)
        self._leases.check(number)
        self._leases.prolong(now)

    def release(self, number: int, why: str, now: float) -> None:
        """End a lease. One that is over is left alone."""
        self.expire(now)
        if (lease := self._leases.held) is not None and lease.number == number:
            self._end(harmless(why)[:MOST_NAME_CHARACTERS] or "released", now)

    def end(self, why: str, now: float) -> None:
        """End the lease that is held: the robot cannot be driven any more."""
        self.expire(now)
        self._end(why, now)

    def take(self, setpoint: Setpoint, now: float) -> Drop | None:
        """Take a setpoint, or say why it was dropped."""
        self.expire(now)
        drop = Drop.LEASE if self._watch is None else self._watch.take(setpoint, now)
        if drop is None:
            self._leases.prolong(now)
        else:
            self.drops[drop] += 1
            if drop is Drop.SETPOINT:
                self._end("a setpoint with a value that is no number, or with another number of axes", now)
        return drop

    def expire(self, now: float) -> None:
        """End what time has ended."""
        if self._step_at is not None and now > self._step_at + self.model.robot_timeout_s:
            self._end("the bridge stood still, and the robot has stopped by itself", now)
            self._ramp.rest()
            self._step_at = now
        if self._watch is not None and self._watch.is_over(now):
            self._end(f"no setpoint was fresh for {self.model.deadman_s * 1000:.0f} ms", now)
        elif self._leases.is_silent(now):
            self._end("nothing was heard of it", now)

    def step(self, now: float) -> tuple[float, ...] | None:
        """What to write to the robot now; None where nothing is due. Call it at `next_step`."""
        self.expire(now)
        step_at = self._step_at
        if step_at is None or now < step_at:
            return None
        while now >= step_at:
            step_at += self.model.period_s
            must_write = self._is_stopping or self._is_beginning or self._watch is None
            if not self._go(now):
                self._step_at = None
                return self._ramp.values
            if must_write and not self._is_stopping:  # each of these zeros is written, however late
                step_at = max(step_at, now + self.model.period_s)
        self._step_at = step_at
        return self._ramp.values

    def publish(self, now: float) -> Status | None:
        """The status to publish now; None where nothing is due. Call it at `next_publish`."""
        self.expire(now)
        if self._publish_at is None or now < self._publish_at:
            return None
        self._echoes.count(now)
        is_changing = self._leases.held is not None or self._is_stopping
        self._publish_at = now + COUNTER_PERIOD_S if is_changing else None
        return self.status()

    def status(self) -> Status:
        """What there is to say, with the last counter."""
        lease = self._leases.held
        return Status(
            self._echoes.counter,
            self.state,
            0 if lease is None else lease.number,
            "" if lease is None else lease.holder,
            0 if self._watch is None else self._watch.number,
            self._leases.last_end,
            self._ramp.values,
            tuple([self.drops[Drop(cause)] for cause in SETPOINT_DROPS]),
        )

    @property
    def next_step(self) -> float | None:
        """When `step` is due; None while nothing is written."""
        return self._step_at

    @property
    def next_publish(self) -> float | None:
        """When `publish` is due; None while nothing changes."""
        return self._publish_at

    def _go(self, now: float) -> bool:
        """One period; whether another one follows."""
        watch = self._watch
        if self._is_stopping:
            self._ramp.brake()
            if self._ramp.is_at_rest:
                self._is_stopping, self._zeros, self._publish_at = False, ZEROS_AT_END, now
        elif self._is_beginning:
            self._is_beginning = False
        elif watch is not None:
            self._ramp.follow(watch.values)
        else:
            self._zeros -= 1
            return self._zeros > 0
        return True

    def _end(self, why: str, now: float) -> None:
        if self._leases.held is None:
            return
        self._leases.end(why)
        self._watch = None
        self._publish_at = now
        self._stop()

    def _stop(self) -> None:
        self._is_stopping, self._is_beginning = True, False
