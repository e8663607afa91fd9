"""What OPC 10000-4 and 10000-6 say of channels and sessions, asked through asyncua's client."""

from __future__ import annotations

import time
from typing import Any

import pytest
from asyncua.crypto import security_policies

from tests.integration.server_security.harness import Client, Door, bad, lose, send, ua
from tests.integration.server_security.test_limits import create_subscription, monitored
from tests.integration.server_security.test_sessions import open_channel
from tests.integration.server_security.test_subscriptions import create_items, publish, values

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def read_plain(client: Client, hardened: Door) -> Any:
    return await client.get_node(hardened.nodes.plain).read_value()


async def leave(client: Client) -> None:
    """Drop a connection that has no session to close."""
    await client._cancel_task(client._renew_channel_task)
    client.disconnect_socket()


async def test_two_renewals_in_a_row_have_two_tokens(hardened: Door) -> None:
    """asyncua counts from the token in use, so that both get the same id."""
    async with hardened.connected() as client:
        protocol: Any = client.uaclient.protocol
        protocol.revolve_security_token = lambda: None  # only when this test says so
        connection = protocol._connection
        issued = connection.security_token.TokenId
        await client.open_secure_channel(renew=True)
        first = connection.next_security_token.TokenId
        connection.revolve_tokens()
        await client.open_secure_channel(renew=True)
        second = connection.next_security_token.TokenId
        assert len({issued, first, second}) == 3
        assert await read_plain(client, hardened) == 7.0  # under the first, while the second waits
        connection.revolve_tokens()
        assert await read_plain(client, hardened) == 7.0


async def test_renewals_that_are_never_used_are_forgotten(hardened: Door) -> None:
    async with hardened.connected() as client:
        for _ in range(10):
            await client.open_secure_channel(renew=True)
        assert await read_plain(client, hardened) == 7.0


@pytest.mark.parametrize("limit", ["max_chunkcount", "max_messagesize"])
async def test_responses_are_as_large_as_the_client_takes(hardened: Door, limit: str) -> None:
    """Stock asyncua sends whatever it has."""
    client = await hardened.client()
    setattr(client, limit, 1 if limit == "max_chunkcount" else 65_000)
    await client.connect()
    text = client.get_node(hardened.nodes.text)
    server_side = hardened.server.get_node(hardened.nodes.text)
    await server_side.write_value("x" * 60_000)
    assert len(await text.read_value()) == 60_000
    await server_side.write_value("x" * 70_000)
    assert await bad(text.read_value()) == "BadResponseTooLarge"
    # What does not fit is told by its StatusCode; the subscription, and its other values, go on.
    subscription = (await create_subscription(client)).SubscriptionId
    await create_items(client, subscription, monitored(hardened.nodes.text), monitored(hardened.nodes.plain))
    told = await publish(client)
    seen = [item.Value for data in told.NotificationMessage.NotificationData for item in data.MonitoredItems]
    while len(seen) < 2:
        told = await publish(client)
        seen += [item.Value for data in told.NotificationMessage.NotificationData for item in data.MonitoredItems]
    assert [value.StatusCode.name for value in seen] == ["BadEncodingLimitsExceeded", "Good"]
    await server_side.write_value("abcdef")
    assert values(await publish(client)) == ["abcdef"]
    await client.disconnect()


async def test_notification_messages_are_as_large_as_a_session_asks_for(hardened: Door) -> None:
    """Other responses are as large as Hello allows: node-opcua asks for 800,000 bytes at most, and takes 64 MiB."""
    client = await hardened.client()
    create: Any = client.uaclient.create_session

    async def with_limit(parameters: Any) -> Any:
        parameters.MaxResponseMessageSize = 20_000
        return await create(parameters)

    client.uaclient.create_session = with_limit
    await client.connect()
    server_side = hardened.server.get_node(hardened.nodes.text)
    await server_side.write_value("x" * 30_000)
    assert len(await client.get_node(hardened.nodes.text).read_value()) == 30_000
    await server_side.write_value("x" * 7_000)
    subscription = (await create_subscription(client)).SubscriptionId
    await create_items(client, subscription, *[monitored(hardened.nodes.text) for _ in range(4)])
    told = [len(values(await publish(client))) for _ in range(2)]
    assert told == [2, 2]
    await server_side.write_value("abcdef")
    await client.disconnect()


async def test_a_session_that_is_used_before_its_activation_is_closed(hardened: Door) -> None:
    """OPC 10000-4 5.7.3.1. Stock asyncua keeps it."""
    client = await hardened.client()
    await open_channel(client)
    await client.create_session()
    assert await bad(read_plain(client, hardened)) == "BadSessionNotActivated"
    assert await bad(client.activate_session(client._username, client._password)) == "BadSessionIdInvalid"
    await leave(client)


async def test_a_channel_has_several_sessions(hardened: Door) -> None:
    """OPC 10000-4 5.7.2.1: a second CreateSession leaves the first as it is, activated or not."""
    client = await hardened.client()
    await open_channel(client)
    await client.create_session()
    session = client.uaclient.session
    token, nonce = session.authentication_token, client._server_nonce
    await client.create_session()
    second, second_nonce = session.authentication_token, client._server_nonce
    session.restore_authentication_token(token)
    client._server_nonce = nonce
    await client.activate_session(client._username, client._password)
    assert await read_plain(client, hardened) == 7.0
    session.restore_authentication_token(second)
    client._server_nonce = second_nonce
    await client.activate_session(client._username, client._password)
    assert await read_plain(client, hardened) == 7.0
    session.restore_authentication_token(token)
    assert await read_plain(client, hardened) == 7.0
    for each in (token, second):
        session.restore_authentication_token(each)
        await send(client, ua.CloseSessionRequest(), ua.CloseSessionResponse)
    await leave(client)


async def test_sessions_that_wait_on_one_connection_are_bounded(hardened: Door) -> None:
    client = await hardened.client()
    await open_channel(client)
    await client.create_session()
    session = client.uaclient.session
    token, nonce = session.authentication_token, client._server_nonce
    server: Any = hardened.server
    before = len(server._services.sessions)
    for _ in range(60):
        await client.create_session()
    assert len(server._services.sessions) == before + 49
    session.restore_authentication_token(token)
    client._server_nonce = nonce
    assert await bad(client.activate_session(client._username, client._password)) == "BadSessionIdInvalid"
    await leave(client)


async def refused_opening(client: Client, hardened: Door, *, renew: bool) -> list[str]:
    """The StatusCodes that the audit log has when the client names another certificate as ours."""
    policy: Any = client.security_policy
    seen = len(hardened.audit())
    asked = client.open_secure_channel(renew=True) if renew else client.connect_sessionless()
    assert await bad(asked) in ("BadCertificateInvalid", "closed"), policy.peer_certificate
    return [line["status"] for line in hardened.audit()[seen:] if line.get("what") == "message"]


@pytest.mark.parametrize("named", [b"another certificate", b""])
async def test_a_channel_is_opened_only_for_our_own_certificate(hardened: Door, named: bytes) -> None:
    """OPC 10000-6 6.7.6: the ReceiverCertificateThumbprint is verified, also where our key was used."""
    client = await hardened.client()
    client.security_policy.peer_certificate = named
    assert await refused_opening(client, hardened, renew=False) == ["BadCertificateInvalid"]


async def test_a_channel_is_renewed_only_for_our_own_certificate(hardened: Door) -> None:
    client = await hardened.client()
    await client.connect_sessionless()
    client.security_policy.peer_certificate = b"another certificate"
    assert await refused_opening(client, hardened, renew=True) == ["BadCertificateInvalid"]
    await leave(client)


def messages_refused(hardened: Door, seen: int) -> list[str]:
    """The StatusCodes of the frames that were refused since the audit log had so many lines."""
    return [line["status"] for line in hardened.audit()[seen:] if line.get("what") == "message"]


async def assert_signature_refused(client: Any, hardened: Door) -> None:
    """The next message of a client is refused for its signature, as its own mistake."""
    seen = len(hardened.audit())
    assert await bad(read_plain(client, hardened)) in ("BadSecurityChecksFailed", "closed")
    assert messages_refused(hardened, seen) == ["BadSecurityChecksFailed"]
    assert not hardened.server.context.mistakes.text()
    await lose(client)


async def test_a_new_token_is_not_taken_under_the_keys_of_the_one_before(hardened: Door) -> None:
    """asyncua tries the keys before where a signature is wrong, for as long as they would have lasted."""
    client = await hardened.client()
    await client.connect()
    protocol: Any = client.uaclient.protocol
    protocol.revolve_security_token = lambda: None
    connection = protocol._connection
    keys: Any = connection.security_policy.symmetric_cryptography
    before = keys.Signer, keys.Encryptor
    await client.open_secure_channel(renew=True)
    assert await read_plain(client, hardened) == 7.0  # the response was still under way
    connection.revolve_tokens()
    assert await read_plain(client, hardened) == 7.0
    keys.Signer, keys.Encryptor = before
    await assert_signature_refused(client, hardened)


async def test_a_message_with_a_wrong_signature_is_the_clients_mistake(hardened: Door) -> None:
    client = await hardened.client()
    await client.connect()
    protocol: Any = client.uaclient.protocol
    crypto: Any = security_policies
    protocol._connection.security_policy.symmetric_cryptography.Signer = crypto.SignerHMac256(bytes(32))
    await assert_signature_refused(client, hardened)


async def test_a_channel_is_renewed_only_under_its_own_id(hardened: Door) -> None:
    """OPC 10000-6 6.7.2: an id that is not the channel's is an error."""
    client = await hardened.client()
    await client.connect_sessionless()
    protocol: Any = client.uaclient.protocol
    token = protocol._connection.security_token
    token.ChannelId += 12_345
    seen = len(hardened.audit())
    assert await bad(client.open_secure_channel(renew=True)) in ("BadTcpSecureChannelUnknown", "closed")
    assert messages_refused(hardened, seen) == ["BadTcpSecureChannelUnknown"]
    await leave(client)


class Later:
    """The time of the server, some seconds ahead."""

    def __init__(self) -> None:
        self.ahead_s = 0.0

    def monotonic(self) -> float:
        return time.monotonic() + self.ahead_s


@pytest.fixture
def later(monkeypatch: pytest.MonkeyPatch) -> Later:
    """The clock of tokens, not the one of the connections that they belong to."""
    clock = Later()
    for module in ("channel", "secure_connection"):
        monkeypatch.setattr(f"ua_fleet.endpoint.{module}.time", clock)
    return clock


@pytest.mark.parametrize("number", [1, 3])
async def test_a_token_expires_though_its_client_renews(hardened: Door, later: Later, number: int) -> None:
    """It is good for a quarter of its lifetime more (OPC 10000-4 5.5.2.1), whatever other tokens there are."""
    client = await hardened.client()
    client.secure_channel_timeout = 60_000
    await client.connect()
    await client._cancel_task(client._renew_channel_task)
    protocol: Any = client.uaclient.protocol
    protocol.revolve_security_token = lambda: None
    later.ahead_s = 74.0
    for _ in range(number):
        await client.open_secure_channel(renew=True)
    assert await read_plain(client, hardened) == 7.0
    later.ahead_s = 76.0
    await client.open_secure_channel(renew=True)
    seen = len(hardened.audit())
    assert await bad(read_plain(client, hardened)) in ("BadSecureChannelTokenUnknown", "closed")
    assert messages_refused(hardened, seen) == ["BadSecureChannelTokenUnknown"]
    await lose(client)


async def test_a_client_that_renews_and_says_nothing_goes_on_under_its_last_token(hardened: Door, later: Later) -> None:
    client = await hardened.client()
    client.secure_channel_timeout = 60_000
    await client.connect()
    await client._cancel_task(client._renew_channel_task)
    protocol: Any = client.uaclient.protocol
    protocol.revolve_security_token = lambda: None
    for _ in range(10):
        later.ahead_s += 45.0
        await client.open_secure_channel(renew=True)
    protocol._connection.revolve_tokens()
    assert await read_plain(client, hardened) == 7.0
    later.ahead_s += 76.0
    assert await bad(read_plain(client, hardened)) in ("BadSecureChannelTokenUnknown", "closed")
    await lose(client)
