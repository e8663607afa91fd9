"""The job that all processes of a testbed wait for: it writes what they need into their volumes, and ends.

It may run as often as one likes. What is there stays: certificates, users, keys, files that were edited, and whom the
server trusts or no longer does. All that is secret is made here, on the machine where it is used.
"""

from __future__ import annotations

import asyncio
import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Final

from ua_demo.console import CONSOLE, introduce_console
from ua_demo.layout import check_same_fleet
from ua_demo.site import USER
from ua_demo.testbed.broker import prepare_broker
from ua_demo.testbed.key_files import prepare_keys
from ua_demo.testbed.plan import FLEET, IDENTITY, OPERATOR, PASSWORD, SERVER, Options, Testbed
from ua_demo.testbed.volumes import check_volume, write_unless_edited
from ua_fleet.client import ClientIdentity
from ua_fleet.config.load import load
from ua_fleet.config.schema import FleetConfig
from ua_fleet.console.identity import console_identity
from ua_fleet.endpoint.certificates import (
    CertificateState,
    ensure_application_certificate,
    host_names,
    list_certificates,
    load_certificate,
    thumbprint,
    trust,
)
from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore
from ua_fleet.errors import ConfigError
from ua_fleet.server.app import application_uri
from ua_fleet.server.mutual_trust import introduce_bridge
from ua_fleet.storage.files import write_whole

__all__ = ["prepare"]

_SERVICES: Final = ("server",)
"""Names by which clients in other containers reach the server."""


async def prepare(testbed: Testbed, folder: Path, options: Options, say: Callable[[str], None]) -> None:
    """Prepare the volumes of a testbed.

    Args:
        testbed: which.
        folder: the volumes' folders stand in it.
        options: chosen by the user.
        say: tells people what was done, and what was not.

    Raises:
        ConfigError: a volume cannot be used: its name, what is wrong, and the remedy.
        ConfigInvalid: somebody has edited fleet.yaml, and made mistakes.
        ServerStartError: a certificate that is there is of no use.
    """
    try:
        await _prepare(testbed, folder, options, say)
    except OSError as error:
        remedy = "free some room, or remove the volume, and start again"
        reason = error.strerror or type(error).__name__
        raise ConfigError(
            f"cannot be written: {reason}", file=str(error.filename or folder), suggestion=remedy
        ) from error


async def _prepare(testbed: Testbed, folder: Path, options: Options, say: Callable[[str], None]) -> None:
    fleet = folder / FLEET
    check_volume(fleet, os.geteuid())
    files = testbed.files(options)
    check_same_fleet(fleet / "fleet.yaml", files["fleet.yaml"], "give this testbed volumes of its own")
    for name in testbed.volumes:
        check_volume(folder / name, os.geteuid())
    for edited in write_unless_edited(fleet, files):
        say(f"{fleet / edited} was edited, and is kept whatever UA_FLEET_... says; remove it for a new one")
    config = load(fleet / "fleet.yaml", {**os.environ, **testbed.environment(SERVER)})
    server = folder / SERVER
    certificate = _server_certificate(config, server, options, say)
    if testbed.has_broker:
        prepare_keys(config, folder)
        prepare_broker(config, folder)
    # Who has keys from files never comes to the server as a client.
    for bridge in config.bridges if config.pubsub.keys.source == "service" else ():
        own = ClientIdentity.of_bridge(fleet / config.state_dir_of(bridge), config.fleet.name, bridge).certificate
        if not _was_revoked(server, own, f"--bridge {bridge} ", say):
            await introduce_bridge(config, fleet, bridge)
    await _operator(folder / OPERATOR, server, certificate, say)
    await _console(folder / CONSOLE, server, certificate, say)
    say(f"the testbed {testbed.name} is prepared: {len(config.bridges)} bridges, user {USER}")


def _server_certificate(config: FleetConfig, server: Path, options: Options, say: Callable[[str], None]) -> bytes:
    published = [options.published_host] if options.published_host != "0.0.0.0" else []
    wanted = [*_SERVICES, *published]
    made = ensure_application_certificate(server, application_uri(config), wanted)
    missing = set(wanted) - host_names(load_certificate(made.certificate))
    if missing:
        say(
            f"{made.certificate} does not name {', '.join(sorted(missing))}: UaExpert will say so; move it and its key "
            "away for a new one, which all clients meet anew"
        )
    return made.certificate.read_bytes()


def _was_revoked(server: Path, certificate: Path, option: str, say: Callable[[str], None]) -> bool:
    """Whether the server has trusted a certificate, and does not any more: that is not ours to undo."""
    if not certificate.exists():
        return False
    mark = thumbprint(load_certificate(certificate))
    if {info.state for info in list_certificates(server) if info.thumbprint == mark} != {CertificateState.REJECTED}:
        return False
    say(f"{certificate} was revoked, and stays so; undo it on the server with: ua-fleet cert trust {option}{mark[:12]}")
    return True


async def _operator(operator: Path, server: Path, server_certificate: bytes, say: Callable[[str], None]) -> None:
    """The user with a password, and a client that the server knows, and that knows the server."""
    password = operator / PASSWORD
    store = UserStore(server / USERS_FILE)
    if not password.exists() or all(user.name != USER for user in store.list()):
        word = secrets.token_urlsafe(12)
        await asyncio.to_thread(store.add, USER, word, Role.OPERATOR, replace_existing=True)
        write_whole(password, f"{word}\n".encode())
    identity = ClientIdentity(operator / IDENTITY, application_uri="urn:ua-fleet:testbed:client")
    await identity.ensure()
    if not _was_revoked(server, identity.certificate, "", say):
        trust(server, identity.certificate)
    write_whole(identity.pinned_server, server_certificate)


async def _console(state: Path, server: Path, server_certificate: bytes, say: Callable[[str], None]) -> None:
    """A console that the server knows as a gateway, and that knows the server."""
    identity = console_identity(state)
    if not _was_revoked(server, identity.certificate, f"--gateway {CONSOLE} ", say):
        await introduce_console(server, state)
    write_whole(identity.pinned_server, server_certificate)
