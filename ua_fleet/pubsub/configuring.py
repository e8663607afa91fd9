"""What a Publisher of ours is configured to send, as the structures of OPC 10000-14 6.2 say it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Final

from ua_fleet.pubsub import components
from ua_fleet.pubsub.application import Application
from ua_fleet.pubsub.layout import PLAIN, WriterSettings
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.values import BuiltinType, Variant
from ua_fleet.wire.discovered import (
    NO_SECURITY,
    DatagramConnectionTransport,
    DataSetWriter,
    JsonDataSetWriterMessage,
    JsonWriterGroupMessage,
    NetworkAddressUrl,
    PubSubConnection,
    UadpDataSetWriterMessage,
    UadpWriterGroupMessage,
    WriterGroup,
)
from ua_fleet.wire.json import Form
from ua_fleet.wire.messages import FieldEncoding

__all__ = ["WriterGroups", "connection", "group_name", "group_number", "writer_group"]

NETWORK_MESSAGE_CONTENT: Final = 0x47
"""UadpNetworkMessageContentMask: PublisherId, GroupHeader, WriterGroupId, PayloadHeader (6.3.1.1.4)."""
DATA_SET_MESSAGE_CONTENT: Final = 0x3D
"""UadpDataSetMessageContentMask: Timestamp, Status, major and minor version, SequenceNumber (6.3.1.3.2)."""

JSON_NETWORK_MESSAGE_CONTENT: Final = 0x4B
"""JsonNetworkMessageContentMask: both headers, PublisherId, WriterGroupName (6.3.2.1.1)."""
JSON_DATA_SET_MESSAGE_CONTENT: Final = 0x7F
"""JsonDataSetMessageContentMask: all from DataSetWriterId to DataSetWriterName (6.3.2.3.1)."""
JSON_ACTION_CONTENT: Final = 0x2B
"""The same of Actions: DataSetWriterId, MetaDataVersion, Timestamp, MessageType."""
FIELD_ENCODING_1: Final = 1 << 7
"""Set for the CompactEncoding, where FIELD_ENCODING_2 is set; otherwise it is the VerboseEncoding."""
FIELD_ENCODING_2: Final = 1 << 11

_UINT16_MAX: Final = 0xFFFF
RAW_DATA: Final = 0x20
"""Bit of the DataSetFieldContentMask (6.2.4.2)."""


class WriterGroups:
    """The DataSetWriters of a Publisher by WriterGroup, with their names."""

    def __init__(self) -> None:
        self._names: dict[int, dict[int, str]] = {}
        self._of_writer: dict[int, list[int]] = {}

    def put(self, ns: int, writer_id: int, name: str) -> bool:
        """Have a DataSetWriter with this name; says whether that is news.

        A name that another one of the group has gets the id behind it, since names are unique in a WriterGroup: a
        broker has them as levels of its topics.
        """
        names = self._names.setdefault(ns, {})
        if any(other == name for other_id, other in names.items() if other_id != writer_id):
            name = f"{name}-{writer_id}"
        if names.get(writer_id) == name:
            return False
        if writer_id not in names:
            self._of_writer.setdefault(writer_id, []).append(ns)
        names[writer_id] = name
        return True

    def remove(self, ns: int, writer_id: int) -> bool:
        """Have it no more; says whether that is news."""
        if self._names.get(ns, {}).pop(writer_id, None) is None:
            return False
        numbers = self._of_writer[writer_id]
        numbers.remove(ns)
        if not numbers:
            del self._of_writer[writer_id]
        return True

    def names(self, ns: int) -> Mapping[int, str]:
        """The names of a group's writers by their ids."""
        return self._names.get(ns, {})

    def numbers(self) -> tuple[int, ...]:
        """The WriterGroupIds."""
        return tuple(self._names)

    def ids(self) -> tuple[int, ...]:
        """All DataSetWriterIds."""
        return tuple(self._of_writer)

    def of_writer(self, writer_id: int) -> tuple[int, ...]:
        """The groups that a DataSetWriterId stands in: one, unless several WriterGroups use it."""
        return tuple(self._of_writer.get(writer_id, ()))


def group_name(ns: int, *, are_actions: bool = False) -> str:
    """The name of a WriterGroup; a broker has it as a level of its topics, so it has no spaces."""
    return f"actions-{ns}" if are_actions else f"group-{ns}"


def group_number(name: str, *, are_actions: bool = False) -> int | None:
    """The WriterGroupId in the name of a WriterGroup; None where it is none of ours."""
    digits = name.removeprefix("actions-" if are_actions else "group-")
    if digits == name or not (digits.isascii() and digits.isdigit() and len(digits) <= 5) or digits[:1] == "0":
        return None
    number = int(digits)
    return number if number <= _UINT16_MAX else None


def writer_group(
    application: Application,
    timing: PubSubTiming,
    ns: int,
    writers: Iterable[tuple[int, str]],
    *,
    are_actions: bool = False,
    settings: Callable[[int], WriterSettings] = lambda _: PLAIN,
    is_enabled: Callable[[components.Component], bool] = lambda _: True,
) -> WriterGroup:
    """A WriterGroup with these of its DataSetWriters: (DataSetWriterId, name). Messages go when there is news.

    `settings` says how a DataSetWriter sends, `is_enabled` whether the group or one of its writers is enabled itself.
    """
    security_group = application.command_group if are_actions else application.data_group
    return WriterGroup(
        group_name(ns, are_actions=are_actions),
        is_enabled(components.writer_group(ns)),
        security_mode=NO_SECURITY if security_group is None else application.security_mode,
        security_group_id=security_group,
        max_network_message_size=application.max_message_bytes,
        writer_group_id=ns,
        keep_alive_time_ms=0.0 if are_actions else timing.keep_alive_s * 1000.0,
        message_settings=UadpWriterGroupMessage(network_message_content_mask=NETWORK_MESSAGE_CONTENT)
        if application.json_form is None
        else JsonWriterGroupMessage(JSON_NETWORK_MESSAGE_CONTENT),
        data_set_writers=tuple(
            [
                _writer(
                    writer_id,
                    name,
                    settings(writer_id),
                    application.json_form,
                    are_actions=are_actions,
                    is_enabled=is_enabled(components.writer(ns, writer_id)),
                )
                for writer_id, name in writers
            ]
        ),
    )


def _writer(
    writer_id: int, name: str, settings: WriterSettings, form: Form | None, *, are_actions: bool, is_enabled: bool
) -> DataSetWriter:
    is_raw = settings.encoding is FieldEncoding.RAW_DATA if form is None else form is Form.RAW_DATA
    if form is None:
        message: UadpDataSetWriterMessage | JsonDataSetWriterMessage
        message = UadpDataSetWriterMessage(0 if are_actions else DATA_SET_MESSAGE_CONTENT)
    else:
        content = JSON_ACTION_CONTENT if are_actions else JSON_DATA_SET_MESSAGE_CONTENT
        is_compact = form is Form.COMPACT and not are_actions
        message = JsonDataSetWriterMessage(content | FIELD_ENCODING_2 | (FIELD_ENCODING_1 if is_compact else 0))
    return DataSetWriter(
        name,
        is_enabled,
        writer_id,
        data_set_field_content_mask=RAW_DATA if is_raw and not are_actions else 0,
        key_frame_count=0 if settings.are_events else settings.key_frame_count,
        data_set_name=name,
        message_settings=message,
    )


def connection(
    application: Application, timing: PubSubTiming, publisher_id: int, groups: tuple[WriterGroup, ...]
) -> PubSubConnection:
    """The PubSubConnection of a process of ours that an application describes, one of several perhaps."""
    address = NetworkAddressUrl(None if application.url_is_brokers else application.network_interface, application.url)
    udp = (
        None if application.url_is_brokers else DatagramConnectionTransport(address, round(timing.announce_interval_s))
    )
    names = (application.description.application_name.text, application.connection_name)
    return PubSubConnection(
        " ".join(filter(None, names)) or None,
        True,
        application.publisher_id or Variant(int(BuiltinType.UINT16), publisher_id),
        application.profile,
        address,
        transport_settings=udp,
        writer_groups=groups,
    )
