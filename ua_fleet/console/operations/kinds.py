"""What an operation is."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict

from ua_fleet.client import FleetClient

__all__ = ["Bytes", "OperationKind", "OperationParameters"]


class OperationParameters(BaseModel):
    """What a page says of what it wants done; an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True, slots=True)
class Bytes:
    """An answer that is bytes, which no browser has to read as JSON, behind what is said of them."""

    head: dict[str, Any]
    """What JSON can hold."""
    content: bytes


@dataclass(frozen=True, slots=True)
class OperationKind:
    """Something that is asked for once and has one answer."""

    name: str
    """`subject.verb`."""
    parameters: type[OperationParameters]
    run: Callable[[FleetClient, Any], Awaitable[Any]]
    """Its result is what JSON can hold, or Bytes."""
    method: str
    """What the server is asked for, as it is named where rights are missing."""
    role: str
    """The least role that may: observer, operator or engineer. A page hides by it; the server decides."""
    timeout_s: float = 20.0
