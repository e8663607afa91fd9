"""The content of a recording, before it is compressed.

    "UAFLEETR", UInt16 version, UInt32 length, header as JSON
    each record: Byte kind (1 or 2), UInt64 time of receipt (ns since 1970), UInt16 connection,
                 UInt16, UInt16, UInt32 lengths of the next three; sender as text, key as text, datagram

A datagram stands there as it was received, so what was encrypted stays so. Over a broker it is the payload of a
message, and its sender is the topic; of kind 2 is what the broker had kept, which says nothing of the time at which it
came. `key` names the key that it was secured
with, `<SecurityGroup>/<SecurityTokenId>`, and is empty where it was not.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from struct import Struct
from typing import Any, Final, NamedTuple, cast

from ua_fleet.errors import UPGRADE, RemoteWireError, UaFleetError, newer_version
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.values import StatusCode
from ua_fleet.wire.security import SecurityMode, read_security

__all__ = [
    "MOST_DATAGRAM_BYTES",
    "Connection",
    "Header",
    "Record",
    "RecordingBroken",
    "encode_header",
    "encode_record",
    "key_name",
    "read_records",
]

MAGIC: Final = b"UAFLEETR"
VERSION: Final = 1
MOST_HEADER_BYTES: Final = 1024 * 1024
MOST_TEXT_BYTES: Final = 4096
MOST_DATAGRAM_BYTES: Final = 16 * 1024 * 1024

_HEAD: Final = Struct("<8sHI")
_RECORD: Final = Struct("<BQHHHI")
_FRESH, _KEPT = 1, 2


class RecordingBroken(UaFleetError):
    """A file is no recording, or not all of it."""

    ua_status = StatusCode.BAD_DECODING_ERROR
    remedy = "Name a file that `ua-fleet pubsub record` has written."


class Connection(NamedTuple):
    """Where it was listened."""

    url: str
    interface: str


class Header(NamedTuple):
    """What holds for the whole recording."""

    begun_ns: int
    connections: tuple[Connection, ...]
    setpoint_groups: tuple[tuple[int, int], ...] = ()
    """WriterGroups of the server's setpoints, each with its space."""


class Record(NamedTuple):
    """One datagram."""

    time_ns: int
    """By the wall clock of the recorder, since 1970."""
    connection: int
    sender: tuple[str, int]
    key: str
    datagram: bytes
    is_kept: bool = False
    """Whether a broker had kept it: it was sent at any time before."""


def key_name(datagram: bytes, setpoint_groups: dict[int, int]) -> str:
    """Which key a datagram says that it is secured with; empty where it is not secured, or cannot be read."""
    try:
        heard = read_security(datagram)
    except RemoteWireError:
        return ""
    publisher_id = heard.publisher_id
    if heard.mode is SecurityMode.NONE or not isinstance(publisher_id, int):
        return ""
    space = setpoint_groups.get(heard.writer_group_id or 0) if publisher_id == SERVER_SPACE else None
    if heard.is_action or (space is not None and not heard.is_discovery):
        return f"{command_group(publisher_id if space is None else space)}/{heard.token_id}"
    return f"{telemetry_group(publisher_id)}/{heard.token_id}"


def encode_header(header: Header) -> bytes:
    """The beginning of a recording."""
    content = json.dumps(
        {
            "begun_ns": header.begun_ns,
            "connections": [connection._asdict() for connection in header.connections],
            "setpoint_groups": [list(pair) for pair in header.setpoint_groups],
        }
    ).encode()
    return _HEAD.pack(MAGIC, VERSION, len(content)) + content


def encode_record(record: Record) -> bytes:
    """One record."""
    sender = f"{record.sender[0]} {record.sender[1]}".encode()[:MOST_TEXT_BYTES]
    key = record.key.encode()[:MOST_TEXT_BYTES]
    kind = _KEPT if record.is_kept else _FRESH
    head = _RECORD.pack(kind, record.time_ns, record.connection, len(sender), len(key), len(record.datagram))
    return b"".join((head, sender, key, record.datagram))


class _Cursor:
    """Takes bytes out of blocks as they come."""

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._blocks = iter(blocks)
        self._held = bytearray()

    def take(self, count: int) -> bytes | None:
        """So many bytes; None where fewer are left."""
        while len(self._held) < count:
            block = next(self._blocks, None)
            if block is None:
                return None
            self._held += block
        taken = bytes(self._held[:count])
        del self._held[:count]
        return taken


def read_records(blocks: Iterable[bytes]) -> tuple[Header, Iterator[Record]]:
    """What stands in a recording. A last record that is not whole is left out: its recorder was killed.

    Raises:
        RecordingBroken: it is none, or of a newer version; reading on, for a record that cannot be.
    """
    cursor = _Cursor(blocks)
    head = cursor.take(_HEAD.size)
    magic, version, size = _HEAD.unpack(head or bytes(_HEAD.size))
    if magic != MAGIC:
        raise RecordingBroken("it is no recording")
    if newer := newer_version(version, VERSION):
        raise RecordingBroken(f"{newer}; {UPGRADE}")
    content = cursor.take(size) if size <= MOST_HEADER_BYTES else None
    try:
        return _header(json.loads(content or b"")), _records(cursor)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RecordingBroken("the header of the recording cannot be read") from error


def _header(document: Any) -> Header:
    return Header(
        int(document["begun_ns"]),
        tuple([Connection(str(one["url"]), str(one["interface"])) for one in document["connections"]]),
        tuple([(int(group), int(space)) for group, space in document["setpoint_groups"]]),
    )


def _records(cursor: _Cursor) -> Iterator[Record]:
    while (head := cursor.take(_RECORD.size)) is not None:
        kind, time_ns, connection, sender_size, key_size, size = cast(
            "tuple[int, int, int, int, int, int]", _RECORD.unpack(head)
        )
        if kind not in (_FRESH, _KEPT) or max(sender_size, key_size) > MOST_TEXT_BYTES or size > MOST_DATAGRAM_BYTES:
            raise RecordingBroken("what follows in the recording is no record")
        rest = cursor.take(sender_size + key_size + size)
        if rest is None:
            return
        host, _, port = rest[:sender_size].decode(errors="replace").rpartition(" ")
        key = rest[sender_size : sender_size + key_size].decode(errors="replace")
        is_port = port.isascii() and port.isdecimal() and len(port) <= 5
        who = host, int(port) if is_port else 0
        yield Record(time_ns, connection, who, key, rest[sender_size + key_size :], kind == _KEPT)
