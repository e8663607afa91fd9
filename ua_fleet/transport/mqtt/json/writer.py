"""Plain UADP messages of a process as JSON. What UADP has no names for has them here: groups, writers and fields."""

from __future__ import annotations

import uuid
from itertools import count
from typing import Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.pubsub.configuring import group_name
from ua_fleet.transport.mqtt.json.action_fields import announced_over_json
from ua_fleet.transport.mqtt.json.descriptions import Descriptions
from ua_fleet.transport.mqtt.topics import Kind, TopicTree
from ua_fleet.transport.party import NamesOf
from ua_fleet.values import Quality, quality_of
from ua_fleet.wire import Codec, decode_raw_fields
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, AnyAnnouncement, WriterConfigurationAnnouncement
from ua_fleet.wire.json import (
    DataSetFields,
    Form,
    JsonAction,
    JsonAnnouncement,
    JsonData,
    JsonWriterPlan,
    Source,
    encode_action,
    encode_announcement,
    encode_data,
)
from ua_fleet.wire.messages import (
    Announcement,
    DataSetMessage,
    FieldEncoding,
    FrameKind,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
)

__all__ = ["JsonWriter"]

_KEY: Final = FrameKind.KEY.value
_VARIANT: Final = FieldEncoding.VARIANT.value
_RAW: Final = FieldEncoding.RAW_DATA.value
_PREFIX_DIGITS: Final = 20
"""Of a MessageId, which looks like a Guid; the other 12 count the messages."""


class _Planned:
    """How the key frames of one DataSetWriter are written, for one version of its metadata and its names."""

    __slots__ = ("fields", "names", "plan", "types", "version")

    def __init__(
        self, fields: DataSetFields, names: tuple[str, str], publisher: str, writer_id: int, form: Form
    ) -> None:
        self.fields, self.names = fields, names
        self.version = fields.metadata.configuration_version
        self.types = tuple([field.code for field in fields.fields])
        self.plan = JsonWriterPlan(fields, form, source=Source(publisher, names[0], writer_id, names[1]))


class JsonWriter:
    """What one process says, as JSON."""

    def __init__(
        self,
        tree: TopicTree,
        names_of: NamesOf,
        descriptions: Descriptions,
        heard: Descriptions,
        *,
        form: Form = Form.VERBOSE,
        run_id: str | None = None,
    ) -> None:
        """Make it.

        Args:
            tree: the topics: responses are wanted at the standard one.
            names_of: of the DataSetWriters that this process speaks for.
            descriptions: what this process announces is put there.
            heard: what others announce: their Actions, of which this process asks.
            form: how fields of data are written.
            run_id: begins the MessageIds; random if left out.
        """
        self._tree, self._names_of, self._form = tree, names_of, form
        self._descriptions, self._heard = descriptions, heard
        digits = (run_id or uuid.uuid4().hex)[:_PREFIX_DIGITS]
        self._id_head = f"{digits[:8]}-{digits[8:12]}-{digits[12:16]}-{digits[16:20]}-"
        self._number = count(1)
        self._codec = Codec()
        self._planned: dict[tuple[int | str | None, int | None, int], _Planned] = {}

    def encode(self, plain: bytes, wall_ticks: int) -> bytes | None:
        """The text of a plain and whole message; None where JSON has none, as for probes.

        Raises LocalWireError for what JSON cannot hold, or names that are not known.
        """
        try:
            message = self._codec.decode(plain)
        except RemoteWireError as error:
            raise LocalWireError(f"no message of ours: {error}") from None
        if type(message) is NetworkMessage:
            return self._data(message)
        if isinstance(message, ActionMessage):
            return self._action(message, wall_ticks)
        if isinstance(message, NetworkMessage | Probe | Announcement | WriterConfigurationAnnouncement):
            return None
        return self._announcement(message, wall_ticks)

    def _data(self, message: NetworkMessage) -> bytes:
        parts = message.messages
        if len(parts) == 1:
            part = parts[0]
            planned = self._plan_of(message, part)
            if (
                planned is not None
                and part.kind == _KEY
                and part.encoding == _VARIANT
                and part.types == planned.types
                and (part.major_version, part.minor_version) == planned.version
                and part.sequence_number is not None
                and part.timestamp is not None
            ):
                return planned.plan.encode(
                    self._next_id(), part.sequence_number, part.timestamp, part.status or 0, part.values
                )
        planned_parts = [self._plan_of(message, part) for part in parts]
        fields = [None if planned is None else planned.fields for planned in planned_parts]
        group = group_name(message.writer_group_id or 0)
        sources = [
            Source(None, None, part.data_set_writer_id, None if planned is None else planned.names[1])
            for part, planned in zip(parts, planned_parts, strict=True)
        ]
        whole = [_decoded(part, its) for part, its in zip(parts, fields, strict=True)]
        data = JsonData(message._replace(messages=tuple(whole)), tuple(sources), self._next_id(), group)
        return encode_data(data, fields, self._form)

    def _plan_of(self, message: NetworkMessage, part: DataSetMessage) -> _Planned | None:
        """What is known of a DataSetWriter; None before its announcement."""
        writer_id = part.data_set_writer_id
        key = message.publisher_id, message.writer_group_id, writer_id
        publisher = str(message.publisher_id)
        version = self._descriptions.version(publisher, writer_id)
        planned = self._planned.get(key)
        if planned is not None and planned.version == version:
            return planned
        fields = self._fields(publisher, writer_id)
        if fields is None:
            return None
        known = None if message.publisher_id is None else self._names_of(message.publisher_id, writer_id)
        names = group_name(message.writer_group_id or 0), (known or ("", fields.metadata.name))[1]
        planned = self._planned[key] = _Planned(fields, names, publisher, writer_id, self._form)
        return planned

    def _fields(self, publisher: str, writer_id: int) -> DataSetFields | None:
        try:
            return self._descriptions.fields(publisher, writer_id)
        except RemoteWireError as error:
            raise LocalWireError(f"metadata of ours that contradicts itself: {error}") from None

    def _action(self, message: ActionMessage, wall_ticks: int) -> bytes:
        group = group_name(message.writer_group_id or 0, are_actions=True)
        if message.is_request and message.response_address is None:
            address = self._tree.topic(Kind.ACTION_RESPONSE, str(message.publisher_id), group)
            message = message._replace(response_address=address)
        messages = (message, *message.others)
        fields = [self._action_fields(each) for each in messages]
        issued = wall_ticks if message.timestamp is None else message.timestamp
        return encode_action(JsonAction(message, self._next_id(), issued), fields)

    def _action_fields(self, message: ActionMessage) -> DataSetFields | None:
        publisher, writer_id = str(message.publisher_id), message.data_set_writer_id
        try:
            fields = self._descriptions.actions(publisher, writer_id) or self._heard.actions(publisher, writer_id)
        except RemoteWireError as error:
            raise LocalWireError(f"an Action that contradicts itself: {error}") from None
        return None if fields is None else fields.to_write(message)

    def _announcement(self, announcement: AnyAnnouncement, wall_ticks: int) -> bytes | None:
        names: tuple[str | None, str | None] = None, None
        if isinstance(announcement, MetaDataAnnouncement | ActionMetaDataAnnouncement):
            if isinstance(announcement, MetaDataAnnouncement) and quality_of(announcement.status) is Quality.BAD:
                return None
            publisher = announcement.publisher_id
            names = (publisher is not None and self._names_of(publisher, announcement.data_set_writer_id)) or names
            self._descriptions.learn(announcement, names[1])
            if isinstance(announcement, ActionMetaDataAnnouncement):
                announcement = announced_over_json(announcement)
        return encode_announcement(JsonAnnouncement(announcement, self._next_id(), wall_ticks, *names))

    def _next_id(self) -> str:
        return f"{self._id_head}{next(self._number):012x}"


def _decoded(part: DataSetMessage, fields: DataSetFields | None) -> DataSetMessage:
    """A DataSetMessage whose values are decoded; RawData of UADP needs the metadata for that."""
    if part.encoding != _RAW or fields is None:
        return part
    try:
        return decode_raw_fields(part, fields.metadata)
    except RemoteWireError as error:
        raise LocalWireError(f"RawData of ours that contradicts its metadata: {error}") from None
