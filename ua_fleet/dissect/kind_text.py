"""What kind of message a NetworkMessage is, in the words of the specification: for lists that people look at."""

from __future__ import annotations

from ua_fleet.dissect.annotate_payload import INFORMATION_TYPES, KINDS, PROBE_TYPES
from ua_fleet.errors import RemoteWireError
from ua_fleet.wire import actions as a
from ua_fleet.wire import data_set_message as d
from ua_fleet.wire.announcements import ANNOUNCEMENT_NAMES
from ua_fleet.wire.discovery import INFORMATION_PROBE
from ua_fleet.wire.header import MESSAGE_TYPE_BITS, MessageType
from ua_fleet.wire.outline import is_chunk
from ua_fleet.wire.security import SecuredDatagram, read_security

__all__ = ["kind_text"]

_PROBE = MessageType.PROBE << 2


def kind_text(message: bytes) -> str:
    """The kind of a plain message, or of one in its opened form (`security.opened_form`); empty: none can be read.

    Of several DataSetMessages it is that of the first one. It says nothing of whether the message is right.
    """
    try:
        heard = read_security(message)
        return "chunk" if is_chunk(message) else _kind(heard)
    except (RemoteWireError, IndexError):
        return ""


def _kind(heard: SecuredDatagram) -> str:
    message, at = heard.datagram, heard.payload_offset
    if heard.is_action:
        return "Action request" if message[at] & a.IS_REQUEST else "Action response"
    if heard.is_discovery:
        if message[2] & MESSAGE_TYPE_BITS != _PROBE:
            return f"announcement: {ANNOUNCEMENT_NAMES[message[at]]}" if message[at] in ANNOUNCEMENT_NAMES else ""
        kinds = INFORMATION_TYPES if message[at] == INFORMATION_PROBE else PROBE_TYPES
        said = kinds.get(message[at + 1] if message[at] == INFORMATION_PROBE else message[at])
        return f"probe: {said}" if said else ""
    count = len(heard.writer_ids) or 1
    if count > 1:
        at += 2 * count
    flags1 = message[at]
    if not flags1 & d.IS_VALID:
        return "not valid"
    return KINDS.get(message[at + 1] & d.FRAME_KIND_BITS if flags1 & d.HAS_FLAGS_2 else 0, "")
