"""A bridge's source of keys, against a server that comes and goes."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import io
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import structlog
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from tests import system
from tests.integration.key_service.harness import INVALIDATE, ROTATE, Cards, Desk, call, desk, get_keys, name
from tests.unit.server.key_service.fleet import fleet
from ua_fleet.client.key_source import ServiceKeySource
from ua_fleet.endpoint.certificates import revoke_bridge, trust_bridge
from ua_fleet.endpoint.throttle import LoginThrottle
from ua_fleet.errors import KeySourceUnavailable, KeysRefused
from ua_fleet.server.key_service.files import GROUPS_FILE, load_groups
from ua_fleet.wire.security import SecurityPolicy

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def test_it_gives_what_the_service_has(running: Desk, cards: Cards, tmp_path: Path) -> None:
    async with ServiceKeySource(running.url, cards.identity("arm", tmp_path), "arm") as source:
        for group in ("t-0", "t-300", "c-1", "c-2"):
            keys = await source.fetch(group, 0, 5)
            expected = running.service.keys_for_space(1, group, 0, 5)
            assert keys[:3] == expected[:3]
            assert keys.key_lifetime_s == 3600.0
            assert 0 < keys.time_to_next_key_s <= 3600.0
        assert keys.policy is SecurityPolicy.AES256_CTR
    logins = [line for line in running.audit() if line["event"] == "login" and line["user"] == "bridge:arm"]
    assert len(logins) == 1


async def test_groups_that_it_does_not_get(running: Desk, cards: Cards, tmp_path: Path) -> None:
    async with ServiceKeySource(running.url, cards.identity("arm", tmp_path), "arm") as source:
        with pytest.raises(KeysRefused, match=r"no keys of c-300: bridge arm may not have them; see `requestors`"):
            await source.fetch("c-300", 0, 5)
        with pytest.raises(KeysRefused, match=r"no keys of t-9: .* has no keys of such a group"):
            await source.fetch("t-9", 0, 5)
        assert (await source.fetch("t-0", 0, 1)).keys


async def test_it_finds_a_server_that_was_restarted(tmp_path: Path, cards: Cards) -> None:
    port = system.free_tcp_port()
    async with desk(tmp_path, cards, port=port) as made:
        source = ServiceKeySource(made.url, cards.identity("arm", tmp_path / "arm"), "arm")
        before = await source.fetch("t-1", 0, 5)
    with pytest.raises(KeySourceUnavailable, match="does not answer") as away:
        await source.fetch("t-1", 0, 5)
    assert "\n" not in str(away.value)
    async with desk(tmp_path, cards, port=port):
        assert (await source.fetch("t-1", 0, 5))[:3] == before[:3]
        await source.close()
        assert (await source.fetch("t-1", 0, 5))[:3] == before[:3]
        await source.close()


async def until_more(source: ServiceKeySource, generation: int) -> None:
    async with asyncio.timeout(60):
        while source.generation <= generation:
            await asyncio.sleep(0.01)


async def test_it_hears_of_keys_that_change_before_their_time(tmp_path: Path, cards: Cards) -> None:
    port = system.free_tcp_port()
    async with desk(tmp_path, cards, port=port) as made:
        source = ServiceKeySource(made.url, cards.identity("arm", tmp_path / "arm"), "arm")
        await source.fetch("t-1", 0, 5)
        async with made.connected(card="visitor", user="eva") as engineer:
            for method, token in ((ROTATE, 2), (INVALIDATE, 7), (INVALIDATE, 12)):
                before = source.generation
                assert name(await call(engineer, made.group("t-1"), method)) == "Good"
                await until_more(source, before)
                assert (await source.fetch("t-1", 0, 5)).first_token_id == token
            assert await engineer.get_node("ns=2;s=SecurityGroups.Changes").read_value() == 3
        before = source.generation
    # A server that is gone cannot say anything.
    await until_more(source, before)
    with pytest.raises(KeySourceUnavailable):
        await source.fetch("t-1", 0, 5)
    async with desk(tmp_path, cards, port=port):
        before = source.generation
        assert (await source.fetch("t-1", 0, 5)).first_token_id == 12
        assert source.generation == before
        await source.close()
        assert source.generation == before


async def test_it_says_which_command_makes_it_known(running: Desk, cards: Cards, tmp_path: Path) -> None:
    for card in ("stranger", "visitor"):
        identity = cards.identity(card, tmp_path / card)
        async with ServiceKeySource(running.url, identity, "arm") as source:
            with pytest.raises(KeySourceUnavailable) as unknown:
                await source.fetch("t-0", 0, 5)
        assert str(unknown.value) == (
            f"{running.url} does not know bridge arm by its certificate; on the server run: "
            f"ua-fleet cert trust --bridge arm {identity.certificate}"
        )


async def test_it_makes_its_own_certificate_and_waits_to_be_known(tmp_path: Path, cards: Cards) -> None:
    from ua_fleet.client.identity import ClientIdentity

    async with desk(tmp_path, cards) as made:
        identity = ClientIdentity.of_bridge(tmp_path / "arm", "Fleet", "arm")
        async with ServiceKeySource(made.url, identity, "arm") as source:
            with pytest.raises(KeySourceUnavailable, match="does not know bridge arm"):
                await source.fetch("c-1", 0, 5)
            assert identity.key.stat().st_mode & 0o777 == 0o600
            trust_bridge(made.state_dir, "arm", identity.certificate)
            assert (await source.fetch("c-1", 0, 5)).first_token_id == 1
            revoke_bridge(made.state_dir, "arm")
            made.server.context.throttle = LoginThrottle()
            with pytest.raises(KeySourceUnavailable, match="does not know bridge arm"):
                await until_refused(source)


async def until_refused(source: ServiceKeySource) -> None:
    async with asyncio.timeout(60):
        while True:
            await source.fetch("c-1", 0, 5)
            await asyncio.sleep(0.02)


async def test_another_server_at_the_same_place(tmp_path: Path, cards: Cards) -> None:
    async with desk(tmp_path, cards) as made:
        identity = cards.identity("arm", tmp_path / "arm")
        own = (made.state_dir / "certificates" / "own" / "server.der").read_bytes()
        pem = x509.load_der_x509_certificate(own).public_bytes(Encoding.PEM)
        for pinned in (own, pem):
            identity.pinned_server.write_bytes(pinned)
            async with ServiceKeySource(made.url, identity, "arm") as source:
                assert (await source.fetch("t-0", 0, 1)).keys
        assert not (identity.folder / "servers.json").exists()
        identity.pinned_server.write_bytes(cards.get("visitor").certificate.read_bytes())
        async with ServiceKeySource(made.url, identity, "arm") as source:
            with pytest.raises(KeySourceUnavailable, match=r"shows a certificate .* that is not .*server\.der"):
                await source.fetch("t-0", 0, 1)


async def test_another_products_key_service_does_not_count_changes(tmp_path: Path, cards: Cards) -> None:
    async with desk(tmp_path, cards) as made:
        await made.server.delete_nodes([made.server.get_node("ns=2;s=SecurityGroups.Changes")])
        async with ServiceKeySource(made.url, cards.identity("arm", tmp_path / "arm"), "arm") as source:
            assert (await source.fetch("t-1", 0, 5)).first_token_id == 1
            assert (await source.fetch("t-0", 0, 5)).first_token_id == 1


async def test_a_connection_that_is_cut_while_keys_are_fetched(tmp_path: Path, cards: Cards) -> None:
    """asyncua cancels the request then; nobody has cancelled who waits for it."""
    async with desk(tmp_path, cards) as made:
        server: Any = made.server
        async with ServiceKeySource(made.url, cards.identity("arm", tmp_path / "arm"), "arm") as source:
            await source.fetch("t-0", 0, 1)
            for _ in range(10):
                fetching = asyncio.ensure_future(source.fetch("t-0", 0, 1))
                await asyncio.sleep(0)
                for connection in list(server._listener._connections):
                    connection.abort()
                with contextlib.suppress(KeySourceUnavailable):
                    assert (await fetching).first_token_id == 1


async def test_giving_up_leaves_no_connection(running: Desk, cards: Cards, tmp_path: Path) -> None:
    """At whatever point of the connection a bridge is ended."""
    source = ServiceKeySource(running.url, cards.identity("arm", tmp_path), "arm")
    server: Any = running.server
    listener = server._listener
    for steps in (1, 2, 4, 8, 16, 32, 64, 128, 256):
        fetching = asyncio.ensure_future(source.fetch("t-0", 0, 1))
        for _ in range(steps):
            await asyncio.sleep(0)
        fetching.cancel()
        await asyncio.wait([fetching])
        await source.close()
        async with asyncio.timeout(60):
            while listener._connections:
                await asyncio.sleep(0.01)


async def test_a_server_without_a_key_service(tmp_path: Path, cards: Cards) -> None:
    from tests.integration.server_security.harness import Identities, door

    async with door(tmp_path, Identities(tmp_path)) as plain:
        trust_bridge(plain.state_dir, "arm", cards.get("arm").certificate)
        async with ServiceKeySource(plain.url, cards.identity("arm", tmp_path / "arm"), "arm") as source:
            with pytest.raises(KeySourceUnavailable):
                await source.fetch("t-0", 0, 1)


@pytest.fixture
def everything_logged() -> Iterator[io.StringIO]:
    """All that any logger says, at its lowest level."""
    shown = io.StringIO()
    handler = logging.StreamHandler(shown)
    root = logging.getLogger()
    level, asyncua_level = root.level, logging.getLogger("asyncua").level
    root.addHandler(handler)
    root.setLevel(logging.DEBUG)
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(shown))
    yield shown
    structlog.reset_defaults()
    root.setLevel(level)
    logging.getLogger("asyncua").setLevel(asyncua_level)
    root.removeHandler(handler)


async def test_no_key_is_shown_anywhere(
    tmp_path: Path, cards: Cards, everything_logged: io.StringIO, capfd: pytest.CaptureFixture[str]
) -> None:
    """In no log, audit log, error, representation or file but the one that keeps them."""
    shown: list[str] = []
    given: list[bytes] = []
    async with desk(tmp_path, cards, config=fleet(keys={"lifetime_s": 2.0})) as made:
        source = ServiceKeySource(made.url, cards.identity("arm", tmp_path / "arm"), "arm")
        for group in ("t-0", "t-1", "c-1", "c-2", "c-300", "t-9"):
            try:
                keys = await source.fetch(group, 0, 5)
                given += keys.keys
                shown += [repr(keys), str(keys), f"{source!r} {vars(source)!r}"]
            except KeysRefused as error:
                shown += [repr(error), str(error), repr(error.__cause__)]
        async with made.connected(card="visitor", user="eva") as client:
            await call(client, made.group("t-1"), INVALIDATE)
            shown.append(repr(await get_keys(client, "t-1")))
        await source.fetch("t-1", 0, 5)
        await source.close()
        shown += [repr(made.service), repr(vars(made.service)), made.audit_text(), everything_logged.getvalue()]
        groups = load_groups(made.state_dir / GROUPS_FILE)
        shown.append(repr(groups))
    output = capfd.readouterr()
    text = "".join([*shown, output.out, output.err, everything_logged.getvalue()])
    assert "keys made invalid" in text
    others = [path for path in tmp_path.rglob("*") if path.is_file() and path.name != GROUPS_FILE]
    content = b"".join(path.read_bytes() for path in others) + text.encode()
    kept = [key for state in groups.values() for key in state.keys]
    assert len(kept) >= 35
    for key in {*kept, *given}:
        for form in (key, key.hex().encode(), key.hex().upper().encode(), base64.b64encode(key), repr(key).encode()):
            for part in (form[:16], form[-20:-4]):
                assert part not in content
