"""A client that gives up, at whatever moment, leaves neither subscription nor offer in the server."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, Final

import pytest
from asyncua.common.subscription import Subscription

from tests.integration.robots.conftest import Yard
from tests.integration.robots.test_client import SKILL, connected
from tests.integration.server_model.harness import OPERATOR
from ua_fleet.client import FleetClient
from ua_fleet.endpoint.subscriptions import SubscriptionRegistry
from ua_fleet.errors import NotConnected, RobotOffline

STATE: Final = "i=2259"


@pytest.fixture
def open_ones(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """How many subscriptions the server has that the test starts."""
    made: list[SubscriptionRegistry] = []
    real = SubscriptionRegistry.__init__

    def noted(self: SubscriptionRegistry, *arguments: Any) -> None:
        real(self, *arguments)
        made.append(self)

    monkeypatch.setattr(SubscriptionRegistry, "__init__", noted)
    return lambda: sum(len(service.subscriptions) for service in made)


async def _watch(client: FleetClient) -> None:
    async for _ in client.watch([STATE]):
        pass


async def _hear(client: FleetClient) -> None:
    async with client.told() as told:
        await anext(told)


async def _offer(client: FleetClient) -> None:
    async with client.offer_skill("mechanic", "sweep", SKILL) as offered:
        await anext(offered)


async def _start(client: FleetClient) -> None:
    await client.start_skill("mechanic", "repair", what="x")


async def _notify(client: FleetClient) -> None:
    await client.notify(STATE, lambda _: None)


USES: Final[list[Callable[[FleetClient], Awaitable[None]]]] = [_watch, _hear, _offer, _start, _notify]


BEGINNING: Final = ("create_monitored_items",)
HELD: Final[list[tuple[tuple[str, ...], bool]]] = [(("init",), False), (BEGINNING, False), (BEGINNING, True)]
"""After which steps the client is held, and whether they fail then."""


async def test_no_subscription_is_left_by_who_does_not_get_it(
    yard: Yard, monkeypatch: pytest.MonkeyPatch, open_ones: Callable[[], int]
) -> None:
    """Just after the server has made it, or watches something for it, but before the client goes on."""
    reached = asyncio.Queue[int]()
    fails = False

    def hold(name: str) -> None:
        real = getattr(Subscription, name)

        async def held(*arguments: Any, **options: Any) -> Any:
            result = await real(*arguments, **options)
            reached.put_nowait(open_ones())
            if fails:
                raise OSError("broken")
            await asyncio.sleep(0.05)
            return result

        patched.setattr(Subscription, name, held)

    async with (
        yard.server() as running,
        connected(running) as host,
        connected(running, OPERATOR) as client,
        host.offer_skill("mechanic", "repair", SKILL),
    ):
        before = open_ones()
        for names, fails in HELD:
            with monkeypatch.context() as patched:
                for name in names:
                    hold(name)
                for use in USES:
                    using = asyncio.ensure_future(use(host if use is _offer else client))
                    assert await asyncio.wait_for(reached.get(), 10) == before + 1
                    if not fails:
                        using.cancel()
                    with pytest.raises(NotConnected if fails else asyncio.CancelledError):
                        await using
                    assert open_ones() == before, f"{use.__name__} has left one"


async def test_an_offer_ends_with_its_context_and_what_nobody_takes_is_counted(
    yard: Yard, open_ones: Callable[[], int]
) -> None:
    skill = {**SKILL, "limits": {"requests_at_once": 2}}

    async def give_up(host: FleetClient, client: FleetClient) -> None:
        async with host.offer_skill("mechanic", "repair", skill) as offered:
            offered._queue = asyncio.Queue(1)  # pyright: ignore[reportPrivateUsage]
            await client.start_skill("mechanic", "repair", what="the belt")
            await client.start_skill("mechanic", "repair", what="the roof")
            async with asyncio.timeout(60):
                while host.dropped != 1:
                    await asyncio.sleep(0.02)
            assert (await anext(offered)).arguments == {"what": "the roof"}
            raise ValueError("broken")

    async with yard.server() as running, connected(running) as host, connected(running, OPERATOR) as client:
        with pytest.raises(ValueError, match="broken"):
            await give_up(host, client)
        assert (host.dropped, client.dropped) == (1, 0)
        assert open_ones() == 1, "of the client, for its skills"
        with pytest.raises(RobotOffline):
            await client.start_skill("mechanic", "repair", what="x")
