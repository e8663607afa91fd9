"""`ua-fleet login`, `logout` and `contexts`: one password, and then none for some days."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.context_file import ContextFile, LoginContext, check_name
from ua_fleet.cli.endings import NotFound, UsageError, extra_needed
from ua_fleet.cli.options import (
    CONNECT_TIMEOUT_S,
    DEFAULT_ENDPOINT,
    ConnectionOptions,
    ContextName,
    Insecure,
    Json,
    PasswordFile,
    Policy,
    SecurityPolicy,
    Timeout,
    complete_context,
    password_for,
)
from ua_fleet.cli.output import message, print_json, print_line, print_table
from ua_fleet.cli.process import run
from ua_fleet.errors import AccessRefused, UaFleetError
from ua_fleet.values import StatusCode

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient, IssuedKey

__all__ = ["CONTEXTS_EXAMPLES", "LOGIN_EXAMPLES", "LOGOUT_EXAMPLES", "contexts", "login", "logout"]

LOGIN_EXAMPLES = (
    "ua-fleet login --user anna",
    "ua-fleet login opc.tcp://10.0.0.5:4840/ua_fleet --user anna -c hall2",
    "ua-fleet login -c hall2",
)
LOGOUT_EXAMPLES = ("ua-fleet logout", "ua-fleet logout -c hall2")
CONTEXTS_EXAMPLES = ("ua-fleet contexts", "ua-fleet contexts --use hall2")

DEFAULT_DAYS: Final = 7.0
DAY_S: Final = 86_400.0


def login(
    endpoint: Annotated[
        str | None,
        typer.Argument(
            envvar="UA_FLEET_ENDPOINT",
            help=f"URL of the OPC UA server; without it that of the context, or {DEFAULT_ENDPOINT}.",
        ),
    ] = None,
    user: Annotated[
        str | None, typer.Option("--user", "-u", envvar="UA_FLEET_USER", help="User; without it that of the context.")
    ] = None,
    context: ContextName = None,
    password_file: PasswordFile = None,
    days: Annotated[
        float, typer.Option(help="Validity of the key in days; the server may shorten it.", min=0.01)
    ] = DEFAULT_DAYS,
    policy: SecurityPolicy = None,
    insecure: Insecure = False,
    timeout: Timeout = CONNECT_TIMEOUT_S,
    as_json: Json = False,
) -> None:
    """Log in once: afterwards the other commands need neither endpoint, user nor password.

    The server issues a session key, which is kept instead of the password: in the keyring of the desktop if the package
    keyring is installed and works, otherwise in a file that other users cannot read. A second login gets a new key, and
    the server ends the old one. Each server and user is a context of its own; the last one is current.
    """
    file = ContextFile()
    stored = file.load()
    known = stored.find(check_name(context)) if context else None
    if context is None and endpoint is None and user is None:
        known = stored.chosen
    endpoint = endpoint or (known.endpoint if known else DEFAULT_ENDPOINT)
    user = user or (known.user if known else _ask_user())
    if known is not None and known.endpoint == endpoint:
        policy, insecure = policy or Policy(known.policy), insecure or known.insecure
    policy = policy or Policy.BASIC256SHA256
    if password_file is None and "UA_FLEET_PASSWORD" not in os.environ and sys.stdin.isatty():
        run(_knock(ConnectionOptions(endpoint, None, None, policy, insecure, timeout)))
    wanted = ConnectionOptions(endpoint, user, password_for(user, password_file), policy, insecure, timeout)
    run(_login(file, wanted, user, context, days, as_json))


async def _knock(wanted: ConnectionOptions) -> None:
    """Raise what stands in the way before a password is typed: nobody answers, or does not trust our certificate."""
    try:
        async with connected(wanted):
            pass
    except AccessRefused as error:
        # That it takes nobody without a user is as it should be.
        if error.ua_status != StatusCode.BAD_IDENTITY_TOKEN_REJECTED:
            raise


def _ask_user() -> str:
    if not sys.stdin.isatty():
        raise UsageError("the user is missing; run: ua-fleet login --user NAME")
    name = str(typer.prompt("User", err=True))
    if not name:
        raise UsageError("the user is missing; run: ua-fleet login --user NAME")
    return name


async def _login(
    file: ContextFile, wanted: ConnectionOptions, user: str, name: str | None, days: float, as_json: bool
) -> None:
    with extra_needed("this command", "client"):
        from ua_fleet.client import issue_session_key
    async with connected(wanted) as client:
        issued = await issue_session_key(client, f"ua-fleet on {socket.gethostname()}", days * DAY_S)
        made, before = file.put(_context(name or "", wanted, user, client, issued), issued.key)
        is_same = before is not None and (before.user, before.server_uri) == (user, client.server_uri)
        if before is not None and is_same:
            await _end(client, before)
    if before is not None:
        file.forget_key(before)
        if not is_same and (problem := await _end_by_itself(before)):
            _tell_left(before, problem)
    if issued.message:
        message(issued.message)
    if as_json:
        print_json(_as_json(made, is_current=True))
    else:
        where = "in the keyring" if made.key is None else f"in {file.path}"
        print_line(f"logged in as {user} at {made.endpoint}: context {made.name}, until {_local(made.valid_until)}")
        message(f"its key is kept {where}; end it with: ua-fleet logout")


def _context(name: str, wanted: ConnectionOptions, user: str, client: FleetClient, issued: IssuedKey) -> LoginContext:
    return LoginContext(
        name=name,
        endpoint=wanted.endpoint,
        user=user,
        server_uri=client.server_uri,
        policy=wanted.policy.value,
        insecure=wanted.insecure,
        key_id=issued.id,
        valid_until=issued.valid_until,
        key=issued.key,
    )


async def _end(client: FleetClient, context: LoginContext) -> None:
    """End the key of a context, which may have ended already."""
    from ua_fleet.client import NotDone, revoke_session_key

    with contextlib.suppress(NotDone):
        await revoke_session_key(client, context.key_id)


async def _end_by_itself(context: LoginContext) -> str:
    """End the key of a context by that key itself; why not, or empty."""
    if context.has_ended(datetime.now(UTC)):
        return ""
    try:
        key, policy = context.secret(), Policy(context.policy)
        wanted = ConnectionOptions(
            context.endpoint,
            context.user,
            key,
            policy,
            context.insecure,
            CONNECT_TIMEOUT_S,
            context.name,
            context.server_uri,
        )
        async with connected(wanted) as client:
            await _end(client, context)
    except UaFleetError as error:
        return str(error)
    return ""


def _tell_left(context: LoginContext, problem: str) -> None:
    message(f"the server did not end the key: {problem}")
    message(
        f"the key is valid until {_local(context.valid_until)}; on the server run: "
        f"ua-fleet user logout {context.user} --key {context.key_id}"
    )


def logout(context: ContextName = None, as_json: Json = False) -> None:
    """Log out: the server ends the session key, and this machine deletes it."""
    file = ContextFile()
    stored = file.load()
    found = stored.named(context) if context is not None else stored.chosen
    if found is None:
        there = ", ".join(one.name for one in stored.all) or "none"
        raise NotFound(f"no context is the current one; contexts: {there}; name one with: ua-fleet logout -c NAME")

    async def end() -> None:
        problem = await _end_by_itself(found)
        file.remove(found)
        if problem:
            _tell_left(found, problem)

    run(end())
    if as_json:
        print_json({"logged_out": found.name})
    else:
        print_line(f"logged out: context {found.name} ({found.user} at {found.endpoint})")


def contexts(
    use: Annotated[
        str | None,
        typer.Option(help="Make this context the current one.", autocompletion=complete_context),
    ] = None,
    as_json: Json = False,
) -> None:
    """List where `ua-fleet login` has logged in, which of these is used, and until when its key is valid."""
    file = ContextFile()
    stored = file.switch(use) if use is not None else file.load()
    now = datetime.now(UTC)
    if as_json:
        for one in stored.all:
            print_json(_as_json(one, is_current=one.name == stored.current))
        return
    if not stored.all:
        message("not logged in anywhere; log in: ua-fleet login ENDPOINT --user NAME")
        return
    rows = [
        (
            "*" if one.name == stored.current else "",
            one.name,
            one.user,
            one.endpoint,
            f"ended; run: {one.login_command}" if one.has_ended(now) else _local(one.valid_until),
        )
        for one in stored.all
    ]
    print_table([("", "name", "user", "endpoint", "valid until"), *rows])
    if os.environ.get("UA_FLEET_CONTEXT") or os.environ.get("UA_FLEET_ENDPOINT") or os.environ.get("UA_FLEET_USER"):
        message("UA_FLEET_CONTEXT, UA_FLEET_ENDPOINT or UA_FLEET_USER is set and has priority over the current context")


def _as_json(context: LoginContext, *, is_current: bool) -> dict[str, object]:
    shown = {key: value for key, value in context.dump().items() if key != "key"}
    return {**shown, "current": is_current, "in_keyring": context.key is None}


def _local(moment: datetime) -> str:
    return f"{moment.astimezone():%Y-%m-%d %H:%M %Z}"
