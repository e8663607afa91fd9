"""Who has to stop is told until it is heard, and nobody else is."""

from __future__ import annotations

from typing import Any, cast

import pytest
from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.modes import RuntimeState
from ua_bridges.ur.owed_stops import OwedStops
from ua_bridges.ur.state import State
from ua_bridges.ur.task import RobotTask

from ua_fleet.errors import SkillRejected, SkillTimeout

ONE = b"1" * 16
SILENT = SkillTimeout("stop: the controller does not answer")


class Controller:
    """Task and link in one: it stops by its program, where that is heard."""

    is_silent = True
    can_halt = True

    def __init__(self) -> None:
        self.tries = 0

    def check_can_halt(self) -> None:
        if not self.can_halt:
            raise SkillRejected("it cannot be taken back")

    def halt(self, _link: object, _state: object) -> None:
        self.check_can_halt()
        self.stop_program()

    def stop_program(self) -> None:
        self.tries += 1
        if self.is_silent:
            raise SILENT


class Bench:
    def __init__(self) -> None:
        self.controller, self.owed, self.now = Controller(), OwedStops("192.0.2.1"), 100.0
        self.link, self.task = cast("CommandLink", self.controller), cast("RobotTask", self.controller)

    def halt(self, state: State | None) -> None:
        self.owed.halt(ONE, self.task, self.link, state, self.now)

    def give_up(self) -> bool:
        return self.owed.give_up(ONE, self.task, self.link, shown(RuntimeState.PLAYING), self.now)

    def goes_on(self, seconds: float, runtime: RuntimeState = RuntimeState.PLAYING, *, runs: bool = True) -> int:
        """How often it is told meanwhile."""
        before = self.controller.tries
        for _ in range(round(seconds / 0.02)):
            self.now += 0.02
            self.owed.settle([ONE] if runs else [], self.link, shown(runtime), self.now)
        return self.controller.tries - before


def shown(runtime: RuntimeState) -> State:
    values: dict[str, Any] = {"runtime_state": int(runtime)}
    return State(1.0, 1, 1.0, values)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_halt_is_told_each_second_until_it_is_heard(bench: Bench) -> None:
    bench.halt(shown(RuntimeState.PLAYING))
    assert bench.controller.tries == 1
    assert bench.goes_on(0.9) == 0
    assert bench.goes_on(3) == 3
    bench.controller.is_silent = False
    assert bench.goes_on(5) == 1


def test_a_halt_without_a_state_is_told_with_the_first(bench: Bench) -> None:
    bench.controller.is_silent = False
    bench.halt(None)
    assert bench.controller.tries == 0
    assert bench.goes_on(5) == 1


def test_an_execution_that_has_ended_is_halted_no_more(bench: Bench) -> None:
    bench.halt(shown(RuntimeState.PLAYING))
    assert bench.goes_on(5, runs=False) == 0


def test_what_was_given_up_is_told_until_nothing_runs(bench: Bench) -> None:
    """It may be another one's program that runs after that."""
    assert not bench.give_up()
    assert bench.goes_on(2.9, runs=False) == 2
    assert bench.owed.keeps_from_beginning()
    assert bench.goes_on(0.02, RuntimeState.STOPPED, runs=False) == 0
    assert not bench.owed.keeps_from_beginning()
    assert bench.goes_on(5, runs=False) == 0


def test_what_was_given_up_and_cannot_be_halted_is_not(bench: Bench) -> None:
    bench.controller.can_halt = False
    assert not bench.give_up()
    assert bench.goes_on(5) == bench.controller.tries == 0


def test_what_was_halted_and_given_up_is_told_once_a_second(bench: Bench) -> None:
    bench.halt(shown(RuntimeState.PLAYING))
    assert not bench.give_up()
    assert bench.controller.tries == 1
    assert bench.goes_on(3.1, runs=False) == 3


def test_who_asks_for_a_halt_again_and_again_has_it_told_once_a_second(bench: Bench) -> None:
    told = 0
    for _ in range(40):
        bench.halt(shown(RuntimeState.PLAYING))
        told += bench.goes_on(0.1)
    assert bench.controller.tries == told + 1 == 4
    bench.controller.is_silent = False
    assert bench.goes_on(1.1) == 1


def test_what_a_safety_stop_has_ended_is_stopped_at_once_or_where_it_is_paused(bench: Bench) -> None:
    bench.owed.has_failed(bench.link, bench.now)
    assert bench.controller.tries == 1
    assert bench.goes_on(3.1, RuntimeState.PAUSED) == 3
    bench.controller.is_silent = False
    bench.owed.has_failed(bench.link, bench.now)
    assert bench.goes_on(5, RuntimeState.PAUSED) == 0


def test_a_program_of_driving_by_hand_is_stopped_where_it_is_paused(bench: Bench) -> None:
    """The state may show a moment later that it is."""
    bench.owed.may_be_paused(bench.now)
    assert bench.goes_on(0.5) == 0
    assert bench.goes_on(3.1, RuntimeState.PAUSED) == 4
    bench.controller.is_silent = False
    assert bench.goes_on(5, RuntimeState.PAUSED) == 1


@pytest.mark.parametrize("runtime", [RuntimeState.PLAYING, RuntimeState.STOPPED])
def test_a_program_that_is_paused_later_is_nobody_s_but_who_paused_it(bench: Bench, runtime: RuntimeState) -> None:
    bench.owed.may_be_paused(bench.now)
    assert bench.goes_on(1.1, runtime) == 0
    assert bench.goes_on(5, RuntimeState.PAUSED) == 0
