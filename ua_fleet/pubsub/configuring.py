"""What a Publisher of ours is configured to send, as the structures of OPC 10000-14 6.2 say it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Final

from ua_fleet.pubsub.application import UDP_UADP, Application
from ua_fleet.pubsub.layout import PLAIN, WriterSettings
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.values import BuiltinType, Variant
from ua_fleet.wire.discovered import (
    NO_SECURITY,
    DatagramConnectionTransport,
    DataSetWriter,
    NetworkAddressUrl,
    PubSubConnection,
    UadpDataSetWriterMessage,
    UadpWriterGroupMessage,
    WriterGroup,
)
from ua_fleet.wire.messages import FieldEncoding

__all__ = ["WriterGroups", "connection", "writer_group"]

NETWORK_MESSAGE_CONTENT: Final = 0x47
"""UadpNetworkMessageContentMask: PublisherId, GroupHeader, WriterGroupId, PayloadHeader (6.3.1.1.4)."""
DATA_SET_MESSAGE_CONTENT: Final = 0x3D
"""UadpDataSetMessageContentMask: Timestamp, Status, major and minor version, SequenceNumber (6.3.1.3.2)."""

RAW_DATA: Final = 0x20
"""Bit of the DataSetFieldContentMask (6.2.4.2)."""


class WriterGroups:
    """The DataSetWriters of a Publisher by WriterGroup, with their names."""

    def __init__(self) -> None:
        self._names: dict[int, dict[int, str]] = {}
        self._of_writer: dict[int, list[int]] = {}

    def put(self, ns: int, writer_id: int, name: str) -> bool:
        """Have a DataSetWriter with this name; says whether that is news."""
        names = self._names.setdefault(ns, {})
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


def writer_group(
    application: Application,
    timing: PubSubTiming,
    ns: int,
    writers: Iterable[tuple[int, str]],
    *,
    are_actions: bool = False,
    settings: Callable[[int], WriterSettings] = lambda _: PLAIN,
) -> WriterGroup:
    """A WriterGroup with these of its DataSetWriters: (DataSetWriterId, name). Messages go when there is news.

    `settings` says how a DataSetWriter sends.
    """
    security_group = application.command_group if are_actions else application.data_group
    return WriterGroup(
        f"actions {ns}" if are_actions else f"group {ns}",
        True,
        security_mode=NO_SECURITY if security_group is None else application.security_mode,
        security_group_id=security_group,
        max_network_message_size=application.max_message_bytes,
        writer_group_id=ns,
        keep_alive_time_ms=0.0 if are_actions else timing.keep_alive_s * 1000.0,
        message_settings=UadpWriterGroupMessage(network_message_content_mask=NETWORK_MESSAGE_CONTENT),
        data_set_writers=tuple(
            [
                _writer(writer_id, name, settings(writer_id), 0 if are_actions else DATA_SET_MESSAGE_CONTENT)
                for writer_id, name in writers
            ]
        ),
    )


def _writer(writer_id: int, name: str, settings: WriterSettings, content: int) -> DataSetWriter:
    return DataSetWriter(
        name,
        True,
        writer_id,
        data_set_field_content_mask=RAW_DATA if settings.encoding is FieldEncoding.RAW_DATA else 0,
        key_frame_count=0 if settings.are_events else settings.key_frame_count,
        data_set_name=name,
        message_settings=UadpDataSetWriterMessage(content),
    )


def connection(
    application: Application, timing: PubSubTiming, publisher_id: int, groups: tuple[WriterGroup, ...]
) -> PubSubConnection:
    """The PubSubConnection of a process of ours, which has one."""
    address = NetworkAddressUrl(application.network_interface, application.url)
    return PubSubConnection(
        application.description.application_name.text,
        True,
        application.publisher_id or Variant(int(BuiltinType.UINT16), publisher_id),
        UDP_UADP,
        address,
        transport_settings=DatagramConnectionTransport(address, round(timing.announce_interval_s)),
        writer_groups=groups,
    )
