"""The folder of a demonstration: kept for one that stays up, since clients remember its server's certificate."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from ua_fleet.errors import ConfigError

__all__ = ["run_folder"]


@contextmanager
def run_folder(wanted: Path | None, *, keep: bool) -> Generator[Path]:
    """A folder for one run.

    Args:
        wanted: the user's choice.
        keep: without a choice, use the one folder in `$XDG_STATE_HOME` that all such runs share, unless another run has
            it now. Otherwise a temporary one is made, and removed at the end.
    """
    if wanted is not None:
        yield _made(wanted)
        return
    if keep:
        base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
        shared = _made(Path(base) / "ua-fleet" / "demo-pal")
        with (shared / "lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                pass
            else:
                yield shared
                return
    with tempfile.TemporaryDirectory(prefix="ua-fleet-pal-") as temporary:
        yield Path(temporary)


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot make this folder: {error.strerror}", file=str(folder)) from error
    return folder
