"""The codec that publishers and subscribers use."""

from __future__ import annotations

from ua_fleet.wire.encode_plan import WriterPlan
from ua_fleet.wire.generic import Decoded, decode_message, encode_message
from ua_fleet.wire.messages import NetworkMessage

__all__ = ["Codec"]


class Codec:
    """Encodes and decodes UADP messages. Compiled plans make known layouts fast; the result is the same."""

    def decode(self, datagram: bytes) -> Decoded:
        """Decode one datagram; raises RemoteWireError and nothing else."""
        return decode_message(datagram)

    def encode(self, message: NetworkMessage) -> bytes:
        """Encode one NetworkMessage; raises LocalWireError on what cannot be encoded."""
        return encode_message(message)

    def writer_plan(
        self,
        publisher_id: int,
        writer_group_id: int,
        data_set_writer_id: int,
        types: tuple[int, ...],
        major_version: int,
        minor_version: int,
    ) -> WriterPlan:
        """A plan for the key frames of one DataSetWriter (see the package's docstring)."""
        return WriterPlan(publisher_id, writer_group_id, data_set_writer_id, types, major_version, minor_version)
