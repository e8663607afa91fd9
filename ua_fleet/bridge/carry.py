"""What a bridge gives to who carries runs in it: see `ua_fleet.carrier`.

The engine of scenarios is no part of the kit: the program that starts a bridge brings it, so that what a driver sees
does not grow with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from ua_fleet.bridge.actions import Actions
from ua_fleet.bridge.core import BridgeCore, CarrySide
from ua_fleet.counters import Counters
from ua_fleet.monitoring import Mistakes
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.skill.responder import ResponderLimits
from ua_fleet.transport.party import Answers

__all__ = ["CarryFactory", "CarryGround", "TurnLoop"]


class TurnLoop(Protocol):
    """What is needed of an event loop."""

    def time(self) -> float:
        """Monotonic seconds."""
        ...

    def call_soon(self, callback: Callable[..., object], *args: Any) -> object:
        """Call it in the next turn."""
        ...

    def call_later(self, delay: float, callback: Callable[..., object], *args: Any) -> object:
        """Call it in a turn so many seconds later."""
        ...


@dataclass(frozen=True, slots=True)
class CarryGround:
    """What a bridge gives to who carries runs in it."""

    publisher: Publisher
    subscriber: Subscriber
    core: BridgeCore
    actions: Actions
    counters: Counters
    mistakes: Mistakes
    loop: TurnLoop
    send: Callable[[bytes], None]
    """Sends a plain message to all."""
    send_to: Callable[[bytes, tuple[str, int]], None]
    """Sends a plain message to one address."""
    wall_ticks: Callable[[], int]
    sooner: Callable[[], None]
    """Called when the next deadline may have come nearer."""
    must_be_verified: bool
    answers: Answers
    limits: ResponderLimits


CarryFactory = Callable[[CarryGround], CarrySide]
