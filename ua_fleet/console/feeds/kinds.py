"""What a feed is."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from ua_fleet.client import FleetClient
from ua_fleet.console.board import Board

__all__ = ["FeedKind", "FeedParameters", "NoParameters", "OfAnyRobot"]


class FeedParameters(BaseModel):
    """What a page says of the feed that it wants; an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class OfAnyRobot(FeedParameters):
    """All robots, or one of them."""

    robot: str = Field(default="", max_length=200)


class NoParameters(FeedParameters):
    """Nothing more is to be said."""


@dataclass(frozen=True, slots=True)
class FeedKind:
    """A kind of feed.

    `run` fills a board, says `board.ready()` when it is whole, and keeps it true until it is cancelled or the
    connection is lost; then it is run anew on the healed link.
    """

    name: str
    parameters: type[FeedParameters]
    run: Callable[[FleetClient, Any, Board], Awaitable[None]]
