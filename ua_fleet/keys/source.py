"""Where a process gets the keys of its SecurityGroups from."""

from __future__ import annotations

from typing import Protocol

from ua_fleet.pubsub.security.keyring import GroupKeys

__all__ = ["CURRENT_TOKEN", "KeySource"]

CURRENT_TOKEN = 0
"""StartingTokenId of `fetch` for the current key (OPC 10000-14 8.3.2)."""


class KeySource(Protocol):
    """Gives the keys of SecurityGroups. `keep_keys` asks it; it need not remember what it gave."""

    @property
    def refresh_s(self) -> float:
        """A group is asked for at least so often, also when no key is missing; infinity where asking costs."""
        ...

    @property
    def generation(self) -> int:
        """Grows when keys may have changed before their time: all groups are asked for at once then."""
        ...

    async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        """The keys of a SecurityGroup from a token on (0: the current one), at most `count` (GetSecurityKeys).

        Raises:
            KeySourceUnavailable: nobody can be asked now. It says where and why, never a key.
            KeysRefused: the source is there, and has no keys of this group for us.
        """
        ...
