"""What of a broker may reach the subscriber: a message has to be what its topic says. Pure.

Nothing is proved here: the header of a message is compared with its topic, and the signature, which comes later,
proves the header. So nobody can send in the name of another on a topic where a broker lets them write.
"""

from __future__ import annotations

from enum import Enum
from functools import lru_cache

from ua_fleet.errors import RemoteWireError
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.subject import ALL_PUBLISHERS
from ua_fleet.transport.mqtt.topics import MOST_REMEMBERED, Kind, Place, TopicTree, level_of
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.header import MessageType
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.outline import Outline, read_outline

__all__ = ["Verdict", "judge", "usual_heads"]

_ACTIONS = frozenset({Kind.ACTION_REQUEST, Kind.ACTION_RESPONSE})


class Verdict(Enum):
    """What is done with a message of a broker."""

    FRESH = "fresh"
    """It was sent just now."""
    KEPT = "kept"
    """The broker had it: retained, or a will. It may be of any time, and be heard again."""
    NOT_ITS_TOPIC = "not its topic"
    """It is dropped."""


def judge(tree: TopicTree, topic: str, payload: bytes, *, is_retained: bool) -> Verdict:
    """Judge a message; one that is malformed is handed on, since the subscriber counts it by its cause."""
    place = tree.read(topic)
    if place is None:
        return Verdict.NOT_ITS_TOPIC
    # A will comes as any other message to who is subscribed; its bytes are as old as the connection that has ended.
    passed = Verdict.KEPT if is_retained or place.kind is Kind.STATUS else Verdict.FRESH
    if payload.startswith(usual_heads(tree, place)):
        return passed  # as its outline would say
    try:
        outline = read_outline(Cursor(payload))
    except RemoteWireError:
        return passed
    is_of_kind = (
        outline.is_discovery is place.kind.is_discovery
        and (outline.message_type is MessageType.PROBE) is (place.kind is Kind.PROBE)
        and outline.is_action is (place.kind in _ACTIONS)
    )
    if not is_of_kind:
        return Verdict.NOT_ITS_TOPIC
    publisher = ALL_PUBLISHERS if outline.publisher_id is None else level_of(str(outline.publisher_id))
    if place.source is None:
        return passed if publisher == place.publisher else Verdict.NOT_ITS_TOPIC
    if tree.publisher_ids is not None:
        outline = read_outline(Cursor(tree.publisher_ids.inward(payload)))  # a queue is named by the space
    if not _is_of(outline, place.source):
        return Verdict.NOT_ITS_TOPIC
    return passed


def usual_heads(tree: TopicTree, place: Place) -> tuple[bytes, ...]:
    """How most messages on a topic begin, if it is one of the data of one DataSetWriter: they are what it says."""
    return () if place.source is None or tree.publisher_ids is not None else _usual_heads(place.source)


def _is_of(outline: Outline, source: Topic) -> bool:
    """Whether a data message holds values of one DataSetWriter alone."""
    return (
        outline.publisher_id == source.space
        and outline.publisher_id_type == PublisherIdType.UINT16
        and outline.writer_group_id == source.ns
        and outline.writer_ids == (source.id,)
    )


@lru_cache(MOST_REMEMBERED)
def _usual_heads(source: Topic) -> tuple[bytes, bytes]:
    """How most messages of a DataSetWriter begin: those of bridges, without and with a SecurityHeader.

    UADPFlags of PublisherId, GroupHeader and PayloadHeader; ExtendedFlags1 of a UInt16, and of security; the
    PublisherId; GroupFlags of the WriterGroupId alone; that; one DataSetWriterId. What follows changes no outline.
    """
    head = b"%b\x01%b\x01%b" % tuple(number.to_bytes(2, "little") for number in source)
    return b"\xf1\x01" + head, b"\xf1\x11" + head
