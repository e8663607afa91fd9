"""Passwords: who fails too often waits, nobody else does, and no password stands in any log."""

from __future__ import annotations

import asyncio
import importlib
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.integration.server_security.harness import (
    PASSWORDS,
    SERVER_URI,
    Door,
    Identities,
    bad,
    binary,
    door,
    ua,
)
from tests.waiting import until
from ua_fleet.config.schema import ServerConfig
from ua_fleet.endpoint.hardened_server import create_server
from ua_fleet.endpoint.throttle import FREE_FAILURES
from ua_fleet.endpoint.users import User
from ua_fleet.errors import ServerStartError

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def test_failures_lock_their_source_out_and_nobody_else(tmp_path: Path, identities: Identities) -> None:
    """Stock asyncua lets anybody guess as fast as they can."""
    async with door(tmp_path, identities) as guarded:
        for _ in range(FREE_FAILURES):
            guess = await guarded.client("oscar", password="wrong guess")
            assert await bad(guess.connect()) == "BadUserAccessDenied"
        assert guarded.server.context.throttle.failed == FREE_FAILURES
        locked = await guarded.client("oscar")
        assert await bad(locked.connect()) == "BadUserAccessDenied"
        assert guarded.server.context.throttle.locked_out == 1
        async with guarded.connected("eva") as other:
            assert await other.get_node(guarded.nodes.plain).read_value() == 7.0
        await asyncio.sleep(1.05)
        async with guarded.connected("oscar") as again:
            assert await again.get_node(guarded.nodes.plain).read_value() == 7.0
        log = (guarded.state_dir / "audit.log").read_text()
        assert log.count("wrong user or password") == FREE_FAILURES
        assert "locked out" in log
        assert "wrong guess" not in log
        assert not any(password in log for password in PASSWORDS.values())


async def test_password_checks_do_not_block_the_server(hardened: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stock asyncua checks a password in the event loop: nobody else is served meanwhile."""

    def slow(*_args: Any) -> None:
        time.sleep(0.4)

    monkeypatch.setattr(hardened.users, "verify", slow)
    async with asyncio.timeout(5):
        client = await hardened.client("olga")
        monkeypatch.undo()
        async with hardened.connected() as working:
            monkeypatch.setattr(hardened.users, "verify", slow)
            login = asyncio.ensure_future(bad(client.connect()))
            await asyncio.sleep(0.1)
            assert not login.done()
            for _ in range(20):
                assert await working.get_node(hardened.nodes.plain).read_value() == 7.0
            assert not login.done()
            assert await login == "BadUserAccessDenied"


async def test_encrypted_password_is_for_one_session(hardened: Door) -> None:
    """Stock asyncua does not look at the nonce in an encrypted password, so that it can be replayed."""
    uacrypto: Any = importlib.import_module("asyncua.crypto.uacrypto")
    client = await hardened.client()
    await client.connect_sessionless()
    await client.create_session()
    server: Any = hardened.server.iserver.certificate
    key = server.public_key()

    async def activate(nonce: bytes, algorithm: str = "http://www.w3.org/2001/04/xmlenc#rsa-oaep") -> str:
        parameters = ua.ActivateSessionParameters()
        challenge = client.security_policy.peer_certificate + client._server_nonce
        parameters.ClientSignature.Signature = client.security_policy.asymmetric_cryptography.signature(challenge)
        token = ua.UserNameIdentityToken()
        token.UserName = "oscar"
        plain = binary.Primitives.Bytes.pack(PASSWORDS["oscar"].encode() + nonce)
        token.Password = uacrypto.encrypt_rsa_oaep(key, plain)
        token.EncryptionAlgorithm = algorithm
        parameters.UserIdentityToken = token
        return await bad(client.uaclient.activate_session(parameters))

    assert client._server_nonce is not None
    assert await activate(b"another session's nonce".ljust(32)) == "BadIdentityTokenInvalid"
    rsa15 = "http://www.w3.org/2001/04/xmlenc#rsa-1_5"
    assert await activate(client._server_nonce, rsa15) == "BadIdentityTokenInvalid"
    assert await activate(client._server_nonce) == "Good"
    await client._cancel_task(client._renew_channel_task)
    await client.uaclient.close_session(True)
    client.disconnect_socket()


async def test_plain_password_needs_an_encrypted_channel(hardened: Door) -> None:
    """The check stands in the login itself too, for a channel without security."""
    from ua_fleet.endpoint.logins import identify
    from ua_fleet.endpoint.stack import Refusal

    token = ua.UserNameIdentityToken()
    token.UserName, token.Password = "oscar", PASSWORDS["oscar"].encode()
    params = ua.ActivateSessionParameters()
    params.UserIdentityToken = token
    channel: Any = SimpleNamespace(secured=False)
    with pytest.raises(Refusal, match="plain text"):
        await identify(hardened.server.context, channel, params, nonce=b"", address="127.0.0.1")
    channel.secured = True
    user = await identify(hardened.server.context, channel, params, nonce=b"", address="127.0.0.1")
    assert user.name == "oscar"


async def test_audit_log_has_a_line_for_each_write_and_call(hardened: Door) -> None:
    """Stock asyncua has no audit."""
    async with hardened.connected() as client:
        await client.get_node(hardened.nodes.value).write_value(12.5)
        assert await bad(client.get_node(hardened.nodes.plain).write_value(12.5)) == "BadNotWritable"
        method = client.get_node(hardened.nodes.methods["add"])
        await client.nodes.objects.call_method(
            method, ua.Variant(1, ua.VariantType.Int64), ua.Variant(2, ua.VariantType.Int64)
        )
        assert await bad(client.nodes.objects.call_method(method)) == "BadArgumentsMissing"
    mine = [line for line in hardened.audit() if line.get("user") == "oscar"]
    session = mine[-1]["session"]
    mine = [line for line in mine if line["session"] == session]
    assert [(line["event"], line["status"]) for line in mine] == [
        ("login", "Good"),
        ("write", "Good"),
        ("write", "BadNotWritable"),
        ("call", "Good"),
        ("call", "BadArgumentsMissing"),
        ("logout", "Good"),
    ]
    assert (mine[1]["node"], mine[1]["value"], mine[1]["role"]) == ("ns=2;s=value", "12.5", "operator")
    assert (mine[3]["method"], mine[3]["value"]) == ("ns=2;s=add", "[1, 2]")
    assert mine[1]["client"].startswith("127.0.0.1:")
    assert (hardened.state_dir / "audit.log").stat().st_mode & 0o777 == 0o600


async def test_refused_messages_are_in_the_audit_log(hardened: Door) -> None:
    async with hardened.connected("olga") as client:
        from tests.integration.server_security.harness import send

        assert await bad(send(client, ua.AddNodesRequest(), ua.AddNodesResponse)) == "BadServiceUnsupported"
    last = [line for line in hardened.audit() if line["event"] == "refusal"][-1]
    assert (last["user"], last["what"], last["status"]) == ("olga", "AddNodes", "BadServiceUnsupported")


async def test_users_file_that_others_can_read_stops_the_start(tmp_path: Path, identities: Identities) -> None:
    identities.install_server(tmp_path)
    (tmp_path / "users.yaml").write_text("version: 1\nusers: {}\n")
    (tmp_path / "users.yaml").chmod(0o644)
    with pytest.raises(ServerStartError, match="chmod 600") as refused:
        await create_server(ServerConfig(port=0), tmp_path, application_uri=SERVER_URI)
    assert "\n" not in str(refused.value)


async def test_port_in_use_is_one_line_with_the_remedy(hardened: Door, tmp_path: Path, identities: Identities) -> None:
    identities.install_server(tmp_path)
    server = await create_server(ServerConfig(port=hardened.server.port), tmp_path, application_uri=SERVER_URI)
    with pytest.raises(ServerStartError, match=r"server\.port") as refused:
        await server.start()
    assert "\n" not in str(refused.value)
    await server.stop()


async def test_long_names_and_node_ids_do_not_fill_the_log(hardened: Door) -> None:
    """What a client chooses stands in a log, and in memory, only as far as it is of use."""
    client = await hardened.client("x" * 20_000, password="y" * 20_000)
    assert await bad(client.connect()) == "BadUserAccessDenied"
    throttle: Any = hardened.server.context.throttle
    assert all(len(str(key)) < 200 for key in throttle._sources)
    async with hardened.connected() as writer:
        assert await bad(writer.get_node(ua.NodeId("n" * 1_000_000, 2)).write_value(1.0)) == "BadNodeIdUnknown"
    assert max(len(line) for line in (hardened.state_dir / "audit.log").read_text().splitlines()) < 2_000


async def test_a_timeout_while_the_password_is_checked_is_told_once(
    tmp_path: Path, identities: Identities, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was told and counted at every tick until the check was done."""
    done = threading.Event()
    async with door(tmp_path, identities, limits={"handshake_s": 0.2, "own_work_s": 0.2}) as short:
        verify = short.users.verify

        def slow_verify(name: str, password: str) -> User | None:
            done.wait(20)
            return verify(name, password)

        monkeypatch.setattr(short.users, "verify", slow_verify)
        client = await short.client()
        connecting = asyncio.ensure_future(bad(client.connect()))
        await until(lambda: short.server.statistics.handshake_timeouts)
        ticks = asyncio.get_running_loop().time() + 10 * 0.02
        await until(lambda: asyncio.get_running_loop().time() > ticks)
        done.set()
        assert await connecting == "closed"
        assert short.server.statistics.handshake_timeouts == 1
        assert [line["status"] for line in short.audit()].count("BadTimeout") == 1


async def test_the_time_of_a_client_does_not_run_while_the_server_works(
    tmp_path: Path, identities: Identities, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a password waited for a core for more than 5 s, the login was cut off as if the client had been silent."""
    begun, done = threading.Event(), threading.Event()
    async with door(tmp_path, identities, limits={"handshake_s": 1.0}) as short:
        verify = short.users.verify

        def slow_verify(name: str, password: str) -> User | None:
            begun.set()
            done.wait(20)
            return verify(name, password)

        monkeypatch.setattr(short.users, "verify", slow_verify)
        client = await short.client()
        connecting = asyncio.ensure_future(client.connect())
        await until(begun.is_set)
        await asyncio.sleep(2.0)
        done.set()
        await connecting
        assert short.server.statistics.handshake_timeouts == 0
        await client.disconnect()
