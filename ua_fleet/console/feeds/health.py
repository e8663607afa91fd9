"""Feed `health`: `server`, each bridge (`bridge/NAME`), the server's `traffic`, its `drops`, and `causes` of drops."""

from __future__ import annotations

from contextlib import aclosing
from typing import Final

from ua_fleet.client import BridgeNodes, FleetClient, Reading, bridge_nodes, server_status
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.kinds import FeedKind, NoParameters
from ua_fleet.console.shown import harmless_value, shown_reading, shown_time, shown_value
from ua_fleet.drop_meanings import drop_meanings, is_loss

__all__ = ["HEALTH"]

_PERIOD_MS: Final = 1000.0


async def _run(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    server = await server_status(client)
    board.put(
        "server",
        {
            "name": harmless_value(server.name),
            "endpoint": server.endpoint,
            "version": harmless_value(server.version),
            "state": server.state,
            "started": shown_time(server.started),
            "certificate_until": shown_time(server.certificate_until),
        },
    )
    board.put("causes", {cause: {"text": text, "loss": is_loss(cause)} for cause, text in drop_meanings().items()})
    nodes = await bridge_nodes(client)
    place: dict[str, tuple[str, str, bool]] = {}
    for one in nodes:
        place |= {node: (one.name, part, False) for part, node in one.members.items()}
        place |= {node: (one.name, cause, True) for cause, node in one.drops.items()}
    told: dict[str, dict[str, Reading]] = {one.name: {} for one in nodes}
    drops: dict[str, dict[str, int]] = {one.name: {} for one in nodes}
    missing = set(place)
    async with aclosing(client.watch(list(place), period_ms=_PERIOD_MS)) as changes:
        async for reading in changes:
            name, part, is_drop = place[reading.node_id]
            if is_drop:
                drops[name][part] = int(reading.value or 0)
            else:
                told[name][part] = reading
            missing.discard(reading.node_id)
            if missing:
                continue
            if board.is_ready:
                _show(board, name, told[name], drops[name])
            else:
                for each, parts in told.items():
                    _show(board, each, parts, drops[each])
                board.ready()


def _show(board: Board, name: str, told: dict[str, Reading], drops: dict[str, int]) -> None:
    counted = {cause: count for cause, count in drops.items() if count}
    if name == BridgeNodes.SERVER:
        board.put("drops", counted)
        board.put("traffic", {part: shown_value(reading.exact) for part, reading in told.items()})
        return
    values = {part: shown_value(reading.exact) for part, reading in told.items()}
    online = told.get("Online")
    board.put(
        f"bridge/{name}",
        {
            "name": name,
            "kind": values.pop("Kind", None),
            "space": values.pop("Space", None),
            "online": values.pop("Online", None) is True,
            "since": shown_time(online.source_time) if online is not None else None,
            "connected": shown_reading(told["Connected"]) if "Connected" in told else None,
            "detail": harmless_value(values.pop("Detail", None) or ""),
            "counters": {part: value for part, value in values.items() if part != "Connected"},
            "drops": counted,
        },
    )


HEALTH: Final = FeedKind("health", NoParameters, _run)
