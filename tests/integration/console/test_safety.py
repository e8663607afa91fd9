"""What a stranger's page, a stranger's program and a flood get: refused, counted, and the page lives."""

from __future__ import annotations

import asyncio
import contextlib
import json
import ssl
import threading
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import httpx
import pytest
import pytest_asyncio
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from tests import system
from tests.integration.console.conftest import rover_server
from tests.integration.console.harness import NO_TLS, OPERATOR, Browser, Console, console_at
from tests.integration.server_model.harness import Running
from tests.waiting import until
from ua_fleet.console.sessions import BrowserSession, BrowserSessions
from ua_fleet.endpoint.certificates import CertificateFiles, create_certificate

pytestmark = pytest.mark.asyncio(loop_scope="module")
LOGIN = {"fleet": "hall", "user": OPERATOR[0], "password": OPERATOR[1]}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[Running]:
    """One for all; each has a console of its own, and those that guess, which it counts too, a server of their own."""
    async with rover_server(tmp_path_factory.mktemp("rover")) as running:
        yield running


@pytest_asyncio.fixture(loop_scope="module")
async def console(server: Running, tmp_path: Path) -> AsyncGenerator[Console]:
    async with console_at(tmp_path, {"hall": server.url}) as running:
        yield running


async def drops(console: Console) -> dict[str, int]:
    async with console.browser() as browser:
        counted: dict[str, int] = (await browser.get("healthz")).json()["drops"]
        return counted


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "https://127.0.0.1", "http://127.0.0.1:1"])
async def test_a_post_of_another_page_is_refused(console: Console, origin: str | None) -> None:
    async with httpx.AsyncClient(base_url=console.url, verify=NO_TLS) as client:
        headers = {"origin": origin} if origin else {}
        answer = await client.post("api/login", json=LOGIN, headers=headers)
        assert answer.status_code == 403
        assert not client.cookies
    assert (await drops(console))["wrong_origin"] == 1


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:80", "", "localhost@evil.example"])
async def test_another_host_is_refused_against_dns_rebinding(console: Console, host: str) -> None:
    async with httpx.AsyncClient(base_url=console.url, verify=NO_TLS) as client:
        answer = await client.get("api/fleets", headers={"host": host, "origin": f"http://{host}"})
        assert answer.status_code == 400
        with pytest.raises(InvalidStatus):
            async with connect(console.url.replace("http", "ws") + "api/live", additional_headers={"Host": host}):
                pass
    assert (await drops(console))["wrong_host"] >= 1


async def test_every_answer_has_the_headers_of_safety(console: Console) -> None:
    async with console.browser() as browser:
        for path in ("", "api/fleets", "api/me", "no/such/file", "assets/app-1234.js"):
            headers = (await browser.get(path)).headers
            policy = headers["content-security-policy"]
            assert "default-src 'self'" in policy
            assert "frame-ancestors 'none'" in policy
            assert "unsafe" not in policy
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["referrer-policy"] == "no-referrer"
            assert headers["cross-origin-opener-policy"] == "same-origin"
            assert headers["cross-origin-resource-policy"] == "same-origin"
            assert "gamepad=(self)" in headers["permissions-policy"]
            assert "server" not in headers
        assert "immutable" in (await browser.get("assets/app-1234.js")).headers["cache-control"]
        assert (await browser.get("")).headers["cache-control"] == "no-cache"
        assert (await browser.get("api/fleets")).headers["cache-control"] == "no-store"
        packed = await browser.get("assets/app-1234.js", headers={"accept-encoding": "gzip"})
        assert packed.headers["content-encoding"] == "gzip"
        for path in ("..%2f..%2fapp.py", "%2e%2e/app.py", "assets/../../app.py"):
            assert (await browser.get(path)).status_code == 404


async def test_the_cookie_is_for_nobody_but_this_page(console: Console) -> None:
    async with console.browser() as browser:
        answer = await browser.post("api/login", json=LOGIN)
        cookie = answer.headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        assert "Path" not in cookie
        again = await browser.post("api/login", json=LOGIN)
        assert "set-cookie" not in again.headers


async def test_two_consoles_of_a_host_do_not_log_each_other_out(server: Running, tmp_path: Path) -> None:
    """A browser sends its cookies to all ports of a host: containers, and a console of this machine beside them."""
    port = system.free_tcp_port()
    names: set[str] = set()
    for folder, listen in (("one", port), ("two", port), ("two", 0)):
        (tmp_path / folder).mkdir(exist_ok=True)
        given = {"listen": f"127.0.0.1:{listen}"}
        async with (
            console_at(tmp_path / folder, {"hall": server.url}, **given) as console,
            console.browser() as browser,
        ):
            answer = await browser.post("api/login", json=LOGIN)
            assert answer.status_code == 200, answer.text
            names.add(answer.headers["set-cookie"].partition("=")[0])
    assert len(names) == 3


async def test_a_post_needs_the_token_of_its_session(console: Console) -> None:
    async with console.logged_in() as first, console.logged_in() as second:
        for token in (b"", b"x", second.csrf.encode(), "\u00e9".encode()):
            answer = await first.http.post("api/hall/robots.hold", json={"robot": "rover"}, headers={b"x-csrf": token})
            assert answer.status_code == 403
            assert "X-CSRF" in answer.json()["error"]["message"]
    assert (await drops(console))["wrong_csrf"] == 4


async def test_a_body_is_json_and_has_a_bound(console: Console) -> None:
    async with console.logged_in() as browser:
        headers = {"x-csrf": browser.csrf, "content-type": "text/plain"}
        assert (await browser.http.post("api/hall/robots.hold", content="{}", headers=headers)).status_code == 400
        large = await browser.ask("scenario.outline", scenario="x" * 1_200_000)
        assert large.status_code == 413
        assert (await drops(console))["too_large"] == 1
        for body in (b"\xff", b"[1]", b"{", b'{"robot": 1e999}', b"[" * 100_000):
            headers["content-type"] = "application/json"
            answer = await browser.http.post("api/hall/robots.hold", content=body, headers=headers)
            assert answer.status_code == 400, body[:20]
            assert "\n" not in answer.json()["error"]["message"]
        assert (await browser.http.get("healthz")).json()["mistakes"] == {}


async def socket_closes(browser: Browser, *messages: str, **headers: str) -> int:
    url = browser.console.url.replace("http", "ws", 1) + "api/live"
    given = {"origin": browser.console.origin, "cookie": browser.cookie, **headers}
    async with connect(url, additional_headers=given) as socket:
        try:
            for message in messages:
                await socket.send(message)
            async with asyncio.timeout(60):
                while True:
                    await socket.recv()
        except ConnectionClosed:
            return int(socket.close_code or 0)


async def test_a_websocket_of_another_page_or_without_a_login_is_refused(console: Console) -> None:
    async with console.logged_in() as browser:
        csrf = json.dumps({"csrf": browser.csrf})
        for origin in ("http://evil.example", "null"):
            with pytest.raises(InvalidStatus):
                await socket_closes(browser, csrf, origin=origin)
        assert await socket_closes(browser, csrf, cookie="none=1") == 4401
        assert await socket_closes(browser, json.dumps({"csrf": "wrong"})) == 4403
        assert await socket_closes(browser, "{}") == 4403


FORGED: list[Any] = [
    "no json",
    "[]",
    '{"csrf": 1}',
    '{"want": {"1": {"fleet": "hall"}}}',
    '{"want": {"1": {"fleet": "hall", "feed": "robots", "more": 1}}}',
    '{"unknown": 1}',
    '{"seen": "x"}',
    "[" * 60_000,
]


@pytest.mark.parametrize("forged", FORGED, ids=range(len(FORGED)))
async def test_a_forged_message_ends_its_socket_and_nothing_else(console: Console, forged: str) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("all", "robots")
        await live.until(lambda: "all" in live.feeds)
        assert await socket_closes(browser, json.dumps({"csrf": browser.csrf}), forged) == 4400
        await live.want("again", "robots")
        await live.until(lambda: "again" in live.feeds)
        health = (await browser.http.get("healthz")).json()
        assert (health["mistakes"], health["drops"]["invalid"]) == ({}, 1)


async def test_floods_of_one_page_end_with_it(console: Console) -> None:
    async with console.logged_in() as browser:
        csrf = json.dumps({"csrf": browser.csrf})
        assert await socket_closes(browser, csrf, *['{"seen": 1}'] * 400) == 4429
        assert await socket_closes(browser, csrf, json.dumps({"drop": ["x" * 70_000]})) == 1009
        async with browser.live() as live:
            for number in range(80):
                await live.want(str(number), "robots")
            await live.until(lambda: len(live.feeds) + len(live.errors) == 80)
            assert (len(live.feeds), len(live.errors)) == (64, 16)
        assert (await browser.http.get("api/me")).status_code == 200
        counted = await drops(console)
        assert (counted["too_many_messages"], counted["too_many_feeds"]) == (1, 16)


async def test_tabs_of_a_browser_are_bounded(server: Running, tmp_path: Path) -> None:
    limits = {"sockets_per_session": 2}
    async with console_at(tmp_path, {"hall": server.url}, limits=limits) as console, console.logged_in() as browser:
        csrf = json.dumps({"csrf": browser.csrf})
        async with browser.live() as one, browser.live() as two:
            await one.until(lambda: one.links)
            await two.until(lambda: two.links)
            assert await socket_closes(browser, csrf) == 4429
        async with asyncio.timeout(60):
            while (await browser.http.get("healthz")).json()["sockets"]:
                await asyncio.sleep(0.05)
        async with browser.live() as three:
            await three.until(lambda: three.links)


async def test_guessing_is_slowed_before_the_server_locks_anybody_out(tmp_path: Path) -> None:
    async with rover_server(tmp_path) as server, console_at(tmp_path, {"hall": server.url}) as console:
        async with console.browser() as guesser:
            codes = [
                (await guesser.post("api/login", json={**LOGIN, "password": f"guess-{number}"})).status_code
                for number in range(6)
            ]
            assert codes == [401] * 4 + [429] * 2
            late = await guesser.post("api/login", json=LOGIN)
            assert late.status_code == 429
            assert int(late.headers["retry-after"]) >= 1
        async with console.logged_in(("olga", "observe-1")):
            pass  # another user of the same address
        counted = await drops(console)
        assert (counted["login_failed"], counted["login_limited"]) == (4, 3)


async def test_browsers_of_a_user_are_bounded(server: Running, tmp_path: Path) -> None:
    async with (
        console_at(tmp_path, {"hall": server.url}, limits={"sessions_per_user": 2}) as console,
        console.logged_in() as first,
        console.logged_in() as second,
        console.logged_in() as third,
    ):
        codes = [(await one.http.get("api/me")).status_code for one in (first, second, third)]
        assert codes == [401, 200, 200]


async def test_behind_a_proxy_the_browsers_view_counts(server: Running, tmp_path: Path) -> None:
    proxied = {"x-forwarded-proto": "https", "x-forwarded-host": "fleet.example", "x-forwarded-for": "203.0.113.9"}
    headers = {**proxied, "origin": "https://fleet.example"}
    trusting = {"trusted_proxies": ["127.0.0.1"], "allowed_hosts": ["fleet.example"]}
    async with (
        console_at(tmp_path, {"hall": server.url}, **trusting) as console,
        httpx.AsyncClient(base_url=console.url, headers=headers, verify=NO_TLS) as client,
    ):
        answer = await client.post("api/login", json=LOGIN)
        assert answer.status_code == 200, answer.text
        cookie = answer.headers["set-cookie"]
        assert "; Secure" in cookie
        assert cookie.startswith("__Secure-")
        token = {"x-csrf": answer.json()["csrf"], "cookie": cookie.partition(";")[0]}
        ended = (await client.post("api/logout", json={}, headers=token)).headers["set-cookie"]
        assert ended.startswith(f"{cookie.partition('=')[0]}=;")
        assert "; Secure" in ended, "a browser takes no cookie of this name without it"
        assert "strict-transport-security" in answer.headers
        assert (await client.post("api/login", json=LOGIN, headers={"origin": console.origin})).status_code == 403
    async with (
        console_at(tmp_path, {"hall": server.url}, allowed_hosts=["fleet.example"]) as console,
        httpx.AsyncClient(base_url=console.url, headers=headers, verify=NO_TLS) as client,
    ):
        assert (await client.post("api/login", json=LOGIN)).status_code == 403, "nobody is trusted here"


async def test_with_a_certificate_it_is_https_alone(server: Running, tmp_path: Path) -> None:
    files = CertificateFiles(tmp_path / "console.der", tmp_path / "console-key.pem")
    create_certificate(files, application_uri="urn:test:console", common_name="localhost")
    tls = {"certificate": str(files.certificate), "key": str(files.private_key)}
    async with console_at(tmp_path, {"hall": server.url}, tls=tls) as console:
        assert console.url.startswith("https://")
        context = ssl.create_default_context(cadata=files.certificate.read_bytes())
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE  # it is no CA's: a person looks at it once, and accepts it
        async with httpx.AsyncClient(
            base_url=console.url, headers={"origin": console.origin}, verify=context
        ) as client:
            answer = await client.post("api/login", json=LOGIN)
            assert answer.status_code == 200, answer.text
            assert "; Secure" in answer.headers["set-cookie"]
            url = console.url.replace("http", "ws", 1) + "api/live"
            cookie = answer.headers["set-cookie"].partition(";")[0]
            given = {"origin": console.origin, "cookie": cookie}
            async with connect(url, additional_headers=given, ssl=context) as socket:
                await socket.send(json.dumps({"csrf": answer.json()["csrf"]}))
                assert "links" in json.loads(await socket.recv())


async def test_a_slow_head_is_cut_off(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ua_fleet.console.connections.HEAD_S", 0.3)
    port = int(console.origin.rpartition(":")[2])
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET / HTTP/1.1\r\nHost: localhost\r\n")
    async with asyncio.timeout(5):
        with contextlib.suppress(ConnectionResetError):
            assert await reader.read() == b""
    writer.close()
    assert (await drops(console))["too_slow"] == 1


async def test_each_line_of_a_forwarded_header_counts(tmp_path: Path) -> None:
    """Some proxies add a line of their own to what the one before has sent; people do not share an address then."""
    given: dict[str, Any] = {"trusted_proxies": ["127.0.0.1", "10.0.0.0/8"]}
    async with (
        rover_server(tmp_path) as server,
        console_at(tmp_path, {"hall": server.url}, **given) as console,
        console.browser() as browser,
    ):

        async def login(password: str, address: str) -> int:
            headers = [("origin", console.origin), ("x-forwarded-for", address), ("x-forwarded-for", "10.0.0.1")]
            async with httpx.AsyncClient(base_url=console.url, verify=NO_TLS) as client:
                body = {**LOGIN, "password": password}
                return (await client.post("api/login", json=body, headers=headers)).status_code

        assert [await login("a guess", "192.0.2.1") for _ in range(5)] == [401] * 4 + [429]
        assert await login(OPERATOR[1], "192.0.2.2") == 200
        headers = [("host", console.origin.partition("//")[2]), ("origin", console.origin), ("origin", "null")]
        assert (await browser.request("POST", "api/login", json=LOGIN, headers=headers)).status_code == 403


async def test_outlines_of_a_user_are_made_one_after_the_other_and_the_page_waits_for_none(
    console: Console, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once: list[int] = []
    go_on = threading.Event()

    def slow(_text: str) -> dict[str, Any]:
        at_once.append(1)
        go_on.wait(20)
        return {}

    monkeypatch.setattr("ua_fleet.console.operations.scenarios.outline", slow)
    async with console.logged_in() as browser:
        page = await browser.http.get("")
        asked = [asyncio.ensure_future(browser.ask("scenario.outline", scenario="x")) for _ in range(8)]
        loop = asyncio.get_running_loop()
        others: list[asyncio.Future[bool]] = []
        try:
            await until(lambda: at_once)
            others = [loop.run_in_executor(None, go_on.wait, 20) for _ in range(40)]  # all other threads
            async with asyncio.timeout(10):
                assert (await browser.http.get("")).text == page.text
                while (await browser.ask("scenario.outline", scenario="x")).status_code != 429:
                    pass  # all 8 are there
            assert len(at_once) == 1
        finally:
            go_on.set()
        assert {(await one).status_code for one in asked} == {200}
        await asyncio.gather(*others)


async def test_a_page_that_only_wants_keeps_no_login(server: Running, tmp_path: Path) -> None:
    """It wants its feeds again after each outage; that somebody is there it says itself."""
    used: list[float] = []
    use = BrowserSessions.use

    def noted(sessions: BrowserSessions, session: BrowserSession, now: float) -> None:
        used.append(now)
        use(sessions, session, now)

    async with console_at(tmp_path, {"hall": server.url}) as console, console.logged_in() as browser:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(BrowserSessions, "use", noted)
            async with browser.live() as live:
                await live.want("all", "robots")
                await live.until(lambda: "all" in live.feeds)
                assert not used
                await live.say(active=True)
                await live.until(lambda: used)


async def test_connections_of_an_address_are_bounded(server: Running, tmp_path: Path) -> None:
    limits = {"connections_per_address": 3}
    async with console_at(tmp_path, {"hall": server.url}, limits=limits) as console:
        port = int(console.origin.rpartition(":")[2])
        there = [await asyncio.open_connection("127.0.0.1", port) for _ in range(3)]
        await asyncio.sleep(0.1)
        async with console.browser() as browser:
            with pytest.raises(httpx.TransportError):
                await browser.get("api/fleets")
            for _, writer in there:
                writer.close()
            await asyncio.sleep(0.2)
            assert (await browser.get("api/fleets")).status_code == 200
        assert (await drops(console))["too_many_connections"] >= 1
