"""`relays` of `fleet.yaml`: processes that forward data from one PubSub connection to another."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ua_fleet.config.base import Model, Name, Port

__all__ = ["OriginName", "RelayConfig", "RelayedConfig"]

OriginName = (
    Annotated[int, Field(ge=0, le=65535)]
    | Annotated[str, Field(min_length=1, max_length=64, examples=["cell", "ua_1_2_1005"])]
)


class RelayedConfig(Model, frozen=True):
    """What a relay forwards in one direction."""

    source: Name
    """Name of the connection that it comes from."""
    target: Name
    """Name of the connection that it is sent to."""
    origins: Annotated[tuple[OriginName, ...], Field(min_length=1)]
    """Whose data: names of bridges, numbers of spaces (0 is the server's), or single sources like `ua_1_2_1005`. Who is
    on the target takes these from the relay, and nothing else. From JSON to UADP only single sources."""


class RelayConfig(Model, frozen=True):
    """A process that forwards data between PubSub connections (`ua-fleet pubsub relay`), never Actions or setpoints."""

    forwards: Annotated[tuple[RelayedConfig, ...], Field(min_length=1)]
    """What it forwards, each origin in one direction."""
    state_dir: str | None = None
    """Folder for its certificate and its use of keys; `state/relays/<name>` if left out. Relative to `fleet.yaml`."""
    monitoring_port: Port | None = None
    """This relay's port in place of `monitoring.port`."""
