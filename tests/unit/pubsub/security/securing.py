"""Keys, envelopes and plain messages for the tests of this folder."""

from __future__ import annotations

import struct
from random import Random
from typing import Any

from tests.unit.pubsub.publishing import CODEC
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.keyring import GroupKeys, next_token_id
from ua_fleet.pubsub.security.nonces import MemoryNonces, NonceReservations
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.values import BuiltinType
from ua_fleet.wire import SecurityMode, SecurityPolicy, encode_metadata_announcement, encode_probe
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)

AES256 = SecurityPolicy.AES256_CTR
NONE, SIGN, ENCRYPT = SecurityMode.NONE, SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT
STRING = int(BuiltinType.STRING)
UINT16 = PublisherIdType.UINT16.value


def key_data(token_id: int, seed: int | str = 0, policy: SecurityPolicy = AES256) -> bytes:
    """The key of a token of one service; other seeds are other services or groups."""
    return Random(f"{seed}/{token_id}").randbytes(policy.key_data_bytes)


def group_keys(
    first: int = 1,
    count: int = 3,
    *,
    seed: int | str = 0,
    next_s: float = 60.0,
    lifetime_s: float = 60.0,
    policy: SecurityPolicy = AES256,
) -> GroupKeys:
    tokens = [first]
    while len(tokens) < count:
        tokens.append(next_token_id(tokens[-1]))
    return GroupKeys(policy, first, tuple(key_data(token, seed, policy) for token in tokens), next_s, lifetime_s)


def envelope(
    space: int,
    *groups: str,
    mode: SecurityMode = ENCRYPT,
    nonces: NonceReservations | None = None,
    seed: int | str = 0,
    counters: Counters | None = None,
    random: int | None = None,
    **more: Any,
) -> Envelope:
    """An envelope that has got the keys of these groups at time 0; each group has its own."""
    made = Envelope(
        space,
        counters or Counters(),
        mode=mode,
        nonces=nonces or MemoryNonces(),
        random=Random(space if random is None else random),
        **more,
    )
    for group_id in groups:
        made.want(group_id)
        made.install(group_id, group_keys(seed=f"{seed}{group_id}"), 0.0)
    return made


def data(text: str = "a", publisher_id: int = 1, *, writer_id: int = 1001, **header: Any) -> bytes:
    """A plain message with one String."""
    part = DataSetMessage(writer_id, types=(STRING,), values=(text,), major_version=1, minor_version=1)
    arguments: dict[str, Any] = {"publisher_id_type": UINT16, "writer_group_id": 2, **header}
    return CODEC.encode(NetworkMessage(publisher_id, messages=(part,), **arguments))


def action(text: bytes = b"act", publisher_id: int = 1) -> bytes:
    """A plain message with an ActionHeader; only its outline is like that of one."""
    return struct.pack("<BBBHBHBH", 0xF1, 0x81, 0x20, publisher_id, 1, 2, 1, 1001) + text


def announcement(publisher_id: int = 1, version: int = 1) -> bytes:
    metadata = DataSetMetaData("forged", (), ConfigurationVersion(version, version))
    return encode_metadata_announcement(MetaDataAnnouncement(publisher_id, UINT16, 0, 1001, metadata))


def probe(publisher_id: int = 1) -> bytes:
    return encode_probe(Probe(publisher_id, UINT16, ProbeKind.DATA_SET_META_DATA.value, (1001,)))


def one(datagrams: list[bytes]) -> bytes:
    (datagram,) = datagrams
    return datagram


def refusal(opener: Envelope, datagram: bytes, now: float = 0.0) -> Drop:
    """Why a datagram is refused."""
    try:
        opened = opener.open(datagram, now)
    except DatagramRefused as refused:
        return refused.drop
    raise AssertionError(f"not refused: {opened!r}")
