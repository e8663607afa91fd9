"""Keys that a foreign key service has pushed to this server (SetSecurityKeys, OPC 10000-14 9.1.3.3).

Pure, with the wall time as an argument. It gives to the bridges what `KeyStore` gives, and makes no keys itself:

    tokens   4      5      6      7      each push names the current key and those after it; the time moves the mark on
    keys     past   CURRENT future       past ones stay where the push continues what was known before

A push whose current key is not the one that was known under its token means that the service has begun anew: nothing of
what was known stays. After the last key that was pushed there is none: it is given for LIFETIMES_BEYOND KeyLifetimes
more, as everybody uses it, and then nothing is.

A push is written down before it counts, so that a server that restarts need not wait for the next one. Nothing here
shows key data, in a representation or in an error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from ua_fleet.errors import UaFleetError
from ua_fleet.pubsub.security.keyring import LIFETIMES_BEYOND, MOST_TOKENS, GroupKeys
from ua_fleet.server.key_service.store import (
    MAX_TOKEN_ID,
    GroupSettings,
    GroupState,
    GroupUnknown,
    SaveGroups,
    later_token_id,
    steps_between,
)
from ua_fleet.values import StatusCode
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["KeysNotPushed", "Push", "PushRefused", "PushedKeys"]

_BAD_SECURITY_POLICY_REJECTED: Final = 0x8055_0000
SHORTEST_LIFETIME_S: Final = 1.0
"""Processes fetch keys at half of the KeyLifetime; `pubsub.keys.lifetime_s` has the same bound."""
LONGEST_LIFETIME_S: Final = 366 * 86_400.0


class KeysNotPushed(UaFleetError):
    """There are no keys of this group yet, or they are over."""

    ua_status = StatusCode.BAD_NOT_FOUND
    remedy = "Let the key service push keys of the group to the server: see Pushed keys in docs/security.md."


class PushRefused(UaFleetError):
    """What was pushed cannot be keys of this group."""

    ua_status: int = StatusCode.BAD_INVALID_ARGUMENT
    remedy = "Set the key service to the policy and lifetimes of the fleet."

    def __init__(self, reason: str, ua_status: int = StatusCode.BAD_INVALID_ARGUMENT) -> None:
        super().__init__(reason)
        self.ua_status = ua_status


class Push(NamedTuple):
    """The arguments of SetSecurityKeys. It is never shown."""

    group_id: str
    policy_uri: str
    current_token_id: int
    keys: tuple[bytes | None, ...]
    """CurrentKey and FutureKeys."""
    time_to_next_key_s: float
    key_lifetime_s: float

    def __repr__(self) -> str:
        return f"Push({self.group_id!r:.80}, {len(self.keys)} keys from token {self.current_token_id})"


class PushedKeys:
    """The SecurityGroups of a fleet whose keys are made elsewhere."""

    def __init__(
        self, settings: Mapping[str, GroupSettings], kept: Mapping[str, GroupState], *, save: SaveGroups
    ) -> None:
        """Make a store.

        Args:
            settings: the groups, by SecurityGroupId. Their KeyLifetimes are what is pushed, not what stands here.
            kept: what was saved last.
            save: keeps all groups durably; raises where it cannot, and then nothing has changed.
        """
        self._settings, self._save = dict(settings), save
        self._groups = {
            group_id: state
            for group_id, state in kept.items()
            if group_id in settings and state.policy == settings[group_id].policy
        }

    @property
    def group_ids(self) -> tuple[str, ...]:
        """The SecurityGroupIds that there are."""
        return tuple(self._settings)

    def settings(self, group_id: str) -> GroupSettings:
        """A group's settings; raises GroupUnknown."""
        settings = self._settings.get(group_id)
        if settings is None:
            raise GroupUnknown(f"there is no SecurityGroup {group_id[:64]!r}")
        return settings

    def push(self, push: Push, now: float) -> None:
        """Take the keys of a group.

        Raises:
            GroupUnknown: there is no such group.
            PushRefused: what stands in the push is no set of keys for it. Nothing has changed.
        """
        settings = self.settings(push.group_id)
        keys = _checked(push, settings.policy)
        past = self._past(push, keys[0], settings.max_past_keys)
        state = GroupState(
            settings.policy,
            push.key_lifetime_s,
            later_token_id(push.current_token_id, -len(past)),
            (*past, *keys),
            len(past),
            now + push.time_to_next_key_s - push.key_lifetime_s,
        )
        groups = {**self._groups, push.group_id: state}
        self._save(groups)
        self._groups = groups

    def _past(self, push: Push, current: bytes, most: int) -> tuple[bytes, ...]:
        """The keys before the current one of a push, where it continues what was known."""
        known = self._groups.get(push.group_id)
        if known is None:
            return ()
        position = steps_between(known.first_token_id, push.current_token_id)
        if position >= len(known.keys) or known.keys[position] != current:
            return ()
        return known.keys[max(position - most, 0) : position]

    def get_keys(self, group_id: str, starting_token_id: int, count: int, now: float) -> GroupKeys:
        """What GetSecurityKeys returns (OPC 10000-14 8.3.2); arguments as those of `KeyStore.get_keys`.

        Raises:
            GroupUnknown: there is no such group.
            KeysNotPushed: no keys of it were pushed, or the last one is over.
        """
        settings = self.settings(group_id)
        state = self._groups.get(group_id)
        if state is None:
            raise KeysNotPushed(f"no keys of {group_id} were pushed yet")
        last = len(state.keys) - 1
        passed = max(int((now - state.since) // state.lifetime_s), 0)
        current = min(state.current + passed, last)
        ends_at = state.since + (current - state.current + 1) * state.lifetime_s
        if now >= ends_at + LIFETIMES_BEYOND * state.lifetime_s:
            raise KeysNotPushed(f"the last key of {group_id} that was pushed is over")
        first = current
        if starting_token_id:
            first = steps_between(state.first_token_id, starting_token_id)
            if first > last:
                first = max(current - settings.max_past_keys, 0)
        end = min(first + max(count, 1), current + settings.max_future_keys + 1)
        return GroupKeys(
            policy=state.policy,
            first_token_id=later_token_id(state.first_token_id, first),
            keys=state.keys[first : max(end, first + 1)],
            time_to_next_key_s=min(max(ends_at - now, 0.0), state.lifetime_s),
            key_lifetime_s=state.lifetime_s,
        )


def _checked(push: Push, policy: SecurityPolicy) -> tuple[bytes, ...]:
    """The keys of a push; raises PushRefused."""
    if push.policy_uri != policy.value:
        raise PushRefused(f"the keys of {push.group_id} are of {policy.short_name}", _BAD_SECURITY_POLICY_REJECTED)
    if not 1 <= push.current_token_id <= MAX_TOKEN_ID:
        raise PushRefused("0 is no SecurityTokenId")
    if len(push.keys) > MOST_TOKENS:
        raise PushRefused(f"{len(push.keys)} keys at once, at most {MOST_TOKENS}")
    if not SHORTEST_LIFETIME_S <= push.key_lifetime_s <= LONGEST_LIFETIME_S:  # NaN is none of these
        raise PushRefused(f"a KeyLifetime of {push.key_lifetime_s:g} s")
    if not math.isfinite(push.time_to_next_key_s) or not 0 <= push.time_to_next_key_s <= push.key_lifetime_s:
        left_s, lifetime_s = push.time_to_next_key_s, push.key_lifetime_s
        raise PushRefused(f"a TimeToNextKey of {left_s:g} s for keys that live for {lifetime_s:g} s")
    return _sound_keys(push.keys, policy.key_data_bytes)


def _sound_keys(keys: Sequence[bytes | None], size: int) -> tuple[bytes, ...]:
    sound = tuple([key for key in keys if key is not None and len(key) == size])
    if len(sound) != len(keys):
        raise PushRefused(f"a key that has not {size} bytes")
    if len(set(sound)) != len(sound):  # the same key under two tokens would use a nonce twice
        raise PushRefused("one key for two tokens")
    return sound
