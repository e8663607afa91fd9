"""The console as a page meets it: login, operations, live data."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx

from tests.integration.console.harness import ENGINEER, OBSERVER, OPERATOR, PAGE, Browser, Console
from tests.integration.server_model.harness import SPEED, Running
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType, StatusCode


async def test_who_is_not_logged_in_sees_the_fleets_and_nothing_else(console: Console) -> None:
    async with console.browser() as browser:
        fleets = (await browser.get("api/fleets")).json()
        assert [(one["name"], one["title"]) for one in fleets["fleets"]] == [("hall", "hall")]
        assert (await browser.get("api/me")).status_code == 401
        answer = await browser.post("api/hall/skill.start", json={})
        assert answer.status_code == 401
        assert "log in" in answer.json()["error"]["message"]
        assert (await browser.get("/")).text == PAGE


async def test_roles_are_the_servers(console: Console) -> None:
    expected = {
        OBSERVER: ["observer"],
        OPERATOR: ["observer", "operator"],
        ENGINEER: ["observer", "operator", "engineer"],
    }
    for user, roles in expected.items():
        async with console.logged_in(user) as browser:
            hall = (await browser.http.get("api/me")).json()["fleets"]["hall"]
            assert (hall["user"], hall["roles"], hall["state"]) == (user[0], roles, "live")
            assert ("skill.start" in hall["may"]) == ("operator" in roles)


async def test_a_wrong_password_is_told(console: Console) -> None:
    async with console.browser() as browser:
        answer = await browser.post("api/login", json={"fleet": "hall", "user": "oscar", "password": "wrong-password"})
        assert answer.status_code == 401
        error = answer.json()["error"]
        assert (error["status"], error["field"]) == ("BadUserAccessDenied", "password")
        assert not browser.cookies


async def test_feeds_are_whole_then_what_changes(console: Console, server: Running) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("all", "robots")
        await live.want("one", "robot", robot="rover")
        await live.until(lambda: "rover" in live.feeds.get("all", {}) and "robot" in live.feeds.get("one", {}))
        card = live.feeds["all"]["rover"]
        assert (card["state"]["v"], card["capacities"], card["held"]) == ("offline", ["mobile"], None)
        speed = f"ns=2;i={SPEED.id}"
        described = live.feeds["one"][f"data/{speed}"]
        assert (described["path"], described["unit"], described["low"], described["high"]) == (["speed"], "m/s", -2, 2)
        argument = live.feeds["one"]["skill/goto"]["arguments"][0]
        assert (argument["name"], argument["unit"], argument["default"], argument["low"]) == ("x", "m", 0, -5)
        server.peer.announce(SPEED, (make_field("data", BuiltinType.DOUBLE),))
        server.peer.publish(SPEED, 1.5)
        await live.until(lambda: live.feeds["one"][f"value/{speed}"]["v"] == 1.5)
        assert live.feeds["one"][f"value/{speed}"]["s"] == 0
        assert live.wholes == {"all": 1, "one": 1}


async def test_a_feed_that_there_is_not_says_so_and_others_go_on(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("x", "nothing")
        await live.want("y", "robot", wrong=1)
        await live.want("z", "robot", robot="nobody")
        await live.want("all", "robots")
        await live.until(lambda: {"x", "y", "z"} <= live.errors.keys() and "all" in live.feeds)
        assert "no feed 'nothing'" in live.errors["x"]["message"]
        assert live.errors["y"]["field"] in ("robot", "wrong")
        assert live.errors["z"]["status"] == "BadNodeIdUnknown"


async def test_feeds_that_are_refused_take_no_place(console: Console) -> None:
    wrong: dict[str, Any] = {"fleet": "hall", "feed": "robot", "parameters": {"none": 1}}
    none = {"fleet": "hall", "feed": "none"}
    async with console.logged_in() as browser, browser.live() as live:
        await live.say(want={f"wrong{number}": wrong if number % 2 else none for number in range(200)})
        await live.until(lambda: len(live.errors) == 200)
        await live.want("all", "robots")
        await live.until(lambda: "all" in live.feeds)
        for turn in range(4):  # and none is confirmed
            await live.say(want={f"{turn}-{number}": none for number in range(200)})
        await live.socket.wait_closed()
        assert live.socket.close_code == 4429
        assert (await browser.http.get("healthz")).json()["drops"]["too_many_feeds"] == 1
        async with browser.live() as other:
            await other.want("x" * 101, "robots")  # no name that a page gives
            await other.socket.wait_closed()
            assert other.socket.close_code == 4400


async def test_an_operation_is_refused_by_the_server_with_the_method_named(console: Console) -> None:
    async with console.logged_in(OBSERVER) as browser:
        answer = await browser.ask("skill.start", robot="rover", skill="goto")
        assert answer.status_code == 403
        error = answer.json()["error"]
        assert error["code"] == StatusCode.BAD_USER_ACCESS_DENIED
        assert "Start of a skill" in error["message"]


async def test_mistakes_of_the_page_are_told_with_the_field(console: Console) -> None:
    async with console.logged_in() as browser:
        mistaken: list[tuple[dict[str, Any], str]] = [
            ({"skill": "goto"}, "robot"),
            ({"robot": "rover", "skill": "goto", "y": 1}, "y"),
        ]
        for parameters, field in mistaken:
            answer = await browser.ask("skill.start", **parameters)
            assert (answer.status_code, answer.json()["error"]["field"]) == (400, field)
        answer = await browser.ask("skill.start", robot="rover", skill="goto", arguments={"x": "far"})
        assert answer.status_code == 400
        assert "x is 'far', and no Double" in answer.json()["error"]["message"]
        assert answer.json()["error"]["field"] == "x"
        answer = await browser.ask("skill.start", robot="rover", skill="goto", arguments={"x": 7})
        assert (answer.status_code, answer.json()["error"]["field"]) == (400, "x")
        answer = await browser.ask("skill.start", robot="rover", skill="goto")
        assert answer.status_code == 409
        assert "the robot is silent" in answer.json()["error"]["message"]
        assert (await browser.ask("skill.start", robot="nobody", skill="goto")).status_code == 404
        assert (await browser.ask("skill.jump")).status_code == 404


async def test_a_command_that_is_sent_again_is_carried_out_once(console: Console) -> None:
    """Its answer was lost on the way: the page gives the same key, and is told what was answered."""

    async def hold(browser: Browser, key: str, reason: str = "painted") -> httpx.Response:
        headers = {"x-csrf": browser.csrf, "idempotency-key": key}
        return await browser.http.post(
            "api/hall/robots.hold", json={"robot": "rover", "reason": reason}, headers=headers
        )

    async with console.logged_in() as browser, console.logged_in(ENGINEER) as other:
        first, together = await asyncio.gather(hold(browser, "one"), hold(browser, "one"))
        assert [first.status_code, together.status_code] == [200, 200]
        assert (first.json(), "idempotent-replayed" in first.headers) == (together.json(), False)
        assert together.headers["idempotent-replayed"] == "true"
        assert (await browser.ask("robots.release", robot="rover")).status_code == 200
        again = await hold(browser, "one")
        assert (again.status_code, again.json()) == (200, first.json())
        async with browser.live() as live:
            await live.want("all", "robots")
            await live.until(lambda: "rover" in live.feeds.get("all", {}))
            assert live.feeds["all"]["rover"]["held"] is None, "it was carried out twice"
        # Another reason, another key, another browser: other commands.
        assert "idempotent-replayed" not in (await hold(browser, "one", "other")).headers
        assert "idempotent-replayed" not in (await hold(browser, "two")).headers
        assert "idempotent-replayed" not in (await hold(other, "one")).headers
        for one in (browser, other):
            await one.ask("robots.release", robot="rover")


async def test_a_page_that_shows_another_user_commands_nothing(console: Console) -> None:
    """Another tab of the browser has logged somebody else in, and this one does not know it yet."""
    parameters = {"robot": "rover", "reason": "painted"}
    async with console.logged_in() as browser:
        for user, status in (("anna%20b", 401), (OPERATOR[0], 200)):
            headers = {"x-csrf": browser.csrf, "x-user": user}
            answer = await browser.http.post("api/hall/robots.hold", json=parameters, headers=headers)
            assert answer.status_code == status
            if status == 401:
                assert "at hall as oscar now, and not as anna b" in answer.json()["error"]["message"]
        assert (await browser.http.get("healthz")).json()["drops"]["other_user"] == 1
        await browser.ask("robots.release", robot="rover")


async def test_after_logout_nothing_is_left(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("all", "robots")
        await live.until(lambda: "all" in live.feeds)
        before = browser.cookie
        answer = await browser.http.post("api/logout", json={}, headers={"x-csrf": browser.csrf})
        assert answer.status_code == 200
        assert (await browser.http.get("api/me", headers={"cookie": before})).status_code == 401
        await live.socket.wait_closed()
        assert live.socket.close_code == 4401
