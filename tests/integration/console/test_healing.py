"""A server that goes, stands still, changes, or takes rights away: said in one place, and healed by itself."""

from __future__ import annotations

import asyncio
import signal
import socket
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from tests.integration.console.conftest import FLEET
from tests.integration.console.harness import ENGINEER, OPERATOR, Browser, Console, Live, console_at
from tests.integration.scenarios.conftest import Plant
from tests.integration.server_model.harness import Running, fleet_config, serving, ua
from ua_fleet.endpoint.users import USERS_FILE

CARD = "left"


@asynccontextmanager
async def robots_of(console: Console) -> AsyncGenerator[tuple[Browser, Live]]:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("all", "robots")
        await live.until(lambda: "all" in live.feeds)
        yield browser, live


def state(live: Live) -> str:
    return str(live.links.get("hall", {}).get("state"))


async def test_a_server_that_is_killed_and_started_is_found_again_without_a_login(plant: Plant) -> None:
    plant.users()
    server = plant.server_process()
    url = f"opc.tcp://127.0.0.1:{plant.config.server.port}/ua_fleet"
    async with console_at(plant.folder, {"hall": url}) as console, robots_of(console) as (browser, live):
        assert (state(live), live.wholes["all"]) == ("live", 1)
        server.end(signal.SIGKILL)
        await live.until(lambda: state(live) == "away", 10)
        await live.until(lambda: "lost" not in live.links["hall"]["reason"])
        said = f"the server at 127.0.0.1:{plant.config.server.port} does not answer (connection refused)"
        assert live.links["hall"]["reason"].startswith(said)
        assert live.feeds["all"].keys() == {"left", "middle", "right"}, "what was seen last stays"
        refused = await browser.ask("robots.hold", robot=CARD, reason="tyre")
        assert refused.status_code == 503
        assert "hall is not reachable" in refused.json()["error"]["message"]
        plant.server_process()
        await live.until(lambda: state(live) == "live" and live.wholes["all"] == 2, 30)
        assert (await browser.ask("robots.hold", robot=CARD, reason="tyre")).status_code == 200
        await live.until(lambda: live.feeds["all"][CARD]["held"])


async def test_a_server_that_stands_still_is_away_within_seconds_and_nothing_is_done_later(plant: Plant) -> None:
    plant.users()
    server = plant.server_process()
    url = f"opc.tcp://127.0.0.1:{plant.config.server.port}/ua_fleet"
    async with console_at(plant.folder, {"hall": url}) as console, robots_of(console) as (browser, live):
        server.process.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        try:
            await live.until(lambda: state(live) == "away", 10)
            assert time.monotonic() - began < 6
            refused = await browser.ask("robots.hold", robot=CARD, reason="tyre")
            assert refused.status_code == 503
        finally:
            server.process.send_signal(signal.SIGCONT)
        await live.until(lambda: state(live) == "live", 15)
        assert (await browser.ask("robots.release", robot=CARD)).status_code == 409, "it was not held meanwhile"


async def test_a_role_that_is_taken_away_is_seen_and_refused(console: Console, server: Running) -> None:
    async with robots_of(console) as (browser, live):
        assert live.links["hall"]["roles"] == ["observer", "operator"]
        file = server.folder / "state" / USERS_FILE
        before = file.read_text()
        lines = before.split("\n")
        place = next(at for at, line in enumerate(lines) if "oscar" in line)
        at = next(at for at in range(place, len(lines)) if "role: operator" in lines[at])
        lines[at] = lines[at].replace("operator", "observer")
        file.write_text("\n".join(lines))
        await live.until(lambda: live.links["hall"]["roles"] == ["observer"], 20)
        assert (state(live), "robots.hold" in live.links["hall"]["may"]) == ("live", False)
        refused = await browser.ask("robots.hold", robot="rover", reason="tyre")
        assert refused.status_code == 403, refused.text
        assert "Hold of a robot" in refused.json()["error"]["message"]
        file.write_text(before)
        await live.until(lambda: "operator" in live.links["hall"]["roles"], 20)


async def test_a_key_that_is_revoked_ends_the_link_and_a_login_begins_anew(console: Console, server: Running) -> None:
    async with robots_of(console) as (browser, live), server.client(OPERATOR) as other:
        fleet = other.get_node("ns=2;s=Fleet")
        ids, names, *_ = await fleet.call_method(ua.NodeId("Fleet.ListSessionKeys", 2))
        assert [name.startswith("console on ") for name in names] == [True]
        await fleet.call_method(ua.NodeId("Fleet.RevokeSessionKey", 2), ids[0])
        await live.until(lambda: state(live) == "ended", 20)
        assert "log in again" in live.links["hall"]["reason"]
        assert (await browser.ask("robots.hold", robot="rover")).status_code == 401
        answer = await browser.http.post(
            "api/login", json={"fleet": "hall", "user": OPERATOR[0], "password": OPERATOR[1]}
        )
        assert answer.status_code == 200
        await live.until(lambda: state(live) == "live" and live.wholes["all"] == 2, 20)


async def test_logout_revokes_the_key_and_so_does_the_consoles_end(server: Running, tmp_path: Path) -> None:
    async with server.client(ENGINEER) as erna:

        async def keys() -> list[str]:
            ids, *_ = await erna.get_node("ns=2;s=Fleet").call_method(ua.NodeId("Fleet.ListSessionKeys", 2))
            return list(ids or ())

        async with console_at(tmp_path, {"hall": server.url}) as console:
            async with console.logged_in(ENGINEER) as browser:
                assert len(await keys()) == 1
                await browser.http.post("api/logout", json={}, headers={"x-csrf": browser.csrf})
                async with asyncio.timeout(60):
                    while await keys():
                        await asyncio.sleep(0.1)
            async with console.logged_in(ENGINEER):
                assert len(await keys()) == 1
        async with asyncio.timeout(60):
            while await keys():
                await asyncio.sleep(0.1)


async def test_two_browsers_of_a_user_have_one_session_which_ends_with_the_last(
    console: Console, server: Running
) -> None:
    async with console.logged_in() as first, console.logged_in() as second:
        health = (await first.http.get("healthz")).json()
        assert (health["sessions"], health["links"]) == (2, {"live": 1})
        await first.http.post("api/logout", json={}, headers={"x-csrf": first.csrf})
        assert (await second.ask("robots.hold", robot="rover")).status_code == 200
        await second.http.post("api/logout", json={}, headers={"x-csrf": second.csrf})
        health = (await second.http.get("healthz")).json()
        assert (health["sessions"], health["links"]) == (0, {})


async def test_a_server_with_another_certificate_is_not_given_the_key(
    tmp_path: Path, udp_url: str, tcp_port: int
) -> None:
    config = fleet_config(udp_url, tcp_port, robots=FLEET)
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    url = f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet"
    async with console_at(tmp_path, {"hall": url}) as console:
        async with serving(tmp_path / "one", config):
            context = robots_of(console)
            _, live = await context.__aenter__()
        async with serving(tmp_path / "two", config):
            await live.until(lambda: state(live) == "ended", 30)
            assert "certificate" in live.links["hall"]["reason"]
        await context.__aexit__(None, None, None)


@pytest.mark.parametrize("silent", [True, False])
async def test_a_login_at_a_server_that_is_not_there_says_so(tmp_path: Path, tcp_port: int, silent: bool) -> None:
    url = f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet"
    with socket.socket() as mute:
        if silent:
            mute.bind(("127.0.0.1", tcp_port))
            mute.listen()
        async with console_at(tmp_path, {"hall": url}) as console, console.browser() as browser:
            answer = await browser.post("api/login", json={"fleet": "hall", "user": "anna", "password": "a password"})
            assert answer.status_code == (504 if silent else 503), answer.text
            assert "\n" not in answer.json()["error"]["message"]


async def test_a_server_that_does_not_trust_the_console_says_what_to_do(
    tmp_path: Path, udp_url: str, tcp_port: int
) -> None:
    config = fleet_config(udp_url, tcp_port, robots=FLEET, trust_all_clients=False)
    async with (
        serving(tmp_path, config) as server,
        console_at(tmp_path, {"hall": server.url}) as console,
        console.browser() as browser,
    ):
        login = {"fleet": "hall", "user": OPERATOR[0], "password": OPERATOR[1]}
        answer = await browser.post("api/login", json=login)
        assert answer.status_code == 502
        assert "cert trust --last --show" in answer.json()["error"]["message"]
        (refused,) = (server.folder / "state").rglob("rejected/*.der")
        trusted = refused.parent.parent / "gateways"
        trusted.mkdir(exist_ok=True)
        refused.rename(trusted / "console.der")
        async with asyncio.timeout(60):
            while (answer := await browser.post("api/login", json=login)).status_code != 200:
                await asyncio.sleep(0.3)
