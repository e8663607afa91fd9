"""JSON messages as they come from a broker, as plain UADP. What contradicts its topic is refused, as for UADP.

A topic may say what a message leaves out: on the queue of a source `{"speed": 1.5}` alone is a message.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from typing import Final
from urllib.parse import unquote

from ua_fleet.counters import Drop
from ua_fleet.errors import LocalWireError, RemoteWireError, TopicInvalid
from ua_fleet.pubsub.configuring import group_number
from ua_fleet.pubsub.sequence import MASK
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.json.action_fields import ActionFields, heard_over_json
from ua_fleet.transport.mqtt.json.descriptions import Descriptions
from ua_fleet.transport.mqtt.json.undescribed import Shown, Undescribed
from ua_fleet.transport.mqtt.topics import Kind, Place, level_of
from ua_fleet.wire import Codec, encode_action, encode_announcement
from ua_fleet.wire import discovered as d
from ua_fleet.wire.json import (
    DEFAULT_LIMITS,
    JSON_PAYLOAD,
    DataSetFields,
    JsonAction,
    JsonAnnouncement,
    JsonData,
    Limits,
    Reading,
    Source,
    decode_json,
    decode_payload,
    publisher_id_number,
)
from ua_fleet.wire.messages import (
    DataSetMessage,
    DataSetMetaData,
    FrameKind,
    MetaDataAnnouncement,
    NetworkMessage,
    PublisherIdType,
)

__all__ = ["JsonReader", "NotItsTopic"]

_KINDS: Final[dict[type, Kind]] = {
    MetaDataAnnouncement: Kind.METADATA,
    d.ApplicationAnnouncement: Kind.APPLICATION,
    d.EndpointsAnnouncement: Kind.ENDPOINTS,
    d.StatusAnnouncement: Kind.STATUS,
    d.ConnectionsAnnouncement: Kind.CONNECTION,
    d.ActionMetaDataAnnouncement: Kind.ACTION_METADATA,
    d.ActionResponderAnnouncement: Kind.ACTION_RESPONDER,
}
_NUMBERS: Final = (PublisherIdType.UINT16, PublisherIdType.UINT32, PublisherIdType.UINT64)
_BITS: Final = (16, 32, 64)


class NotItsTopic(Exception):
    """A message is of another publisher, DataSetWriter or kind than its topic says."""


class JsonReader:
    """Reads what one process hears. Each `read` may add to `drops` and `forgiven`, which their owner empties."""

    def __init__(
        self,
        own: int | None,
        own_descriptions: Descriptions,
        descriptions: Descriptions,
        *,
        stated: Mapping[tuple[str, int], DataSetMetaData] | None = None,
        described: Collection[Topic] = (),
        limits: Limits = DEFAULT_LIMITS,
        undescribed: Undescribed | None = None,
    ) -> None:
        """Make it.

        Args:
            own: the PublisherId of this process; what others say in its name describes nothing.
            own_descriptions: what this process announces: its Actions, by which requests to it are read.
            descriptions: what others announce is put there.
            stated: metadata of DataSetWriters that announce none, by PublisherId and DataSetWriterId.
            described: sources that are never shown as a text.
            limits: of a message.
            undescribed: what has no metadata.
        """
        self.drops: Counter[Drop] = Counter()
        self.forgiven: Counter[str] = Counter()
        self._own, self._own_descriptions, self._limits = str(own), own_descriptions, limits
        self._descriptions = descriptions
        self._undescribed, self._never_shown = undescribed or Undescribed(), frozenset(described)
        self._stated = {key: DataSetFields(metadata) for key, metadata in (stated or {}).items()}
        self._codec = Codec()

    def read(self, place: Place, text: bytes, now: float, *, is_fresh: bool = True) -> list[bytes]:
        """The plain messages that a text is, in their order; none where it was counted as dropped, or is held.

        Args:
            place: what its topic says.
            text: as it came.
            now: the time.
            is_fresh: False for what the broker had kept.

        Raises:
            RemoteWireError: it is malformed.
            NotItsTopic: it contradicts its topic.
        """
        decoded = decode_json(text, self._fields_of, self._action_fields_of, _source_of(place), limits=self._limits)
        for leniency, number in decoded.leniencies.items():
            self.forgiven[leniency.value] += number
        if isinstance(decoded, JsonData):
            return self._data(place, decoded, now)
        if isinstance(decoded, JsonAction):
            return self._action(place, decoded)
        return self._announcement(place, decoded, now, is_fresh=is_fresh)

    def poll(self, now: float) -> list[bytes]:
        """What has waited for its metadata long enough, as a text."""
        return self._shown(self._undescribed.poll(now))

    def _fields_of(self, source: Source) -> DataSetFields | None:
        publisher, writer_id = source.publisher_id, self._writer_id(source)
        if publisher is None or writer_id is None:
            return None
        stated = self._stated.get((publisher, writer_id))
        if stated is not None:  # `fleet.yaml` has the last word: anybody may announce something else
            return stated
        known = self._own_descriptions if publisher == self._own else self._descriptions
        return known.fields(publisher, writer_id)

    def _action_fields_of(self, publisher: str, writer_id: int, is_request: bool) -> DataSetFields | None:
        fields = self._actions_of(publisher, writer_id)
        if fields is None:
            return None
        return fields.request if is_request else fields.response

    def _actions_of(self, publisher: str, writer_id: int) -> ActionFields | None:
        known = self._own_descriptions if publisher == self._own else self._descriptions
        return known.actions(publisher, writer_id)

    def _writer_id(self, source: Source) -> int | None:
        if source.data_set_writer_id:
            return source.data_set_writer_id
        publisher, name = source.publisher_id, source.data_set_writer_name
        return None if publisher is None or name is None else self._descriptions.writer_id(publisher, name)

    def _data(self, place: Place, data: JsonData, now: float) -> list[bytes]:
        if place.kind is not Kind.DATA:
            raise NotItsTopic
        plain: list[bytes] = []
        for source in data.sources:  # all of them, before anything of one is taken
            self._check_data(place, source)
        for message, source in zip(data.message.messages, data.sources, strict=True):
            writer_id = self._writer_id(source)
            if writer_id is None or source.publisher_id is None:
                self.drops[Drop.UNKNOWN_SOURCE] += 1
                continue
            if message.encoding == JSON_PAYLOAD:
                stated = self._stated.get((source.publisher_id, writer_id))
                if stated is not None:
                    message = decode_payload(Reading(), message, stated)  # whatever version the message names
            number = message.sequence_number
            if message.data_set_writer_id != writer_id or (number is not None and number > MASK):
                number = None if number is None else number & MASK
                message = message._replace(data_set_writer_id=writer_id, sequence_number=number)
            ns = place.source.ns if place.source is not None else group_number(source.writer_group_name or "")
            held = self._held(source, ns, message, now)
            if held is not None:
                plain += self._shown(held)
            elif message.encoding == JSON_PAYLOAD:
                self.drops[Drop.NO_METADATA] += 1
            else:
                plain += self._encoded(source.publisher_id, ns, message)
        self._count_lost()
        return plain

    def _check_data(self, place: Place, source: Source) -> None:
        """Raise NotItsTopic for data of another DataSetWriter than its topic says."""
        queue, group, publisher = place.source, source.writer_group_name, source.publisher_id or ""
        if queue is not None:
            ns = None if group is None else group_number(group)
            said = source.publisher_id, queue.ns if ns is None else ns, source.data_set_writer_id
            if said != (str(queue.space), queue.ns, queue.id):
                raise NotItsTopic
            return
        if level_of(publisher) != place.publisher or level_of(group or "") != place.names[0]:
            raise NotItsTopic
        if len(place.names) > 1:
            if source.data_set_writer_name is not None:
                is_its = level_of(source.data_set_writer_name) == place.names[1]
            else:  # its number alone: metadata has told which one has this name
                known = self._descriptions.writer_id(publisher, unquote(place.names[1]))
                is_its = known in (None, source.data_set_writer_id)
            if not is_its:
                raise NotItsTopic

    def _held(self, source: Source, ns: int | None, message: DataSetMessage, now: float) -> list[Shown] | None:
        """Hold a message that has no metadata; None for one that has, or that is of no source of a fleet."""
        if message.encoding != JSON_PAYLOAD and not self._undescribed:
            return None
        publisher = source.publisher_id or ""
        space = publisher_id_number(publisher)
        if space is None or ns is None:
            return None
        try:
            topic = Topic.checked(space, ns, message.data_set_writer_id)
        except TopicInvalid:
            return None
        if message.encoding != JSON_PAYLOAD and message.kind != FrameKind.KEEP_ALIVE:
            self._undescribed.described(topic.space, topic.id, now)  # what was held is older
            return None
        if message.encoding != JSON_PAYLOAD and topic not in self._undescribed:
            return None
        may_show = topic not in self._never_shown and self._fields_of(source) is None
        name = source.data_set_writer_name or topic.name
        return self._undescribed.put(topic, name, message, now, may_show=may_show)

    def _count_lost(self) -> None:
        if self._undescribed.lost:
            self.drops[Drop.NO_METADATA] += self._undescribed.lost
            self._undescribed.lost = 0

    def _shown(self, shown: Sequence[Shown]) -> list[bytes]:
        plain: list[bytes] = []
        for source, announcement, message in shown:
            plain.append(encode_announcement(announcement))
            plain += self._encoded(str(source.space), source.ns, message)
        return plain

    def _encoded(self, publisher: str, ns: int | None, *messages: DataSetMessage) -> list[bytes]:
        number, kind = _publisher_id(publisher)
        try:
            return [self._codec.encode(NetworkMessage(number, kind, writer_group_id=ns, messages=messages))]
        except LocalWireError:  # a structure without description has no bytes
            self.drops[Drop.CONVERSION] += len(messages)
            return []

    def _action(self, place: Place, action: JsonAction) -> list[bytes]:
        first = action.message
        kind = Kind.ACTION_REQUEST if first.is_request else Kind.ACTION_RESPONSE
        publisher = str(first.publisher_id)
        if place.kind is not kind or level_of(publisher) != place.publisher:
            raise NotItsTopic
        number, id_type = _publisher_id(publisher)
        group = group_number(unquote(place.names[0]), are_actions=True)
        plain: list[bytes] = []
        for message, payload in zip((first, *first.others), action.payloads, strict=True):
            if payload is not None:
                self.drops[Drop.NO_METADATA] += 1
                continue
            fields = self._actions_of(publisher, message.data_set_writer_id)
            whole = (message if fields is None else fields.as_read(message))._replace(
                publisher_id=number,
                publisher_id_type=id_type,
                writer_group_id=group,
                timestamp=action.timestamp if message.timestamp is None else message.timestamp,
                others=(),
            )
            try:
                plain.append(encode_action(whole))
            except LocalWireError:
                self.drops[Drop.CONVERSION] += 1
        return plain

    def _announcement(self, place: Place, message: JsonAnnouncement, now: float, *, is_fresh: bool) -> list[bytes]:
        announcement = message.announcement
        if isinstance(announcement, d.ActionMetaDataAnnouncement):
            announcement = heard_over_json(announcement)
        publisher = str(announcement.publisher_id)
        if place.kind is not _KINDS.get(type(announcement)) or level_of(publisher) != place.publisher:
            raise NotItsTopic
        if place.names:  # of a DataSetWriter
            said = zip((message.writer_group_name, message.data_set_writer_name), place.names, strict=True)
            if any(name is not None and level_of(name) != level for name, level in said):
                raise NotItsTopic
        number, kind = _publisher_id(publisher)
        try:
            plain = [encode_announcement(announcement._replace(publisher_id=number, publisher_id_type=kind))]
        except LocalWireError:
            self.drops[Drop.CONVERSION] += 1
            return []
        if not isinstance(announcement, MetaDataAnnouncement | d.ActionMetaDataAnnouncement) or publisher == self._own:
            return plain
        name = message.data_set_writer_name or unquote(place.names[1])
        if not self._descriptions.learn(announcement, name, is_fresh=is_fresh, size=len(plain[0])):
            self.drops[Drop.RETAINED if not is_fresh else Drop.UNKNOWN_SOURCE] += 1
            return []
        if isinstance(announcement, MetaDataAnnouncement):
            plain += self._described(publisher, announcement.data_set_writer_id, now)
        return plain

    def _described(self, publisher: str, writer_id: int, now: float) -> list[bytes]:
        """The last values that came before their metadata."""
        space = publisher_id_number(publisher)
        waited = [] if space is None else self._undescribed.described(space, writer_id, now)
        self._count_lost()
        plain: list[bytes] = []
        reading = Reading()  # one for all of them: one announcement has one budget
        for topic, message in waited:
            try:
                fields = self._descriptions.fields(publisher, writer_id)
                if fields is None or not fields.fits(message):
                    self.drops[Drop.NO_METADATA] += 1
                    continue
                decoded = decode_payload(reading, message, fields)
            except RemoteWireError:  # of this value; the announcement is right
                self.drops[Drop.LAYOUT] += 1
                continue
            plain += self._encoded(publisher, topic.ns, decoded)
        for leniency, number in reading.leniencies.items():
            self.forgiven[leniency.value] += number
        return plain


def _source_of(place: Place) -> Source:
    """What a topic says of the data on it."""
    if place.source is not None:
        return Source(str(place.source.space), None, place.source.id)
    names = [unquote(level) for level in place.names]
    group, writer = (*names, None, None)[:2]
    return Source(unquote(place.publisher), group, None, writer)


@lru_cache(maxsize=1024)
def _publisher_id(text: str) -> tuple[int | str, int]:
    """A PublisherId of UADP: JSON does not tell the type of a number, so it is the smallest that holds it."""
    number = publisher_id_number(text)
    if number is None:
        return text, PublisherIdType.STRING.value
    return number, next(kind.value for kind, bits in zip(_NUMBERS, _BITS, strict=True) if number < 1 << bits)
