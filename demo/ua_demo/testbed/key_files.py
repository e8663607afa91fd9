"""Key files for a testbed whose bridges reach no key service: each process has those that it needs, and no others.

The server's folder has the keys of all groups. Who rotates keys does it there, and runs the job once more.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

from ua_demo.testbed.plan import SERVER
from ua_fleet.config.connections import barred_on, connection_numbers
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups, groups_of
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.storage.key_files import KeyFile, KeyFolder, NoKeyFile
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["KEYS", "prepare_keys"]

KEYS: Final = "keys"
"""Folder in that of each process."""


def prepare_keys(config: FleetConfig, folder: Path) -> None:
    """Make the keys that are missing, and hand out those that have changed; raises ConfigError for files of no use.

    Args:
        config: of the fleet.
        folder: the volumes' folders stand in it.
    """
    keys, policy = config.pubsub.keys, SecurityPolicy.named(config.pubsub.keys.policy)
    every = KeyFolder(folder / SERVER / KEYS)
    with every.exclusive():
        for group_id in all_groups(config):
            if _read(every, group_id) is None:
                every.write(KeyFile.new(group_id, policy, keys.lifetime_s, time.time()))
        for name, bridge in config.bridges.items():
            own = KeyFolder(folder / name / KEYS)
            with own.exclusive():
                for group_id in _needed(config, bridge.space):
                    wanted = every.read(group_id)
                    if _read(own, group_id) != wanted:
                        own.write(wanted)


def _needed(config: FleetConfig, space: int) -> list[str]:
    """The groups of a process, without those of spaces that come by none of its connections."""
    barred = [barred_on(config, number) for number in connection_numbers(config, space)]
    nowhere = [other for other in barred[0] if all(other in others for others in barred)]
    unheard = {make(other) for other in nowhere for make in (telemetry_group, command_group)}
    return [group_id for group_id in groups_of(config, space) if group_id not in unheard]


def _read(folder: KeyFolder, group_id: str) -> KeyFile | None:
    try:
        return folder.read(group_id)
    except NoKeyFile:
        return None
