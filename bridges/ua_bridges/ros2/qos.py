"""Which quality of service the bridge offers and asks for: pure decisions, in one place.

What the bridge OFFERS (its publishers):

    topic                       reliability   durability        depth   matches subscribers that ask for
    mirrored ua_<other>_*       RELIABLE      TRANSIENT_LOCAL   1       anything
    a sink in fleet.yaml        `qos`, else RELIABLE, VOLATILE, `depth`  as configured

A mirrored topic is always transient local, since the bridge cannot know how the robots of its space will subscribe:
a subscriber that asks for TRANSIENT_LOCAL gets the current value even if the source is not latched, a default one
(VOLATILE) gets only what comes after it. The depth is 1, since a late joiner must get the current value and not a
history of old ones.

What the bridge ASKS FOR (its subscriptions) follows the publishers that are there, because a subscription that asks for
more than a publisher offers gets nothing from it:

    publishers offer                       the bridge asks for
    all RELIABLE                           RELIABLE, else BEST_EFFORT
    all TRANSIENT_LOCAL                    TRANSIENT_LOCAL, else VOLATILE

`qos` in fleet.yaml overrules that for each key that it names. A subscription is made again when a publisher comes that
offers less than it asks for, when history can be had that it did not ask for, or when none of the publishers that it
was made for is left.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Final, NamedTuple

from ua_bridges.ros.topic_mapping import QosConfig

__all__ = ["EVENTS", "MIRROR", "QUEUE_DEPTH", "Offer", "Qos", "choose", "is_outdated", "sink_qos"]

QUEUE_DEPTH: Final = 1000
"""Messages that a subscription holds until the bridge takes them: half a second at 2,000 a second."""


class Qos(NamedTuple):
    """Quality of service, without ROS."""

    reliable: bool
    transient_local: bool
    depth: int


class Offer(NamedTuple):
    """One publisher in the graph: its endpoint's GID and what it offers."""

    gid: bytes
    reliable: bool
    transient_local: bool


MIRROR: Final = Qos(reliable=True, transient_local=True, depth=1)
"""What the bridge's own publishers of mirrored topics offer."""
EVENTS: Final = Qos(reliable=True, transient_local=False, depth=QUEUE_DEPTH)
"""What they offer for events: none is kept for who comes later, and all of a burst until they are acknowledged."""

_FOLLOW: Final = QosConfig(depth=QUEUE_DEPTH)


def choose(offers: Collection[Offer], configured: QosConfig = _FOLLOW) -> Qos:
    """What a subscription asks for, given the publishers that are there."""
    reliable = all(offer.reliable for offer in offers)
    transient_local = bool(offers) and all(offer.transient_local for offer in offers)
    if configured.reliability is not None:
        reliable = configured.reliability == "reliable"
    if configured.durability is not None:
        transient_local = configured.durability == "transient_local"
    return Qos(reliable, transient_local, configured.depth)


def is_outdated(current: Qos, wanted: Qos, made_for: Iterable[bytes], present: Collection[bytes]) -> bool:
    """Whether a subscription has to be made again.

    Args:
        current: what it asks for.
        wanted: what `choose` says now.
        made_for: the publishers that were there when it was made.
        present: the publishers that are there now, at least one.
    """
    if current == wanted:
        return False
    asks_too_much = (current.reliable and not wanted.reliable) or (
        current.transient_local and not wanted.transient_local
    )
    misses_history = wanted.transient_local and not current.transient_local
    return asks_too_much or misses_history or not set(made_for) & set(present)


def sink_qos(configured: QosConfig) -> Qos:
    """What the publisher of a mapped topic offers: what rclpy's default profile does, unless it is configured."""
    return Qos(configured.reliability != "best_effort", configured.durability == "transient_local", configured.depth)
