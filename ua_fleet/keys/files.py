"""Keys from key files: a file that was changed is noticed at the next fetch."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from ua_fleet.errors import ConfigError, KeysRefused
from ua_fleet.keys.source import CURRENT_TOKEN
from ua_fleet.printing import config_option
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.storage.key_files import FileStamp, KeyFile, KeyFolder, NoKeyFile
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["REFRESH_S", "FileKeySource"]

REFRESH_S: Final = 0.5
"""A changed file is noticed within this time, and the period of `keep_keys`: less than a second in all."""
_MOST_KEPT: Final = 1024
"""Files that are kept in memory; those of further groups are read at each fetch."""


class FileKeySource:
    """A KeySource over a folder of key files.

    A key stays current until the file has a newer one that has become active: without `ua-fleet keys rotate` nothing
    ends. Where a file is taken away, the keys that were read last for their lifetime.
    """

    def __init__(self, folder: Path, policy: SecurityPolicy, wall: Callable[[], float] = time.time) -> None:
        """Make a source.

        Args:
            folder: the folder of the key files.
            policy: the SecurityPolicy that all of them must have.
            wall: the clock that activation times are compared with.
        """
        self._folder, self._policy, self._wall = KeyFolder(folder), policy, wall
        self._read: dict[str, tuple[FileStamp, KeyFile]] = {}

    @property
    def refresh_s(self) -> float:
        """A look at the file's times costs next to nothing."""
        return REFRESH_S

    @property
    def generation(self) -> int:
        """What changes is noticed by `refresh_s` anyhow."""
        return 0

    def check(self, own: Iterable[str], others: Iterable[str]) -> None:
        """Raise ConfigError where a process cannot begin with these files.

        Args:
            own: groups without whose keys the process could say nothing.
            others: groups whose file may be missing, but must be sound where it is there.
        """
        for group_id in own:
            self._file(group_id)
        for group_id in others:
            try:
                self._file(group_id)
            except NoKeyFile:
                continue

    async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        """The keys of a group as its file has them now; see KeySource."""
        try:
            key_file = self._file(group_id)
        except ConfigError as error:
            raise KeysRefused(group_id, str(error)) from error
        return group_keys(key_file, starting_token_id, count, self._wall())

    def _file(self, group_id: str) -> KeyFile:
        known = self._read.get(group_id)
        try:
            if known is not None and known[0] == self._folder.stamp(group_id):
                return known[1]
            key_file, stamp = self._folder.read_stamped(group_id)
        except ConfigError:
            self._read.pop(group_id, None)
            raise
        if key_file.policy is not self._policy:
            raise ConfigError(
                f"is {key_file.policy.short_name}, and fleet.yaml says {self._policy.short_name}",
                file=str(self._folder.path_of(group_id)),
                key="policy",
                suggestion=f"move the file away and run: ua-fleet keys create {group_id}{config_option()}",
            )
        if known is not None or len(self._read) < _MOST_KEPT:
            self._read[group_id] = stamp, key_file
        return key_file


def group_keys(key_file: KeyFile, starting_token_id: int, count: int, wall_s: float) -> GroupKeys:
    """The keys of a file from a token on; an unknown token stands for the oldest one (OPC 10000-14 8.3.2).

    None is given after the next one: who has a list moves on with each KeyLifetime, and a file has times of its own.
    """
    keys, current = key_file.keys, key_file.current_index(wall_s)
    first = current
    if starting_token_id != CURRENT_TOKEN:
        first = next((i for i, key in enumerate(keys[: current + 2]) if key.token_id == starting_token_id), 0)
    coming = keys[current + 1] if current + 1 < len(keys) else None
    return GroupKeys(
        policy=key_file.policy,
        first_token_id=keys[first].token_id,
        keys=tuple(key.key_data for key in keys[first : min(first + max(1, count), current + 2)]),
        time_to_next_key_s=key_file.lifetime_s if coming is None else max(0.0, coming.active_from - wall_s),
        key_lifetime_s=key_file.lifetime_s,
    )
