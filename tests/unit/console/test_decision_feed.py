"""The feed of a decision: its ranking comes Variable by Variable, and is shown as one."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from types import SimpleNamespace
from typing import Any, Final

import pytest

from ua_fleet.console.board import Board
from ua_fleet.console.feeds import following
from ua_fleet.console.feeds.decisions import DECISION
from ua_fleet.console.feeds.following import PartsDiffer

NODE: Final = "ns=2;s=Fleet.Resilience.Decisions.one"
TWO: Final = {
    "Robots": ["middle", "right"],
    "Scores": [0.6, 0.4],
    "Excluded": ["left"],
    "Reasons": ["worn"],
    "Criteria": ["battery"],
    "Weights": [1.0],
    "ConsistencyRatio": 0.0,
    "RawValues": [60.0, 40.0],
    "CriterionScores": [0.6, 0.4],
    "Missing": ["", ""],
}
ONE: Final = {
    "Robots": ["right"],
    "Scores": [0.4],
    "Excluded": ["left", "middle"],
    "Reasons": ["worn", "worn too"],
    "RawValues": [40.0],
    "CriterionScores": [0.4],
    "Missing": [""],
}


class Client:
    """Tells Variables one by one, and says what the board has after each."""

    def __init__(self, board: Board, *told: tuple[str, Any]) -> None:
        self.board, self.told = board, told
        self.robots: list[list[str]] = []
        """The ranking after each of them."""
        self.is_over = asyncio.Event()

    async def read(self, _address: str) -> None:
        """It is there."""

    async def watch(self, addresses: list[str], period_ms: float) -> AsyncGenerator[Any]:
        for address in addresses:
            name = address.rpartition(".")[2]
            value = TWO.get(name, None if name in ("StartTime", "Deadline") else "")
            yield SimpleNamespace(node_id=address, value=value, exact=value)
        for name, value in self.told:
            yield SimpleNamespace(node_id=f"{NODE}.{name}", value=value, exact=value)
            shown = json.loads(self.board.get("decision") or "")["ranking"]["robots"]
            self.robots.append([one["robot"] for one in shown])
        self.is_over.set()
        await asyncio.Event().wait()


async def follow(client: Any) -> None:
    parameters = DECISION.parameters.model_validate({"decision": "one"})
    await DECISION.run(client, parameters, client.board)


async def test_a_ranking_of_another_length_is_shown_once_all_of_it_is_there() -> None:
    client = Client(Board(), *ONE.items())
    following_it = asyncio.ensure_future(follow(client))
    async with asyncio.timeout(60):
        await client.is_over.wait()
    assert client.board.is_ready
    assert client.robots == [["middle", "right"]] * (len(ONE) - 1) + [["right"]]
    following_it.cancel()
    await asyncio.wait([following_it])


async def test_a_ranking_that_stays_half_told_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(following, "_PARTS_DIFFER_S", 0.05)
    client = Client(Board(), ("Robots", ["right"]))
    with pytest.raises(PartsDiffer, match=f"{NODE}: Scores has 2 elements in place of 1"):
        async with asyncio.timeout(60):
            await follow(client)
    assert client.robots == [["middle", "right"]]
