"""Facts of a carried run, as one bridge has them. They are journaled; the state of `Holder` is made of them alone."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from ua_fleet.scenario.expression import Value

__all__ = [
    "BridgeReturned",
    "CarryFact",
    "EndTold",
    "HandedOver",
    "PartAdopted",
    "PartTaken",
    "PauseTold",
    "RunClosed",
    "RunDoubted",
    "SegmentBegun",
    "SegmentOver",
    "TokenTaken",
    "decode_carry_fact",
    "encode_carry_fact",
]


@dataclass(frozen=True, slots=True)
class PartTaken:
    """The server has given this bridge its part of a plan."""

    at: float
    """Seconds since 1970, as in all facts."""
    run_id: str
    content: str
    """The part as it came, in hexadecimal digits; so are tokens."""


@dataclass(frozen=True, slots=True)
class TokenTaken:
    """A token has come. It is acknowledged after this was written."""

    at: float
    run_id: str
    content: str
    sender: int
    """The space that it came from; 0: the server, which has begun the run."""


@dataclass(frozen=True, slots=True)
class SegmentBegun:
    """All slots of a segment are filled: the engine has it from now on."""

    at: float
    run_id: str
    segment: int
    rounds: tuple[int, ...] = ()
    """The numbers of the repetitions around it."""


@dataclass(frozen=True, slots=True)
class SegmentOver:
    """A segment has ended. Tokens of it are sent after this was written."""

    at: float
    run_id: str
    segment: int
    failed: str = ""
    """Why it has failed; empty: it is done."""
    results: Mapping[str, Value] = field(default_factory=dict[str, Value])
    """All that is known here of results, by `task.result`."""
    ends: str = ""
    """How all of the run ends with it, where one of its steps says so."""
    rounds: tuple[int, ...] = ()
    way: bool = True
    """What it has decided, where it ends with a decision."""
    reason: str = ""
    """Why all of the run ends, where a step says so."""


@dataclass(frozen=True, slots=True)
class HandedOver:
    """The target of a token has it."""

    at: float
    run_id: str
    segment: int
    target: int
    slot: int
    rounds: tuple[int, ...] = ()
    """Of the segment that is over."""


@dataclass(frozen=True, slots=True)
class RunClosed:
    """The run is over: its last segment is, an `end` was reached, somebody has aborted it, or its lease is over."""

    at: float
    run_id: str
    outcome: str
    """done, failed, aborted or lost."""
    reason: str
    by: int
    """The space of the bridge that has ended it, and tells the others; 0: the server."""


@dataclass(frozen=True, slots=True)
class EndTold:
    """Another bridge knows that the run is over; or the server does, and has fetched all of it from here."""

    at: float
    run_id: str
    space: int
    """Of the bridge; 0: the server."""


@dataclass(frozen=True, slots=True)
class PauseTold:
    """The server has told this bridge to begin no further task of a run, or to go on."""

    at: float
    run_id: str
    is_paused: bool
    by: str
    """The person who wants it."""


@dataclass(frozen=True, slots=True)
class PartAdopted:
    """A bridge of the run is off: this one has its part anew, with the next epoch. See `adoption`."""

    at: float
    run_id: str
    content: str


@dataclass(frozen=True, slots=True)
class RunDoubted:
    """This bridge was away for long, so that another one may have its segments; or it has heard that none has."""

    at: float
    run_id: str
    is_doubted: bool


@dataclass(frozen=True, slots=True)
class BridgeReturned:
    """A bridge that was left out of a run is heard again: it is off no more."""

    at: float
    run_id: str
    space: int


CarryFact = (
    PartTaken
    | TokenTaken
    | SegmentBegun
    | SegmentOver
    | HandedOver
    | RunClosed
    | EndTold
    | PauseTold
    | PartAdopted
    | RunDoubted
    | BridgeReturned
)

_KINDS: Final[dict[str, type[Any]]] = {kind.__name__: kind for kind in CarryFact.__args__}


def encode_carry_fact(fact: CarryFact) -> str:
    """A fact as one line of JSON."""
    return json.dumps({"fact": type(fact).__name__, **dataclasses.asdict(fact)}, ensure_ascii=False)


def decode_carry_fact(line: str) -> CarryFact:
    """The fact in a line.

    Raises:
        ValueError: the line holds none that this program knows.
    """
    try:
        data: dict[str, Any] = json.loads(line)
        if "rounds" in data:
            data["rounds"] = tuple(data["rounds"])
        fact: CarryFact = _KINDS[data.pop("fact")](**data)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"no fact of a carried run: {error}") from error
    return fact
