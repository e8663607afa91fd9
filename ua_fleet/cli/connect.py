"""Connecting a command to the server."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ua_fleet.cli.endings import extra_needed
from ua_fleet.cli.options import password_for
from ua_fleet.cli.output import message

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient

__all__ = ["connected"]


@asynccontextmanager
async def connected(
    endpoint: str, user: str | None, password_file: Path | None, *, insecure: bool, timeout_s: float
) -> AsyncGenerator[FleetClient]:
    """The client that the options ask for."""
    with extra_needed("this command", "client"):
        from ua_fleet.client import FleetClient
    password = password_for(user, password_file)
    async with FleetClient.connect(
        endpoint, user=user, password=password, insecure=insecure, timeout_s=timeout_s
    ) as client:
        if client.first_meeting:
            message(f"{endpoint}: first meeting with this server; its certificate is trusted from now on")
        yield client
