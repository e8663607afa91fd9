"""The kind of each message, from what stands in it and what its sender has said before. The one place that decides.

    what is sent                                                          kind
    application, status or DataSetWriters announced                       registration
        cyclic status, unchanged                                          keep_alive
        the others, unchanged                                             repeat
        status that says Error                                            fault
    metadata of a DataSet or an Action announced, or a whole
        PubSubConnection or Action responder, to who asks                 metadata; unchanged: repeat
    probe that looks for applications                                     registration
    any other probe                                                       metadata
    Action request, Action response, again or not                         request, response
        of CarryRun: part, token, end of a run                            token
        of CarryRun: what the server asks of a run                        telemetry
        of CarryRun, an answer whose request was not seen: with content   telemetry; without: token
    frame whose Timestamp is not new                                      repeat
    keep-alive, or key frame without fields                               keep_alive
    frame with Bad_NoCommunication: the source has gone                   fault
    SkillStatus in which an execution newly has failed or is unknown      fault
    any other SkillStatus                                                 status
    what a bridge tells of the runs that it carries                       run
    data of a source whose kind the owner has given                       that one
    any other data                                                        telemetry

`docs/simulator.md` says why. What passes on another way than PubSub, keys or a scenario that is handed on, is counted
by `record`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, Final, NamedTuple

from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.carry_action import CARRY_ID, Word
from ua_fleet.pubsub.run_data import RUN_DATA_ID
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import SKILL_STATUS_FIELDS
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire import ActionMessage, Codec
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionResponderAnnouncement,
    AnyAnnouncement,
    ConnectionsAnnouncement,
    PubSubState,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
)
from ua_fleet.wire.messages import (
    DataSetMessage,
    DataSetMetaData,
    FrameKind,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
)

__all__ = ["MessageKind", "Traffic"]


class MessageKind(StrEnum):
    """What a message is for. The values are the names that reports have."""

    REGISTRATION = "registration"
    """A process or robot introduces itself, or looks for others."""
    METADATA = "metadata"
    """What data and Actions look like."""
    REQUEST = "request"
    RESPONSE = "response"
    STATUS = "status"
    """How far a robot is with what it was asked for."""
    TOKEN = "token"  # noqa: S105 - a name, not a secret
    """A scenario is handed on from one robot to the next. Where a server keeps it, nothing is."""
    FAULT = "fault"
    """A robot, source or process tells that it cannot go on."""
    KEEP_ALIVE = "keep_alive"
    REPEAT = "repeat"
    """What was said before, for who came late or has lost it."""
    TELEMETRY = "telemetry"
    RUN = "run"
    """What a bridge tells of a run that it carries, for whoever watches."""
    SENSOR = "sensor"
    """Data of a sensor that belongs to no robot's own telemetry."""


_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION) >> 16
_FAILED: Final = frozenset({ExecutionState.FAILED.value, ExecutionState.UNKNOWN.value})
_ID: Final = SKILL_STATUS_FIELDS[0].name
_STATE: Final = SKILL_STATUS_FIELDS[2].name
_SKILL_STATUS: Final = frozenset({field.name for field in SKILL_STATUS_FIELDS})
_NOTHING: Final[frozenset[Any]] = frozenset()

_Writer = tuple[int | str | None, int | None, int]


class _Columns(NamedTuple):
    """Where in a SkillStatus two of its fields stand."""

    execution_id: int
    state: int


class Traffic:
    """Counts the messages of a network by kind. Give it each datagram once, as it was sent, in the order of sending."""

    def __init__(self, known: Mapping[Topic, MessageKind] | None = None) -> None:
        """Begin with nothing.

        Args:
            known: kinds of data that their configuration tells: sensors, and what robots announce of their faults.
        """
        self.messages: Counter[MessageKind] = Counter()
        self.bytes: Counter[MessageKind] = Counter()
        """As on the wire: what security adds is in it, what UDP and IP add is not."""
        self.messages_at: Counter[tuple[int, MessageKind]] = Counter()
        """By (whole seconds since time 0, kind)."""
        self.bytes_at: Counter[tuple[int, MessageKind]] = Counter()
        self.unreadable = 0
        """Datagrams that the codec refused; they are in none of the counts."""
        self._known: Mapping[Any, MessageKind] = known or {}
        self._codec = Codec()
        self._columns: dict[tuple[int | str | None, int], _Columns] = {}
        """Of the sources that are a SkillStatus, by PublisherId and DataSetWriterId."""
        self._said: dict[tuple[Any, ...], Any] = {}
        self._timestamps: dict[_Writer, int] = {}
        self._failed: dict[_Writer, frozenset[Any]] = {}
        """The executions that the last SkillStatus told as failed."""

    def take(self, plain: bytes, wire_bytes: int, now: float) -> list[MessageKind]:
        """Count a message, and say what it was.

        Args:
            plain: the whole message, opened and put together from its chunks where it was sent as such.
            wire_bytes: what was sent for it, all chunks together.
            now: seconds.

        Returns:
            A kind for each DataSetMessage, request, response, probe or announcement in it. They share its bytes evenly.
        """
        try:
            message = self._codec.decode(plain)
        except RemoteWireError:
            self.unreadable += 1
            return []
        if isinstance(message, NetworkMessage):
            kinds = [self._data_kind(message, part) for part in message.messages]
        elif isinstance(message, ActionMessage):
            kinds = [self._action_kind(message)] * (1 + len(message.others))
        elif isinstance(message, Probe):
            kinds = [MessageKind.REGISTRATION if message.kind == ProbeKind.FIND_APPLICATIONS else MessageKind.METADATA]
        else:
            kinds = [self._announcement_kind(message)]
        if kinds:
            share, rest = divmod(wire_bytes, len(kinds))
            for number, kind in enumerate(kinds):
                self.record(kind, share + (rest if number == 0 else 0), now)
        return kinds

    def _action_kind(self, message: ActionMessage) -> MessageKind:
        if message.data_set_writer_id != CARRY_ID:
            return MessageKind.REQUEST if message.is_request else MessageKind.RESPONSE
        key = ("carried", message.correlation_data)
        if message.is_request and message.values:
            is_watching = message.values[0] in (Word.FETCH, Word.ANSWER)
            self._said[key] = MessageKind.TELEMETRY if is_watching else MessageKind.TOKEN
        kind: MessageKind | None = self._said.get(key)
        if kind is None:  # the request was not seen, as by a bridge that writes down what it sends itself
            has_content = not message.is_request and bool(message.values) and bool(message.values[-1])
            kind = MessageKind.TELEMETRY if has_content else MessageKind.TOKEN
        return kind

    def record(self, kind: MessageKind, size: int, now: float) -> None:
        """Count a message of a kind that the caller knows."""
        second = int(now)
        self.messages[kind] += 1
        self.bytes[kind] += size
        self.messages_at[second, kind] += 1
        self.bytes_at[second, kind] += size

    def _announcement_kind(self, announcement: AnyAnnouncement) -> MessageKind:
        said: Any = announcement._replace(sequence_number=0)
        new, again = MessageKind.REGISTRATION, MessageKind.REPEAT
        about: tuple[Any, ...] = ()
        if isinstance(announcement, MetaDataAnnouncement):
            new, about = MessageKind.METADATA, (announcement.data_set_writer_id,)
            self._learn(announcement.publisher_id, announcement.data_set_writer_id, announcement.metadata)
        elif isinstance(announcement, ActionMetaDataAnnouncement):
            new, about = MessageKind.METADATA, (announcement.data_set_writer_id,)
        elif isinstance(announcement, ConnectionsAnnouncement | ActionResponderAnnouncement):
            new = MessageKind.METADATA
        elif isinstance(announcement, WriterConfigurationAnnouncement):
            about = announcement.writer_group.writer_group_id, announcement.data_set_writer_ids
        elif isinstance(announcement, StatusAnnouncement):
            again, said = MessageKind.KEEP_ALIVE, (announcement.is_cyclic, announcement.state)
            if announcement.state == PubSubState.ERROR:
                new = MessageKind.FAULT
        key = (type(announcement), announcement.publisher_id, *about)
        if self._said.get(key) == said:
            return again
        self._said[key] = said
        return new

    def _learn(self, publisher_id: int | str | None, writer_id: int, metadata: DataSetMetaData) -> None:
        names = [field.name for field in metadata.fields]
        if _SKILL_STATUS.issubset(names):
            self._columns[publisher_id, writer_id] = _Columns(names.index(_ID), names.index(_STATE))
        else:
            self._columns.pop((publisher_id, writer_id), None)

    def _data_kind(self, message: NetworkMessage, part: DataSetMessage) -> MessageKind:
        if part.kind == FrameKind.KEEP_ALIVE or (part.kind == FrameKind.KEY and not part.types and part.raw is None):
            return MessageKind.KEEP_ALIVE
        writer: _Writer = message.publisher_id, message.writer_group_id, part.data_set_writer_id
        timestamp = part.timestamp if part.timestamp is not None else message.timestamp
        if timestamp is not None:
            if timestamp <= self._timestamps.get(writer, -1):
                return MessageKind.REPEAT
            self._timestamps[writer] = timestamp
        if (part.status or 0) >> 16 == _NO_COMMUNICATION:
            return MessageKind.FAULT
        if part.data_set_writer_id == RUN_DATA_ID:
            return MessageKind.RUN
        columns = self._columns.get((message.publisher_id, part.data_set_writer_id))
        if columns is not None:
            return self._skill_status_kind(writer, part, columns)
        return self._known.get(writer, MessageKind.TELEMETRY)

    def _skill_status_kind(self, writer: _Writer, part: DataSetMessage, columns: _Columns) -> MessageKind:
        if len(part.values) <= max(columns):
            return MessageKind.STATUS
        rows = zip(part.values[columns.execution_id] or (), part.values[columns.state] or (), strict=False)
        failed = frozenset([execution_id for execution_id, state in rows if state in _FAILED])
        is_new = bool(failed - self._failed.get(writer, _NOTHING))
        self._failed[writer] = failed
        return MessageKind.FAULT if is_new else MessageKind.STATUS
