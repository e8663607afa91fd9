"""Where a process tells how it is, written into its folder for those who look for it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Final

__all__ = ["ADDRESS_FILE", "remove_address", "write_address"]

ADDRESS_FILE: Final = "monitoring.json"
"""In a process's `state_dir`."""


def write_address(state_dir: Path, host: str, port: int, instance: str) -> None:
    """Write where a process listens; raises OSError.

    Args:
        state_dir: its folder, which is made where it is not there.
        host: the address that it listens on.
        port: the port that it really has.
        instance: what it says of itself in each answer, since after its end its port may be another's.
    """
    state_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    file = state_dir / ADDRESS_FILE
    beside = file.with_suffix(".new")
    beside.write_text(json.dumps({"host": host, "port": port, "instance": instance, "pid": os.getpid()}) + "\n")
    beside.replace(file)


def remove_address(state_dir: Path, instance: str) -> None:
    """Remove what this process has written, unless another one has written since; nothing is said of a failure."""
    file = state_dir / ADDRESS_FILE
    try:
        if json.loads(file.read_text())["instance"] == instance:
            file.unlink()
    except (OSError, ValueError, KeyError, TypeError):
        return
