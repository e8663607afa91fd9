"""An operator and a bridge with a network between them that delays, repeats, reorders and is cut, in simulated time."""

from __future__ import annotations

import heapq
from itertools import count
from random import Random
from typing import NamedTuple

import pytest

from tests.unit.teleoperation.rigs import LINEAR, control, model
from ua_fleet.teleoperation import Setpoint, State

DEADMAN_S, PERIOD_S, SEND_S = 0.3, 0.02, 0.05
TICK_S = 0.005


class Wish(NamedTuple):
    """A setpoint with the time at which its operator had it, which the bridge does not know."""

    wished_at: float
    setpoint: Setpoint


class Network:
    """Messages under way in both directions."""

    def __init__(self, random: Random, delay_s: float, *, repeats: float = 0.0) -> None:
        self._random, self._delay_s, self._repeats = random, delay_s, repeats
        self._order = count()
        self._under_way: list[tuple[float, int, Wish | int]] = []
        self.cut_at = float("inf")
        """From then on what is sent gets lost, and what is under way too."""
        self.held_until = 0.0
        """Until then everything waits in a queue, and then comes at once."""

    def send(self, message: Wish | int, now: float) -> None:
        for _ in range(1 + (self._random.random() < self._repeats)):
            at = max(now + self._random.uniform(0, self._delay_s), self.held_until)
            heapq.heappush(self._under_way, (at, next(self._order), message))

    def take(self, now: float) -> list[Wish | int]:
        taken: list[Wish | int] = []
        while self._under_way and self._under_way[0][0] <= now:
            message = heapq.heappop(self._under_way)[2]
            if now < self.cut_at:
                taken.append(message)
        return taken


class World:
    """One robot, one operator who keeps a stick where it is, and what the robot does."""

    def __init__(self, seed: int, delay_s: float, *, repeats: float = 0.0) -> None:
        random = Random(seed)
        self.there, self.back = Network(random, delay_s, repeats=repeats), Network(random, delay_s, repeats=repeats)
        self.robot = control(model((LINEAR,), deadman_s=DEADMAN_S, period_s=PERIOD_S))
        self.now, self._send_at, self._number = 10.0, 0.0, 0
        granted = self.robot.acquire("anna", "s1", self.now)
        self._lease, self._counter = granted.lease, granted.counter
        self.outputs: list[tuple[float, float]] = []
        self._followed: Wish | None = None

    def run(self, seconds: float) -> None:
        until = self.now + seconds
        while self.now < until:
            self.now += TICK_S
            for message in self.back.take(self.now):
                assert isinstance(message, int)
                self._counter = max(self._counter, message)
            if self.now >= self._send_at:
                self._send_at, self._number = self.now + SEND_S, self._number + 1
                setpoint = Setpoint(self._lease, self._number, self._counter, (LINEAR.speed,))
                self.there.send(Wish(self.now, setpoint), self.now)
            for message in self.there.take(self.now):
                assert isinstance(message, Wish)
                if self.robot.take(message.setpoint, self.now) is None:
                    self._followed = message
            if (status := self.robot.publish(self.now)) is not None:
                self.back.send(status.counter, self.now)
            if (values := self.robot.step(self.now)) is not None:
                self.outputs.append((self.now, values[0]))
            if self.robot.state is State.HELD and self._followed is not None:
                assert self.now - self._followed.wished_at <= DEADMAN_S + PERIOD_S, "it follows an old wish"

    def stopped(self, after: float) -> tuple[float, float]:
        """When the output began to fall after a time, and when it was zero."""
        values = [(at, value) for at, value in self.outputs if at >= after]
        highest = max(value for _, value in values)
        began = max(at for at, value in values if value == highest)
        return began, next(at for at, value in values if at > began and value == 0.0)


@pytest.mark.parametrize("seed", range(20))
def test_a_network_that_is_quick_enough_never_stops_the_robot(seed: int) -> None:
    world = World(seed, 0.08, repeats=0.3)
    world.run(5.0)
    assert world.robot.state is State.HELD
    assert world.outputs[-1][1] == LINEAR.speed


@pytest.mark.parametrize("seed", range(60))
def test_wherever_it_is_cut_the_stop_begins_in_time_and_is_over_in_time(seed: int) -> None:
    world, random = World(seed, 0.06, repeats=0.2), Random(seed)
    world.run(2.0 + random.random())
    cut = world.now
    ways = [world.there, world.back] if seed % 3 == 2 else [(world.there, world.back)[seed % 3]]
    for way in ways:
        way.cut_at = cut
    world.run(DEADMAN_S + LINEAR.stop_s + 1.0)
    began, ended = world.stopped(cut - PERIOD_S)
    late = 0.0 if seed % 3 != 1 else 0.06  # counters that were heard before the cut may still be echoed
    assert began - cut <= DEADMAN_S + PERIOD_S + TICK_S + late
    assert ended - began <= LINEAR.stop_s + 3 * PERIOD_S
    assert world.robot.lease is None


@pytest.mark.parametrize("seed", range(60))
def test_what_waited_in_a_queue_moves_nothing_when_it_comes(seed: int) -> None:
    world, random = World(seed, 0.04), Random(seed)
    world.run(2.0)
    (world.there, world.back)[seed % 2].held_until = held = world.now + random.uniform(0.5, 3.0)
    world.run(DEADMAN_S + PERIOD_S)
    assert world.robot.lease is None
    since = len(world.outputs)
    world.run(held - world.now + LINEAR.stop_s + 1.0)
    values = [value for _, value in world.outputs[since:]]
    assert values == sorted(values, reverse=True), "it went on when the queue came"
    assert values[-1] == 0.0
    assert world.robot.lease is None


@pytest.mark.parametrize("seed", range(20))
def test_a_network_that_is_too_slow_never_lets_the_robot_run_on(seed: int) -> None:
    world = World(seed, 0.6, repeats=0.3)
    world.run(5.0)
    assert world.robot.lease is None
    assert world.outputs[-1][1] == 0.0
