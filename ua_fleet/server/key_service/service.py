"""The key service of one server: the store, its file, and who may have what."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import structlog

from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.call_limit import CallLimit
from ua_fleet.errors import UaFleetError
from ua_fleet.operation.runs.clock import steady
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.server.key_service.access import KeyAccess
from ua_fleet.server.key_service.files import GROUPS_FILE, PUSHED_FILE, KeysNotKept, load_groups, save_groups
from ua_fleet.server.key_service.pushed import Push, PushedKeys
from ua_fleet.server.key_service.store import GroupSettings, KeyStore
from ua_fleet.values import StatusCode
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["KeyService", "KeysDenied", "TooManyKeyCalls"]

_log = structlog.get_logger("ua_fleet.keys")

_BAD_SERVER_TOO_BUSY: Final = 0x80EE_0000


class KeysDenied(UaFleetError):
    """The caller may not have this group's keys."""

    ua_status = StatusCode.BAD_USER_ACCESS_DENIED
    remedy = "See `ua-fleet cert list`: the certificate must be trusted for that bridge."


class TooManyKeyCalls(UaFleetError):
    """The caller asks far more often than keys change."""

    ua_status = _BAD_SERVER_TOO_BUSY
    remedy = "Find the client that asks; keys change once in a lifetime only."


class KeyService:
    """Gives keys to the bridges and the server itself. May be called from any thread; may wait for the disk."""

    def __init__(
        self,
        config: FleetConfig,
        state_dir: Path,
        *,
        wall_s: Callable[[], float] | None = None,
        token_bytes: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        """Open the service, with the keys that were kept.

        Args:
            config: names the groups, who may have them, and their policy and lifetime.
            state_dir: the server's; the keys stand in it.
            wall_s: the wall clock. Left out: ours as it is now, and what passes from now on; no key is over since
                somebody has set it.
            token_bytes: makes random bytes fit for keys.

        Raises:
            ServerStartError: the kept keys cannot be used.
            KeysNotKept: new ones cannot be kept.
        """
        self.access = KeyAccess(config)
        keys = config.pubsub.keys
        self._wall_s = wall_s or steady(time.monotonic, time.time)
        self._lock = threading.Lock()
        self.pushed_by = keys.pushed_by
        """Name of the user who pushes the keys; None where they are made here."""
        path = state_dir / (GROUPS_FILE if keys.pushed_by is None else PUSHED_FILE)
        settings = GroupSettings(SecurityPolicy.named(keys.policy), keys.lifetime_s, keys.future_keys, keys.past_keys)
        self._limit = CallLimit(len(self.access.group_ids), keys.lifetime_s)
        groups, kept, save = (
            dict.fromkeys(self.access.group_ids, settings),
            load_groups(path),
            partial(save_groups, path),
        )
        self._store: KeyStore | PushedKeys
        if keys.pushed_by is not None:
            self._store = self._pushed = PushedKeys(groups, kept, save=save)
        else:
            self._store = self._made = KeyStore(groups, kept, now=self._wall_s(), token_bytes=token_bytes, save=save)
        self.changes = 0
        """How often keys have changed before their time, since the start."""

    @property
    def group_ids(self) -> tuple[str, ...]:
        """The SecurityGroups."""
        return self._store.group_ids

    def settings(self, group_id: str) -> GroupSettings:
        """A group's settings; raises GroupUnknown."""
        return self._store.settings(group_id)

    def keys_for_bridge(self, name: str, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        """Keys for a bridge that has proved who it is.

        Raises:
            TooManyKeyCalls: it has asked too often.
            GroupUnknown: there is no such group.
            KeysDenied: the group is not one of its own.
            KeysNotKept: it is time for new keys, and they cannot be written down.
        """
        if not self._limit.take(name, time.monotonic()):
            raise TooManyKeyCalls(f"bridge {name} asks for keys too often")
        self._store.settings(group_id)
        if not self.access.bridge_may(name, group_id):
            raise KeysDenied(f"bridge {name} may not have the keys of {group_id}")
        return self._get(group_id, starting_token_id, count)

    def keys_for_space(self, space: int, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        """Keys for a space that lives in this process; raises as `keys_for_bridge`, and is not limited."""
        self._store.settings(group_id)
        if not self.access.space_may(space, group_id):
            raise KeysDenied(f"space {space} may not have the keys of {group_id}")
        return self._get(group_id, starting_token_id, count)

    def invalidate(self, group_id: str) -> None:
        """InvalidateKeys (OPC 10000-14 8.4.2); raises GroupUnknown or KeysNotKept."""
        with self._lock:
            self._made.invalidate(group_id, self._wall_s())
            self.changes += 1
        _log.warning("keys made invalid", group=group_id)

    def rotate(self, group_id: str) -> None:
        """ForceKeyRotation (OPC 10000-14 8.4.3); raises GroupUnknown or KeysNotKept."""
        with self._lock:
            self._made.rotate(group_id, self._wall_s())
            self.changes += 1
        _log.info("next key made current", group=group_id)

    def push(self, push: Push) -> None:
        """SetSecurityKeys (OPC 10000-14 9.1.3.3), of the user that may.

        Raises:
            TooManyKeyCalls: it has called too often.
            GroupUnknown: there is no such group.
            PushRefused: they are no keys of it.
            KeysNotKept: they cannot be written down, and so they do not count.
        """
        if not self._limit.take(f"user:{self.pushed_by}", time.monotonic()):
            raise TooManyKeyCalls("keys are pushed too often")
        with self._lock:
            self._pushed.push(push, self._wall_s())
            self.changes += 1
        _log.info("keys pushed", group=push.group_id, first_token=push.current_token_id, count=len(push.keys))

    def _get(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        try:
            with self._lock:
                return self._store.get_keys(group_id, starting_token_id, count, self._wall_s())
        except KeysNotKept as error:
            _log.error("no keys are given", group=group_id, reason=str(error))
            raise
