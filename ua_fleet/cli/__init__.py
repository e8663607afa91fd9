"""The command line, one command a file. `main` is the entry point of `ua-fleet`."""

from __future__ import annotations

import sys
from typing import NoReturn

__all__ = ["main"]


def main() -> NoReturn:
    """Run the command that the arguments name, and exit."""
    if sys.argv[1:2] == ["healthcheck"]:
        # Asked by every container every few seconds: it does without what the other commands need.
        from ua_fleet.cli.health import quick

        if (code := quick(sys.argv[2:])) is not None:
            sys.exit(code)
    from ua_fleet.cli.app import main as whole

    whole()
