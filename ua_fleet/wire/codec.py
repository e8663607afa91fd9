"""The codec that publishers and subscribers use."""

from __future__ import annotations

from ua_fleet.wire.generic import Decoded, decode_message, encode_message
from ua_fleet.wire.messages import NetworkMessage

__all__ = ["Codec"]


class Codec:
    """Encodes and decodes UADP messages. Compiled plans make messages of a known layout fast; the result is the same."""

    def decode(self, datagram: bytes) -> Decoded:
        """Decode one datagram; raises RemoteWireError and nothing else."""
        return decode_message(datagram)

    def encode(self, message: NetworkMessage) -> bytes:
        """Encode one NetworkMessage; raises LocalWireError on what cannot be encoded."""
        return encode_message(message)
