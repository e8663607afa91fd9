# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""The last PubSub messages of the server, opened, for engineers (docs/pubsub.md)."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from asyncua import ua

from ua_fleet.client.fleet_client import FleetClient
from ua_fleet.client.methods import call_method, text

__all__ = ["MessagesHeard", "PubSubMessage", "recent_messages"]


@dataclass(frozen=True, slots=True)
class PubSubMessage:
    """A NetworkMessage that the server has sent or received."""

    number: int
    """Rises from one to the next."""
    time: datetime
    sent: bool
    address: str
    """Where it came from, or went to alone; empty: it went to all."""
    data: bytes
    """Its beginning, with what was encrypted in plain where it is `opened`."""
    size: int
    """Bytes of the whole message."""
    opened: bool
    security: str
    """`None`, `Sign` or `SignAndEncrypt`."""
    token_id: int
    in_chunks: bool
    dropped: tuple[str, ...]
    """Causes for which it, or a part of it, was dropped."""


@dataclass(frozen=True, slots=True)
class MessagesHeard:
    """An answer."""

    messages: tuple[PubSubMessage, ...]
    lost: int
    """Messages that had no place at the server since the last call."""
    has_more: bool


async def recent_messages(client: FleetClient, source: str = "", after: int = 0) -> MessagesHeard:
    """What the server has sent and received; kept from the first call on, while the next one comes within 15 s.

    Args:
        client: connected, as an engineer.
        source: whose messages: a PublisherId, or a UA topic; empty: all.
        after: the number of the last message that is known; 0: all that are kept.

    Raises:
        NotDone: too many look at messages.
        AccessRefused: the server has no such Method, or refuses it to this user.
        NotConnected: the connection was lost.
    """
    number = ua.Variant(after, ua.VariantType.UInt64)
    returned = await call_method(client, "Fleet", "RecentMessages", text(source), number)
    *columns, lost, more = returned.check()
    rows = zip(*[column or () for column in columns], strict=True)
    return MessagesHeard(tuple([_message(*row) for row in rows]), int(lost), bool(more))


def _message(
    number: int,
    time: datetime,
    sent: bool,
    address: str | None,
    data: bytes | None,
    size: int,
    opened: bool,
    security: str,
    token: int,
    chunks: bool,
    dropped: str | None,
) -> PubSubMessage:
    return PubSubMessage(
        int(number),
        time if time.tzinfo is not None else time.replace(tzinfo=UTC),
        bool(sent),
        str(address or ""),
        bytes(data or b""),
        int(size),
        bool(opened),
        str(security),
        int(token),
        bool(chunks),
        tuple((dropped or "").split()),
    )
