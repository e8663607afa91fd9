"""The keys of one SecurityGroup over time (OPC 10000-14 6.2.12.2, 8.3.2).

    past      no publisher should use it any more; readers take it for `past_keys` more KeyLifetimes
    current   what we send with, and everybody takes
    future    readers take it already, since a peer's clock may be ahead; we send with it once TimeToNextKey is over

Everybody moves to the next key by its own clock, without asking. Where there is no next key, the last one is used and
taken for at most two KeyLifetimes beyond its end, and then not at all.

New keys are matched by token and key data. Keys that are known keep their state (their replay windows are part of it).
A current key that is not known, or that is another than the one of that token, means that the service has begun anew
or made all keys invalid: everything that was known is discarded (9.1.3.3). We never go back to an earlier key when our
clock is ahead of the service's.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from ua_fleet.pubsub.security.replay import ReplayWindows
from ua_fleet.wire.security import MessageKey, SecurityPolicy

__all__ = ["MAX_TOKEN_ID", "GroupKeys", "Keyring", "Token", "next_token_id"]

MAX_TOKEN_ID: Final = 0xFFFF_FFFF
LIFETIMES_BEYOND: Final = 2
"""KeyLifetimes for which the last key is used beyond its end (6.2.12.2)."""
SHORTEST_LIFETIME_S: Final = 0.001
MOST_TOKENS: Final = 256
"""Tokens that are taken from a source at once."""


class GroupKeys(NamedTuple):
    """What GetSecurityKeys returns (8.3.2) for the current token and those after it. It is never shown."""

    policy: SecurityPolicy
    first_token_id: int
    keys: tuple[bytes, ...]
    """Key data of consecutive tokens, the current one first."""
    time_to_next_key_s: float
    key_lifetime_s: float

    def __repr__(self) -> str:
        return (
            f"GroupKeys({self.policy.short_name}, {len(self.keys)} keys from token {self.first_token_id}, "
            f"next in {self.time_to_next_key_s:g} s, lifetime {self.key_lifetime_s:g} s)"
        )


def next_token_id(token_id: int) -> int:
    """The SecurityTokenId that follows; 0 is none, so that the last one is followed by 1 (9.1.3.3)."""
    return token_id + 1 if token_id < MAX_TOKEN_ID else 1


class Token:
    """One security token: its key, and what was heard under it."""

    __slots__ = ("_data", "key", "token_id", "until", "windows")

    def __init__(self, token_id: int, key: MessageKey, data: bytes, *, is_unused: bool) -> None:
        self.token_id = token_id
        self.key = key
        self.windows = ReplayWindows(is_unused=is_unused)
        self.until = math.inf
        """Readers take it until then."""
        self._data = data

    def __repr__(self) -> str:
        return f"Token({self.token_id})"

    def is_key(self, data: bytes) -> bool:
        """Whether this is its key data."""
        return data == self._data


class Keyring:
    """Past, current and future keys of one group."""

    __slots__ = (
        "_current",
        "_ends_at",
        "_fetch_at",
        "_lifetime_s",
        "_must_fetch",
        "_order",
        "_past_keys",
        "changes_at",
        "group_id",
        "tokens",
    )

    def __init__(self, group_id: str, past_keys: int = 1) -> None:
        """Make a keyring without keys; `past_keys` is how many KeyLifetimes readers take a key that was replaced."""
        self.group_id = group_id
        self.tokens: dict[int, Token] = {}
        """What readers take, by SecurityTokenId; right as long as the time is before `changes_at`."""
        self.changes_at = math.inf
        """When `advance` is to be called next."""
        self._past_keys = past_keys
        self._order: list[Token] = []
        """All tokens, the oldest first."""
        self._current: int = 0
        """Where in `_order` the current one stands."""
        self._ends_at: float = 0.0
        """The end of the current one's lifetime."""
        self._lifetime_s = 0.0
        self._fetch_at = -math.inf
        self._must_fetch = False

    def install(self, keys: GroupKeys, now: float) -> None:
        """Take what the source of keys has given; the first of `keys` is the current one.

        Raises LocalWireError for key data of the wrong length; nothing has changed then.
        """
        self.advance(now)
        offered = self._known_or_new(keys)
        if not offered:
            return
        self._lifetime_s = max(keys.key_lifetime_s, SHORTEST_LIFETIME_S)
        if offered[0] in self._order:
            self._merge(offered, now)
        else:
            self._order, self._current = offered, 0
        ahead = self._current - self._order.index(offered[0])
        # open62541's TimeToNextKey can be negative.
        self._ends_at = now + max(keys.time_to_next_key_s, 0.0) + ahead * self._lifetime_s
        self._fetch_at = now + self._lifetime_s / 2
        self._must_fetch = False
        self.advance(now)

    def _known_or_new(self, keys: GroupKeys) -> list[Token]:
        """The tokens offered: those that are known, with their state, and new ones."""
        known = {token.token_id: token for token in self._order}
        token_id = keys.first_token_id
        offered: list[Token] = []
        for data in keys.keys[:MOST_TOKENS]:
            token = known.get(token_id)
            if token is None or not token.is_key(data):
                # The current one of a list that is new to us may have been used before; those after it were not.
                token = Token(token_id, MessageKey(keys.policy, data), data, is_unused=bool(offered))
            offered.append(token)
            token_id = next_token_id(token_id)
        return offered

    def _merge(self, offered: list[Token], now: float) -> None:
        """Put a list whose current token is known in place of what is known from there on."""
        order, ours = self._order, self._order[self._current]
        last = order.index(offered[-1]) if offered[-1] in order else len(order)
        merged = order[: order.index(offered[0])] + offered + order[last + 1 :]
        before = merged.index(ours) if ours in merged else 0
        self._order, self._current = merged, max(before, merged.index(offered[0]))
        for token in merged[before : self._current]:
            token.until = min(token.until, now + self._past_keys * self._lifetime_s)

    def advance(self, now: float) -> None:
        """Move to the next key where its time has come, and forget those that nobody may use any more."""
        order = self._order
        if not order:
            return
        while now >= self._ends_at and self._current + 1 < len(order):
            order[self._current].until = self._ends_at + self._past_keys * self._lifetime_s
            self._current += 1
            self._ends_at += self._lifetime_s
        current = order[self._current]
        has_next = self._current + 1 < len(order)
        current.until = math.inf if has_next else self._ends_at + LIFETIMES_BEYOND * self._lifetime_s
        kept = [token for token in order if token.until > now] if current.until > now else []
        self._current = kept.index(current) if kept else 0
        self._order = kept
        self.tokens = {token.token_id: token for token in kept}
        changes = [token.until for token in kept]
        if has_next:
            changes.append(self._ends_at)
        self.changes_at = min(changes, default=math.inf)

    def sending(self, now: float) -> Token | None:
        """The token to send with; None if there is none or the last one is over."""
        if now >= self.changes_at:
            self.advance(now)
        return self._order[self._current] if self._order else None

    def lasts_s(self, now: float) -> float | None:
        """Time until the last key that is here is over; below 0 it is used beyond that. None where there is none."""
        if now >= self.changes_at:
            self.advance(now)
        if not self._order:
            return None
        return self._ends_at - now + (len(self._order) - 1 - self._current) * self._lifetime_s

    def around_current(self) -> list[Token]:
        """The current token, the next and the one before: those that a message without a token may be signed with."""
        order, current = self._order, self._current
        return order[current : current + 2] + order[max(current - 1, 0) : current]

    def is_over(self, token_id: int) -> bool:
        """Whether a token comes before all that are taken, so that its key is none that is yet to come."""
        behind = (self._order[0].token_id - token_id) & MAX_TOKEN_ID if self._order else 0
        return 0 < behind <= MAX_TOKEN_ID >> 1

    def ask(self) -> None:
        """Keys are to be fetched now: an unknown token was heard, or a publisher has said that all will be invalid."""
        self._must_fetch = True

    def is_wanted(self, now: float) -> bool:
        """Whether keys are to be fetched: there are none, half of a KeyLifetime is over, or somebody said so."""
        if now >= self.changes_at:
            self.advance(now)
        return self._must_fetch or not self._order or now >= self._fetch_at

    def __repr__(self) -> str:
        return f"Keyring({self.group_id}, tokens {[token.token_id for token in self._order]})"
