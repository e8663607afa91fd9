"""Keys of SecurityGroups over time (OPC 10000-14 8.3.2 and 8.4): pure, with the wall time as an argument.

A group has its past keys, the current one and the future ones, with consecutive SecurityTokenIds:

    tokens   4      5      6      7      8           KeyLifetime passes, or ForceKeyRotation: the mark moves on by one
    keys     past   CURRENT future future future     InvalidateKeys: all are thrown away, and 9 is current

After an absence (of the service, or of its clock) the mark stops at the last key that was handed out, until everybody
has had half a KeyLifetime to fetch the next ones. Who asks first would otherwise publish with a key that only he has.

Whatever changes is saved before it is handed out, so that no SecurityTokenId is ever given to two keys. Nothing here
shows key data, in a representation or in an error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from ua_fleet.errors import UaFleetError
from ua_fleet.pubsub.security.keyring import LIFETIMES_BEYOND, GroupKeys
from ua_fleet.values import StatusCode
from ua_fleet.wire.security import SecurityPolicy

__all__ = [
    "MAX_TOKEN_ID",
    "GroupSettings",
    "GroupState",
    "GroupUnknown",
    "KeyStore",
    "SaveGroups",
    "later_token_id",
    "steps_between",
]

MAX_TOKEN_ID: Final = 0xFFFF_FFFF
"""After it comes 1: 0 is no SecurityTokenId (OPC 10000-14 8.3.2)."""
CLOCK_STEP_S: Final = 1.0
"""A wall clock that is put back by more than this begins the current key's lifetime anew."""

SaveGroups = Callable[[Mapping[str, "GroupState"]], None]


class GroupUnknown(UaFleetError):
    """There is no SecurityGroup of this id."""

    ua_status = StatusCode.BAD_NOT_FOUND
    remedy = "Name a group such as `t-2` or `c-2` of a space that fleet.yaml has."


@dataclass(frozen=True, slots=True)
class GroupSettings:
    """What SecurityGroupType says of a group (OPC 10000-14 8.4.1)."""

    policy: SecurityPolicy
    lifetime_s: float
    """KeyLifetime."""
    max_future_keys: int
    """MaxFutureKeyCount: keys after the current one that GetSecurityKeys returns."""
    max_past_keys: int
    """MaxPastKeyCount: keys before the current one that are kept."""


@dataclass(frozen=True, slots=True)
class GroupState:
    """The keys that a group has now; this is what is kept on disk."""

    policy: SecurityPolicy
    lifetime_s: float
    first_token_id: int
    """SecurityTokenId of the first key."""
    keys: tuple[bytes, ...] = field(repr=False)
    """Key data, oldest first."""
    current: int
    """Position of the current key."""
    since: float
    """Wall time, in seconds, at which the current key became current."""

    @property
    def current_token_id(self) -> int:
        """SecurityTokenId of the current key."""
        return later_token_id(self.first_token_id, self.current)

    @property
    def due(self) -> float:
        """Wall time at which the next key becomes current."""
        return self.since + self.lifetime_s


def later_token_id(token_id: int, steps: int) -> int:
    """The SecurityTokenId that many keys later."""
    return (token_id - 1 + steps) % MAX_TOKEN_ID + 1


def steps_between(earlier: int, token_id: int) -> int:
    """How many keys later a SecurityTokenId is."""
    return (token_id - earlier) % MAX_TOKEN_ID


def _after_absence(state: GroupState, now: float) -> tuple[int, float] | None:
    """How many keys to move on after an absence and since when that one counts; None where its own pace is right.

    Processes have gone on by themselves up to the newest key they have, and use it for two KeyLifetimes beyond its
    end. So that one stays, and not everybody has what comes after it: the newest was made at the last change only.
    Where no change was missed nothing is put off, or restarts that follow each other would put it off for ever.
    """
    if now < state.due:
        return None
    newest = len(state.keys) - 1
    position = min(state.current + int((now - state.since) // state.lifetime_s), newest)
    steps = position - state.current
    end = state.due + steps * state.lifetime_s
    to_fetch_s = state.lifetime_s / 2
    if position >= newest - 1 and end - to_fetch_s < now < end + LIFETIMES_BEYOND * state.lifetime_s:
        return steps, now + to_fetch_s - state.lifetime_s
    return None


class KeyStore:
    """The SecurityGroups of one key service."""

    def __init__(
        self,
        settings: Mapping[str, GroupSettings],
        kept: Mapping[str, GroupState],
        *,
        now: float,
        token_bytes: Callable[[int], bytes],
        save: SaveGroups,
    ) -> None:
        """Make a store, with new keys for the groups that have none.

        Args:
            settings: the groups, by SecurityGroupId.
            kept: what was saved last. Groups that are no longer there are kept, for when they come back.
            now: wall time in seconds.
            token_bytes: makes random bytes fit for keys.
            save: keeps all groups durably; raises where it cannot, and then nothing has changed.
        """
        self._settings = dict(settings)
        self._groups = dict(kept)
        self._token_bytes, self._save = token_bytes, save
        fresh: dict[str, GroupState] = {}
        for group_id, wanted in settings.items():
            state = self._groups.get(group_id)
            if state is None:
                fresh[group_id] = self._begin(wanted, 1, now)
            elif (state.policy, state.lifetime_s) != (wanted.policy, wanted.lifetime_s):
                # Other settings make all keys invalid (OPC 10000-14 6.2.12.2).
                fresh[group_id] = self._begin(wanted, later_token_id(state.first_token_id, len(state.keys)), now)
            elif (known := _after_absence(state, now)) is not None:
                fresh[group_id] = self._moved(wanted, state, *known)
            elif (filled := self._filled(wanted, state)) is not state:
                fresh[group_id] = filled
        self._keep(fresh)
        self._advance(now)

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

    def current_token_id(self, group_id: str, now: float) -> int:
        """SecurityTokenId of a group's current key; raises GroupUnknown."""
        self.settings(group_id)
        self._advance(now)
        return self._groups[group_id].current_token_id

    def get_keys(self, group_id: str, starting_token_id: int, count: int, now: float) -> GroupKeys:
        """What GetSecurityKeys returns (OPC 10000-14 8.3.2).

        Args:
            group_id: SecurityGroupId.
            starting_token_id: token of the first key wanted; 0 is the current one. An unknown one stands for the
                oldest that there is.
            count: keys wanted; 0 is one key, and no more than there are are returned.
            now: wall time in seconds.

        Raises:
            GroupUnknown: there is no such group.
        """
        settings = self.settings(group_id)
        self._advance(now)
        state = self._groups[group_id]
        first = state.current
        if starting_token_id:
            first = steps_between(state.first_token_id, starting_token_id)
            if first >= len(state.keys):
                first = 0
        last = min(first + max(count, 1), state.current + settings.max_future_keys + 1)
        return GroupKeys(
            policy=state.policy,
            first_token_id=later_token_id(state.first_token_id, first),
            keys=state.keys[first : max(last, first + 1)],
            time_to_next_key_s=min(max(state.due - now, 0.0), state.lifetime_s),
            key_lifetime_s=state.lifetime_s,
        )

    def invalidate(self, group_id: str, now: float) -> None:
        """InvalidateKeys: no key that anybody has is of use; the new token is beyond all that were given (8.4.2)."""
        settings = self.settings(group_id)
        self._advance(now)
        state = self._groups[group_id]
        self._keep({group_id: self._begin(settings, later_token_id(state.first_token_id, len(state.keys)), now)})

    def rotate(self, group_id: str, now: float) -> None:
        """ForceKeyRotation: the next key becomes current before its time (8.4.3)."""
        settings = self.settings(group_id)
        self._advance(now)
        self._keep({group_id: self._moved(settings, self._groups[group_id], 1, now)})

    def _begin(self, settings: GroupSettings, token_id: int, now: float) -> GroupState:
        empty = GroupState(settings.policy, settings.lifetime_s, token_id, (), 0, now)
        return self._filled(settings, empty)

    def _filled(self, settings: GroupSettings, state: GroupState) -> GroupState:
        """A state with all future keys that it should have."""
        missing = state.current + 1 + settings.max_future_keys - len(state.keys)
        if missing <= 0:
            return state
        fresh = tuple(self._token_bytes(settings.policy.key_data_bytes) for _ in range(missing))
        return replace(state, keys=(*state.keys, *fresh))

    def _moved(self, settings: GroupSettings, state: GroupState, steps: int, since: float) -> GroupState:
        """A state whose current key is `steps` later, without the past keys that are too old."""
        current = state.current + steps
        # After a long rest the keys between are not made up: nobody has used them.
        dropped = max(current - settings.max_past_keys, 0) if current <= len(state.keys) else current
        return self._filled(
            settings,
            replace(
                state,
                first_token_id=later_token_id(state.first_token_id, dropped),
                keys=state.keys[dropped:],
                current=current - dropped,
                since=since,
            ),
        )

    def _advance(self, now: float) -> None:
        """Bring all groups to this time; whatever changes is saved at once."""
        changed: dict[str, GroupState] = {}
        for group_id, settings in self._settings.items():
            state = self._groups[group_id]
            if now >= state.due:
                steps = int((now - state.since) // state.lifetime_s)
                move = (steps, state.since + steps * state.lifetime_s)
                if steps > 1:
                    move = _after_absence(state, now) or move
                changed[group_id] = self._moved(settings, state, *move)
            elif now < state.since - CLOCK_STEP_S:
                changed[group_id] = replace(state, since=now)
        self._keep(changed)

    def _keep(self, changed: Mapping[str, GroupState]) -> None:
        if changed:
            groups = {**self._groups, **changed}
            self._save(groups)
            self._groups = groups
