"""What a program of a test says on stdout, from any of its threads: a line is one write, so that no two get mixed.

`print` writes each of its arguments, the spaces and the end of the line apart.
"""

from __future__ import annotations

import sys

__all__ = ["say"]


def say(*what: object) -> None:
    """Say it on a line of its own, at once."""
    sys.stdout.write(" ".join(map(str, what)) + "\n")
    sys.stdout.flush()
