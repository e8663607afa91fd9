"""Feed `nodes`: the values of any Variables. Keys are their NodeIds as they were given."""

from __future__ import annotations

from typing import Annotated, Any, Final

from pydantic import Field

from ua_fleet.client import FleetClient, NodeNotFound, Reading
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import followed
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters
from ua_fleet.console.shown import shown_reading

__all__ = ["NODES"]


class OfNodes(FeedParameters):
    """Which Variables."""

    nodes: list[Annotated[str, Field(min_length=3, max_length=4096)]] = Field(max_length=500)


async def _readable(client: FleetClient, node: str) -> Reading | str:
    try:
        return await client.read(node)
    except NodeNotFound as error:
        return str(error)


async def _run(client: FleetClient, parameters: OfNodes, board: Board) -> None:
    async def look() -> dict[str, str]:
        """Which of them are there, as they are watched: one that there is not costs none of the others."""
        there: dict[str, str] = {}
        for node in dict.fromkeys(parameters.nodes):
            found = await _readable(client, node)
            if isinstance(found, str):
                board.put(node, {"v": None, "s": 0x8034_0000, "t": None, "type": None, "error": found})
            else:
                there[node] = found.node_id
        return there

    async def show(there: dict[str, str]) -> None:
        given: dict[str, list[str]] = {}
        for node, node_id in there.items():
            given.setdefault(node_id, []).append(node)
        missing = set(given)
        if not missing:
            board.ready()
        async for reading in client.watch(list(given), with_times=True, newest_only=True):
            for node in given[reading.node_id]:
                board.put(node, _shown(reading))
            missing.discard(reading.node_id)
            if not missing:
                board.ready()

    await followed(client, look, show)


def _shown(reading: Reading) -> dict[str, Any]:
    return {**shown_reading(reading), "type": reading.type_name}


NODES: Final = FeedKind("nodes", OfNodes, _run)
