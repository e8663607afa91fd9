"""Plans that encode the messages of one DataSetWriter."""

from __future__ import annotations

from typing import Any

from ua_fleet.wire.generic import encode_message
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, PublisherIdType

__all__ = ["WriterPlan"]


class WriterPlan:
    """Encodes the key frames of one DataSetWriter with one ConfigurationVersion."""

    def __init__(
        self,
        publisher_id: int,
        writer_group_id: int,
        data_set_writer_id: int,
        types: tuple[int, ...],
        major_version: int,
        minor_version: int,
    ) -> None:
        self._network_message = NetworkMessage(
            publisher_id=publisher_id,
            publisher_id_type=PublisherIdType.UINT16.value,
            writer_group_id=writer_group_id,
        )
        self._message = DataSetMessage(
            data_set_writer_id,
            kind=FrameKind.KEY.value,
            types=types,
            major_version=major_version,
            minor_version=minor_version,
        )

    def encode(self, sequence_number: int, timestamp: int, status: int, values: tuple[Any, ...]) -> bytes:
        """The NetworkMessage with these values; raises LocalWireError on a value that does not fit its type."""
        part = self._message._replace(
            values=values, sequence_number=sequence_number, timestamp=timestamp, status=status
        )
        return encode_message(self._network_message._replace(messages=(part,)))
