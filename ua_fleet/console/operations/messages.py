"""PubSub messages byte by byte."""

from __future__ import annotations

import base64
import binascii
from typing import Any, Final

from pydantic import Field, field_validator

from ua_fleet.client import FleetClient
from ua_fleet.console.dissecting import dissected
from ua_fleet.console.operations.kinds import OperationKind, OperationParameters

__all__ = ["MESSAGE_OPERATIONS"]

MOST_BYTES: Final = 8192


class Message(OperationParameters):
    """A message as the feed `messages` has it."""

    data: str = Field(max_length=MOST_BYTES * 4 // 3 + 4)
    open: bool = True
    whole: bool = True

    @field_validator("data")
    @classmethod
    def _is_base64(cls, data: str) -> str:
        try:
            base64.b64decode(data, validate=True)
        except binascii.Error as error:
            raise ValueError(f"no base64: {error}") from None
        return data


async def _dissect(_client: FleetClient, asked: Message) -> dict[str, Any]:
    return dissected(base64.b64decode(asked.data), is_open=asked.open, is_whole=asked.whole)


MESSAGE_OPERATIONS: Final = (OperationKind("messages.dissect", Message, _dissect, "RecentMessages", "engineer"),)
