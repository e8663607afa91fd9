"""A publisher that sends any bytes to a fleet's multicast group, from a plain socket."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ua_fleet.topics import Topic
from ua_fleet.transport.addresses import parse_url
from ua_fleet.values import ticks_from_unix_ns
from ua_fleet.wire import Codec, encode_metadata_announcement
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldMetaData,
    MetaDataAnnouncement,
    NetworkMessage,
    PublisherIdType,
)

__all__ = ["Stranger", "group_of", "stranger"]

_UINT16 = PublisherIdType.UINT16


def group_of(folder: Path) -> tuple[str, int]:
    """Address and port of the multicast group in the `fleet.yaml` of a folder."""
    return parse_url(json.loads((folder / "fleet.yaml").read_text())["pubsub"]["url"])


class Stranger:
    """Says whatever it likes, under any PublisherId."""

    def __init__(self, link: socket.socket) -> None:
        self._link, self._codec, self._number = link, Codec(), 0

    def send(self, datagram: bytes) -> None:
        """Send any bytes."""
        self._link.send(datagram)

    def announce(self, topic: Topic, name: str, fields: Sequence[FieldMetaData], version: int) -> None:
        """Announce the metadata of a DataSet."""
        metadata = DataSetMetaData(name, tuple(fields), ConfigurationVersion(version, version))
        self.send(
            encode_metadata_announcement(
                MetaDataAnnouncement(topic.space, _UINT16, self._next(), topic.id, metadata),
            )
        )

    def publish(self, topic: Topic, types: Sequence[int], values: Sequence[Any], version: int) -> None:
        """Send a key frame."""
        part = DataSetMessage(
            topic.id,
            types=tuple(types),
            values=tuple(values),
            sequence_number=self._next(),
            timestamp=ticks_from_unix_ns(time.time_ns()),
            major_version=version,
            minor_version=version,
        )
        message = NetworkMessage(publisher_id=topic.space, writer_group_id=topic.ns, messages=(part,))
        self.send(self._codec.encode(message))

    def _next(self) -> int:
        self._number = (self._number + 1) & 0xFFFF
        return self._number


@contextmanager
def stranger(folder: Path) -> Generator[Stranger]:
    """One that reaches the group of the fleet in a folder."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        link.connect(group_of(folder))
        yield Stranger(link)
