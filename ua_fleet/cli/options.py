"""Options that several commands share."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Final

import typer

from ua_fleet.config import FleetConfig, load
from ua_fleet.errors import ConfigError

__all__ = [
    "DEFAULT_ENDPOINT",
    "Config",
    "Endpoint",
    "Insecure",
    "Json",
    "PasswordFile",
    "Timeout",
    "User",
    "WithoutLoopRule",
    "load_config",
    "password_for",
]

DEFAULT_ENDPOINT: Final = "opc.tcp://127.0.0.1:4840/ua_fleet"

Config = Annotated[
    Path, typer.Option("--config", "-c", envvar="UA_FLEET_CONFIG", help="The fleet's configuration file.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, one object a line.")]
Endpoint = Annotated[
    str, typer.Option("--endpoint", "-e", envvar="UA_FLEET_ENDPOINT", help="URL of the OPC UA server.")
]
User = Annotated[str | None, typer.Option("--user", "-u", envvar="UA_FLEET_USER", help="User; without it, anonymous.")]
PasswordFile = Annotated[
    Path | None,
    typer.Option(help="File that holds the password; otherwise UA_FLEET_PASSWORD, otherwise it is asked for."),
]
Insecure = Annotated[bool, typer.Option("--insecure", help="Neither sign nor encrypt, where the server allows it.")]
Timeout = Annotated[float, typer.Option(help="Longest wait for an answer, in seconds.", min=0.1)]
WithoutLoopRule = Annotated[
    bool,
    typer.Option("--without-loop-rule", help="For tests: forward everything, so that messages go round for ever."),
]


def load_config(path: Path) -> FleetConfig:
    """Load the configuration file with the environment's layer."""
    return load(path, os.environ)


def password_for(user: str | None, password_file: Path | None) -> str | None:
    """The password of a user: from the file, the environment, or asked for on a terminal."""
    if user is None:
        return None
    if password_file is not None:
        try:
            return password_file.read_text(encoding="utf-8").rstrip("\r\n")
        except OSError as error:
            raise ConfigError(f"cannot read the password: {error.strerror}", file=str(password_file)) from error
    given = os.environ.get("UA_FLEET_PASSWORD")
    if given is not None:
        return given
    if not sys.stdin.isatty():
        raise ConfigError(f"no password for {user}", suggestion="give --password-file or UA_FLEET_PASSWORD")
    return str(typer.prompt(f"Password of {user}", hide_input=True, err=True))
