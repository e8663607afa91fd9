"""The Action by which the server and bridges tell each other of carried runs: parts, tokens, ends, and questions.

Each bridge that carries has it, at the DataSetWriterId below the one of `SwitchPubSub`. It is answered at once, after
what it says was journaled: so the same words said again change nothing.
"""

from __future__ import annotations

import json
from enum import IntEnum
from typing import Any, Final

from ua_fleet.errors import ScenarioError
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode

__all__ = [
    "CARRY",
    "CARRY_ID",
    "CARRY_REQUEST",
    "CARRY_RESPONSE",
    "Word",
    "carry_topic",
    "decode_words",
    "encode_words",
]

CARRY: Final = "CarryRun"
CARRY_ID: Final = 0xFFFE
"""Its DataSetWriterId, which no DataSet should have."""
CARRY_REQUEST: Final = (
    make_field("Word", BuiltinType.BYTE),
    make_field("Content", BuiltinType.BYTE_STRING),
)
CARRY_RESPONSE: Final = (make_field("Content", BuiltinType.BYTE_STRING),)
_MOST_JSON_BYTES: Final = 4000


class Word(IntEnum):
    """What is said."""

    PART = 1
    """The server gives a bridge its part of a plan; `encode_part`."""
    TOKEN = 2
    """`encode_token`."""
    END = 3
    """A run is over: `run`, `outcome` and `reason`."""
    FETCH = 4
    """The server asks what has become of a run: `run`, and the number of facts that it has (`after`)."""
    ANSWER = 5
    """A person says through the server what became of a task: `run`, `step`, `answer` and `by`."""


def carry_topic(space: int, ns: int) -> Topic:
    """The Action of a bridge; `ns` is the fleet's namespace."""
    return Topic(space, ns, CARRY_ID)


def encode_words(**words: Any) -> bytes:
    """What stands beside a word that is no part and no token."""
    return json.dumps(words, ensure_ascii=False, separators=(",", ":")).encode()


def decode_words(content: bytes, *, most: int = _MOST_JSON_BYTES) -> dict[str, Any]:
    """The same as somebody has sent it, of at most so many bytes; raises ScenarioError."""
    try:
        words: Any = json.loads(content[:most])
        return {str(name): words[name] for name in words} if isinstance(words, dict) else {}
    except (ValueError, RecursionError) as error:
        refused = ScenarioError("the content of this word cannot be read")
        refused.ua_status = StatusCode.BAD_INVALID_ARGUMENT
        raise refused from error
