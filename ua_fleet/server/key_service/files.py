"""The file that keeps the key service's keys over a restart: `<state_dir>/security-groups.json`, mode 0600.

{"version": 1, "groups": {"t-2": {"policy": "PubSub-Aes256-CTR", "lifetime_s": 3600.0, "first_token": 6,
                                  "current": 1, "since": 1769860800.0, "keys": ["<hexadecimal>", ..]}, ..}}

It is written whole before anything in it is handed out.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from ua_fleet.errors import UPGRADE, ServerStartError, UaFleetError, newer_version
from ua_fleet.server.key_service.store import MAX_TOKEN_ID, GroupState
from ua_fleet.storage.files import write_whole
from ua_fleet.values import StatusCode
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["GROUPS_FILE", "PUSHED_FILE", "KeysNotKept", "load_groups", "save_groups"]

GROUPS_FILE: Final = "security-groups.json"
PUSHED_FILE: Final = "pushed-keys.json"
"""The same for keys that others have made: they are never mixed."""
VERSION: Final = 1


class KeysNotKept(UaFleetError):
    """New keys cannot be written down, so they are not given to anybody."""

    ua_status = StatusCode.BAD_RESOURCE_UNAVAILABLE
    remedy = "Give the server a `state_dir` on a disk with room that it can write."


def load_groups(path: Path) -> dict[str, GroupState]:
    """The groups of a file; none where there is no file.

    Raises:
        ServerStartError: others can read the file, or it is broken.
    """
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            content = file.read()
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise ServerStartError(f"{path}: cannot be read ({error.strerror}); run: chown $USER {path}") from error
    if status.st_mode & 0o077:
        raise ServerStartError(
            f"{path}: others may read or write it (mode {status.st_mode & 0o777:o}); run: chmod 600 {path}"
        )
    if status.st_uid not in (os.geteuid(), 0):
        raise ServerStartError(f"{path}: belongs to another user; run: chown $USER {path}")
    try:
        document: dict[str, Any] = json.loads(content)
        newer = newer_version(document["version"], VERSION)
        if not newer:
            if document["version"] != VERSION:
                raise ValueError
            groups: dict[str, dict[str, Any]] = document["groups"]
            return {group_id: _state(entry) for group_id, entry in groups.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        # Without the cause: it may quote a key.
        raise ServerStartError(
            f"{path}: is no file of SecurityGroups; take it from a backup, or move it away and restart the bridges: "
            "all keys are made anew then"
        ) from None
    raise ServerStartError(f"{path}: {newer}; {UPGRADE}")


def _state(entry: Mapping[str, Any]) -> GroupState:
    state = GroupState(
        policy=SecurityPolicy.named(entry["policy"]),
        lifetime_s=float(entry["lifetime_s"]),
        first_token_id=int(entry["first_token"]),
        keys=tuple(bytes.fromhex(key) for key in entry["keys"]),
        current=int(entry["current"]),
        since=float(entry["since"]),
    )
    lengths = {len(key) for key in state.keys}
    if not 0 <= state.current < len(state.keys) or lengths != {state.policy.key_data_bytes}:
        raise ValueError
    if not 1 <= state.first_token_id <= MAX_TOKEN_ID or not 0 < state.lifetime_s < float("inf"):
        raise ValueError
    if not abs(state.since) < float("inf"):
        raise ValueError
    return state


def save_groups(path: Path, groups: Mapping[str, GroupState]) -> None:
    """Write all groups down, whole or not at all; raises KeysNotKept."""
    entries = {
        group_id: {
            "policy": state.policy.short_name,
            "lifetime_s": state.lifetime_s,
            "first_token": state.first_token_id,
            "current": state.current,
            "since": state.since,
            "keys": [key.hex() for key in state.keys],
        }
        for group_id, state in groups.items()
    }
    try:
        write_whole(path, json.dumps({"version": VERSION, "groups": entries}, indent=1).encode())
    except OSError as error:
        raise KeysNotKept(f"{path}: new keys cannot be written ({error.strerror}); free some space") from error
