"""The Action by which the server and bridges tell each other of carried runs: parts, tokens, ends, and questions.

Each bridge that carries has it, at the DataSetWriterId below the one of `SwitchPubSub`. It is answered at once, after
what it says was journaled: so the same words said again change nothing.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

__all__ = ["CARRY", "CARRY_ID", "CARRY_REQUEST", "CARRY_RESPONSE", "Word", "carry_topic"]

CARRY: Final = "CarryRun"
CARRY_ID: Final = 0xFFFE
"""Its DataSetWriterId, which no DataSet should have."""
CARRY_REQUEST: Final = (
    make_field("Word", BuiltinType.BYTE),
    make_field("Content", BuiltinType.BYTE_STRING),
)
CARRY_RESPONSE: Final = (make_field("Content", BuiltinType.BYTE_STRING),)


class Word(IntEnum):
    """What is said. What the content is, `ua_fleet.carrying` says."""

    PART = 1
    """The server gives a bridge its part of a plan."""
    TOKEN = 2
    END = 3
    """A run is over: `run`, `outcome` and `reason`."""
    FETCH = 4
    """The server asks what has become of a run: `run`, and the number of facts that it has (`after`)."""
    ANSWER = 5
    """A person says through the server what became of a task: `run`, `step`, `answer` and `by`."""
    PAUSE = 6
    """The server has a run paused, or go on: `run`, `paused` and `by`."""
    ADOPT = 8
    """The server says that a bridge is off, and gives this one its part anew. The answer has the tokens here."""
    EPOCH = 9
    """A bridge that was away asks another one for the epoch of a run: `run`. The answer has `epoch`; and
    `outcome` and `reason`, where the run is over there."""
    CONFIRM = 7
    """A person chooses through the server who takes a task over: `run`, `decision`, `robot` and `by`."""


def carry_topic(space: int, ns: int) -> Topic:
    """The Action of a bridge; `ns` is the fleet's namespace."""
    return Topic(space, ns, CARRY_ID)
