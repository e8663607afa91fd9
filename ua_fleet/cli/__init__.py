"""The command line, one command a file. `main` is the entry point of `ua-fleet`."""

from ua_fleet.cli.app import main

__all__ = ["main"]
