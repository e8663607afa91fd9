"""Lines of our processes' logs, which are JSON where there is no terminal, as lines for people."""

from __future__ import annotations

import json
from typing import Any, Final

from ua_fleet.document import as_mapping

__all__ = ["readable"]

_NOT_SHOWN: Final = ("event", "level", "timestamp", "logger", "exception", "process", "bridge")


def readable(line: str) -> list[str]:
    """A line of a log as `level event name=value ..`, with its traceback below; any other line as it is."""
    record = _record(line)
    if record is None:
        return [line]
    details = [f"{name}={value}" for name, value in record.items() if name not in _NOT_SHOWN]
    first = " ".join([f"{record.get('level') or ''!s:<8}", str(record["event"]), *details])
    return [first, *str(record.get("exception") or "").splitlines()]


def _record(line: str) -> dict[str, Any] | None:
    if not line.startswith("{"):
        return None
    try:
        found = as_mapping(json.loads(line))
    except ValueError:
        return None
    return dict(found) if found is not None and "event" in found else None
