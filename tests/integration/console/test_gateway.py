"""The console as a gateway of the server: those who guess in its login form lock nobody else out."""

from __future__ import annotations

import asyncio
from collections import Counter
from pathlib import Path

import httpx
import pytest

from tests.integration.console.harness import ENGINEER, OBSERVER, OPERATOR, Console, console_at
from tests.integration.server_model.harness import Running
from ua_fleet.endpoint.certificates import trust_gateway
from ua_fleet.endpoint.throttle import FREE_FAILURES_OF_ADDRESS

GUESSERS = FREE_FAILURES_OF_ADDRESS + 4


async def guess(console: Console, count: int) -> Counter[int]:
    """Wrong passwords from as many browsers, each with another address; the statuses of their answers."""
    answers: Counter[int] = Counter()

    async def one(number: int, browser: httpx.AsyncClient) -> None:
        user = OPERATOR[0] if number % 4 == 0 else f"nobody{number}"
        login = {"fleet": "hall", "user": user, "password": "wrong-password"}
        answer = await browser.post("api/login", json=login, headers={"x-forwarded-for": f"10.1.{number}.1"})
        answers[answer.status_code] += 1

    async with console.browser() as browser:
        for begin in range(0, count, 4):
            await asyncio.gather(*(one(number, browser) for number in range(begin, begin + 4)))
    return answers


@pytest.mark.parametrize("is_marked", [True, False], ids=["marked", "not marked"])
async def test_guessers_in_many_browsers(server: Running, tmp_path: Path, is_marked: bool) -> None:
    async with console_at(tmp_path, {"hall": server.url}, trusted_proxies=["127.0.0.1"]) as console:
        if is_marked:
            trust_gateway(server.folder / "state", "console", tmp_path / "console" / "console.der")
        async with console.logged_in(OPERATOR) as before:
            answers = await guess(console, GUESSERS)
            assert set(answers) <= {401, 429, 502}
            assert answers[401] >= 10
            me = (await before.http.get("api/me")).json()["fleets"]["hall"]
            assert (me["user"], me["state"]) == (OPERATOR[0], "live")
            if is_marked:
                for user in (OBSERVER, ENGINEER):
                    async with console.logged_in(user) as browser:
                        assert browser.me["fleets"]["hall"]["user"] == user[0]
                return
            # So it was before there were gateways, and is for every other client. A lock lasts 1 s first, and twice as
            # long at each failure after it: a slow machine lets the first ones pass.
            async with console.browser() as browser:
                login = {"fleet": "hall", "user": OBSERVER[0], "password": OBSERVER[1]}
                for _ in range(8):
                    if (await browser.post("api/login", json=login)).status_code == 401:
                        return
                    await guess(console, 4)
            pytest.fail("one guesser at an address that is no gateway locks nobody out")
