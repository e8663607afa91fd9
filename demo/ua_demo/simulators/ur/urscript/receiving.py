"""Where a program ends in what comes in through a socket.

A client sends `def name():` to `end`, or single lines; TCP cuts and joins as it likes. Lines are counted by the word
that they begin with, so that a program's end is known before anything of it is understood.
"""

from __future__ import annotations

import re
from typing import Final

__all__ = ["ProgramReceiver"]

LARGEST_PROGRAM: Final = 1_000_000
_OPENS: Final = re.compile(r"\s*(def|sec|thread|while|if)\b")
_CLOSES: Final = re.compile(r"\s*end\s*(#.*)?$")


class ProgramReceiver:
    """What one connection has sent so far."""

    def __init__(self) -> None:
        self._rest = b""
        self._lines: list[str] = []
        self._size = 0
        self._depth = 0

    def feed(self, data: bytes) -> list[str]:
        """Bytes in, complete programs out.

        Raises:
            ValueError: it grows without end.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if self._size + len(self._rest) > LARGEST_PROGRAM:
            raise ValueError(f"a program of more than {LARGEST_PROGRAM} bytes")
        programs: list[str] = []
        for raw in lines:
            line = raw.decode("utf-8", "replace")
            self._size += len(raw) + 1
            if not self._lines and not line.strip():
                self._size = 0
                continue
            self._lines.append(line)
            if _OPENS.match(line):
                self._depth += 1
            elif _CLOSES.match(line):
                self._depth -= 1
            if self._depth <= 0:
                programs.append("\n".join(self._lines) + "\n")
                self._lines, self._size, self._depth = [], 0, 0
        return programs
