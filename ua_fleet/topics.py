"""UA topics, and the loop rule.

A UA topic `ua_<space>_<ns>_<id>` names one data source: the space where its data ORIGINATES, and the namespace
index and numeric identifier of its OPC UA node. Without a broker the same three numbers travel as the UADP triple
PublisherId, WriterGroupId, DataSetWriterId. Nothing else in the project takes such a name apart or puts it together.
"""

from __future__ import annotations

import re
from enum import Enum
from typing import Final, NamedTuple

from ua_fleet.errors import TopicInvalid

__all__ = [
    "FIRST_VENDOR_SPACE",
    "LAST_ROS2_SPACE",
    "ROS1_SPACE",
    "SERVER_SPACE",
    "TYPES_URI",
    "LoopVerdict",
    "Side",
    "Topic",
    "check_ros2_space",
    "check_space",
    "loop_verdict",
]

SERVER_SPACE: Final = 0
"""The space of data that the OPC UA server originates."""
ROS1_SPACE: Final = 1
LAST_ROS2_SPACE: Final = 232
"""The highest ROS 2 domain id: 233 would need a UDP port above 65535, and Fast DDS ends the process for it."""
FIRST_VENDOR_SPACE: Final = 256
TYPES_URI: Final = "http://ua-fleet.org/UA/"
"""The namespace of the UaFleet types in the server. A name, not an address."""

_PATTERN = re.compile(r"ua_(0|[1-9][0-9]{0,4})_(0|[1-9][0-9]{0,4})_(0|[1-9][0-9]{0,4})", re.ASCII)


def check_space(space: int) -> int:
    """Return `space` if it is a legal space id, else raise TopicInvalid with the reason."""
    if not 0 <= space <= 0xFFFF:
        raise TopicInvalid(str(space), "a space id is 0..65535")
    if LAST_ROS2_SPACE < space < FIRST_VENDOR_SPACE:
        raise TopicInvalid(str(space), "space ids 233..255 are reserved")
    return space


def check_ros2_space(space: int) -> int:
    """Return `space` if a ROS 2 domain can have that id; to be asked before any ROS library sees the number."""
    if not ROS1_SPACE < space <= LAST_ROS2_SPACE:
        raise TopicInvalid(str(space), "a ROS 2 space is the domain id, 2..232")
    return space


class Topic(NamedTuple):
    """One data source. Also the UADP triple: PublisherId, WriterGroupId, DataSetWriterId."""

    space: int
    ns: int
    id: int

    @classmethod
    def parse(cls, name: str) -> Topic:
        """The topic of a name; each topic has exactly one spelling (no leading zeros, no slash, ASCII digits)."""
        match = _PATTERN.fullmatch(name)
        if match is None:
            raise TopicInvalid(name, "expected ua_<space>_<ns>_<id> in decimal without leading zeros")
        return cls.checked(int(match[1]), int(match[2]), int(match[3]))

    @classmethod
    def checked(cls, space: int, ns: int, id: int) -> Topic:
        """The topic of three numbers, e.g. a UADP triple; raises TopicInvalid. 0 is null for ns and id on the wire."""
        check_space(space)
        for what, number in (("namespace index", ns), ("identifier", id)):
            if not 1 <= number <= 0xFFFF:
                raise TopicInvalid(f"ua_{space}_{ns}_{id}", f"a {what} is 1..65535")
        return cls(space, ns, id)

    @property
    def name(self) -> str:
        """The name that the topic has in every space."""
        return f"ua_{self.space}_{self.ns}_{self.id}"


class Side(Enum):
    """The side of a bridge on which a message arrived."""

    PUBSUB = "pubsub"
    SPACE = "space"


class LoopVerdict(Enum):
    """What a bridge does with a message."""

    TO_SPACE = "to_space"
    TO_PUBSUB = "to_pubsub"
    DROP_LOOP = "loop"
    """Our own space's data came back over PubSub."""
    DROP_FOREIGN = "foreign"
    """Another bridge (or we) brought this data into the space."""
    DROP_OWN = "own_publication"
    """We published it ourselves; needed where the origin does not stand in the name."""


def loop_verdict(side: Side, origin: int, own_space: int, own_publication: bool) -> LoopVerdict:
    """The loop rule, the only place that decides what a bridge forwards.

    Args:
        side: where the message arrived.
        origin: the space where the data originates.
        own_space: the space that the bridge stands in.
        own_publication: whether the bridge itself published the message into its space.
    """
    if side is Side.PUBSUB:
        return LoopVerdict.DROP_LOOP if origin == own_space else LoopVerdict.TO_SPACE
    if origin != own_space:
        return LoopVerdict.DROP_FOREIGN
    return LoopVerdict.DROP_OWN if own_publication else LoopVerdict.TO_PUBSUB
