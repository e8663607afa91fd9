"""Connecting a command to the server."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Generator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from typing import TYPE_CHECKING

from ua_fleet.cli.endings import extra_needed
from ua_fleet.cli.options import ConnectionOptions
from ua_fleet.cli.output import message
from ua_fleet.errors import AccessRefused
from ua_fleet.values import StatusCode

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient

__all__ = ["connected"]


@asynccontextmanager
async def connected(options: ConnectionOptions) -> AsyncGenerator[FleetClient]:
    """The client that the options ask for."""
    with extra_needed("this command", "client"):
        from ua_fleet.client import FleetClient
    async with AsyncExitStack() as stack:
        with _told_of(options):
            client = await stack.enter_async_context(
                FleetClient.connect(
                    options.endpoint,
                    user=options.user,
                    password=options.password,
                    policy=options.policy.value,
                    insecure=options.insecure,
                    server_uri=options.server_uri,
                    timeout_s=options.timeout_s,
                )
            )
        if client.meeting.is_first:
            others = f"; another than {', '.join(client.meeting.others)}" if client.meeting.others else ""
            message(
                f"{options.endpoint}: first meeting with this server{others}; its certificate is trusted from now on"
            )
        yield client


@contextmanager
def _told_of(options: ConnectionOptions) -> Generator[None]:
    """Say what a refusal means for a context, and what to do."""
    from ua_fleet.client import AnotherServer

    again = f"ua-fleet login -c {options.context}"
    try:
        yield
    except AnotherServer as error:
        raise AccessRefused(
            error.ua_status,
            f"context {options.context}: {error}; its key was not sent; log in to the other one: "
            f"ua-fleet login {options.endpoint} --user {options.user}",
        ) from error
    except AccessRefused as error:
        if not options.context or error.ua_status != StatusCode.BAD_USER_ACCESS_DENIED:
            raise
        raise AccessRefused(
            error.ua_status,
            f"context {options.context}: {options.endpoint} does not take the key of {options.user} any more: it was "
            f"revoked, or the password has changed; log in again: {again}",
        ) from error
