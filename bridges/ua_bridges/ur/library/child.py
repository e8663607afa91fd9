"""The bridge's end of a child with ur-rtde: start it, read its lines with a limit, end it."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from typing import Any, Final

__all__ = ["ChildEnded", "ChildFailed", "LibraryChild", "NoAnswer"]

_READ_BYTES: Final = 1 << 20
_LONGEST_LINE: Final = 1 << 20


class ChildFailed(Exception):
    """The child has ended, or says why it cannot do what it should."""


class ChildEnded(ChildFailed):
    """The child has ended without a word, as a library does that cannot bear what it reads."""


class NoAnswer(ChildFailed):
    """The child said nothing in time. It is of no use any more."""


class LibraryChild:
    """One process with ur-rtde. For one thread."""

    def __init__(self, module: str, *arguments: str) -> None:
        """Start it; `module` is the last part of its name.

        Raises:
            ChildFailed: the system has no place for another process.
        """
        try:
            self._process = subprocess.Popen(  # noqa: S603 - our own module, and values that the configuration checked
                # Where modules are is told: so it need not look for that at its start, for longer than all else there.
                [sys.executable, "-S", "-m", f"ua_bridges.ur.library.{module}", *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                bufsize=0,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            )
        except OSError as error:
            raise ChildFailed(
                f"ur-rtde's process cannot be started ({error.strerror or error}); see the limits of this machine"
            ) from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        self._rest = b""

    @property
    def has_ended(self) -> bool:
        """Whether it is gone."""
        return self._process.poll() is not None

    def say(self, thing: Any) -> None:
        """A line for it.

        Raises:
            ChildFailed: it has ended.
        """
        try:
            self._in.write(json.dumps(thing).encode() + b"\n")  # shorter than what a pipe takes at once
        except OSError as error:
            raise ChildFailed("ur-rtde's process has ended") from error

    def line(self, timeout_s: float) -> Any:
        """Its next line; with 0 only one that is there.

        Raises:
            NoAnswer: none came in time.
            ChildEnded: it has ended.
        """
        deadline = time.monotonic() + timeout_s
        while b"\n" not in self._rest:
            left = deadline - time.monotonic()
            if not select.select([self._out], [], [], max(left, 0.0))[0]:
                raise NoAnswer(f"no answer within {timeout_s:g} s")
            data = os.read(self._out.fileno(), _READ_BYTES)
            self._rest += data
            if not data or len(self._rest) > _LONGEST_LINE:
                raise ChildEnded("ur-rtde's process has ended")
        line, self._rest = self._rest.split(b"\n", 1)
        return json.loads(line)

    def end(self) -> None:
        """End it, whatever it does."""
        self._process.kill()
        self._process.wait()
        self._in.close()
        self._out.close()
