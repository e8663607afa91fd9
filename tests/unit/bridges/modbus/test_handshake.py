"""What a device's words say of an execution."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_bridges.modbus.handshake import Phase, StatusWords, next_number, phase_of
from ua_demo.simulators.modbus import HandshakeLayout, HandshakeProgram, Memory, Work
from ua_demo.simulators.modbus.program import Task

from ua_fleet.registers import Register, RegisterType, Table

NUMBERS = st.integers(0, 0xFFFF)


@pytest.mark.parametrize(
    ("words", "phase"),
    [
        (StatusWords(6, 6), Phase.NEVER_WRITTEN),
        (StatusWords(6, 6, done=True), Phase.NEVER_WRITTEN),
        (StatusWords(7, 6), Phase.WAITING),
        (StatusWords(7, 6, done=True), Phase.WAITING),
        (StatusWords(7, 6, error=True), Phase.WAITING),
        (StatusWords(7, 7, busy=True), Phase.RUNNING),
        (StatusWords(7, 7), Phase.RUNNING),
        (StatusWords(7, 7, busy=True, done=True), Phase.RUNNING),
        (StatusWords(7, 7, done=True), Phase.DONE),
        (StatusWords(7, 7, error=True), Phase.FAILED),
        (StatusWords(7, 7, done=True, error=True), Phase.FAILED),
        (StatusWords(6, 7, busy=True), Phase.RUNNING),
        (StatusWords(0, 0), Phase.LOST),
        (StatusWords(0, 0, done=True), Phase.LOST),
        (StatusWords(8, 8, done=True), Phase.LOST),
    ],
)
def test_phase_of_execution_7_after_6(words: StatusWords, phase: Phase) -> None:
    assert phase_of(words, 7, 6) is phase


@given(NUMBERS, NUMBERS)
def test_a_new_number_is_none_that_the_device_shows(request: int, accepted: int) -> None:
    number = next_number(StatusWords(request, accepted))
    assert 1 <= number <= 0xFFFF
    assert number not in (request, accepted)


@given(NUMBERS, NUMBERS, NUMBERS, st.sets(NUMBERS, max_size=20))
def test_a_new_number_is_none_that_was_taken_back(request: int, accepted: int, last: int, withdrawn: set[int]) -> None:
    number = next_number(StatusWords(request, accepted), last, withdrawn)
    assert 1 <= number <= 0xFFFF
    assert number not in (request, accepted, last, *withdrawn)


@given(NUMBERS, NUMBERS, st.booleans(), st.booleans(), st.booleans())
def test_nothing_that_the_device_shows_before_is_taken_for_the_new_execution(
    request: int, accepted: int, busy: bool, done: bool, error: bool
) -> None:
    words = StatusWords(request, accepted, busy, done, error)
    # 0 is what a device shows whose memory was cleared: from that nothing follows.
    assert phase_of(words, next_number(words), request) is (Phase.NEVER_WRITTEN if request else Phase.LOST)


class Plc:
    """A PLC with the program of the tests."""

    def __init__(self) -> None:
        self.memory, self.layout, self.told = Memory(1000), HandshakeLayout(100), list[str]()
        tasks: dict[int, Task] = {0: Work(100, self.told.append)}
        self.program = HandshakeProgram(self.memory, self.layout, tasks)

    def ask(self, number: int, work: str, seconds: float) -> None:
        self.memory.put(Register(Table.HOLDING, 130, RegisterType.STRING, length=20), work)
        self.memory.put(Register(Table.HOLDING, 150, RegisterType.FLOAT64), seconds)
        self.memory.put(self.layout.request, number)

    def words(self) -> StatusWords:
        flags = [bool(self.memory.get(self.layout.flag(bit))) for bit in range(3)]
        return StatusWords(
            int(self.memory.get(self.layout.request)), int(self.memory.get(self.layout.accepted)), *flags
        )


def test_program_does_each_number_once() -> None:
    plc = Plc()
    for number in (1, 2):
        plc.ask(number, f"work {number}", 1.0)
        phases: list[Phase] = []
        for cycle in range(20):
            plc.program.cycle(number * 10 + cycle * 0.1)
            phases.append(phase_of(plc.words(), number, number - 1))
        assert phases[0] is Phase.RUNNING
        assert phases[-1] is Phase.DONE
    assert plc.told == ["work 1", "work 2"]


def test_program_stops_what_it_is_told_to_and_nothing_else() -> None:
    plc = Plc()
    plc.ask(5, "never ends", 0.0)
    plc.program.cycle(0.0)
    plc.memory.put(plc.layout.halt, 4)
    plc.program.cycle(0.1)
    assert phase_of(plc.words(), 5, 4) is Phase.RUNNING
    plc.memory.put(plc.layout.halt, 5)
    plc.program.cycle(0.2)
    assert phase_of(plc.words(), 5, 4) is Phase.FAILED
    assert plc.memory.get(plc.layout.error_text) == "stopped"


def test_program_refuses_with_its_reason() -> None:
    plc = Plc()
    plc.ask(1, "refuse", 0.0)
    plc.program.cycle(0.0)
    assert phase_of(plc.words(), 1, 0) is Phase.FAILED
    assert plc.memory.get(plc.layout.error_text) == "the machine does not do that"
    assert plc.told == []
