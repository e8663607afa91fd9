"""The fixtures of the command line's own tests."""

from tests.unit.cli.conftest import invoke

__all__ = ["invoke"]
