"""Options that several commands share."""

from __future__ import annotations

import inspect
import os
import stat
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ua_fleet.cli.endings import UsageError
from ua_fleet.printing import config_option

if TYPE_CHECKING:
    from ua_fleet.cli.context_file import LoginContext
    from ua_fleet.config import FleetConfig

__all__ = [
    "DEFAULT_CONFIG",
    "DEFAULT_ENDPOINT",
    "Config",
    "ConnectionOptions",
    "ContextName",
    "Endpoint",
    "Insecure",
    "Json",
    "PasswordFile",
    "Policy",
    "SecurityPolicy",
    "Timeout",
    "User",
    "WithoutLoopRule",
    "complete_context",
    "connecting",
    "load_config",
    "password_for",
    "read_secret",
    "state_folder",
]

DEFAULT_CONFIG: Final = Path("fleet.yaml")
CONNECT_TIMEOUT_S: Final = 10.0
DEFAULT_ENDPOINT: Final = "opc.tcp://127.0.0.1:4840/ua_fleet"


def _about(path: Path) -> Path:
    """Have all commands that are printed from here on name the file, those of a wrong usage too."""
    config_option(path, DEFAULT_CONFIG)
    return path


Config = Annotated[
    Path,
    typer.Option("--config", "-c", envvar="UA_FLEET_CONFIG", help="The fleet's configuration file.", callback=_about),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, one object a line.")]
Endpoint = Annotated[
    str, typer.Option("--endpoint", "-e", envvar="UA_FLEET_ENDPOINT", help="URL of the OPC UA server.")
]
_Server = Annotated[
    str | None,
    typer.Option(
        "--endpoint",
        "-e",
        envvar="UA_FLEET_ENDPOINT",
        help=f"URL of the OPC UA server; without it that of the context, or {DEFAULT_ENDPOINT}.",
    ),
]
User = Annotated[
    str | None,
    typer.Option(
        "--user", "-u", envvar="UA_FLEET_USER", help="User; without it that of the context, or '' for anonymous."
    ),
]
PasswordFile = Annotated[
    Path | None,
    typer.Option(
        help="File that holds the password (- for stdin); otherwise UA_FLEET_PASSWORD, otherwise it is asked for."
    ),
]


class Policy(StrEnum):
    """Security policies of `client/fleet_client.py`; a test compares them. Importing those would slow down `--help`."""

    BASIC256SHA256 = "Basic256Sha256"
    AES128_SHA256_RSA_OAEP = "Aes128Sha256RsaOaep"
    AES256_SHA256_RSA_PSS = "Aes256Sha256RsaPss"


@dataclass(frozen=True, slots=True)
class ConnectionOptions:
    """What the options say about the server and the user."""

    endpoint: str
    user: str | None
    password: str | None = field(repr=False)
    policy: Policy
    insecure: bool
    timeout_s: float

    context: str = ""
    """The context that it is of, where its key is the password."""
    server_uri: str = ""
    """ApplicationUri of the server that may be given the password; empty: of any."""

    @classmethod
    def of(
        cls,
        endpoint: str | None,
        user: str | None,
        password_file: Path | None,
        context: str | None,
        policy: Policy | None,
        insecure: bool,
        timeout: float,
    ) -> ConnectionOptions:
        """Say where and as whom, by the options and the contexts in which this user of the machine is logged in.

        A context that is named says both. Without one, what is not given is that of the current one; where a server or
        a user are given, the context of these has the key. Where it has to, it asks for the password; so it is to be
        called before an event loop runs, for Ctrl-C to work.
        """
        from ua_fleet.cli.context_file import ContextFile

        contexts = ContextFile().load()
        if context is not None:
            found: LoginContext | None = contexts.named(context)
            assert found is not None
            _check_not_both(found, endpoint, user)
        elif endpoint is None and user is None:
            found = contexts.chosen
        else:
            current = contexts.chosen
            endpoint = endpoint or (current.endpoint if current is not None else DEFAULT_ENDPOINT)
            is_given = password_file is not None or (user is not None and "UA_FLEET_PASSWORD" in os.environ)
            found = None if is_given or user == "" else contexts.of(endpoint, user)
        if found is None:
            chosen = policy or Policy.BASIC256SHA256
            password = password_for(user, password_file)
            return cls(endpoint or DEFAULT_ENDPOINT, user or None, password, chosen, insecure, timeout)
        chosen, insecure = policy or Policy(found.policy), insecure or found.insecure
        if password_file is not None:
            return cls(found.endpoint, found.user, read_secret(password_file), chosen, insecure, timeout)
        if found.has_ended(datetime.now(UTC)):
            raise UsageError(
                f"the key of context {found.name} ended {found.valid_until:%Y-%m-%d %H:%M} UTC; "
                f"log in again: {found.login_command}"
            )
        if insecure and found.server_uri:
            # Without security nobody can tell which server it is that is given the key.
            raise UsageError(
                f"context {found.name}: its key is for {found.server_uri} alone, and --insecure would give it to "
                f"whoever answers; leave that out, or log in so: {found.login_command} --insecure"
            )
        return cls(found.endpoint, found.user, found.secret(), chosen, insecure, timeout, found.name, found.server_uri)


def _check_not_both(context: LoginContext, endpoint: str | None, user: str | None) -> None:
    """Refuse a context together with another server or user; what stands in the environment gives way."""
    for name, given, own in (("endpoint", endpoint, context.endpoint), ("user", user, context.user)):
        if given not in (None, own, os.environ.get(f"UA_FLEET_{name.upper()}")):
            raise UsageError(f"context {context.name} has the {name} {own}; leave out --context or --{name} {given}")


def complete_context(incomplete: str) -> list[str]:
    """The names of contexts that begin so, for a shell."""
    from ua_fleet.cli.context_file import names

    return list(names(incomplete))


_CONTEXT_HELP: Final = "Context of `ua-fleet login`; without it, the current one (`ua-fleet contexts`)."
ContextName = Annotated[
    str | None,
    typer.Option("--context", "-c", envvar="UA_FLEET_CONTEXT", help=_CONTEXT_HELP, autocompletion=complete_context),
]
_LongContextName = Annotated[
    str | None,
    typer.Option("--context", envvar="UA_FLEET_CONTEXT", help=_CONTEXT_HELP, autocompletion=complete_context),
]
"""Where `-c` is the configuration file."""
SecurityPolicy = Annotated[
    Policy | None,
    typer.Option("--policy", help=f"Security policy of the connection; otherwise {Policy.BASIC256SHA256.value}."),
]
Insecure = Annotated[
    bool, typer.Option("--insecure", help="Connect without signing and encryption, if the server allows it.")
]
Timeout = Annotated[float, typer.Option(help="Time limit for an answer, in seconds.", min=0.1)]
WithoutLoopRule = Annotated[
    bool,
    typer.Option(
        "--without-loop-rule", help="For tests: forward every message, so that messages circulate without end."
    ),
]


def _connection_options(
    endpoint: _Server = None,
    user: User = None,
    password_file: PasswordFile = None,
    context: ContextName = None,
    policy: SecurityPolicy = None,
    insecure: Insecure = False,
    timeout: Timeout = CONNECT_TIMEOUT_S,
) -> None:
    """The options of every command that connects to the server."""


def connecting(command: Callable[..., None]) -> Callable[..., None]:
    """Let a command have the options of a connection, and give it what they say as `connection`.

    A command with a `timeout` of its own waits no longer than that for an answer.
    """
    wanted = inspect.signature(command, eval_str=True)
    options = dict(inspect.signature(_connection_options, eval_str=True).parameters)
    if "timeout" in wanted.parameters:
        del options["timeout"]
    if "config" in wanted.parameters:
        options["context"] = options["context"].replace(annotation=_LongContextName)
    own = [parameter for name, parameter in wanted.parameters.items() if name != "connection"]
    needed = [parameter for parameter in own if parameter.default is parameter.empty]
    others = [parameter for parameter in own if parameter not in needed]

    @wraps(command)
    def connected(**given: Any) -> None:
        said: dict[str, Any] = {"timeout": min(given.get("timeout") or CONNECT_TIMEOUT_S, CONNECT_TIMEOUT_S)}
        said |= {name: given.pop(name) for name in options}
        command(**given, connection=ConnectionOptions.of(**said))

    parameters = [*needed, *others, *options.values()]
    connected.__dict__["__signature__"] = wanted.replace(parameters=parameters)
    connected.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return connected


def load_config(
    path: Path, *, overrides: Mapping[str, object] | None = None, allow_missing_ids: bool = False
) -> FleetConfig:
    """Load the configuration file with the environment's layer, and the command's options above it."""
    from ua_fleet.config import load

    config_option(path, DEFAULT_CONFIG)
    return load(path, os.environ, overrides=overrides, allow_missing_ids=allow_missing_ids)


def state_folder(path: Path) -> tuple[FleetConfig, Path]:
    """A fleet, and the folder of its users and certificates."""
    config = load_config(path, allow_missing_ids=True)
    return config, path.resolve().parent / config.server.state_dir


def read_secret(path: Path) -> str:
    """The first line of a file that nobody else may read, or of stdin for `-`."""
    try:
        text = sys.stdin.read() if str(path) == "-" else _read_private(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UsageError(f"{path}: the password cannot be read: {reason}; name another --password-file") from error
    return text.partition("\n")[0].removesuffix("\r")


def _read_private(path: Path) -> str:
    with path.open(encoding="utf-8") as file:
        status = os.fstat(file.fileno())
        mode = stat.S_IMODE(status.st_mode)
        # A pipe, such as that of <(pass show anna), has no readers but its own.
        if stat.S_ISREG(status.st_mode) and mode & 0o077:
            raise UsageError(f"{path}: others may read the password (mode {mode:o}); run: chmod 600 {path}")
        return file.read()


def password_for(user: str | None, password_file: Path | None) -> str | None:
    """The password of a user: from the file, the environment, or asked for on a terminal."""
    if not user:
        return None
    if password_file is not None:
        return read_secret(password_file)
    given = os.environ.get("UA_FLEET_PASSWORD")
    if given is not None:
        return given
    if not sys.stdin.isatty():
        raise UsageError(
            f"there is no password for {user}; give --password-file or UA_FLEET_PASSWORD, or log in on a terminal: "
            f"ua-fleet login --user {user}"
        )
    from getpass import getpass

    return getpass(f"Password of {user}: ")
