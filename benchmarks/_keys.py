"""Key files for the fleet of a benchmark."""

from __future__ import annotations

import time
from pathlib import Path

from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["write_keys"]


def write_keys(folder: Path, config: FleetConfig) -> None:
    """A file for each SecurityGroup of a fleet, good for an hour, in `keys` below the folder."""
    keys = KeyFolder(folder / "keys")
    for group_id in all_groups(config):
        keys.write(KeyFile.new(group_id, SecurityPolicy.AES256_CTR, 3600.0, time.time()))
