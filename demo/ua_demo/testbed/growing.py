"""Files that other processes append lines to, read as they grow."""

from __future__ import annotations

from pathlib import Path
from stat import S_ISREG
from typing import Final

__all__ = ["GrowingFiles"]

_KEPT: Final = ".1"
"""What the name of a file that has grown too long gets; see `report.py`."""


class GrowingFiles:
    """The lines of some files of a folder, each once."""

    def __init__(self, folder: Path, suffix: str) -> None:
        """Look for files in `folder` whose names end with `suffix`, now or later."""
        self._folder, self._suffix = folder, suffix
        self._read: dict[Path, tuple[int, int]] = {}
        """Of each path the file (its inode), and how far that one was read, in bytes."""

    def new_lines(self) -> list[str]:
        """The whole lines that have come since this was asked last."""
        lines: list[str] = []
        for path in sorted(self._folder.glob(f"*{self._suffix}")):
            known, offset = self._read.get(path, (0, 0))
            try:
                status = path.lstat()
                if not S_ISREG(status.st_mode):
                    continue  # whoever writes here may leave a link, or a pipe on which a reader waits for ever
                if known not in (0, status.st_ino):
                    # It was begun anew: first the rest of the one before.
                    lines += self._lines_of(path.with_name(path.name + _KEPT), known, offset)
                    offset = 0
                lines += self._lines_of(path, status.st_ino, offset if offset <= status.st_size else 0)
            except FileNotFoundError:
                continue
        return lines

    def _lines_of(self, path: Path, number: int, offset: int) -> list[str]:
        if not path.exists() or path.stat().st_ino != number:
            return []
        with path.open("rb") as file:
            file.seek(offset)
            content = file.read()
        end = content.rfind(b"\n") + 1
        if not path.name.endswith(_KEPT):
            self._read[path] = (number, offset + end)
        return content[:end].decode("utf-8", errors="replace").splitlines()
