"""A page drives a robot over `api/drive`: its own lease, its own echo, and an end that nothing here puts off."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator
from datetime import timedelta
from pathlib import Path
from typing import Final

import pytest
import pytest_asyncio
from websockets.exceptions import InvalidStatus

from tests.integration.console.driving import drive
from tests.integration.console.harness import ENGINEER, OBSERVER, Console, console_at
from tests.integration.teleoperation.served import DEADMAN_MS, Floor, fleet, floor, until_value

FULL: Final = 0.5


@pytest_asyncio.fixture
async def made(tmp_path: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[Floor]:
    """A server, and a bridge whose robot is the test."""
    async with floor(tmp_path, fleet(udp_url, tcp_port)) as found:
        yield found


@pytest_asyncio.fixture
async def console(made: Floor, tmp_path: Path) -> AsyncGenerator[Console]:
    async with console_at(tmp_path, {"hall": made.running.url}) as running:
        yield running


async def drops(console: Console) -> dict[str, int]:
    async with console.browser() as browser:
        health = (await browser.get("healthz")).json()
        assert health["mistakes"] == {}
        counted: dict[str, int] = health["drops"]
        return counted


async def test_a_page_drives_and_releases(made: Floor, console: Console) -> None:
    async with console.logged_in() as browser, drive(browser) as page, made.running.client(OBSERVER) as onlooker:
        page.is_patient = True
        assert page.held["axes"][0]["name"] == "linear"
        assert page.held["axes"][0]["speed"] == FULL
        assert page.held["deadman_ms"] == DEADMAN_MS
        await page.until(lambda: page.state.get("taken", 0) > 10 and made.carrier.written[-1][0] == FULL, (FULL, 0.0))
        assert page.state["answered"] >= page.state["taken"]
        assert 0 < page.state["server_ms"] < 1000
        await page.until(lambda: made.carrier.written[-1] == (0.0, 0.0))
        assert await until_value(onlooker, "State", 1) == 1
        await page.say(release=True)
        assert await page.closed() == 1000
        assert page.over == {"message": "released"}
        assert await until_value(onlooker, "LastEnd", bool) == "oscar: released"
    assert sum((await drops(console)).values()) == 0


async def test_the_robot_is_released_when_the_page_goes(made: Floor, console: Console) -> None:
    async with made.running.client(OBSERVER) as onlooker, console.logged_in() as browser:
        async with drive(browser) as page:
            await page.until(lambda: made.carrier.written[-1:] == [(FULL, 0.0)], (FULL, 0.0))
            gone_at = time.monotonic()
            page.socket.transport.abort()
        assert await until_value(onlooker, "LastEnd", bool) == "oscar: released"
        assert time.monotonic() - gone_at < DEADMAN_MS / 1000
        await until_value(onlooker, "State", 0)
        assert made.carrier.written[-1] == (0.0, 0.0)


async def test_a_page_that_shows_another_user_drives_nothing(made: Floor, console: Console) -> None:
    """Another tab of the browser has logged somebody else in, and this one does not know it yet."""
    async with made.running.client(OBSERVER) as onlooker, console.logged_in() as browser:
        async with drive(browser, user="anna b") as page:
            assert await page.closed() == 4401
            assert not page.held
            assert "at hall as oscar now, and not as anna b" in page.over["message"]
        assert await until_value(onlooker, "State", 0) == 0
        async with drive(browser, user="oscar") as page:
            assert page.held["robot"]
    assert (await drops(console))["other_user"] == 1


async def test_a_page_that_is_silent_has_no_lease(made: Floor, console: Console) -> None:
    async with made.running.client(OBSERVER) as onlooker, console.logged_in() as browser, drive(browser) as page:
        began = time.monotonic()
        assert await page.closed() == 4408
        assert "has said nothing for 2 s" in page.over["message"]
        assert time.monotonic() - began < 4.5, "the lease alone would have lasted 5 s"
        assert await until_value(onlooker, "LastEnd", bool) == "oscar: released"
    assert (await drops(console))["drive_silent"] == 1


async def test_the_echo_is_that_of_the_browser(made: Floor, console: Console) -> None:
    """A browser that sees no new counter is stopped, however lively the console is."""
    async with console.logged_in() as browser, drive(browser) as page:
        await page.until(lambda: made.carrier.written[-1:] == [(FULL, 0.0)], (FULL, 0.0))
        frozen, since = page.counter, time.monotonic()
        page.echo = frozen
        assert await page.closed((FULL, 0.0)) == 4410
        assert "no setpoint was fresh" in page.over["message"]
        assert DEADMAN_MS / 1000 - 1 < time.monotonic() - since < DEADMAN_MS / 1000 + 1.5


async def test_what_is_forged_or_repeated_is_dropped_and_feeds_nothing(made: Floor, console: Console) -> None:
    async with console.logged_in() as browser, drive(browser) as page:
        await page.until(lambda: page.state.get("taken", 0) > 3)
        number = page.number
        for forged, echo in ((1, None), (number + 1, 99_999), (number + 2, page.counter + 10_000)):
            await page.wish(FULL, FULL, number=forged, echo=echo)
        await page.until(lambda: page.state["dropped"].get("setpoint_repeated") == 1)
        assert page.state["dropped"]["setpoint_forged"] == 2
        assert set(made.carrier.written) == {(0.0, 0.0)}
    counted = await drops(console)
    assert counted["setpoint_repeated"] == 1
    assert counted["setpoint_forged"] == 2


FORGED: Final[list[str]] = [
    "no json",
    '{"n": 1, "echo": 1}',
    '{"n": 1, "echo": 1, "values": [0.1]}',
    '{"n": 1, "echo": 1, "values": [0.1, NaN]}',
    '{"n": 1, "echo": 1, "values": [1e999, 0]}',
    '{"n": 1, "echo": 1, "values": ["0.1", 0]}',
    '{"n": true, "echo": 1, "values": [0, 0]}',
    '{"n": 4294967296, "echo": 1, "values": [0, 0]}',
    '{"n": 1, "echo": 1, "values": [0, 0], "lease": 1}',
    '{"n": 1, "echo": 1, "values": [' + "0," * 2000 + "0]}",
    "[" * 60_000,
]


async def test_a_message_that_is_none_ends_the_lease(made: Floor, console: Console) -> None:
    async with made.running.client(OBSERVER) as onlooker, console.logged_in() as browser:
        for forged in FORGED:
            async with drive(browser) as page:
                assert page.held, (forged[:50], page.over)
                await page.socket.send(forged)
                assert await page.closed() == 4400, forged[:50]
            await until_value(onlooker, "State", 0)
    assert (await drops(console))["invalid"] == len(FORGED)


async def test_too_many_messages_end_the_lease(made: Floor, console: Console) -> None:
    async with made.running.client(OBSERVER) as onlooker, console.logged_in() as browser, drive(browser) as page:
        for _ in range(400):
            await page.wish(0.0, 0.0)
        assert await page.closed() == 4429
        assert await until_value(onlooker, "LastEnd", bool) == "oscar: released"
    assert (await drops(console))["too_many_messages"] == 1


async def test_who_may_not_open_it(made: Floor, console: Console) -> None:
    del made
    async with console.logged_in() as browser, console.logged_in(OBSERVER) as observer:
        for headers in ({"origin": "http://evil.example"}, {"origin": "null"}):
            with pytest.raises(InvalidStatus):
                async with drive(browser, headers=headers):
                    pass
        async with drive(browser, headers={"cookie": "none=1"}) as page:
            assert await page.closed() == 4401
        for csrf in ("wrong", observer.csrf):
            async with drive(browser, csrf=csrf) as page:
                assert await page.closed() == 4403
        async with drive(browser, fleet="yard") as page:
            assert await page.closed() == 4401
        async with drive(browser, robot="nobody") as page:
            assert await page.closed() == 4409
            assert "nobody" in page.over["message"]
        async with drive(observer) as page:
            assert await page.closed() == 4409
            assert page.over["status"] == "BadUserAccessDenied"
            assert "your role does not allow driving a robot" in page.over["message"]
        assert observer.me["fleets"]["hall"]["may"] == [
            one for one in observer.me["fleets"]["hall"]["may"] if not one.startswith("teleoperation")
        ]
        assert "teleoperation.drive" in browser.me["fleets"]["hall"]["may"]
        assert "teleoperation.take_over" not in browser.me["fleets"]["hall"]["may"]


async def test_two_pages_of_one_user_are_two_who_drive(made: Floor, console: Console) -> None:
    del made
    async with console.logged_in() as one, console.logged_in() as two, drive(one) as first:
        async with drive(two) as second:
            assert await second.closed() == 4409
            assert second.over["message"] == ("carrier is driven by oscar; wait, or have an engineer take it over")
        async with drive(one) as tab:
            assert await tab.closed() == 4409
        await first.until(lambda: first.state.get("taken", 0) > 3)


async def test_an_engineer_takes_over_and_the_other_sees_it(made: Floor, console: Console) -> None:
    async with console.logged_in() as oscar, console.logged_in(ENGINEER) as erna, drive(oscar) as first:
        await first.until(lambda: made.carrier.written[-1:] == [(FULL, 0.0)], (FULL, 0.0))
        async with drive(oscar, take_over=True) as refused:
            assert await refused.closed() == 4409
            assert "taking over a robot" in refused.over["message"]
        async with drive(erna, take_over=True) as second:
            assert second.held["taken_from"] == "oscar"
            assert await first.closed((FULL, 0.0)) == 4410
            assert "taken over by erna" in first.over["message"]
            await second.until(lambda: made.carrier.written[-1:] == [(-FULL, 0.0)], (-FULL, 0.0))


async def test_a_logout_ends_it(made: Floor, console: Console) -> None:
    async with made.running.client(OBSERVER) as onlooker, console.logged_in() as browser, drive(browser) as page:
        await page.until(lambda: page.state.get("taken", 0) > 3)
        answer = await browser.http.post("api/logout", json={}, headers={"x-csrf": browser.csrf})
        assert answer.status_code == 200
        assert await page.closed() == 4401
        await until_value(onlooker, "State", 0)


async def test_a_second_login_of_the_user_stops_nothing(
    made: Floor, console: Console, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It brings a newer key, and the older one is revoked; the session that drives was opened by that."""
    monkeypatch.setattr("ua_fleet.console.people._KEY_SLACK", timedelta(days=-1))
    async with console.logged_in() as one, drive(one) as page:
        await page.until(lambda: page.state.get("taken", 0) > 3)
        async with console.logged_in():
            until_at = time.monotonic() + 2
            await page.until(lambda: time.monotonic() > until_at, (FULL, 0.0))
        assert not page.over
        assert made.carrier.written[-1] == (FULL, 0.0)


async def test_a_bridge_that_has_gone_is_told(made: Floor, console: Console) -> None:
    async with console.logged_in() as browser, drive(browser) as page:
        await page.until(lambda: page.state.get("taken", 0) > 3)
        await made.end_bridge()
        assert await page.closed((0.0, 0.0)) == 4410
        assert page.over["message"]


async def test_all_see_who_drives(made: Floor, console: Console) -> None:
    del made
    async with console.logged_in(OBSERVER) as observer, observer.live() as live, console.logged_in() as browser:
        await live.want("t", "teleoperation", robot="carrier")
        await live.want("none", "teleoperation", robot="nobody")
        await live.until(lambda: live.feeds.get("t", {}).get("status", {}).get("state") == "Idle")
        assert live.feeds["t"]["info"]["axes"][1]["name"] == "angular"
        await live.until(lambda: "none" in live.feeds)
        assert live.feeds["none"] == {"info": None}
        async with drive(browser) as page:
            driving = asyncio.ensure_future(page.until(lambda: False, (FULL, 0.0)))
            await live.until(lambda: live.feeds["t"]["status"]["output"] == [FULL, 0.0])
            assert live.feeds["t"]["status"]["holder"] == "oscar"
            driving.cancel()
        await live.until(lambda: live.feeds["t"]["status"]["state"] == "Idle")
        assert live.feeds["t"]["status"]["last_end"] == "oscar: released"
