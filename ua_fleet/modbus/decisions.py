"""Faults and the ranking of who takes over, as words; and the PLC's choice. Pure but for its memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ua_fleet.client import DecisionInfo, FaultInfo
from ua_fleet.config.modbus_schema import ModbusServerConfig
from ua_fleet.modbus.image import Image
from ua_fleet.modbus.memory import CommandMemory
from ua_fleet.modbus.words import MOST_CANDIDATES, DecisionOutcome, control, status
from ua_fleet.registers import AddressSpan, Register

__all__ = ["DecisionDesk", "PlcAnswer"]

_OPEN = "open"


class PlcAnswer(NamedTuple):
    """A PLC's answer to a decision."""

    number: int
    decision_id: str
    robot: str


class DecisionDesk:
    """The decision words."""

    def __init__(self, image: Image, memory: CommandMemory, config: ModbusServerConfig) -> None:
        """Make one that shows nothing."""
        self._image, self._memory, self._config = image, memory, config
        self._numbers = {robot: number for number, robot in enumerate(config.robots, start=1)}
        self._open: dict[int, DecisionInfo] = {}
        self._choice: PlcAnswer | None = None
        self._decided = 0
        self._telling = 0
        """Number of the choice that the server is being told: a PLC may write it in each of its cycles meanwhile."""
        self._outcome = DecisionOutcome.NONE
        self._is_over = False
        """Whether what was decided last is open no more: when it is again, another choice is wanted."""

    def written(self, span: AddressSpan) -> None:
        """A PLC has written; perhaps a choice.

        Each number is answered once, unless the answer was refused, or is unknown and the decision is still open.
        """
        word = self._control("decision")
        if not span.overlaps(word.span):
            return
        number, robot_number = int(self._image.get(word)), int(self._image.get(self._control("chosen")))
        decision = self._open.get(number)
        robot = next((robot for robot, its in self._numbers.items() if its == robot_number), None)
        if number in (0, self._telling) or (number == self._decided and not (decision and self._is_unknown(number))):
            return
        if decision is None or robot is None:
            self._say(number, DecisionOutcome.REFUSED)
        else:
            self._choice = PlcAnswer(number, decision.decision_id, robot)

    def take(self) -> PlcAnswer | None:
        """The choice that is to be told; once. `answered` follows in any case."""
        choice, self._choice = self._choice, None
        self._telling = 0 if choice is None else choice.number
        return choice

    def refuse(self) -> None:
        """Nobody can be told."""
        if (choice := self.take()) is not None:
            is_unknown = self._is_unknown(choice.number)
            self.answered(choice, DecisionOutcome.UNKNOWN if is_unknown else DecisionOutcome.REFUSED)

    def answered(self, choice: PlcAnswer, outcome: DecisionOutcome) -> None:
        """What became of a choice."""
        self._telling = 0
        self._say(choice.number, outcome)

    def show(self, decisions: Sequence[DecisionInfo], faults: Sequence[FaultInfo]) -> None:
        """Show the oldest decision that is open, and whose faults are active."""
        put = self._image.put
        waiting = [decision for decision in decisions if decision.state == _OPEN]
        self._open = {self._memory.decision_number(decision.decision_id): decision for decision in waiting}
        if self._decided not in self._open:
            self._is_over = True
            if self._choice is not None and self._is_unknown(self._choice.number):
                self._choice = None  # made again, for what is decided meanwhile
        elif self._is_over:
            self._say(0, DecisionOutcome.NONE)
        number = min(self._open, default=0)
        decision = self._open.get(number)
        ranked = [] if decision is None else list(zip(decision.robots, decision.scores, strict=False))
        for place in range(MOST_CANDIDATES):
            robot, score = ranked[place] if place < len(ranked) else ("", 0.0)
            put(self._status(f"candidate_{place + 1}"), self._numbers.get(robot, 0))
            put(self._status(f"score_{place + 1}"), score)
        put(self._status("candidates"), min(len(ranked), MOST_CANDIDATES))
        put(self._status("failed"), 0 if decision is None else self._numbers.get(decision.failed, 0))
        put(self._status("decision"), number)
        bits = 0
        for fault in faults:
            if fault.active and fault.robot in self._numbers:
                bits |= 1 << (self._numbers[fault.robot] - 1)
        put(self._status("faults_1"), bits & 0xFFFF)
        put(self._status("faults_17"), bits >> 16)

    def _is_unknown(self, number: int) -> bool:
        """Whether nobody knows what became of the last choice, and it was for this decision."""
        return number == self._decided and self._outcome is DecisionOutcome.UNKNOWN

    def _say(self, number: int, outcome: DecisionOutcome) -> None:
        is_answered = outcome in (DecisionOutcome.TAKEN, DecisionOutcome.UNKNOWN)
        self._decided, self._outcome, self._is_over = (number if is_answered else 0), outcome, False
        self._image.put(self._status("outcome"), outcome)
        self._image.put(self._status("decided"), number)

    def _status(self, name: str) -> Register:
        return status(name, self._config.status)

    def _control(self, name: str) -> Register:
        return control(name, self._config.control)
