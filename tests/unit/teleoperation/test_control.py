"""One robot that is driven by hand: who may, for how long, and what is written to it, over arbitrary interleavings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.teleoperation.rigs import ANGULAR, LINEAR, control, model
from ua_fleet.counters import Drop
from ua_fleet.errors import LeaseRefused
from ua_fleet.teleoperation import Control, Setpoint, State
from ua_fleet.teleoperation.control import ZEROS_AT_END
from ua_fleet.teleoperation.model import COUNTER_PERIOD_S, LEASE_S
from ua_fleet.values import StatusCode

DEADMAN_S, PERIOD_S, TIMEOUT_S = 0.3, 0.02, 0.5


class Drive:
    """An operator beside the bridge: steps and publishes in time, and drives with the newest counter."""

    def __init__(self, robot: Control | None = None) -> None:
        self.robot = robot or control()
        self.now, self.number, self.counter, self.lease = 100.0, 0, 0, 0
        self.written: list[tuple[float, tuple[float, ...]]] = []

    def acquire(self, holder: str = "anna", session: str = "s1", *, take_over: bool = False) -> int:
        granted = self.robot.acquire(holder, session, self.now, take_over=take_over)
        self.lease, self.counter, self.number = granted.lease, granted.counter, 0
        return granted.lease

    def send(self, *values: float, lease: int | None = None, number: int = 0, echo: int | None = None) -> Drop | None:
        self.number += 1
        return self.robot.take(
            Setpoint(
                self.lease if lease is None else lease,
                number or self.number,
                self.counter if echo is None else echo,
                values,
            ),
            self.now,
        )

    def wait(self, seconds: float) -> None:
        """Let time go on in periods, without the operator."""
        until = self.now + seconds
        while self.now < until - 1e-9:
            self.now += PERIOD_S
            if (status := self.robot.publish(self.now)) is not None:
                self.counter = status.counter
            if (values := self.robot.step(self.now)) is not None:
                self.written.append((self.now, values))

    def drive(self, seconds: float, *values: float) -> None:
        """Drive with a setpoint each period."""
        until = self.now + seconds
        while self.now < until - 1e-9:
            assert self.send(*values) is None
            self.wait(PERIOD_S)

    @property
    def last(self) -> tuple[float, ...]:
        return self.written[-1][1]


def test_a_robot_follows_its_holder_and_stops_when_it_is_released() -> None:
    one = Drive()
    assert (one.robot.state, one.robot.step(one.now), one.robot.next_step) == (State.IDLE, None, None)
    assert one.acquire() == 1
    one.wait(0.2)
    assert {values for _, values in one.written} == {(0.0, 0.0)}
    one.drive(3.0, 0.4, -2.0)
    assert one.last == (0.4, -ANGULAR.speed)
    assert one.robot.status().number == one.number
    one.robot.release(1, "released", one.now)
    assert (one.robot.state, one.robot.last_end) == (State.STOPPING, "anna: released")
    one.wait(LINEAR.stop_s)
    assert one.last == (0.0, 0.0)
    assert one.robot.state is State.IDLE
    one.wait(1.0)
    assert one.robot.step(one.now) is None
    assert [values for _, values in one.written[-ZEROS_AT_END:]] == [(0.0, 0.0)] * ZEROS_AT_END


def test_a_setpoint_counts_until_its_counter_is_too_old_whenever_it_came() -> None:
    one = Drive()
    one.acquire()
    before = one.counter
    while one.counter == before:
        one.wait(PERIOD_S)
    echo, published = one.counter, one.now
    one.wait(0.22)
    assert one.send(0.4, 0.0, echo=echo) is None
    while one.robot.lease is not None:
        one.wait(PERIOD_S)
    assert published + DEADMAN_S <= one.now <= published + DEADMAN_S + PERIOD_S + 1e-9
    assert "no setpoint was fresh for 300 ms" in one.robot.last_end
    assert one.send(0.4, 0.0) is Drop.LEASE
    one.wait(LINEAR.stop_s)
    assert one.last == (0.0, 0.0)


def test_what_is_dropped_and_by_which_cause() -> None:
    one = Drive()
    assert one.send(0.1, 0.1, lease=1) is Drop.LEASE
    one.acquire()
    old = one.counter
    one.drive(DEADMAN_S + 0.02, 0.1, 0.0)
    assert one.send(0.1, 0.0, lease=2) is Drop.LEASE
    assert one.send(0.1, 0.0, number=one.number - 1) is Drop.NUMBER
    assert one.send(0.1, 0.0, echo=old) is Drop.ECHO
    assert one.send(0.1, 0.0, echo=one.counter + 1) is Drop.ECHO
    assert one.robot.state is State.HELD
    assert one.send(math.nan, 0.0, echo=old) is Drop.ECHO
    assert one.robot.state is State.HELD
    assert one.send(math.nan, 0.0) is Drop.SETPOINT
    assert (one.robot.state, one.robot.lease) == (State.STOPPING, None)
    assert one.robot.status().drops == (2, 1, 3, 1)


@pytest.mark.parametrize("values", [(0.1,), (0.1, 0.1, 0.1), (), (0.1, math.inf), (-math.inf, 0.0)])
def test_a_setpoint_that_is_none_stops_the_robot(values: tuple[float, ...]) -> None:
    one = Drive()
    one.acquire()
    one.drive(0.2, 0.4, 0.0)
    assert one.send(*values) is Drop.SETPOINT
    assert one.robot.state is State.STOPPING


def test_one_holder_at_a_time_and_an_engineer_takes_over() -> None:
    one = Drive()
    first = one.acquire()
    with pytest.raises(LeaseRefused, match="carrier is driven by anna; wait") as refused:
        one.robot.acquire("ben", "s2", one.now)
    assert refused.value.ua_status == StatusCode.BAD_RESOURCE_UNAVAILABLE
    one.drive(1.0, 0.4, 0.0)
    granted = one.robot.acquire("eve", "s3", one.now, take_over=True)
    assert (granted.lease, granted.taken_from) == (first + 1, "anna")
    assert one.robot.last_end == "anna: taken over by eve"
    assert one.send(0.4, 0.0) is Drop.LEASE
    with pytest.raises(LeaseRefused, match=r"lease 1 of carrier is over \(anna: taken over by eve\)"):
        one.robot.renew(first, one.now)
    status = one.robot.status()
    assert (status.state, status.lease, status.holder) == (State.STOPPING, granted.lease, "eve")


def test_a_stop_goes_to_its_end_before_the_next_one_drives() -> None:
    one = Drive()
    one.acquire()
    one.drive(2.0, 0.4, 0.0)
    one.acquire("eve", "s3", take_over=True)
    before = len(one.written)
    one.drive(LINEAR.stop_s + 1.0, 0.4, 0.0)
    linear = [values[0] for _, values in one.written[before:]]
    stands = linear.index(0.0)
    assert linear[:stands] == sorted(linear[:stands], reverse=True)
    assert stands * PERIOD_S < LINEAR.stop_s + 2 * PERIOD_S
    assert linear[-1] > 0.1


@pytest.mark.parametrize("late_s", [period * PERIOD_S for period in range(1, 13)])
def test_the_zero_between_two_who_drive_is_written_when_the_bridge_was_late(late_s: float) -> None:
    one = Drive()
    one.acquire()
    one.drive(2.0, 0.4, 0.0)
    one.acquire("eve", "s3", take_over=True)
    before = len(one.written)
    assert one.send(-0.4, 0.0) is None
    while one.last[0] >= 0.0:
        one.now += late_s - PERIOD_S
        one.wait(PERIOD_S)
        assert one.send(-0.4, 0.0) is None
    linear = [(at, values[0]) for at, values in one.written[before:]]
    stood = next(at for at, speed in linear if speed == 0.0)
    went = next(at for at, speed in linear if speed < 0.0)
    assert went >= stood + PERIOD_S - 1e-9


@pytest.mark.parametrize("late_s", [0.0, PERIOD_S / 2, 3 * PERIOD_S])
def test_a_lease_begins_with_a_zero_however_soon_a_setpoint_comes(late_s: float) -> None:
    """A robot whose own watch has stopped it follows nothing before that."""
    one = Drive()
    one.acquire()
    assert one.send(0.4, 0.0) is None
    one.now += late_s
    assert one.robot.step(one.now) == (0.0, 0.0)
    one.wait(PERIOD_S)
    assert one.last[0] > 0.0


def test_the_same_session_acquires_again_without_taking_over() -> None:
    one = Drive()
    assert (one.acquire(), one.acquire()) == (1, 2)
    assert one.robot.last_end == "anna: acquired again by the same session"


def test_a_lease_ends_by_silence_and_lasts_by_renew() -> None:
    one = Drive()
    lease = one.acquire()
    for _ in range(3):
        one.wait(LEASE_S - 0.5)
        one.robot.renew(lease, one.now)
    one.wait(LEASE_S - 0.1)
    assert one.robot.state is State.HELD
    one.wait(0.2)
    assert one.robot.status().lease == 0
    assert one.robot.last_end == "anna: nothing was heard of it"
    with pytest.raises(LeaseRefused, match="is over"):
        one.robot.renew(lease, one.now)
    one.robot.release(lease, "", one.now)


def test_a_busy_robot_and_names_that_are_none_are_refused() -> None:
    robot = control()
    with pytest.raises(LeaseRefused, match="carrier cannot be driven: it does `drive`"):
        robot.acquire("anna", "s1", 0.0, busy="it does `drive`")
    for holder, session in (("", "s"), ("a", ""), ("a" * 257, "s")):
        with pytest.raises(LeaseRefused, match="1 to 256 are legal"):
            robot.acquire(holder, session, 0.0)
    with pytest.raises(LeaseRefused, match="Holder has characters that cannot be shown"):
        robot.acquire("anna\x1b[2J", "s1", 0.0)
    assert robot.driven_by == ""


def test_why_a_lease_was_released_is_one_line() -> None:
    robot = control()
    lease = robot.acquire("anna", "s1", 0.0).lease
    robot.release(lease, "bye\nben: forged", 0.0)
    assert robot.last_end == "anna: bye\\nben: forged"


def test_a_robot_that_is_driven_does_nothing_else_until_it_stands() -> None:
    one = Drive()
    one.acquire()
    assert one.robot.driven_by == "it is driven by hand, by anna"
    one.drive(1.0, 0.4, 0.0)
    one.robot.end("the robot is away", one.now)
    assert one.robot.driven_by == "it is being stopped, since it was driven by hand"
    one.wait(LINEAR.stop_s + (ZEROS_AT_END + 2) * PERIOD_S)
    assert one.robot.driven_by == ""


def test_a_bridge_that_stood_still_does_not_move_a_robot_that_has_stopped_by_itself() -> None:
    one = Drive()
    one.acquire()
    one.drive(2.0, 0.4, 0.0)
    assert one.last[0] == 0.4
    one.now += TIMEOUT_S + 0.1
    assert one.send(0.4, 0.0) is Drop.LEASE
    assert one.robot.step(one.now) == (0.0, 0.0)
    assert "the bridge stood still" in one.robot.last_end
    one.wait(1.0)
    assert {values for at, values in one.written if at > one.now - 1.0} <= {(0.0, 0.0)}


def test_a_bridge_that_stood_for_less_is_where_its_profile_is_by_then() -> None:
    late, timely = Drive(), Drive()
    for one in (late, timely):
        one.acquire()
        one.drive(2.0, 0.4, 0.0)
        one.robot.release(one.lease, "", one.now)
    timely.wait(0.2)
    late.now += 0.2
    assert late.robot.step(late.now) == pytest.approx(timely.last)


def test_a_robot_at_rest_is_told_zero_as_often_when_the_bridge_was_late() -> None:
    one = Drive()
    one.acquire()
    one.drive(1.0, 0.4, 0.0)
    one.robot.release(one.lease, "", one.now)
    while one.robot.state is State.STOPPING:
        one.wait(PERIOD_S)
    before = len(one.written)
    one.now += 0.3
    one.wait(0.3)
    assert [values for _, values in one.written[before:]] == [(0.0, 0.0)] * ZEROS_AT_END


def test_status_is_published_each_50_ms_while_held_and_at_once_when_something_changes() -> None:
    robot, now = control(), 10.0
    assert robot.next_publish is None
    granted = robot.acquire("anna", "s1", now)
    first = robot.publish(now)
    assert first is not None
    assert (first.counter, first.holder, first.state) == (granted.counter + 1, "anna", State.HELD)
    assert robot.publish(now + COUNTER_PERIOD_S / 2) is None
    second = robot.publish(now + COUNTER_PERIOD_S)
    assert second is not None
    assert second.counter == first.counter + 1
    robot.release(granted.lease, "", now + 0.06)
    third = robot.publish(now + 0.06)
    assert third is not None
    assert (third.state, third.lease, third.last_end) == (State.STOPPING, 0, "anna: released")
    assert robot.step(now + 0.07) is not None
    last = robot.publish(now + 0.07)
    assert last is not None
    assert last.state is State.IDLE
    assert robot.next_publish is None


# Arbitrary interleavings. Each event is one of an operator or of the world; between two of them time goes by.


class Event(NamedTuple):
    what: str
    who: int
    number: float
    """A speed, an age in counters, a time: as the event has it."""


OPERATORS = st.integers(0, 2)
DELAYS = st.sampled_from([0.0, 0.001, 0.02, 0.02, 0.05, 0.1, 0.31, 0.6, 1.3, 5.1])
EVENTS = st.one_of(
    st.builds(
        Event, st.sampled_from(["acquire", "take over", "release", "renew", "repeat", "away"]), OPERATORS, st.just(0.0)
    ),
    st.builds(Event, st.just("drive"), OPERATORS, st.floats(-2, 2)),
    st.builds(Event, st.just("drive"), OPERATORS, st.sampled_from([math.nan, math.inf])),
    st.builds(Event, st.just("late"), OPERATORS, st.integers(1, 40)),
    st.builds(Event, st.just("steal"), OPERATORS, OPERATORS),
    st.builds(Event, st.just("stall"), OPERATORS, st.sampled_from([0.1, 0.4, 0.6])),
)


@dataclass
class Operator:
    name: str
    lease: int = 0
    number: int = 0
    last: Setpoint | None = None


@dataclass
class World:
    """Bridge and operators, with what a robot sees of them."""

    robot: Control = field(default_factory=lambda: control(model((LINEAR,))))
    now: float = 50.0
    operators: list[Operator] = field(default_factory=lambda: [Operator(name) for name in ("anna", "ben", "eve")])
    counters: dict[int, float] = field(default_factory=dict[int, float])
    """When each was published."""
    taken: Setpoint | None = None
    """The last setpoint that was taken under the lease that is held."""
    stopping_since: float | None = None
    leases: list[int] = field(default_factory=list[int])
    value: float = 0.0
    has_stalled: bool = False

    def look(self) -> None:
        """What holds after everything."""
        lease = self.robot.lease
        if lease is None or (self.taken is not None and self.taken.lease != lease.number):
            self.taken = None
        if self.taken is not None:
            assert self.now < self.counters[self.taken.echo] + DEADMAN_S + PERIOD_S
        if self.robot.state is not State.STOPPING:
            self.stopping_since = None
        elif self.stopping_since is None:
            self.stopping_since = self.now
        else:
            assert self.now - self.stopping_since <= LINEAR.stop_s + 3 * PERIOD_S + TIMEOUT_S * self.has_stalled

    def send(self, setpoint: Setpoint) -> None:
        held, before = self.robot.lease, self.taken
        drop = self.robot.take(setpoint, self.now)
        if drop is None:
            assert held is not None
            assert setpoint.lease == held.number == max(self.leases)
            assert before is None or setpoint.number > before.number
            assert self.now < self.counters[setpoint.echo] + DEADMAN_S
            self.taken = setpoint

    def wait(self, seconds: float, *, stall: bool = False) -> None:
        until = self.now + seconds
        self.has_stalled |= stall
        while self.now < until - 1e-9:
            self.now = until if stall else min(self.now + PERIOD_S, until)
            if (status := self.robot.publish(self.now)) is not None:
                self.counters[status.counter] = self.now
            if (values := self.robot.step(self.now)) is not None:
                self.wrote(values[0], stalled_s=seconds if stall else 0.0)
            self.look()

    def wrote(self, value: float, stalled_s: float) -> None:
        """What the robot gets: no other sign than its commander wishes, and nothing but the ramp after a lease."""
        if self.robot.lease is None or self.robot.state is State.STOPPING or self.taken is None:
            assert abs(value) <= abs(self.value) + LINEAR.acceleration**2 / 2 / LINEAR.jerk + 1e-9
        periods = max(1, math.ceil(stalled_s / PERIOD_S) + 1)
        most = max(LINEAR.acceleration, LINEAR.deceleration) * PERIOD_S * periods
        is_at_rest_by_itself = value == 0.0 and stalled_s > TIMEOUT_S
        assert abs(value - self.value) <= most * 1.0001 or is_at_rest_by_itself
        self.value = value

    def do(self, event: Event) -> None:
        """Let one event happen."""
        operator, robot, now = self.operators[event.who], self.robot, self.now
        newest = max(self.counters, default=0)
        if event.what in ("acquire", "take over"):
            self.acquire(operator, take_over=event.what == "take over")
        elif event.what == "release":
            robot.release(operator.lease, "released", now)
        elif event.what == "renew":
            held = robot.lease
            if held is not None and held.number == operator.lease:
                robot.renew(operator.lease, now)
            else:
                with pytest.raises(LeaseRefused):
                    robot.renew(operator.lease, now)
        elif event.what == "repeat":
            if operator.last is not None:
                self.send(operator.last)
        elif event.what == "away":
            robot.end("the robot is away", now)
        elif event.what == "stall":
            self.wait(event.number, stall=True)
        else:
            operator.number += 1
            lease, echo, value = operator.lease, newest, event.number
            if event.what == "late":
                echo, value = max(0, newest - int(event.number)), 0.4
            elif event.what == "steal":
                lease, value = self.operators[int(event.number)].lease, -0.4
            operator.last = Setpoint(lease, operator.number, echo, (value,))
            self.send(operator.last)
        self.look()

    def acquire(self, operator: Operator, *, take_over: bool) -> None:
        held = self.robot.lease
        try:
            granted = self.robot.acquire(operator.name, operator.name, self.now, take_over=take_over)
        except LeaseRefused:
            assert held is not None
            assert held.session != operator.name
            assert not take_over
            return
        assert granted.lease > max(self.leases, default=0)
        self.leases.append(granted.lease)
        self.counters[granted.counter] = self.now
        operator.lease, operator.number, self.taken = granted.lease, 0, None


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(EVENTS, DELAYS), max_size=40))
def test_whatever_comes_there_is_one_commander_and_the_stop_keeps_its_time(events: list[tuple[Event, float]]) -> None:
    world = World()
    for event, delay_s in events:
        world.do(event)
        world.wait(delay_s)
    if (lease := world.robot.lease) is not None:
        world.robot.release(lease.number, "", world.now)
    began = world.now
    while world.robot.state is State.STOPPING:
        world.wait(PERIOD_S)
    assert world.now - began <= LINEAR.stop_s + 3 * PERIOD_S
    world.wait((ZEROS_AT_END + 2) * PERIOD_S)
    assert (world.value, world.robot.next_step) == (0.0, None)
