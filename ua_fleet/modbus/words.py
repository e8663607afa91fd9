"""The words by which a PLC commands the fleet and is answered: their places and meanings. Pure.

Holding registers from `control`, which the PLC writes; input registers from `status`, which it reads.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

from ua_fleet.registers import Register, RegisterType, Table

__all__ = ["CONTROL", "STATUS", "CommandState", "DecisionOutcome", "Word", "control", "status"]

MOST_CANDIDATES: Final = 8
TEXT_WORDS: Final = 20
SCORE_SCALE: Final = 0.0001


class CommandState(IntEnum):
    """How far the last command is."""

    NONE = 0
    """There was none."""
    ASKING = 1
    """Taken; the fleet is being asked."""
    RUNNING = 2
    DONE = 3
    FAILED = 4
    REFUSED = 5
    """It was not begun, and never will be."""
    UNKNOWN = 6
    """It may have been begun, and nobody can tell."""

    @property
    def is_over(self) -> bool:
        """Whether nothing follows."""
        return self >= CommandState.DONE


class DecisionOutcome(IntEnum):
    """What became of a choice."""

    NONE = 0
    TAKEN = 1
    REFUSED = 2
    UNKNOWN = 3
    """The connection was lost before the server's answer: it may have taken it."""


class Word(NamedTuple):
    """One value of a block."""

    name: str
    offset: int
    type: RegisterType
    text: str
    length: int = 0
    scale: float = 1.0

    def at(self, table: Table, base: int) -> Register:
        """The register, in a block that begins at `base`."""
        return Register(table, base + self.offset, self.type, length=self.length, scale=self.scale)


_U16, _U32 = RegisterType.UINT16, RegisterType.UINT32
CONTROL: Final = (
    Word("command", 0, _U16, "Number of the command, 1 to 65535, another one each time; write it last"),
    Word("code", 1, _U16, "Which command"),
    Word("decision", 2, _U16, "Number of the decision that is answered; write it last"),
    Word("chosen", 3, _U16, "Number of the robot that takes over"),
)
_STATES: Final = ", ".join(f"{state.value} {state.name.lower()}" for state in CommandState)
_OUTCOMES: Final = ", ".join(f"{outcome.value} {outcome.name.lower()}" for outcome in DecisionOutcome)
STATUS: Final = (
    Word("heartbeat", 0, _U16, "Counts up each half second while this device works"),
    Word("connected", 1, _U16, "1 while the OPC UA server answers; otherwise nothing here is of now"),
    Word("answer", 2, _U16, "Number of the command that the next words are about"),
    Word("state", 3, _U16, _STATES),
    Word("status", 4, _U32, "OPC UA StatusCode of its end"),
    Word("progress", 6, _U16, "How far it is, in percent"),
    Word("decision", 7, _U16, "Number of the decision that waits for an answer; 0: none"),
    Word("failed", 8, _U16, "Number of the robot that failed; 0: it has none"),
    Word("candidates", 9, _U16, "How many robots could take over"),
    *(
        Word(f"candidate_{place + 1}", 10 + place, _U16, f"Number of the robot that ranks {place + 1}.")
        for place in range(MOST_CANDIDATES)
    ),
    *(
        Word(f"score_{place + 1}", 18 + place, _U16, "Its score, 0 to 1", scale=SCORE_SCALE)
        for place in range(MOST_CANDIDATES)
    ),
    Word("decided", 26, _U16, "Number of the decision that was answered last"),
    Word("outcome", 27, _U16, f"What became of that answer: {_OUTCOMES}"),
    Word("faults_1", 28, _U16, "Robots 1 to 16 that have a fault: bit 0 is robot 1"),
    Word("faults_17", 29, _U16, "Robots 17 to 32 that have a fault"),
    Word("message", 30, RegisterType.STRING, "Text for people about the end of the command", TEXT_WORDS),
)
_CONTROL: Final = {word.name: word for word in CONTROL}
_STATUS: Final = {word.name: word for word in STATUS}


def control(name: str, base: int) -> Register:
    """A word that the PLC writes."""
    return _CONTROL[name].at(Table.HOLDING, base)


def status(name: str, base: int) -> Register:
    """A word that the PLC reads."""
    return _STATUS[name].at(Table.INPUT, base)
