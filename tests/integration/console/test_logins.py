"""Logins that wait: for a fleet that stands, of one user, of one address; and one whose browser logs out meanwhile."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.integration.console.harness import ENGINEER, OBSERVER, OPERATOR, Console, console_at
from tests.integration.server_model.harness import Running
from ua_fleet.console.people import People


def login(user: tuple[str, str], fleet: str = "hall") -> dict[str, str]:
    return {"fleet": fleet, "user": user[0], "password": user[1]}


class Waiting:
    """Holds logins at a fleet up where the console asks its server for a key."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, fleet: str = "hall") -> None:
        self.begun = 0
        self.go_on = asyncio.Event()
        people_of_all: Any = People
        secret = people_of_all._secret

        async def held_up(people: People, at: str, *given: Any) -> Any:
            if at == fleet:
                self.begun += 1
                await self.go_on.wait()
            return await secret(people, at, *given)

        monkeypatch.setattr(People, "_secret", held_up)

    async def until(self, count: int) -> None:
        async with asyncio.timeout(20):
            while self.begun < count:
                await asyncio.sleep(0.01)


def begin(
    browser: httpx.AsyncClient, user: tuple[str, str], fleet: str = "hall", **headers: str
) -> asyncio.Task[httpx.Response]:
    async def one() -> httpx.Response:
        return await browser.post("api/login", json=login(user, fleet), headers=headers)

    return asyncio.ensure_future(one())


async def test_a_fleet_that_stands_holds_up_no_login_at_another(
    server: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting = Waiting(monkeypatch, "yard")
    given: dict[str, Any] = {"limits": {"logins_at_once": 2}, "trusted_proxies": ["127.0.0.1"]}
    fleets = {"hall": server.url, "yard": server.url}
    async with console_at(tmp_path, fleets, **given) as console, console.browser() as browser:
        logins = [
            begin(browser, user, "yard", **{"x-forwarded-for": f"192.0.2.{number}"})
            for number, user in enumerate((OPERATOR, ENGINEER))
        ]
        await waiting.until(2)
        third = {"x-forwarded-for": "192.0.2.3"}
        assert (await browser.post("api/login", json=login(OBSERVER, "yard"), headers=third)).status_code == 429
        assert (await browser.post("api/login", json=login(OBSERVER), headers=third)).status_code == 200
        waiting.go_on.set()
        assert [(await one).status_code for one in logins] == [200, 200]


async def test_one_user_and_one_address_have_not_all_the_places(
    server: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting = Waiting(monkeypatch)
    limits = {"logins_at_once": 6}
    given: dict[str, Any] = {"limits": limits, "trusted_proxies": ["127.0.0.1"]}
    async with console_at(tmp_path, {"hall": server.url}, **given) as console, console.browser() as browser:
        insider = {"x-forwarded-for": "192.0.2.1"}
        logins = [begin(browser, OPERATOR, **insider) for _ in range(2)]
        await waiting.until(2)
        refused = await browser.post("api/login", json=login(OPERATOR), headers={"x-forwarded-for": "192.0.2.2"})
        assert refused.status_code == 429, "of a user two wait, wherever they are"
        logins.append(begin(browser, OBSERVER, **insider))
        await waiting.until(3)
        refused = await browser.post("api/login", json=login(ENGINEER), headers=insider)
        assert refused.status_code == 429, "of an address half of them wait"
        logins.append(begin(browser, ENGINEER, **{"x-forwarded-for": "192.0.2.2"}))
        await waiting.until(4)
        waiting.go_on.set()
        assert [(await one).status_code for one in logins] == [200] * 4
        assert (await browser.post("api/login", json=login(OPERATOR), headers=insider)).status_code == 200


async def test_who_logs_out_while_a_login_waits_gets_a_new_session(
    console: Console, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with console.logged_in(OBSERVER) as browser:
        before = browser.cookie
        waiting = Waiting(monkeypatch)
        again = begin(browser.http, OPERATOR, cookie=before)
        await waiting.until(1)
        out = await browser.http.post("api/logout", json={}, headers={"x-csrf": browser.csrf})
        assert out.status_code == 200
        waiting.go_on.set()
        answer = await again
        assert answer.status_code == 200
        assert "set-cookie" in answer.headers
        health = (await browser.http.get("healthz")).json()
        assert (health["sessions"], sum(health["links"].values())) == (1, 1)


async def keys_of(server: Running, user: tuple[str, str]) -> list[str]:
    """The session keys that the server has of a user."""
    async with server.client(user) as client:
        listed = client.get_node("ns=2;s=Fleet.ListSessionKeys").nodeid
        ids, *_ = await client.get_node("ns=2;s=Fleet").call_method(listed)
        return list(ids or ())


async def test_a_login_at_a_full_console_leaves_no_key(server: Running, tmp_path: Path) -> None:
    """With 16 more the server would end the key of the one who is logged in."""
    async with (
        console_at(tmp_path, {"hall": server.url}, limits={"sessions": 1}) as console,
        console.logged_in(OPERATOR) as works,
        console.browser() as second,
    ):
        before = await keys_of(server, OPERATOR)
        refused = await second.post("api/login", json=login(OPERATOR))
        assert (refused.status_code, refused.headers["retry-after"]) == (429, "60")
        assert "too many people are logged in" in refused.json()["error"]["message"]
        assert await keys_of(server, OPERATOR) == before
        again = await works.http.post("api/login", json=login(OPERATOR))
        assert again.status_code == 200, "a browser that has a session needs no further place"


async def test_of_two_logins_for_the_last_place_one_leaves_no_key(
    server: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting, limits = Waiting(monkeypatch), {"sessions": 1}
    async with console_at(tmp_path, {"hall": server.url}, limits=limits) as console, console.browser() as browser:
        logins = [begin(browser, user) for user in (OBSERVER, ENGINEER)]
        await waiting.until(2)
        waiting.go_on.set()
        assert sorted([(await one).status_code for one in logins]) == [200, 429]
        async with asyncio.timeout(60):
            while len([*await keys_of(server, OBSERVER), *await keys_of(server, ENGINEER)]) > 1:
                await asyncio.sleep(0.05)


async def test_a_fleet_that_is_away_is_no_failed_login(tmp_path: Path, tcp_port: int) -> None:
    url = f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet"
    async with console_at(tmp_path, {"hall": url}) as console, console.browser() as browser:
        answers = [await browser.post("api/login", json=login(OPERATOR)) for _ in range(14)]
        assert {answer.status_code for answer in answers} == {503}
