"""MCAP (https://mcap.dev/spec), which Foxglove opens: a channel for each DataSet, its messages as JSON with a schema.

header | chunks, each with its message indexes | data end | schemas, channels, chunk indexes, statistics | footer
"""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from struct import Struct
from typing import Any, Final

from ua_fleet.topics import Topic
from ua_fleet.values import (
    TICKS_PER_SECOND,
    BuiltinType,
    LocalizedText,
    Matrix,
    NodeId,
    datetime_from_ticks,
    status_name,
    unix_ns_from_ticks,
)
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FieldMetaData

__all__ = ["McapWriter"]

MAGIC: Final = b"\x89MCAP0\r\n"
CHUNK_BYTES: Final = 1024 * 1024
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
_MESSAGE_INDEX, _CHUNK_INDEX, _STATISTICS, _SUMMARY_OFFSET, _DATA_END = 0x07, 0x08, 0x0B, 0x0E, 0x0F
_OP: Final = Struct("<BQ")
_U16, _U32, _U64 = Struct("<H"), Struct("<I"), Struct("<Q")
_MESSAGE_HEAD: Final = Struct("<HIQQ")
_MOST_TIME: Final = (1 << 64) - 1


def _record(opcode: int, *parts: bytes) -> bytes:
    content = b"".join(parts)
    return _OP.pack(opcode, len(content)) + content


def _text(text: str) -> bytes:
    content = text.encode()
    return _U32.pack(len(content)) + content


def _sized(*parts: bytes) -> bytes:
    content = b"".join(parts)
    return _U32.pack(len(content)) + content


@dataclass(slots=True)
class _Chunk:
    """What is collected before it is written."""

    content: bytearray = field(default_factory=bytearray)
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict[int, list[tuple[int, int]]])
    """(time, offset) of the messages of each channel."""
    first: int = _MOST_TIME
    last: int = 0


class McapWriter:
    """Writes DataSets as they come. `put` takes the bytes of the file, in order."""

    def __init__(self, put: Callable[[bytes], object], compress: Callable[[bytes], bytes]) -> None:
        """Begin a file; `compress` is zstd."""
        self._write, self._compress = put, compress
        self._at = 0
        self._chunk = _Chunk()
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._known: dict[tuple[Topic, DataSetMetaData], int] = {}
        self._counts: dict[int, int] = {}
        self._chunk_indexes: list[bytes] = []
        self._first, self._last = _MOST_TIME, 0
        self._put(MAGIC, _record(_HEADER, _text(""), _text("ua-fleet")))

    def add(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage, received_ns: int) -> None:
        """A message of a DataSet, received at this time (ns since 1970)."""
        channel = self._channel(topic, metadata)
        count = self._counts[channel] = self._counts.get(channel, 0) + 1
        stamp = message.timestamp
        published = received_ns if stamp is None else max(0, unix_ns_from_ticks(stamp))
        content = json.dumps(_content(metadata, message), ensure_ascii=False, allow_nan=False).encode()
        chunk = self._chunk
        chunk.index.setdefault(channel, []).append((received_ns, len(chunk.content)))
        head = _MESSAGE_HEAD.pack(channel, count & 0xFFFF_FFFF, received_ns, published)
        chunk.content += _record(_MESSAGE, head, content)
        chunk.first, chunk.last = min(chunk.first, received_ns), max(chunk.last, received_ns)
        if len(chunk.content) >= CHUNK_BYTES:
            self._end_chunk()

    def end(self) -> None:
        """Write what is left, and the summary."""
        self._end_chunk()
        self._put(_record(_DATA_END, _U32.pack(0)))
        summary_start, offsets = self._at, list[bytes]()
        for opcode, records in (
            (_SCHEMA, self._schemas),
            (_CHANNEL, self._channels),
            (_CHUNK_INDEX, self._chunk_indexes),
            (_STATISTICS, [self._statistics()]),
        ):
            start = self._at
            self._put(*records)
            if records:
                offsets.append(
                    _record(_SUMMARY_OFFSET, bytes((opcode,)), _U64.pack(start), _U64.pack(self._at - start))
                )
        offset_start = self._at
        self._put(*offsets)
        self._put(_record(_FOOTER, _U64.pack(summary_start), _U64.pack(offset_start), _U32.pack(0)), MAGIC)

    def _channel(self, topic: Topic, metadata: DataSetMetaData) -> int:
        """The channel of a DataSet with this metadata, made where it is new; it stands in the chunk that needs it."""
        known = self._known.get((topic, metadata))
        if known is not None:
            return known
        number = self._known[topic, metadata] = len(self._channels) + 1
        version = metadata.configuration_version
        details = {
            "name": metadata.name,
            "space": str(topic.space),
            "configuration_version": f"{version.major}.{version.minor}",
        }
        schema = json.dumps(_schema(metadata)).encode()
        number_bytes = _U16.pack(number)
        self._schemas.append(
            _record(_SCHEMA, number_bytes, _text(metadata.name or topic.name), _text("jsonschema"), _sized(schema))
        )
        pairs = _sized(*[_text(key) + _text(value) for key, value in details.items()])
        self._channels.append(_record(_CHANNEL, number_bytes, number_bytes, _text(topic.name), _text("json"), pairs))
        self._chunk.content += self._schemas[-1] + self._channels[-1]
        return number

    def _end_chunk(self) -> None:
        chunk, self._chunk = self._chunk, _Chunk()
        if not chunk.index:
            return
        content = bytes(chunk.content)
        packed = self._compress(content)
        start = self._at
        times = _U64.pack(chunk.first) + _U64.pack(chunk.last)
        record = _record(
            _CHUNK,
            times,
            _U64.pack(len(content)) + _U32.pack(zlib.crc32(content)),
            _text("zstd"),
            _U64.pack(len(packed)) + packed,
        )
        self._put(record)
        places: list[bytes] = []
        indexes_at = self._at
        for channel, entries in chunk.index.items():
            places.append(_U16.pack(channel) + _U64.pack(self._at))
            pairs = _sized(*[_U64.pack(at) + _U64.pack(offset) for at, offset in entries])
            self._put(_record(_MESSAGE_INDEX, _U16.pack(channel), pairs))
        self._chunk_indexes.append(
            _record(
                _CHUNK_INDEX,
                times,
                _U64.pack(start) + _U64.pack(len(record)),
                _sized(*places),
                _U64.pack(self._at - indexes_at),
                _text("zstd"),
                _U64.pack(len(packed)) + _U64.pack(len(content)),
            )
        )
        self._first, self._last = min(self._first, chunk.first), max(self._last, chunk.last)

    def _statistics(self) -> bytes:
        counts = [_U16.pack(channel) + _U64.pack(count) for channel, count in self._counts.items()]
        is_empty = not counts
        return _record(
            _STATISTICS,
            _U64.pack(sum(self._counts.values())),
            _U16.pack(len(self._schemas)) + _U32.pack(len(self._channels)) + _U32.pack(0) + _U32.pack(0),
            _U32.pack(len(self._chunk_indexes)),
            _U64.pack(0 if is_empty else self._first) + _U64.pack(self._last),
            _sized(*counts),
        )

    def _put(self, *parts: bytes) -> None:
        for part in parts:
            self._write(part)
            self._at += len(part)


_INTEGERS: Final = frozenset(range(BuiltinType.SBYTE, BuiltinType.UINT64 + 1))
_FLOATS: Final = (BuiltinType.FLOAT, BuiltinType.DOUBLE)


def _schema(metadata: DataSetMetaData) -> dict[str, Any]:
    """JSON Schema of the messages of a DataSet."""
    fields = {one.name: _field_schema(one) for one in metadata.fields}
    text = {"type": "string"}
    return {
        "title": metadata.name,
        "type": "object",
        "properties": {
            "time": {"type": "string", "format": "date-time"},
            "status": text,
            "fields": {"type": "object", "properties": fields},
        },
    }


def _field_schema(one: FieldMetaData) -> dict[str, Any]:
    kind = one.builtin_type
    if kind == BuiltinType.BOOLEAN:
        schema: dict[str, Any] = {"type": "boolean"}
    elif kind in _INTEGERS:
        schema = {"type": "integer"}
    elif kind in _FLOATS:
        schema = {"type": "number"}
    elif kind == BuiltinType.DATETIME:
        schema = {"type": "string", "format": "date-time"}
    elif kind == BuiltinType.BYTE_STRING:
        schema = {"type": "string", "contentEncoding": "base64"}
    else:
        schema = {"type": "string"}
    return {"type": "array", "items": schema} if one.value_rank > 0 else schema


def _content(metadata: DataSetMetaData, message: DataSetMessage) -> dict[str, Any]:
    stamp = message.timestamp
    named = zip(metadata.fields, message.types, message.values, strict=False)
    return {
        "time": None if stamp is None else _time(stamp),
        "status": status_name(message.status or 0),
        "fields": {one.name: _plain(one, code, value) for one, code, value in named},
    }


def _time(ticks: int) -> str:
    """ISO 8601 with 100 ns."""
    whole, rest = divmod(ticks, TICKS_PER_SECOND)
    return f"{datetime_from_ticks(whole * TICKS_PER_SECOND):%Y-%m-%dT%H:%M:%S}.{rest:07d}Z"


def _plain(one: FieldMetaData, code: int, value: Any) -> Any:
    """A value as JSON has it; null for none, for NaN and infinity, and for a field that is Bad."""
    if isinstance(value, Matrix):
        value = value.values
    if one.value_rank > 0 and value is not None and code != BuiltinType.STATUS_CODE:
        return [_plain_element(one.builtin_type, item) for item in value]
    return None if code == BuiltinType.STATUS_CODE != one.builtin_type else _plain_element(one.builtin_type, value)


def _plain_element(kind: int, value: Any) -> Any:
    if kind == BuiltinType.BYTE_STRING and value is not None:
        return base64.b64encode(value).decode("ascii")
    if kind == BuiltinType.DATETIME and isinstance(value, int):
        return _time(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, LocalizedText):
        return value.text
    if isinstance(value, NodeId):
        return f"ns={value.namespace};{'i' if isinstance(value.identifier, int) else 's'}={value.identifier!s}"
    return value if value is None or isinstance(value, bool | int | str) else str(value)
