"""What the server knows of a run that bridges carry; see `operation.runs.carried`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from ua_fleet.carrying.held import LOST
from ua_fleet.operation.runs.adopting import Adopting
from ua_fleet.operation.runs.carried_begun import Beginning
from ua_fleet.operation.runs.followed_facts import FollowedFacts
from ua_fleet.orchestrator import BridgeTold
from ua_fleet.pubsub.run_data import RUN_DATA_COUNT, RUN_DATA_RANKING
from ua_fleet.scenario.facts import Fact

__all__ = ["AskedBridge", "BridgeNames", "CarriedPhase", "FollowedRun"]


class BridgeNames(dict[int, str]):
    """The bridges of fleet.yaml by their spaces; one that a run knows and the file does not is named by its space."""

    def __missing__(self, space: int) -> str:
        """What to call it."""
        return f"space {space}"


class CarriedPhase(Enum):
    """What bridges are asked for now."""

    OFFERING = "offering"
    BEGINNING = "beginning"
    ASKING = "asking"
    FOLLOWING = "following"
    ADOPTING = "adopting"
    CLOSING = "closing"


@dataclass(slots=True)
class AskedBridge:
    """What one bridge is asked for a run."""

    is_done: bool = False
    """Whether it has what it is told in this phase."""
    is_asked: bool = False
    told_meanwhile: bool = False
    """Whether its DataSet of runs has told of news since it was asked."""
    next_at: float = 0.0
    problem: str = "it has not answered yet"
    answered_at: float = 0.0
    """When it has answered last, by the monotonic clock; at first, when the run was known here."""
    is_away: bool = False
    """Whether nothing has come of the last question."""
    has_refused: bool = False
    """Whether it has refused to be told that another one is off: it may know that the run is over."""
    last: int = 0
    """The number of the bridge up to which its facts were fetched."""
    told: int = 0
    """How many facts its DataSet told of when all were fetched that it had."""
    is_caught_up: bool = False
    """Whether all was fetched once that it had: what the others say may be put in order with it."""
    has_pause: bool = True
    """Whether it knows whether the run is paused."""
    is_heard: bool = False
    """Whether its DataSet of runs is heard: then it tells when it has more."""
    has_token: bool = False
    """Whether it has one of the run, as its DataSet of runs or its answer has said last."""
    ranking: Sequence[Any] = ()
    """The last ranking of which its DataSet of runs has told."""
    beginning: Beginning = Beginning.UNSAID
    """What it has said of the beginning of the run, where it was asked for that."""
    is_complete: bool = False
    """Whether it knows that the run is over or does not know the run any more, does nothing, and has no more facts."""

    @property
    def may_take(self) -> bool:
        """Whether it has still to be told in this phase, and has not just refused that."""
        return not self.is_done and not self.has_refused

    def has_news(self, values: Sequence[Any]) -> bool:
        """Whether its DataSet of runs tells of what is to be fetched. A ranking is no fact, and is told again."""
        ranking = values[RUN_DATA_RANKING]
        is_ranked = any(ranking) and ranking != self.ranking
        self.ranking = ranking if is_ranked else self.ranking
        return is_ranked or values[RUN_DATA_COUNT] > self.told or bool(values[-1] and not self.is_complete)


@dataclass(slots=True)
class FollowedRun:
    """A run and its bridges, by their spaces."""

    run_id: str
    robots: frozenset[str]
    phase: CarriedPhase
    bridges: dict[int, AskedBridge]
    until: float = 0.0
    """End of this phase by the monotonic clock, where it has one."""
    parts: Mapping[int, bytes] = field(default_factory=dict[int, bytes])
    token: bytes = b""
    first: int = 0
    """The space that gets the token; 0: not known, after a restart."""
    first_said: str = ""
    """What became of the token there, where it was not acknowledged."""
    adopting: Adopting | None = None
    """A bridge is off, and another one goes on for it."""
    is_paused: bool = False
    paused_by: str = ""
    """The person who has said last whether it is."""
    closed: tuple[float, str, str] | None = None
    """When, how and why the run has ended, as a bridge says or the server has decided."""
    fetched: list[Fact] = field(default_factory=list[Fact])
    """Facts that are not in the journal yet: they are put in order with those of bridges that were not asked yet."""
    decided: list[Any] = field(default_factory=list[Any])
    """What bridges have told of their decisions, which is shown after their facts."""
    fetched_at: float = 0.0
    """When the first of them came, by the monotonic clock."""
    late: dict[int, AskedBridge] = field(default_factory=dict[int, AskedBridge])
    """Bridges that are off, without which the run ends: they are told when they answer."""
    known: FollowedFacts = field(default_factory=FollowedFacts)
    """Facts that are in the journal already, or are about to be."""
    shown: str = ""
    bridges_shown: Mapping[int, BridgeTold] = field(default_factory=dict[int, BridgeTold])

    @property
    def needs_nobody(self) -> bool:
        """Whether it ends without a bridge that is off: another one has said how it has ended, or it is being ended."""
        is_over = self.phase is CarriedPhase.FOLLOWING and self.closed is not None and self.closed[1] != LOST
        return is_over or self.phase is CarriedPhase.CLOSING
