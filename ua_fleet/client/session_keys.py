# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Session keys, which a client gives in place of its user's password."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime

from asyncua import ua

from ua_fleet.client.fleet_client import FleetClient
from ua_fleet.client.methods import call_method, text

__all__ = ["IssuedKey", "issue_session_key", "revoke_session_key"]


@dataclass(frozen=True, slots=True)
class IssuedKey:
    """A key that the server has issued."""

    key: str = field(repr=False)
    """To be given as the password of the user."""
    id: str
    valid_until: datetime
    message: str
    """What to know of it, such as which older key had to give way; else empty."""


async def issue_session_key(client: FleetClient, name: str, lifetime_s: float = 0.0) -> IssuedKey:
    """Have the server issue a key to the client's user, who has logged in with the password.

    Args:
        client: connected.
        name: for lists, such as the machine that keeps it.
        lifetime_s: wanted; 0 for as long as the server lets it live.

    Raises:
        NotDone: the server issues none, or none to this session.
        AccessRefused: the server has no such Method, or refuses it to this user.
        NotConnected: the connection was lost.
    """
    returned = await call_method(
        client, "Fleet", "IssueSessionKey", text(name), ua.Variant(lifetime_s, ua.VariantType.Double)
    )
    key, key_id, until = returned.check()
    aware = until if until.tzinfo is not None else until.replace(tzinfo=UTC)
    return IssuedKey(str(key), str(key_id), aware, returned.message)


async def revoke_session_key(client: FleetClient, key_id: str) -> None:
    """End a key of the client's user.

    Raises:
        NotDone: the user has no such key.
        AccessRefused: the server has no such Method, or refuses it to this user.
        NotConnected: the connection was lost.
    """
    (await call_method(client, "Fleet", "RevokeSessionKey", text(key_id))).check()
