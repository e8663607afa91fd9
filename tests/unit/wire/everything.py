"""Messages of every kind there is, plain, in chunks, and secured: what the fuzz and limits tests start from."""

from __future__ import annotations

import struct

from tests.unit.wire.corpus import valid_messages
from tests.unit.wire.discovery_samples import ANNOUNCEMENTS
from ua_fleet.wire import encode_probe
from ua_fleet.wire.actions import ActionMessage, ActionState, encode_action
from ua_fleet.wire.announcements import encode_announcement
from ua_fleet.wire.chunks import read_chunk, split
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType
from ua_fleet.wire.security import MessageKey, SecurityMode, SecurityPolicy, payload_offset, read_security

U16 = PublisherIdType.UINT16
PROBES = (
    Probe(None, PublisherIdType.STRING, ProbeKind.FIND_APPLICATIONS),
    Probe(7, U16, ProbeKind.ENDPOINTS),
    Probe(7, U16, ProbeKind.DATA_SET_META_DATA, (1, 2, 3)),
    Probe(7, U16, ProbeKind.DATA_SET_WRITER_CONFIGURATION),
    Probe(7, U16, ProbeKind.WRITER_GROUP_CONFIGURATION, (), 5, (), include_data_set_writers=True),
    Probe(7, U16, ProbeKind.PUBSUB_CONNECTIONS, (), 0, ("a", "b"), include_writer_groups=True),
)

_REQUEST = ActionMessage(
    2,
    2,
    1003,
    1,
    7,
    ActionState.EXECUTING,
    is_request=True,
    requestor_id="0.1",
    correlation_data=bytes(range(16)),
    timeout_hint_ms=500.0,
    types=(12, 11),
    values=("pick", 0.5),
    timestamp=1,
)
_RESPONSE = ActionMessage(2, 2, 1003, 1, 7, ActionState.DONE, is_request=False, status=0x8031_0000)
ACTIONS = (
    _REQUEST,
    _REQUEST._replace(response_address="opc.udp://224.0.2.14:4840", types=(), values=()),
    _REQUEST._replace(others=(_REQUEST._replace(request_id=8, data_set_writer_id=1004),)),
    _REQUEST._replace(values=("pick " * 40, 0.5)),
    _RESPONSE._replace(correlation_data=bytes(16), types=(1,), values=(True,)),
    ActionMessage("robot", None, 0, 0, 0, 0, is_request=False, publisher_id_type=PublisherIdType.STRING),
)


def plain_messages() -> list[bytes]:
    """Data, Actions, probes and announcements of every kind, and what was recorded."""
    return [
        *valid_messages(),
        *[encode_announcement(announcement) for announcement in ANNOUNCEMENTS.values()],
        *[encode_probe(probe) for probe in PROBES],
        *[encode_action(action) for action in ACTIONS],
    ]


KEYS = (
    MessageKey(SecurityPolicy.AES128_CTR, bytes(range(52))),
    MessageKey(SecurityPolicy.AES256_CTR, bytes(range(68))),
)
"""Those of the vectors."""


def is_plain(datagram: bytes) -> bool:
    """Whether a message is not secured, so that it can be."""
    return read_security(datagram).mode is SecurityMode.NONE


def chunked_messages() -> list[bytes]:
    """Messages of every kind in chunks, first, middle and last ones."""
    whole = [
        message
        for message in plain_messages()
        if is_plain(message) and read_chunk(message) is None and len(read_security(message).writer_ids) <= 1
    ]
    chunks = [split(message, 120, number) for number, message in enumerate(whole) if len(message) > 120]
    return [chunk for parts in chunks for chunk in (parts[0], *parts[1:-1][:1], parts[-1])]


def secured_messages() -> list[bytes]:
    """Messages and chunks of every kind, signed, and signed and encrypted, with both policies."""
    secured: list[bytes] = []
    for number, plain in enumerate([*plain_messages(), *chunked_messages()]):
        if not is_plain(plain):
            continue
        offset, nonce = payload_offset(plain), struct.pack("<II", 5, number + 1)
        for mode in (SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT):
            secured += [key.protect(plain, offset, 1, nonce, mode, force_key_reset=number % 7 == 0) for key in KEYS]
    return secured
