"""The application: its commands, and how an error ends it.

Data goes to stdout, messages to stderr. Exit codes: 0 done, 1 failed, 2 usage or configuration, 3 not found, 4
unreachable, 5 timeout, 130 interrupted.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Final, NoReturn

import typer

from ua_fleet.cli import bridge, browse, demo, read, serve, watch, write
from ua_fleet.errors import (
    BridgeUnavailable,
    ConfigError,
    ConfigInvalid,
    NotConnected,
    SendTimeout,
    SkillTimeout,
    TopicInvalid,
    TransportError,
    UaFleetError,
)
from ua_fleet.values import StatusCode

__all__ = ["app", "exit_code_of", "main"]

app = typer.Typer(
    name="ua-fleet",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="A mixed fleet of robots as one OPC UA server, with UA bridges over OPC UA PubSub.",
)
app.command("serve")(serve.serve)
app.command("bridge")(bridge.bridge)
app.command("browse")(browse.browse)
app.command("read")(read.read)
app.command("write")(write.write)
app.command("watch")(watch.watch)
app.add_typer(demo.app, name="demo")

EXIT_FAILED: Final = 1
EXIT_USAGE: Final = 2
EXIT_NOT_FOUND: Final = 3
EXIT_UNREACHABLE: Final = 4
EXIT_TIMEOUT: Final = 5
EXIT_INTERRUPTED: Final = 130


def exit_code_of(error: UaFleetError) -> int:
    """The exit code that an error ends the command with."""
    if isinstance(error, ConfigError | ConfigInvalid | TopicInvalid | BridgeUnavailable):
        return EXIT_USAGE
    if isinstance(error, SendTimeout | SkillTimeout):
        return EXIT_TIMEOUT
    if isinstance(error, NotConnected | TransportError):
        return EXIT_UNREACHABLE
    if error.ua_status == StatusCode.BAD_NODE_ID_UNKNOWN:
        return EXIT_NOT_FOUND
    return EXIT_FAILED


def _end(code: int) -> NoReturn:
    """End with a code, also when nobody reads stdout any more."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def _interrupt(_number: int, _frame: object) -> NoReturn:
    raise KeyboardInterrupt


def main() -> NoReturn:
    """Run the command that the arguments name, and exit."""
    # Ended by a supervisor is ended in order, as with Ctrl-C.
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        app(standalone_mode=False)
    except typer.Exit as ending:
        _end(ending.exit_code)
    except typer.Abort:
        _end(EXIT_INTERRUPTED)
    except KeyboardInterrupt:
        _end(EXIT_INTERRUPTED)
    except BrokenPipeError:
        _end(EXIT_FAILED)
    except UaFleetError as error:
        sys.stderr.write(f"ua-fleet: {error}\n" if "\n" not in str(error) else f"{error}\n")
        _end(exit_code_of(error))
    _end(0)
