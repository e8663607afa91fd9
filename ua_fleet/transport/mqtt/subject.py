"""Where a message goes on a broker, and for how long it is worth sending: read from the message before it is secured.

lane         what it is                                          away from the broker
KEPT         announcements that the broker retains               the newest of each topic is kept
VALUE        data; what one writer says is one row               kept for a while, then only the newest of each writer
COMMAND      Actions, setpoints, probes and answers to probes    not kept: nothing of it may come late
"""

from __future__ import annotations

from collections.abc import Collection
from enum import Enum
from typing import Final, NamedTuple

from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.configuring import group_name
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.topics import Kind, TopicTree
from ua_fleet.transport.party import NamesOf
from ua_fleet.values import TICKS_PER_SECOND, Quality, quality_of
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.data_set_message import HAS_FLAGS_2
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionResponderAnnouncement,
    ApplicationAnnouncement,
    ConnectionsAnnouncement,
    EndpointsAnnouncement,
    StatusAnnouncement,
)
from ua_fleet.wire.messages import FrameKind, MetaDataAnnouncement, NetworkMessage, Probe
from ua_fleet.wire.outline import Outline, is_action, read_outline

__all__ = ["ALL_PUBLISHERS", "Addressing", "Lane", "Subject"]

ALL_PUBLISHERS: Final = "all"
"""In place of a PublisherId, in the topic of a probe to all Publishers."""
ANSWER_LIFETIME_S: Final = 5.0
"""A response or an answer to a probe that has waited longer was asked for again meanwhile."""
SETPOINT_LIFETIME_S: Final = 1.0
"""Longer than any `deadman_ms`: nobody would take it."""
_FRAME_KIND_BITS: Final = 0x0F
_OF_PUBLISHER: Final = (
    (ApplicationAnnouncement, Kind.APPLICATION),
    (EndpointsAnnouncement, Kind.ENDPOINTS),
    (StatusAnnouncement, Kind.STATUS),
    (ConnectionsAnnouncement, Kind.CONNECTION),
    (ActionResponderAnnouncement, Kind.ACTION_RESPONDER),
)


class Lane(Enum):
    """How a message is treated while it cannot be sent; see the module."""

    KEPT = "kept"
    VALUE = "value"
    COMMAND = "command"


class Subject(NamedTuple):
    """What is to be known of a message that is sent."""

    topic: str
    lane: Lane
    kind: Kind
    writer: tuple[int | None, int] | None = None
    """WriterGroupId and DataSetWriterId of a value; of metadata the DataSetWriterId alone."""
    lifetime_s: float | None = None
    """After so long it is not sent any more."""
    is_keep_alive: bool = False
    publisher: int | str | None = None
    """PublisherId of a value or of metadata: a relay speaks for several."""
    is_event: bool = False
    """Whether a value is an event, which says nothing of what is now."""

    @property
    def origin(self) -> tuple[int | str | None, tuple[int | None, int] | None]:
        """Whose value it is: what one DataSetWriter says is one row."""
        return self.publisher, self.writer


class Addressing:
    """Finds the subjects of what one process sends."""

    def __init__(self, tree: TopicTree, names_of: NamesOf, setpoint_groups: Collection[int] = ()) -> None:
        """Make it.

        Args:
            tree: the topics.
            names_of: of the DataSetWriters that this process speaks for.
            setpoint_groups: WriterGroups of setpoints, which are commands.
        """
        self._tree, self._names_of, self._setpoint_groups = tree, names_of, frozenset(setpoint_groups)
        self._codec = Codec()
        self._queues: dict[tuple[int, int, int], str] = {}
        """Topics of data, of writers of this process."""

    def subject(self, plain: bytes, wall_ticks: int) -> Subject | None:
        """What a plain and whole message is; None for one that has no place on a broker.

        Args:
            plain: the message.
            wall_ticks: the wall clock, with which the time of a request is compared.
        """
        try:
            cursor = Cursor(plain)
            outline = read_outline(cursor)
            if outline.is_discovery or is_action(plain):
                return self._other(plain, wall_ticks)
            return self._data(outline, cursor)
        except RemoteWireError:  # ours can be decoded; this is for what a test or a tool puts in its place
            return None

    def _data(self, outline: Outline, cursor: Cursor) -> Subject | None:
        publisher, group = outline.publisher_id, outline.writer_group_id
        if publisher is None:
            return None
        if not isinstance(publisher, int) or group is None or len(outline.writer_ids) != 1:
            names = [] if group is None else [group_name(group)]
            topic = self._tree.topic(Kind.DATA, publisher, *(names or ["0"]))
            return Subject(topic, Lane.VALUE, Kind.DATA, (group, 0), publisher=publisher)
        key = publisher, group, outline.writer_ids[0]
        queue = self._queues.get(key)
        if queue is None:
            queue = self._queues[key] = self._tree.queue(Topic(*key))
        if group in self._setpoint_groups:
            return Subject(queue, Lane.COMMAND, Kind.DATA, lifetime_s=SETPOINT_LIFETIME_S)
        flags = cursor.byte()
        kind = cursor.byte() & _FRAME_KIND_BITS if flags & HAS_FLAGS_2 else FrameKind.KEY
        return Subject(
            queue,
            Lane.VALUE,
            Kind.DATA,
            key[1:],
            is_keep_alive=kind == FrameKind.KEEP_ALIVE,
            publisher=publisher,
            is_event=kind == FrameKind.EVENT,
        )

    def _other(self, plain: bytes, wall_ticks: int) -> Subject | None:
        message = self._codec.decode(plain)
        if isinstance(message, ActionMessage):
            return self._action(message, wall_ticks)
        if isinstance(message, Probe):
            publisher = ALL_PUBLISHERS if message.publisher_id is None else message.publisher_id
            topic = self._tree.topic(Kind.PROBE, publisher)
            return Subject(topic, Lane.COMMAND, Kind.PROBE, lifetime_s=ANSWER_LIFETIME_S)
        if isinstance(message, NetworkMessage) or message.publisher_id is None:
            return None
        publisher = message.publisher_id
        for announcement, kind in _OF_PUBLISHER:
            if isinstance(message, announcement):
                return Subject(self._tree.topic(kind, publisher), Lane.KEPT, kind)
        if isinstance(message, MetaDataAnnouncement | ActionMetaDataAnnouncement):
            names = self._names_of(publisher, message.data_set_writer_id)
            denied = isinstance(message, MetaDataAnnouncement) and quality_of(message.status) is Quality.BAD
            if names is not None and not denied:
                kind = Kind.METADATA if isinstance(message, MetaDataAnnouncement) else Kind.ACTION_METADATA
                topic = self._tree.topic(kind, publisher, *names)
                return Subject(topic, Lane.KEPT, kind, (None, message.data_set_writer_id), publisher=publisher)
        topic = self._tree.topic(Kind.ANSWER, publisher)
        return Subject(topic, Lane.COMMAND, Kind.ANSWER, lifetime_s=ANSWER_LIFETIME_S)

    def _action(self, message: ActionMessage, wall_ticks: int) -> Subject | None:
        if message.publisher_id is None:
            return None
        kind = Kind.ACTION_REQUEST if message.is_request else Kind.ACTION_RESPONSE
        topic = self._tree.topic(kind, message.publisher_id, group_name(message.writer_group_id or 0, are_actions=True))
        lifetime_s = ANSWER_LIFETIME_S
        if message.is_request and message.action_state == ActionState.EXECUTING and message.timeout_hint_ms:
            issued = wall_ticks if message.timestamp is None else message.timestamp
            lifetime_s = (issued - wall_ticks) / TICKS_PER_SECOND + message.timeout_hint_ms / 1000.0
        return Subject(topic, Lane.COMMAND, kind, lifetime_s=lifetime_s)
