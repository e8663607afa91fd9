"""By which of several PubSub connections a tool listens."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.endings import NotFound
from ua_fleet.names import listed

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig

__all__ = ["ConnectionName", "on_connection"]

ConnectionName = Annotated[
    str | None,
    typer.Option("--connection", metavar="NAME", help="Which connection of the file, where it has several. [first]"),
]


def on_connection(fleet: FleetConfig, name: str | None) -> FleetConfig:
    """The fleet over the connection of this name alone, the first one without a name; raises NotFound."""
    from ua_fleet.config.connections import over_one

    if name is None:
        return over_one(fleet, 0)
    names = [connection.name for connection in fleet.connections]
    if name not in names:
        there = listed([each for each in names if each is not None]) or "one without a name"
        raise NotFound(f"there is no connection {name!r} in `pubsub`; there are: {there}")
    return over_one(fleet, names.index(name))
