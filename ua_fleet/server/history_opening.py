"""Which store a history has, and how it is opened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ua_fleet.config.history_schema import HistoryConfig
from ua_fleet.errors import StorageUnavailable, add_extra
from ua_fleet.history.store import HistoryStore
from ua_fleet.storage.history_store import HISTORY_FILE, SqliteHistory
from ua_fleet.storage.private_file import read_password

__all__ = ["Opening", "open_store"]


class Opening(NamedTuple):
    """A store that was away at the start."""

    open: Callable[[], HistoryStore]
    """Opens it in the thread; raises StorageUnavailable."""
    reason: str
    """Why it was not opened."""


def open_store(config: HistoryConfig, config_dir: Path, state_dir: Path) -> HistoryStore:
    """The store that `fleet.yaml` names; raises StorageUnavailable."""
    if config.store is None:
        return SqliteHistory(state_dir / HISTORY_FILE)
    try:
        from ua_fleet.storage.postgres_history import PostgresHistory
    except ModuleNotFoundError as error:
        raise StorageUnavailable(f"history.store needs the package {error.name}; {add_extra('postgres')}") from error
    file = config.password_file
    password = None if file is None else read_password(config_dir / file, "history.password_file")
    return PostgresHistory(config.store, config.user or "", password)
