"""A link by itself: what ends it, and what does not."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.console.board import Board
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.feeds import FEEDS
from ua_fleet.console.feeds.kinds import FeedKind, NoParameters
from ua_fleet.console.link import FleetLink, SessionSecret
from ua_fleet.console.settings import FleetAddress
from ua_fleet.errors import AccessRefused, NotConnected, UaFleetError
from ua_fleet.values import StatusCode


@pytest.fixture
def link(tmp_path: Path) -> FleetLink:
    secret = SessionSecret("uafk.id.secret", "id", datetime.now(UTC) + timedelta(hours=1), "urn:server")
    address = FleetAddress(endpoint="opc.tcp://127.0.0.1:1/nobody")
    return FleetLink("hall", address, "anna", secret, ClientIdentity(tmp_path), ConsoleCounts(), 10)


def connecting(monkeypatch: pytest.MonkeyPatch, *outcomes: Exception | None) -> list[str]:
    """Have connections end one after another as given; None waits for ever. What was given as the password."""
    given: list[str] = []
    left = list(outcomes)

    @asynccontextmanager
    async def connect(endpoint: str, **options: Any) -> AsyncGenerator[FleetClient]:
        given.append(options["password"])
        outcome = left.pop(0) if left else None
        if outcome is not None:
            raise outcome
        await asyncio.Event().wait()
        yield FleetClient.__new__(FleetClient)

    monkeypatch.setattr(FleetClient, "connect", connect)
    return given


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (StatusCode.BAD_USER_ACCESS_DENIED, "log in again"),
        (StatusCode.BAD_IDENTITY_TOKEN_REJECTED, "log in again"),
        (StatusCode.BAD_SECURITY_CHECKS_FAILED, "shows another certificate"),
    ],
)
async def test_what_cannot_heal_ends_it_with_what_to_do(
    link: FleetLink, monkeypatch: pytest.MonkeyPatch, code: StatusCode, said: str
) -> None:
    given = connecting(monkeypatch, NotConnected("away"), AccessRefused(code, "it shows another certificate"))
    await asyncio.wait_for(link.run(), 10)
    assert (link.state, said in link.reason) == ("ended", True)
    assert given == ["uafk.id.secret"] * 2


async def test_what_may_pass_is_tried_again(link: FleetLink, monkeypatch: pytest.MonkeyPatch) -> None:
    too_many = 0x8056_0000  # BadTooManySessions
    given = connecting(monkeypatch, NotConnected("nobody"), AccessRefused(too_many, "full"), ValueError("our mistake"))
    task = asyncio.ensure_future(link.run())
    async with asyncio.timeout(60):
        while len(given) < 4:
            await asyncio.sleep(0.01)
    assert (link.state, link.reason) == ("away", "a mistake of the console's; it is in its log")
    task.cancel()
    await asyncio.wait([task])
    assert "secret" not in repr(link.secret).replace("SessionSecret", "")


async def test_one_that_is_cancelled_while_its_connection_fails_ends(
    link: FleetLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A group of tasks of which one fails at that moment raises the failure, and not the cancellation."""

    class Failing:
        on_lost: object = None

        async def executable(self, _methods: object) -> list[bool]:
            return [False, False]

        async def read(self, nodes: list[str]) -> list[Any]:
            """It is there."""
            return [SimpleNamespace(exact=None) for _ in nodes]

    async def failing(_client: Any, _parameters: Any, board: Board) -> None:
        board.ready()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            raise UaFleetError("what is cancelled has failed") from None

    monkeypatch.setitem(FEEDS, "failing", FeedKind("failing", NoParameters, failing))

    @asynccontextmanager
    async def connect(endpoint: str, **options: Any) -> AsyncGenerator[Any]:
        yield Failing()

    monkeypatch.setattr(FleetClient, "connect", connect)
    feed = link.open_feed("failing", NoParameters())
    task = asyncio.ensure_future(link.run())
    await link.settled(5)
    assert link.state == "live"
    async with asyncio.timeout(60):
        while not feed.board.is_ready:
            await asyncio.sleep(0.01)
    task.cancel()
    done, _ = await asyncio.wait([task], timeout=5)
    assert done, "it goes on for ever"
