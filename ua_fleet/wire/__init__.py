"""Part 14 messages as bytes: pure, no I/O. What a message claims is checked; what it means is not.

    codec = Codec()                          # one for each process: it owns the bounded caches of compiled plans
    codec.decode(datagram)                   -> NetworkMessage | Probe | MetaDataAnnouncement | Announcement
                                                or raises RemoteWireError(cause, detail, offset), nothing else;
                                                SecuredMessage, a RemoteWireError, for what only keys can open
    codec.encode(network_message)            -> bytes, or raises LocalWireError
    encode_probe(probe)                      -> bytes
    encode_metadata_announcement(announced)  -> bytes
    decode_raw_fields(message, metadata)     -> the DataSetMessage with `types` and `values` in place of `raw`

`encode` is fastest for a NetworkMessage with one DataSetMessage of a known layout. It compares the header and the
`types` of a message with those of the last one of the same (PublisherId, WriterGroupId, DataSetWriterId), so pass the
same tuple object as `types` each time.
"""

from ua_fleet.wire.causes import Cause, SecuredMessage
from ua_fleet.wire.codec import Codec
from ua_fleet.wire.discovery import encode_metadata_announcement, encode_probe
from ua_fleet.wire.raw import decode_raw_fields

__all__ = [
    "Cause",
    "Codec",
    "SecuredMessage",
    "decode_raw_fields",
    "encode_metadata_announcement",
    "encode_probe",
]
