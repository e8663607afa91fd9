"""Feed `positions`: where robots are (`robot/NAME`), places (`place/NAME`), and `fleet`, whether it is too large."""

from __future__ import annotations

import asyncio
import math
from contextlib import aclosing
from typing import Any, Final

from ua_fleet.client import FleetClient, PositionNodes, Reading, known_places, position_nodes, yaw_of
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import followed
from ua_fleet.console.feeds.kinds import FeedKind, NoParameters
from ua_fleet.console.shown import harmless_value, shown_time
from ua_fleet.values import Quality, quality_of

__all__ = ["POSITIONS_FEED"]

_MOST: Final = 1000
"""Robots of a fleet that are watched; of a larger one the map has none."""
_PERIOD_MS: Final = 500.0
_RANKS: Final = {Quality.GOOD: 0, Quality.UNCERTAIN: 1, Quality.BAD: 2}


def _shown(nodes: PositionNodes, told: dict[str, Reading]) -> dict[str, Any]:
    x, y = told[nodes.x], told[nodes.y]
    worst = max((x, y), key=lambda one: _RANKS[quality_of(one.status)])
    times = [one.source_time for one in (x, y) if one.source_time is not None]
    return {
        "x": _number(x, nodes.metres),
        "y": _number(y, nodes.metres),
        "heading": _heading(nodes, told),
        "s": worst.status,
        "t": shown_time(min(times)) if times else None,
        "frame": harmless_value(str(told[nodes.frame].value or "")) if nodes.frame in told else "",
    }


def _number(reading: Reading, factor: float) -> float | None:
    value = reading.exact
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value) * factor


def _heading(nodes: PositionNodes, told: dict[str, Reading]) -> float | None:
    if nodes.heading:
        return _number(told[nodes.heading], nodes.radians)
    values = [_number(told[one], 1.0) for one in nodes.orientation]
    known = [one for one in values if one is not None]
    return yaw_of(known) if known and len(known) == len(values) else None


async def _run(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    places = {f"place/{name}": (x, y) for name, (x, y) in (await known_places(client)).items()}

    async def look() -> list[PositionNodes]:
        return await position_nodes(client, _MOST)

    async def show(found: list[PositionNodes]) -> None:
        board.keep({*places, *(f"robot/{one.robot}" for one in found), "fleet"})
        for key, (x, y) in places.items():
            board.put(key, {"name": harmless_value(key.partition("/")[2]), "x": x, "y": y})
        board.put("fleet", {"too_large": not found and len(await client.robots()) > _MOST, "most": _MOST})
        owners = {node: one for one in found for node in one.nodes}
        told: dict[str, dict[str, Reading]] = {one.robot: {} for one in found}
        missing = {one.robot for one in found}
        if not owners:
            board.ready()
            await asyncio.Event().wait()
        async with aclosing(client.watch(list(owners), period_ms=_PERIOD_MS)) as changes:
            async for reading in changes:
                one = owners[reading.node_id]
                values = told[one.robot]
                values[reading.node_id] = reading
                if len(values) < len(one.nodes):
                    continue
                board.put(f"robot/{one.robot}", {"name": one.robot, **_shown(one, values)})
                if missing:
                    missing.discard(one.robot)
                    if not missing:
                        board.ready()

    await followed(client, look, show)


POSITIONS_FEED: Final = FeedKind("positions", NoParameters, _run)
