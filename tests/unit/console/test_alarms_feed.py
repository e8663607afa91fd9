"""The feed of alarms: what it has while it is not known whether its alarms are all."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from ua_fleet.client import ConditionInfo, ConditionsKnown
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.alarms import PARTIAL_KEY, follow_conditions

NODES = frozenset({"ns=2;s=Alarms.rover.speed"})


class Client:
    """Tells what is said of the conditions of a server."""

    def __init__(self, *told: ConditionInfo | ConditionsKnown) -> None:
        self.told = told

    @asynccontextmanager
    async def conditions(self) -> AsyncGenerator[AsyncIterator[ConditionInfo | ConditionsKnown]]:
        async def each() -> AsyncIterator[ConditionInfo | ConditionsKnown]:
            for one in self.told:
                yield one

        yield each()


async def board_of(*told: ConditionInfo | ConditionsKnown, partial_key: str = PARTIAL_KEY) -> Board:
    board, client = Board(), Client(*told)
    as_client: Any = client
    await follow_conditions(as_client, board, lambda info: info.name, partial_key=partial_key)
    return board


async def test_it_says_that_there_may_be_more_until_a_refresh_was_whole() -> None:
    part, whole = ConditionsKnown(NODES, is_whole=False), ConditionsKnown(NODES, is_whole=True)
    board = await board_of(part)
    assert (board.is_ready, board.get(PARTIAL_KEY)) == (True, "true")
    assert (await board_of(part, whole)).keys() == []
    assert (await board_of(whole, part)).get(PARTIAL_KEY) == "true"


async def test_who_counts_conditions_counts_them_alone() -> None:
    board = await board_of(ConditionsKnown(NODES, is_whole=False), partial_key="")
    assert (board.is_ready, len(board)) == (True, 0)
