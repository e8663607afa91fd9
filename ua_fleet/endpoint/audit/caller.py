"""Who did something, and a value of theirs, as a line of the audit log has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, cast

from ua_fleet.endpoint.origin import origin

__all__ = ["Caller", "summary"]

MAX_SUMMARY: Final = 200
MAX_ITEMS: Final = 8
_NUMBERS: Final = (float, int, bool)
_DEEPEST: Final = 2
"""Levels of nested values that are shown."""


@dataclass(frozen=True, slots=True)
class Caller:
    """Who did it: as much as is known at that point."""

    client: str
    user: str = ""
    role: str = ""
    session: str = ""

    @property
    def address(self) -> str:
        """The client's address without the port."""
        return self.client.rpartition(":")[0] or self.client

    @property
    def is_stranger(self) -> bool:
        """Whether no user is known, so that one may be many of these."""
        return self.user in ("", "anonymous")

    @property
    def counts_as(self) -> str:
        """Whom a line counts for: the user, from whichever address; without one the address."""
        return origin(self.address) if self.is_stranger else f"user {self.user}"


def summary(value: Any) -> str:
    """A value as short text for one line of the log; it takes no longer for a large value than for a small one."""
    text = repr(value) if type(value) in _NUMBERS else _summary(value, 0)
    return text if len(text) <= MAX_SUMMARY else text[:MAX_SUMMARY] + ".."


def _summary(value: Any, depth: int) -> str:
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, str):
        return repr(value[: MAX_SUMMARY + 1])
    if isinstance(value, list | tuple):
        items = cast("Sequence[Any]", value)
        if len(items) > MAX_ITEMS or depth == _DEEPEST:
            return f"array of {len(items)}"
        return f"[{', '.join([_summary(item, depth + 1) for item in items])}]"
    if dataclasses.is_dataclass(value):
        name = type(value).__name__
        if depth == _DEEPEST:
            return name
        shown = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value) if field.repr]
        return f"{name}({', '.join([f'{name}={_summary(content, depth + 1)}' for name, content in shown])})"
    return repr(value)
