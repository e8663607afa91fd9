"""Lines that are chained: each has its number and the hash of the line before it.

    {"time": .., "event": .., "seq": 7, "prev": "<SHA-256 of line 6, without its newline, in hex>"}

Whoever changes, removes or inserts a line breaks the chain behind it. What is said of a chain here needs no file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, cast

__all__ = ["BEGIN", "ChainLink", "digest_of", "encode_line", "link_of", "now_text", "parse_line"]

NO_LINE: Final = "0" * 64
_encode: Final = json.JSONEncoder(ensure_ascii=True, default=str).encode


@dataclass(frozen=True, slots=True)
class ChainLink:
    """Where a chain ends: the number of its last line, and that line's hash."""

    seq: int
    digest: str


BEGIN: Final = ChainLink(0, NO_LINE)
"""Before the first line."""


def digest_of(line: bytes) -> str:
    """The hash of a line without its newline."""
    return hashlib.sha256(line).hexdigest()


def now_text() -> str:
    """The time of a line: RFC 3339 in UTC, with milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def encode_line(record: Mapping[str, Any], after: ChainLink) -> tuple[bytes, ChainLink]:
    """A record as a line without its newline, in ASCII, and where the chain ends with it."""
    chained = {**record, "seq": after.seq + 1, "prev": after.digest}
    line = _encode(chained).encode()
    return line, ChainLink(after.seq + 1, digest_of(line))


def parse_line(line: bytes) -> dict[str, Any] | None:
    """A line's record; None for what is no line of an audit log."""
    try:
        record: Any = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return cast("dict[str, Any]", record) if isinstance(record, dict) else None


def link_of(record: Mapping[str, Any]) -> ChainLink | None:
    """Number of a line, and the hash of the one before it; None for a line of a version without a chain."""
    seq, prev = record.get("seq"), record.get("prev")
    if isinstance(seq, int) and not isinstance(seq, bool) and isinstance(prev, str):
        return ChainLink(seq, prev)
    return None
