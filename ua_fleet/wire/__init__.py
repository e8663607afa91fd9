"""Part 14 messages as bytes: pure, no I/O. What a message claims is checked; what it means is not.

    codec = Codec()                          # one for each process: it owns the bounded caches of compiled plans
    codec.decode(datagram)                   -> NetworkMessage | Probe | an announcement of `discovered.py`
                                                | ActionMessage
                                                or raises RemoteWireError(cause, detail, offset), nothing else;
                                                SecuredMessage, a RemoteWireError, for what was not opened before
    codec.encode(network_message)            -> bytes, or raises LocalWireError
    encode_probe(probe)                      -> bytes
    encode_announcement(announcement)        -> bytes, of any kind
    encode_action(action_message)            -> bytes, of a request or response
    decode_raw_fields(message, metadata)     -> the DataSetMessage with `types` and `values` in place of `raw`

For a writer that sends one DataSetMessage after the other there is something faster than `encode`, bound once:

    plan = codec.writer_plan(publisher_id, writer_group_id, data_set_writer_id, types, major_version, minor_version)
    plan.encode(sequence_number, timestamp, status, values) -> bytes

A key frame with UInt16 PublisherId, WriterGroupId, payload header, Variant fields, and everything named in the header.
The bytes are those of `codec.encode`; `status` is a whole StatusCode of which the upper 16 bits travel; a value that
does not fit its type raises LocalWireError. `types` has to be a tuple of type codes. Plans are cheap to make and need
not be given back; make a new one when types or version change.

Security and chunks are transforms of whole datagrams around the codec, which knows plain and whole messages only:

    key = MessageKey(SecurityPolicy.AES256_CTR, key_data)
    for part in split(plain, most_bytes, message_sequence_number):       # chunks, where it is too long for one datagram
        key.protect(part, payload_offset(part), token_id, nonce, SecurityMode.SIGN_AND_ENCRYPT)     -> bytes

    heard = read_security(datagram)                                      # claims: sender, mode, token, nonce
    plain = key.unprotect(heard)                                         # or RemoteWireError(Cause.SIGNATURE)
    chunk = read_chunk(plain)                                            # None: it is a whole message
    join(chunk, *parts)                                                  -> bytes, once the data of all chunks is there

The same messages as JSON are in `ua_fleet.wire.json`.
"""

from ua_fleet.wire.actions import ActionMessage, ActionState, encode_action
from ua_fleet.wire.causes import Cause, SecuredMessage
from ua_fleet.wire.chunks import Chunk, join, read_chunk, split
from ua_fleet.wire.codec import Codec
from ua_fleet.wire.discovery import encode_announcement, encode_metadata_announcement, encode_probe
from ua_fleet.wire.encode_plan import WriterPlan
from ua_fleet.wire.raw import decode_raw_fields
from ua_fleet.wire.security import (
    MessageKey,
    SecuredDatagram,
    SecurityMode,
    SecurityPolicy,
    payload_offset,
    read_security,
)

__all__ = [
    "ActionMessage",
    "ActionState",
    "Cause",
    "Chunk",
    "Codec",
    "MessageKey",
    "SecuredDatagram",
    "SecuredMessage",
    "SecurityMode",
    "SecurityPolicy",
    "WriterPlan",
    "decode_raw_fields",
    "encode_action",
    "encode_announcement",
    "encode_metadata_announcement",
    "encode_probe",
    "join",
    "payload_offset",
    "read_chunk",
    "read_security",
    "split",
]
