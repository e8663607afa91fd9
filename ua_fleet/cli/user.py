"""`ua-fleet user`: who may use the server."""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.endings import NotFound, UsageError
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, read_secret, state_folder
from ua_fleet.cli.output import message, print_json, print_line, print_table
from ua_fleet.printing import config_option

if TYPE_CHECKING:
    from ua_fleet.endpoint.session_keys import SessionKeys
    from ua_fleet.endpoint.users import UserStore

__all__ = [
    "ADD_EXAMPLES",
    "KEYS_EXAMPLES",
    "LIST_EXAMPLES",
    "LOGOUT_EXAMPLES",
    "REMOVE_EXAMPLES",
    "RoleName",
    "add",
    "keys",
    "logout",
    "remove",
    "show",
]

ADD_EXAMPLES = (
    "ua-fleet user add anna --role operator",
    "pass show hall2/anna | ua-fleet user add anna --role operator --password-file -",
)
LIST_EXAMPLES = ("ua-fleet user list", "ua-fleet user list --json -c hall2.yaml")
REMOVE_EXAMPLES = ("ua-fleet user remove anna",)
KEYS_EXAMPLES = ("ua-fleet user keys", "ua-fleet user keys anna --json")
LOGOUT_EXAMPLES = ("ua-fleet user logout anna", "ua-fleet user logout anna --key 9f3a5b27c04d1e88")


class RoleName(StrEnum):
    """The roles of `server/users.py`; a test compares them. Importing those would slow down `--help`."""

    OBSERVER = "observer"
    OPERATOR = "operator"
    ENGINEER = "engineer"


def _store(config: Path) -> UserStore:
    from ua_fleet.endpoint.users import USERS_FILE, UserStore

    _, folder = state_folder(config)
    return UserStore(folder / USERS_FILE)


def _session_keys(config: Path) -> SessionKeys:
    from ua_fleet.endpoint.session_keys import DAY_S, KEYS_FILE, SessionKeys
    from ua_fleet.endpoint.users import USERS_FILE, UserStore

    fleet, folder = state_folder(config)
    return SessionKeys(folder / KEYS_FILE, UserStore(folder / USERS_FILE), fleet.server.max_session_key_days * DAY_S)


def _new_password(name: str, password_file: Path | None, command: str) -> str:
    """The password, which is held to the rule before it is asked for again."""
    if password_file is not None:
        return read_secret(password_file)
    if not sys.stdin.isatty():
        raise UsageError(
            "there is no terminal to ask for the password; give it with: --password-file FILE, or - for stdin"
        )
    from getpass import getpass

    from ua_fleet.endpoint.users import MIN_PASSWORD, check_password

    password = getpass(f"Password for {name} (at least {MIN_PASSWORD} characters): ")
    check_password(password)
    if getpass("The same again: ") != password:
        raise UsageError(f"the passwords differ; nothing was changed; run again: {command}")
    return password


def add(
    name: Annotated[str, typer.Argument(help="Name to log in with.")],
    role: Annotated[
        RoleName | None,
        typer.Option(
            help="observer reads; operator also writes and calls methods; engineer may do everything. Without it a new "
            "user is an observer, and one that is replaced keeps the role.",
        ),
    ] = None,
    password_file: Annotated[
        Path | None, typer.Option(help="Take the password from the first line of this file; - for stdin.")
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Give an existing user this password, and --role if it is given.")
    ] = False,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Add a user of the server. The password is asked for twice, and stored as a salted hash.

    A running server knows the user at once.
    """
    from ua_fleet.endpoint.users import Role

    store = _store(config)
    known = next((user for user in store.list() if user.name == name), None)
    file = config_option()
    if known is not None and not replace:
        raise UsageError(
            f"there is a user {name} already; to change the password run: "
            f"ua-fleet user add {name} --role {known.role.value} --replace{file}"
        )
    given = Role(role.value) if role is not None else known.role if known is not None else Role.OBSERVER
    # Without --role, the command that an error tells might give another one by then.
    again = f"ua-fleet user add {name} --role {given.value}{' --replace' if replace else ''}{file}"
    user = store.add(name, _new_password(name, password_file, again), given, replace_existing=replace)
    if as_json:
        print_json({"name": user.name, "role": user.role.value})
    else:
        print_line(f"{user.name} ({user.role.value})")
    message(f"stored in {store.path}")


def show(config: Config = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """List the users of the server with their roles."""
    store = _store(config)
    users = store.list()
    if as_json:
        for user in users:
            print_json({"name": user.name, "role": user.role.value})
        return
    if users:
        print_table([("name", "role"), *((user.name, user.role.value) for user in users)])
    else:
        message(
            "no user exists, so no client can log in; add one with: "
            f"ua-fleet user add NAME --role operator{config_option()}"
        )


def remove(
    name: Annotated[str, typer.Argument(help="The user's name.")],
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Remove a user of the server. The user cannot log in from now on."""
    store = _store(config)
    if name not in {user.name for user in store.list()}:
        raise NotFound(f"there is no user {name}; list them with: ua-fleet user list{config_option()}")
    store.remove(name)
    if as_json:
        print_json({"removed": name})
    else:
        print_line(f"removed {name}")


def keys(
    name: Annotated[str | None, typer.Argument(help="A user; without one, all of them.")] = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """List the session keys by which users log in without their passwords, and until when they are valid."""
    found = _session_keys(config).list(time.time(), name)
    if as_json:
        for key in found:
            times = {"issued": _time(key.issued).isoformat(), "valid_until": _time(key.until).isoformat()}
            print_json({"user": key.user, "key": key.id, "name": key.name, **times})
        return
    if not found:
        message("there are no session keys; users get one with: ua-fleet login")
        return
    rows = [(key.user, key.id, key.name, f"{_time(key.until):%Y-%m-%d %H:%M} UTC") for key in found]
    print_table([("user", "key", "name", "valid until"), *rows])


def logout(
    name: Annotated[str, typer.Argument(help="The user's name.")],
    key: Annotated[str | None, typer.Option(help="Only this key, as `ua-fleet user keys` shows it.")] = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """End the session keys of a user, and the sessions that were opened with them.

    A running server does so at once. The password stays; `user add --replace` sets another one, and ends all keys too.
    """
    stored, now = _session_keys(config), time.time()
    found = stored.list(now, name)
    ended = [one for one in found if key in (None, one.id)]
    if not ended:
        which = f"no session key {key}" if key is not None else "no session keys"
        raise NotFound(f"user {name} has {which}; list them with: ua-fleet user keys{config_option()}")
    if key is None:
        stored.revoke_all(name, now)
    else:
        stored.revoke(name, key, now)
    for one in ended:
        if as_json:
            print_json({"user": name, "ended": one.id, "name": one.name})
        else:
            print_line(f"ended {one.id}  {one.name}")


def _time(time_s: float) -> datetime:
    return datetime.fromtimestamp(time_s, UTC).replace(microsecond=0)
