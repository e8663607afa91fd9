"""While a large answer is sent others have their turn, and what its own client is told meanwhile comes after it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_security.harness import Identities, bad, door, lose, ua
from tests.waiting import until
from ua_fleet.endpoint.connection import TcpConnection
from ua_fleet.endpoint.turns import TURN_S
from ua_fleet.endpoint.users import Role, UserStore

LARGE = 3 << 20


async def test_others_have_their_turn_between_the_chunks_of_a_large_answer(
    tmp_path: Path, identities: Identities, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An answer of 8 MiB was encrypted in one go: 37 to 74 ms."""
    sent: list[tuple[float, int]] = []
    turns: list[float] = []
    send = TcpConnection.send

    def noted(connection: TcpConnection, data: bytes) -> None:
        send(connection, data)
        sent.append((time.monotonic(), len(data)))

    async def take_turns() -> None:
        while True:
            turns.append(time.monotonic())
            await asyncio.sleep(0)

    async with door(tmp_path, identities) as running, running.connected() as client:
        node = client.get_node(running.nodes.text)
        told: list[Any] = []

        class Handler:
            def datachange_notification(self, _node: Any, value: Any, _data: Any) -> None:
                told.append(value)

        subscription: Any = await client.create_subscription(10, Handler())
        await subscription.subscribe_data_change(client.get_node(running.nodes.plain))
        held = running.server.get_node(running.nodes.text)
        await held.write_value("x" * (1 << 20))
        monkeypatch.setattr(TcpConnection, "send", noted)
        task = asyncio.ensure_future(take_turns())
        try:
            for number in range(5):
                await running.server.get_node(running.nodes.plain).write_value(float(number))
                values = await client.read_values([node] * (LARGE >> 20))
                assert [len(value) for value in values] == [1 << 20] * (LARGE >> 20)
        finally:
            task.cancel()
        await until(lambda: told[-1:] == [4.0])
    chunks = [when for when, size in sent if size > 60_000]
    assert max(size for _, size in sent) <= 65_536
    assert len(chunks) >= 5 * LARGE // 65_536
    between = sum(chunks[0] < turn < chunks[-1] for turn in turns)
    assert between >= 20, "others waited for whole answers"


def another_comes(users: UserStore) -> None:
    users.add("petra", "password-1", Role.OBSERVER)


def he_goes(users: UserStore) -> None:
    users.remove("oscar")


def his_role_changes(users: UserStore) -> None:
    users.add("oscar", "operate-1", Role.OBSERVER, replace_existing=True)


@pytest.mark.parametrize(
    ("change", "ends", "reason"),
    [
        (another_comes, "Good", ""),
        (he_goes, "BadSessionClosed", "the session has ended"),
        (his_role_changes, "BadUserAccessDenied", "the user's rights have changed"),
    ],
)
async def test_users_change_in_the_middle_of_a_request(
    tmp_path: Path, identities: Identities, change: Callable[[UserStore], None], ends: str, reason: str
) -> None:
    """Each change ended all requests under way, of whichever user, with Bad_ConnectionClosed over open connections."""
    began, go_on = asyncio.Event(), asyncio.Event()

    async def waits(_parent: Any) -> list[Any]:
        began.set()
        await go_on.wait()
        return []

    async with door(tmp_path, identities) as running:
        server: Any = running.server
        objects = server.nodes.objects
        method = await objects.add_method(ua.NodeId("waits", 2), "waits", waits, [], [])
        client = await running.client("oscar")
        await client.connect()
        called = asyncio.ensure_future(bad(client.nodes.objects.call_method(method.nodeid)))
        await began.wait()
        change(running.users)
        await until(lambda: server._listener._generation == running.users.generation, "that the server knows it")
        await asyncio.sleep(TURN_S)  # so long a request is worked on before it is looked at again
        go_on.set()
        assert await called == ends
        refused = [line["reason"] for line in running.audit() if line.get("what") == "Call"]
        assert refused == ([reason] if reason else [])
        await lose(client)
