from __future__ import annotations

import asyncio

from ua_fleet.endpoint.turns import LARGE_BYTES, Places, Turns


async def test_a_large_request_knows_that_others_of_its_user_wait() -> None:
    """Its client is cut off sooner then: it held the place of its user for 30 s without reading."""
    places = Places()
    first, second = Turns(places.of("olga")), Turns(places.of("olga"))
    contended: list[bool] = []

    async def look() -> None:
        await asyncio.sleep(0)
        contended.append(first.contended)

    await first.end(LARGE_BYTES + 1)
    await look()
    waiting = asyncio.ensure_future(second.end(LARGE_BYTES + 1))
    await look()
    first.leave()
    await waiting
    await look()
    second.leave()
    assert contended == [False, True, False]


async def test_a_request_that_gives_up_waits_no_more() -> None:
    places = Places()
    first, second = Turns(places.of("olga")), Turns(places.of("olga"))
    await first.end(LARGE_BYTES + 1)
    waiting = asyncio.ensure_future(second.end(LARGE_BYTES + 1))
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.wait([waiting])
    assert not first.contended
    first.leave()
