"""Connecting a command to the server."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from ua_fleet.cli.endings import extra_needed
from ua_fleet.cli.options import Connection
from ua_fleet.cli.output import message

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient

__all__ = ["connected"]


@asynccontextmanager
async def connected(options: Connection) -> AsyncGenerator[FleetClient]:
    """The client that the options ask for."""
    with extra_needed("this command", "client"):
        from ua_fleet.client import FleetClient
    async with FleetClient.connect(
        options.endpoint,
        user=options.user,
        password=options.password,
        policy=options.policy.value,
        insecure=options.insecure,
        timeout_s=options.timeout_s,
    ) as client:
        if client.meeting.is_first:
            others = f"; another than {', '.join(client.meeting.others)}" if client.meeting.others else ""
            message(
                f"{options.endpoint}: first meeting with this server{others}; its certificate is trusted from now on"
            )
        yield client
