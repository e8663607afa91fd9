"""The command line, one command a file. `main` is the entry point of `ua-fleet`."""

from __future__ import annotations

import sys
from typing import Final, NoReturn

__all__ = ["EXIT_INTERRUPTED", "main"]

EXIT_INTERRUPTED: Final = 130


def main() -> NoReturn:
    """Run the command that the arguments name, and exit."""
    if sys.argv[1:2] == ["healthcheck"]:
        # Asked by every container every few seconds: it does without what the other commands need.
        from ua_fleet.cli.health import quick

        if (code := quick(sys.argv[2:])) is not None:
            sys.exit(code)
    try:
        from ua_fleet.cli.app import main as whole
    except KeyboardInterrupt:  # the import takes half a second
        sys.exit(EXIT_INTERRUPTED)
    whole()
