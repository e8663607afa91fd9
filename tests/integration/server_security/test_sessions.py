"""Sessions belong to the client, the certificate, the channel and the user that made them."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_security.harness import (
    BASIC256SHA256,
    Client,
    Door,
    Identities,
    Stock,
    bad,
    door,
    lose,
    send,
    ua,
)
from tests.waiting import until

pytestmark = pytest.mark.asyncio(loop_scope="module")


def token_of(client: Client) -> Any:
    return client.uaclient.session.authentication_token


async def open_channel(client: Client) -> None:
    await client.connect_sessionless()


async def call_add(client: Client, method: Any) -> Any:
    request = ua.CallRequest()
    call = ua.CallMethodRequest(ua.NodeId(ua.ObjectIds.ObjectsFolder), method)
    call.InputArguments = [ua.Variant(1, ua.VariantType.Int64), ua.Variant(2, ua.VariantType.Int64)]
    request.Parameters.MethodsToCall = [call]
    response = await send(client, request, ua.CallResponse)
    return response.Results[0].StatusCode


async def steal(thief: Client, token: Any, method: Any) -> tuple[str, str]:
    """Activate another's session with a bad login, then call a method with it: both StatusCodes."""
    await open_channel(thief)
    try:
        thief.uaclient.session.restore_authentication_token(token)
        parameters = ua.ActivateSessionParameters()
        parameters.UserIdentityToken = ua.IssuedIdentityToken()
        activation = await bad(thief.uaclient.activate_session(parameters))
        return activation, await bad(call_add(thief, method))
    finally:
        thief.disconnect_socket()


async def test_refused_activation_binds_no_session_stock(plain: Stock) -> None:
    """The hole in stock asyncua: the refused thief calls a method as the victim."""
    async with plain.client("admin") as victim:
        activation, call = await steal(plain.client(), token_of(victim), plain.nodes.methods["add"])
    assert activation != "Good"
    assert call == "Good"
    assert plain.nodes.called


async def test_refused_activation_binds_no_session(hardened: Door) -> None:
    """Stock asyncua binds the session before it verifies the user; here a refusal changes nothing."""
    before = len(hardened.nodes.called)
    async with hardened.connected() as victim:
        thief = await hardened.client(None)
        activation, call = await steal(thief, token_of(victim), hardened.nodes.methods["add"])
        assert activation == "BadApplicationSignatureInvalid"
        assert call == "BadSecureChannelIdInvalid"
        assert (await call_add(victim, hardened.nodes.methods["add"])).is_good()
    assert len(hardened.nodes.called) == before + 1


async def test_wrong_password_leaves_the_session_with_its_owner(hardened: Door, identities: Identities) -> None:
    """Even with the right certificate a refused login gets nothing, and the owner's session goes on."""
    async with hardened.connected() as victim:
        thief = await hardened.client("oliver", password="wrong")
        await open_channel(thief)
        thief.uaclient.session.restore_authentication_token(token_of(victim))
        thief._server_nonce = victim._server_nonce
        thief._policy_ids = victim._policy_ids
        assert await bad(thief.activate_session("oliver", "wrong")) == "BadUserAccessDenied"
        assert await bad(call_add(thief, hardened.nodes.methods["add"])) == "BadSecureChannelIdInvalid"
        thief.disconnect_socket()
        assert (await call_add(victim, hardened.nodes.methods["add"])).is_good()


async def test_tokens_cannot_be_guessed(hardened: Door, plain: Stock) -> None:
    """Stock asyncua counts its tokens from 1000; ours have 32 random bytes."""
    async with hardened.connected() as one, hardened.connected("olga") as two:
        tokens = [token_of(one).Identifier, token_of(two).Identifier]
    assert all(isinstance(token, bytes) and len(token) == 32 for token in tokens)
    assert len(set(tokens)) == 2
    async with plain.client() as first, plain.client() as second:
        assert 0 < token_of(second).Identifier - token_of(first).Identifier < 10


async def test_token_is_good_on_its_own_channel_only(hardened: Door) -> None:
    """Stock asyncua takes the session from the connection and never looks at the token of a request."""
    async with hardened.connected("oscar") as victim, hardened.connected("olga") as other:
        own = token_of(other)
        other.uaclient.session.restore_authentication_token(token_of(victim))
        assert await bad(call_add(other, hardened.nodes.methods["add"])) == "BadSecureChannelIdInvalid"
        other.uaclient.session.restore_authentication_token(ua.NodeId(1001))
        assert await bad(call_add(other, hardened.nodes.methods["add"])) == "BadSessionIdInvalid"
        other.uaclient.session.restore_authentication_token(own)


async def test_services_need_an_activated_session(hardened: Door) -> None:
    client = await hardened.client()
    await open_channel(client)
    await client.create_session()
    assert await bad(call_add(client, hardened.nodes.methods["add"])) == "BadSessionNotActivated"
    await client._cancel_task(client._renew_channel_task)
    client.disconnect_socket()


async def reattach(hardened: Door, old: Client, **options: Any) -> tuple[Client, str]:
    """Take a session along to a new connection."""
    client = await hardened.client(**options)
    await open_channel(client)
    client.uaclient.session.restore_authentication_token(token_of(old))
    client._server_nonce, client._policy_ids = old._server_nonce, old._policy_ids
    # Without security no channel brings it, and the password is encrypted for it all the same.
    client.security_policy.peer_certificate = old.security_policy.peer_certificate
    return client, await bad(client.activate_session(client._username, client._password))


class Changes:
    """Collects what a subscription tells."""

    def __init__(self) -> None:
        self.queue: asyncio.Queue[Any] = asyncio.Queue()

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        self.queue.put_nowait(value)


async def test_owner_takes_the_session_along_others_do_not(hardened: Door, identities: Identities) -> None:
    """Safe reattachment: the same certificate, signature and user, or nothing."""
    client = await hardened.client()
    await client.connect()
    await client.create_subscription(100, Changes())
    await lose(client)
    for options in (
        {"user": "oliver"},
        {"user": "oscar", "files": identities.other, "uri": "urn:test:other"},
        {"user": "oscar", "password": "wrong"},
    ):
        thief, refused = await reattach(hardened, client, **options)
        assert refused in {"BadIdentityChangeNotSupported", "BadSessionIdInvalid", "BadUserAccessDenied"}
        thief.disconnect_socket()
    owner, activated = await reattach(hardened, client)
    assert activated == "Good"
    assert (await call_add(owner, hardened.nodes.methods["add"])).is_good()
    await owner.uaclient.close_session(True)
    await lose(client)
    owner.disconnect_socket()


@pytest.mark.parametrize("policy", [None, BASIC256SHA256])
async def test_a_session_without_subscriptions_outlives_its_connection_too(
    tmp_path: Path, identities: Identities, policy: Any
) -> None:
    """It ended with it, and its client had to log in anew."""
    async with door(tmp_path, identities, allow_none_security=True) as one:
        client = await one.client(policy=policy)
        await client.connect()
        await lose(client)
        owner, activated = await reattach(one, client, policy=policy)
        assert activated == "Good"
        assert await owner.get_node(one.nodes.value).read_value() == 1.5
        assert (one.server.sessions, one.server.statistics.sessions) == (1, 1)
        assert one.server.statistics.session_aborts == 0
        await owner.uaclient.close_session(True)
        await lose(owner)


async def test_clients_that_were_killed_keep_nobody_out(tmp_path: Path, identities: Identities) -> None:
    """Neither their own user nor others; and none that waits for its subscriptions is lost for them."""
    limits = {"sessions": 4, "sessions_per_user": 3, "reserved_sessions": 1}
    async with door(tmp_path, identities, limits=limits) as one:
        waits = await one.client("olga")
        await waits.connect()
        await waits.create_subscription(100, Changes())
        await lose(waits)
        for user in ("olga", "oscar", "oscar", "oscar", "oliver", "eva", "olga", "oliver", "eva", "eva"):
            client = await one.client(user)
            await client.connect()
            await lose(client)
            assert one.server.sessions <= 4
        assert one.server.statistics.sessions_refused == one.server.statistics.sessions_evicted == 0
        assert one.server.statistics.session_aborts == 7
        owner, activated = await reattach(one, waits, user="olga")
        assert activated == "Good"
        await owner.uaclient.close_session(True)
        await lose(owner)


async def test_a_session_that_was_not_activated_ends_with_its_connection(hardened: Door) -> None:
    client = await hardened.client()
    await open_channel(client)
    await client.create_session()
    await lose(client)
    server: Any = hardened.server
    await until(lambda: not any(session.user is None for session in server._services.sessions), "its end")


async def test_a_removed_user_loses_sessions_without_connection(hardened: Door) -> None:
    hardened.users.add("petra", "password-1", hardened.users.list()[0].role)
    client = await hardened.client("petra", password="password-1")
    await client.connect()
    await lose(client)
    server: Any = hardened.server

    def of_petra() -> list[Any]:
        return [each for each in server._services.sessions if each.user is not None and each.user.name == "petra"]

    assert [each.link for each in of_petra()] == [None]
    hardened.users.remove("petra")
    await until(lambda: not of_petra(), "the end of her session")


async def test_a_detached_session_makes_room_for_its_users_next(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities, limits={"sessions_per_user": 2}) as one:
        left = await one.client()
        await left.connect()
        await left.create_subscription(100, Changes())
        await lose(left)
        server: Any = one.server
        await until(lambda: any(session.link is None for session in server._services.sessions))
        async with one.connected(), one.connected():
            assert one.server.sessions == 2
            third = await one.client()
            assert await bad(third.connect()) == "BadTooManySessions"
            async with one.connected("olga"):
                assert one.server.sessions == 3
        assert one.server.statistics.sessions_evicted == 1
        assert one.server.statistics.sessions_refused == 1
        (ended,) = [line for line in one.audit() if line["status"] == "BadSessionClosed"]
        assert (ended["event"], ended["user"]) == ("logout", "oscar")


async def test_client_signature_is_checked(hardened: Door) -> None:
    """A session cannot be activated without the key of the client's certificate."""
    client = await hardened.client()
    await open_channel(client)
    await client.create_session()
    client._server_nonce = b"x" * 32
    assert await bad(client.activate_session("oscar", "operate-1")) == "BadApplicationSignatureInvalid"
    await client._cancel_task(client._renew_channel_task)
    client.disconnect_socket()


async def test_no_session_without_security(hardened: Door) -> None:
    """Discovery needs no security, all else does; stock asyncua serves sessions on a channel it has no endpoint for."""
    client = await hardened.client("oscar", policy=None)
    endpoints = await client.connect_and_get_server_endpoints()
    assert {str(endpoint.SecurityMode.name) for endpoint in endpoints} == {"SignAndEncrypt"}
    assert len(endpoints) == 3
    assert {token.PolicyId for endpoint in endpoints for token in endpoint.UserIdentityTokens} == {"username"}
    assert len(await client.connect_and_find_servers()) == 1
    await open_channel(client)
    assert await bad(client.create_session()) == "BadSecurityModeInsufficient"
    client.disconnect_socket()


@pytest.mark.parametrize(
    ("user", "password"), [("admin", "anything"), ("Admin", ""), ("oscar", ""), ("oscar", "x" * 5000), ("", "")]
)
async def test_only_users_with_their_password(hardened: Door, user: str, password: str) -> None:
    """Stock asyncua lets `admin` in as administrator with any password."""
    client = await hardened.client(user, password=password)
    assert await bad(client.connect()) in {"BadUserAccessDenied", "BadIdentityTokenRejected"}


async def test_admin_with_any_password_stock(plain: Stock) -> None:
    async with plain.client("admin") as client:
        await client.nodes.objects.add_object(ua.NodeId("intruder", 2), "intruder")


async def test_anonymous_and_none_security_when_asked_for(
    tmp_path: Path, identities: Identities, capsys: pytest.CaptureFixture[str]
) -> None:
    """Asked for by name they are there, the server says so, and anonymous users only observe."""
    async with door(tmp_path, identities, allow_none_security=True, allow_anonymous=True) as lab:
        said = capsys.readouterr()
        assert "allow_none_security" in said.out + said.err
        assert "allow_anonymous" in said.out + said.err
        async with lab.connected(None, policy=None) as client:
            assert await client.get_node(lab.nodes.value).read_value() == 1.5
            assert await bad(client.get_node(lab.nodes.value).write_value(2.0)) == "BadUserAccessDenied"
            assert (await call_add(client, lab.nodes.methods["add"])).name == "BadUserAccessDenied"
        # Nobody takes another's session along by its token alone.
        async with lab.connected("oscar", policy=None) as owner:
            thief = await lab.client(None, policy=None)
            activation, call = await steal(thief, token_of(owner), lab.nodes.methods["add"])
            assert (activation, call) == ("BadIdentityTokenRejected", "BadSecureChannelIdInvalid")
            thief, activation = await reattach(lab, owner, user=None, policy=None)
            assert activation == "BadIdentityChangeNotSupported"
            thief.disconnect_socket()
            assert (await call_add(owner, lab.nodes.methods["add"])).is_good()


async def test_requests_on_the_old_channel_of_a_session_are_refused(hardened: Door) -> None:
    """They were forgotten, and a client that still listens there waited for them until its own limit."""
    client = await hardened.client()
    await open_channel(client)
    await client.create_session()
    await client.activate_session(client._username, client._password)
    request = ua.CreateSubscriptionRequest()
    request.Parameters = ua.CreateSubscriptionParameters(1000.0, 100, 100, 0, True, 0)
    await send(client, request, ua.CreateSubscriptionResponse)
    await send(client, ua.PublishRequest(), ua.PublishResponse)
    waiting = asyncio.create_task(bad(send(client, ua.PublishRequest(), ua.PublishResponse)))
    await asyncio.sleep(0.1)
    owner, activated = await reattach(hardened, client)
    assert activated == "Good"
    assert await waiting == "BadSecureChannelClosed"
    await owner.uaclient.close_session(True)
    await lose(client)
    owner.disconnect_socket()


@pytest.mark.parametrize("user", [None, "oscar"])
async def test_a_session_without_security_is_taken_along_too(
    tmp_path: Path, identities: Identities, user: str | None
) -> None:
    """The same user at the same address; the subscription goes on telling."""
    async with door(tmp_path, identities, allow_none_security=True, allow_anonymous=True) as lab:
        client = await lab.client(user, policy=None)
        await client.connect()
        await client.create_subscription(100, Changes())
        await lose(client)
        owner, activated = await reattach(lab, client, user=user, policy=None)
        assert activated == "Good"
        assert await owner.get_node(lab.nodes.value).read_value() == 1.5
        assert lab.server.sessions == 1
        await owner.uaclient.close_session(True)
        owner.disconnect_socket()


async def test_a_user_without_a_name_has_no_valid_token(hardened: Door) -> None:
    client = await hardened.client()
    await open_channel(client)
    await client.create_session()
    parameters = ua.ActivateSessionParameters()
    client._add_user_auth(parameters, "", "")
    challenge = client.security_policy.peer_certificate + client._server_nonce
    parameters.ClientSignature.Signature = client.security_policy.asymmetric_cryptography.signature(challenge)
    parameters.ClientSignature.Algorithm = client.security_policy.AsymmetricSignatureURI
    assert await bad(client.uaclient.activate_session(parameters)) == "BadIdentityTokenInvalid"
    await lose(client)


@pytest.mark.parametrize("subscribes", [True, False])
async def test_silent_session_ends_with_its_subscriptions(
    tmp_path: Path, identities: Identities, subscribes: bool
) -> None:
    """After a dropped connection a session waits for its client no longer than its timeout."""
    # Long enough for a busy machine to connect and subscribe.
    async with door(tmp_path, identities, limits={"session_timeout_s": (0.1, 1.0)}) as short:
        client = await short.client()
        await client.connect()
        if subscribes:
            await client.create_subscription(100, Changes())
        await lose(client)
        assert short.server.sessions == 1
        async with asyncio.timeout(60):
            while short.server.sessions:
                await asyncio.sleep(0.02)
        assert not short.server.iserver.subscription_service.subscriptions
        assert any(line["event"] == "logout" and line["status"] == "BadTimeout" for line in short.audit())


async def test_a_connection_whose_session_has_moved_keeps_no_place(tmp_path: Path, identities: Identities) -> None:
    """One session, taken from connection to connection, took all places: those left behind never gave way."""
    async with door(tmp_path, identities, limits={"handshake_s": 2.0}) as short:
        server: Any = short.server
        left = await short.client()
        await left.connect()
        owner, activated = await reattach(short, left)
        assert activated == "Good"
        await until(lambda: len(server._listener._connections) == 1, "the end of the connection without a session")
        assert (await call_add(owner, short.nodes.methods["add"])).is_good()
        await owner.uaclient.close_session(True)
        await lose(left)
        await lose(owner)


async def test_a_connection_whose_session_timed_out_keeps_no_place(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities, limits={"handshake_s": 2.0, "session_timeout_s": (1.0, 1.0)}) as short:
        server: Any = short.server
        client = await short.client()
        await client.connect()
        await client._cancel_task(client._stale_watchdog_task)
        await client._cancel_task(client._supervisor_task)
        await until(lambda: not server._listener._connections, "the end of the connection without a session")
        await lose(client)


async def test_whoever_is_cancelled_while_a_subscription_ends_is_cancelled(hardened: Door) -> None:
    """The server's housekeeping may be: it would go on for ever, and the server not stop."""
    client = await hardened.client()
    await client.connect()
    await client.create_subscription(100, Changes())
    (subscription,) = hardened.server.iserver.subscription_service.subscriptions.values()

    async def keep_house() -> None:
        await subscription.stop()
        await asyncio.sleep(60)

    keeping = asyncio.create_task(keep_house())
    await asyncio.sleep(0)
    keeping.cancel()
    async with asyncio.timeout(60):
        await asyncio.wait([keeping])
    assert keeping.cancelled()
    await lose(client)


async def test_removed_user_loses_the_session(hardened: Door) -> None:
    """A user who is removed, or whose role changes, is so at once."""
    hardened.users.add("paul", "password-1", hardened.users.list()[0].role)
    client = await hardened.client("paul", password="password-1")
    await client.connect()
    hardened.users.remove("paul")
    for _ in range(100):
        if await bad(client.get_node(hardened.nodes.value).read_value()) == "BadSessionIdInvalid":
            break
        await asyncio.sleep(0.02)
    assert await bad(client.get_node(hardened.nodes.value).read_value()) == "BadSessionIdInvalid"
    await lose(client)


@pytest.mark.parametrize(
    "name", ["RegisterServer", "RegisterServer2", "AddNodes", "DeleteNodes", "AddReferences", "DeleteReferences"]
)
async def test_management_services_are_not_there(hardened: Door, name: str) -> None:
    """Stock asyncua registers servers for anybody, without a session, and FindServers then tells of them."""
    anybody = await hardened.client(None, policy=None)
    await open_channel(anybody)
    request = getattr(ua, f"{name}Request")()
    response = getattr(ua, f"{name}Response")
    assert await bad(send(anybody, request, response)) == "BadServiceUnsupported"
    anybody.disconnect_socket()
    async with hardened.connected("eva") as engineer:
        assert await bad(send(engineer, request, response)) == "BadServiceUnsupported"
        assert len(await engineer.find_servers()) == 1


async def test_register_server_stock(plain: Stock) -> None:
    client = plain.client()
    await open_channel(client)
    request = ua.RegisterServerRequest()
    request.Server.ServerUri = "urn:evil"
    request.Server.ServerNames = [ua.LocalizedText("evil")]
    request.Server.DiscoveryUrls = ["opc.tcp://evil:4840"]
    await send(client, request, ua.RegisterServerResponse)
    assert len(await client.find_servers()) == 2
    client.disconnect_socket()


async def test_nothing_is_left_when_the_server_stops(tmp_path: Path, identities: Identities) -> None:
    """Connected clients, subscriptions and half-open connections end with the server, without waiting for them."""
    before = asyncio.all_tasks()
    async with door(tmp_path, identities) as server:
        client = await server.client()
        await client.connect()
        await client.create_subscription(100, Changes())
        half_open = await server.client()
        await open_channel(half_open)
        own = {task.get_name() for task in asyncio.all_tasks() - before}
        assert {"housekeeping"} < own
    await lose(client)
    half_open.disconnect_socket()
    await client._cancel_task(client.uaclient.session._publish_task)
    names = {task.get_name().split()[0] for task in asyncio.all_tasks() - before}
    assert not names & {"housekeeping", "connection", "subscription"}
    assert not server.server.iserver.subscription_service.subscriptions
    assert server.server.sessions == 0


async def test_a_part_that_fails_when_somebody_departs_costs_the_others_nothing(
    tmp_path: Path, identities: Identities
) -> None:
    async with door(tmp_path, identities) as running:
        server: Any = running.server
        context, told = server.context, list[str]()

        def fail(_session: str) -> None:
            raise OSError("a mistake of ours")

        context.departed += [fail, told.append]
        client = await running.client("oscar")
        await client.connect()
        await client.disconnect()
        await until(lambda: told)
        assert context.mistakes.counts["departures"] >= 1
        assert not server._services.sessions.holders()
