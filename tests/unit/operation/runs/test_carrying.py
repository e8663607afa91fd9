"""A storm of faults: how often it is written, and for how long others wait in the event loop."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

import pytest
import structlog

from tests.unit.operation.runs.world import FailingJournal
from ua_fleet.errors import StorageUnavailable
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.operation.runs.carrying import TURN_S, OutputCarrier, TaskOutput
from ua_fleet.operation.runs.task_calls import Recorded
from ua_fleet.orchestrator import Fault, FaultChange, FaultChanged, Output, TaskCancelled, TaskStarted

ROBOTS = 200


class NothingPrepared:
    """Requests that are recorded when they are made."""

    @property
    def left(self) -> tuple[bytes, ...]:
        return ()

    def prepare(self, tasks: Iterable[TaskStarted]) -> list[Recorded]:
        del tasks
        return []

    def recorded(self, records: Iterable[Recorded], left_out: Iterable[bytes]) -> None: ...


class Carrying:
    """A carrier whose outputs take `output_s` each, and `ask_s` to ask a robot, and what it has done."""

    def __init__(self, folder: Path, output_s: float = 0.0, ask_s: float | None = None) -> None:
        self.journal = FailingJournal(folder / "runs.db")
        self.now, self._output_s = 100.0, output_s
        self._ask_s = output_s if ask_s is None else ask_s
        self.done: list[Output] = []
        self.asked: list[TaskOutput] = []
        self.shown_before: list[int] = []
        """How many outputs were carried out when robots were asked for each."""
        self.taken_back: list[bool] = []
        self.written_before: list[int] = []
        """How many faults were in the journal when each output was carried out."""
        self.follows: dict[int, list[Output]] = {}
        """What follows from carrying out one that so many were carried out before."""
        self.refused = 0
        """So many of the next tasks are refused at once, each of which has the engine begin another one."""
        self.carrier = OutputCarrier(
            self.journal,
            NothingPrepared(),
            self._ask,
            self._carry_out,
            lambda execution_id, error: None,
            mistakes=Mistakes(),
            log=structlog.get_logger(),
            clock=lambda: self.now,
            sooner=lambda: None,
        )

    def _ask(self, output: TaskOutput, taken_back: Collection[str]) -> None:
        self.now += self._ask_s
        self.asked.append(output)
        self.shown_before.append(len(self.done))
        if isinstance(output, TaskStarted):
            self.taken_back.append(output.execution_id in taken_back)
        if self.refused:
            self.refused -= 1
            self.carrier.do([begun(f"again {self.refused}")])

    def _carry_out(self, output: Output) -> None:
        self.now += self._output_s
        self.written_before.append(len(self.journal.faults()))
        number = len(self.done)
        self.done.append(output)
        self.carrier.do(self.follows.get(number, []))

    def turns(self) -> list[float]:
        """Go on to the end; how long each turn took."""
        took: list[float] = []
        while (due := self.carrier.next_deadline()) is not None:
            began = self.now = max(self.now, due)
            self.carrier.poll(began)
            took.append(self.now - began)
        return took


def faults(count: int = ROBOTS, first: int = 0) -> list[Output]:
    names = [f"robot{number}" for number in range(first, first + count)]
    return [
        FaultChanged(Fault(f"{name}.silent", name, "silent", "it is silent", True, False, 1.0), FaultChange.RAISED)
        for name in names
    ]


def begun(execution_id: str) -> TaskStarted:
    return TaskStarted("run", "0", "a", execution_id, "left", "grab", {}, 30.0)


def test_what_one_input_brings_is_one_transaction(tmp_path: Path) -> None:
    world = Carrying(tmp_path)
    world.carrier.do(faults())
    assert (world.journal.writes, len(world.done)) == (1, ROBOTS)
    assert set(world.written_before) == {ROBOTS}, "all of it was written before the first was carried out"


def test_what_follows_from_carrying_it_out_is_one_more(tmp_path: Path) -> None:
    world = Carrying(tmp_path)
    world.follows = {number: faults(1, ROBOTS + number) for number in range(ROBOTS)}
    world.carrier.do(faults())
    assert (world.journal.writes, len(world.done)) == (2, 2 * ROBOTS)
    assert world.written_before == [ROBOTS] * ROBOTS + [2 * ROBOTS] * ROBOTS
    assert world.done == faults(2 * ROBOTS)


def test_others_get_their_turn_while_much_is_carried_out(tmp_path: Path) -> None:
    world = Carrying(tmp_path, output_s=0.004)
    world.carrier.do(faults())
    assert world.carrier.is_behind
    assert 0 < len(world.done) < 10
    world.carrier.do(faults(1, ROBOTS))  # comes in between
    assert len(world.done) < 10
    took = world.turns()
    assert max(took) <= TURN_S + 0.004
    assert world.done == faults(ROBOTS + 1)
    assert world.journal.writes == 2
    assert not world.carrier.is_behind


def test_who_must_know_that_it_is_written_does_not_wait_for_what_is_carried_out(tmp_path: Path) -> None:
    world = Carrying(tmp_path, output_s=0.004)
    world.carrier.do(faults())
    behind = len(world.done)
    world.carrier.do(faults(1, ROBOTS), must_be_written=True)
    assert (world.journal.writes, len(world.done)) == (2, behind)
    assert len(world.journal.faults()) == ROBOTS + 1
    world.journal.fails = True
    with pytest.raises(StorageUnavailable):
        world.carrier.do(faults(1, ROBOTS + 1), must_be_written=True)
    world.journal.fails = False
    world.turns()
    assert world.done == faults(ROBOTS + 2)


def test_a_task_that_is_taken_back_in_a_later_turn_is_known_as_such(tmp_path: Path) -> None:
    world = Carrying(tmp_path, output_s=1.0)
    cancelled = TaskCancelled("b", "left", "grab")
    world.carrier.do([*faults(1), begun("a"), begun("b"), cancelled])
    assert (world.asked, world.done) == ([begun("a")], [])
    world.turns()
    assert world.taken_back == [False, True]
    world.carrier.do([begun("b")])
    world.turns()
    assert world.taken_back == [False, True, False], "that was another time"


def test_robots_are_asked_before_anything_is_shown_and_all_is_shown_in_its_order(tmp_path: Path) -> None:
    world = Carrying(tmp_path)
    outputs = [*faults(2), begun("a"), *faults(1, 2), TaskCancelled("b", "left", "grab"), begun("c")]
    world.carrier.do(outputs)
    assert world.asked == [begun("a"), TaskCancelled("b", "left", "grab"), begun("c")]
    assert world.shown_before == [0, 0, 0]
    assert world.done == outputs
    assert world.journal.writes == 1


def test_robots_are_asked_before_what_a_turn_has_left_to_show(tmp_path: Path) -> None:
    world = Carrying(tmp_path, output_s=0.004)
    world.carrier.do(faults())
    left = len(world.done)
    world.carrier.do([begun("a")])
    assert world.asked == []
    world.turns()
    assert (world.asked, world.shown_before) == ([begun("a")], [left])
    assert world.done == [*faults(), begun("a")]


def test_what_a_command_brings_is_shown_before_robots_are_asked(tmp_path: Path) -> None:
    world = Carrying(tmp_path)
    outputs = [*faults(2), begun("a"), *faults(1, 2), begun("b"), begun("c")]
    world.carrier.do(outputs, must_be_written=True)
    assert world.asked == [begun("a"), begun("b"), begun("c")]
    assert world.shown_before == [2, 4, 5]
    assert world.done == outputs


def test_robots_that_refuse_one_after_the_other_do_not_hold_up_the_loop(tmp_path: Path) -> None:
    world = Carrying(tmp_path, output_s=0.003, ask_s=0.002)
    world.refused = 500
    began = world.now
    world.carrier.do([begun("a")])
    assert world.now - began < 2 * TURN_S + 0.01
    assert max(world.turns()) < 2 * TURN_S + 0.01
    assert len(world.asked) == len(world.done) == 501


def test_a_slow_disk_keeps_nothing_back_that_is_shown(tmp_path: Path) -> None:
    world = Carrying(tmp_path, output_s=0.001, ask_s=10 * TURN_S)
    outputs = [*faults(3), begun("a")]
    world.carrier.do(outputs)
    assert (world.asked, world.done) == ([begun("a")], outputs)
    assert not world.carrier.is_behind
