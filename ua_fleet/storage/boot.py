"""Whether a computer was started anew since a bridge wrote down its last facts: its clock may not tell that.

A computer without a clock of its own begins with the time of its last shutdown, so that it seems to have been away for
seconds.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

__all__ = ["BootNote"]

BOOT_FILE: Final = "carried.boot"
"""In a bridge's `state_dir`."""
BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")
"""Another one after each start of the computer."""


class BootNote:
    """The boot in which a bridge wrote last."""

    def __init__(self, state_dir: Path) -> None:
        """It is kept in this folder."""
        self._file = state_dir / BOOT_FILE

    def is_other(self) -> bool:
        """Whether the last note is of another boot than this one; not where nothing was noted, or nothing is known."""
        now = self._now()
        try:
            return bool(now) and self._file.read_text("ascii", "replace").strip() != now
        except OSError:
            return False

    def write(self) -> None:
        """Note this boot. Where that fails the one before stays, and the next process asks other bridges needlessly."""
        now = self._now()
        if now and (self.is_other() or not self._file.exists()):
            with suppress(OSError):
                self._file.write_text(f"{now}\n", "ascii")

    @staticmethod
    def _now() -> str:
        try:
            return BOOT_ID.read_text("ascii").strip()
        except OSError:
            return ""
