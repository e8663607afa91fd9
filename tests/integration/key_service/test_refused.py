"""Who gets no keys, and how each attempt ends."""

from __future__ import annotations

import asyncio
import importlib
from pathlib import Path
from typing import Any

import pytest
from asyncua.crypto import uacrypto

from tests.integration.key_service.harness import (
    AES256,
    BASIC256SHA256,
    GET_GROUP,
    GET_KEYS,
    INVALIDATE,
    PUBLISH_SUBSCRIBE,
    ROTATE,
    Cards,
    Client,
    Desk,
    call,
    desk,
    get_keys,
    name,
    string,
    ua,
)
from tests.integration.server_security.harness import bad
from tests.waiting import until
from ua_fleet.endpoint.call_limit import LEAST_BURST
from ua_fleet.endpoint.certificates import CertificateFiles, revoke_bridge, trust, trust_bridge
from ua_fleet.endpoint.throttle import FREE_FAILURES, LoginThrottle

sign_asymmetric: Any = importlib.import_module("asyncua.crypto.security_policies").sign_asymmetric

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest.mark.parametrize("user", ["olga", "oscar", "eva"])
async def test_people_get_no_keys(running: Desk, user: str) -> None:
    """Not even an engineer, and not from a bridge's own machine either."""
    for card in ("visitor", "arm"):
        async with running.connected(card=card, user=user) as client:
            assert name(await get_keys(client, "t-0")) == "BadUserAccessDenied"
            executable = client.get_node(GET_KEYS).read_attribute(ua.AttributeIds.UserExecutable)
            assert (await executable).Value.Value is False


@pytest.mark.parametrize(("user", "card"), [("olga", "visitor"), ("oscar", "visitor"), (None, "arm")])
async def test_who_is_no_engineer_changes_no_keys(running: Desk, user: str | None, card: str) -> None:
    before = running.service.keys_for_space(0, "t-1", 0, 5)
    async with running.connected(card=card, user=user) as client:
        for method in (INVALIDATE, ROTATE):
            assert name(await call(client, running.group("t-1"), method)) == "BadUserAccessDenied"
        if user is not None:
            assert name(await call(client, PUBLISH_SUBSCRIBE, GET_GROUP, string("t-0"))) == "BadUserAccessDenied"
    assert running.service.keys_for_space(0, "t-1", 0, 5).keys == before.keys


@pytest.mark.parametrize(("bridge", "foreign"), [("arm", "c-300"), ("rover", "c-1"), ("plc", "c-2")])
async def test_a_bridge_gets_no_keys_to_command_others(running: Desk, bridge: str, foreign: str) -> None:
    async with running.connected(card=bridge) as client:
        assert name(await get_keys(client, foreign)) == "BadUserAccessDenied"
        assert name(await get_keys(client, "t-0")) == "Good"


async def test_a_bridge_may_do_nothing_else(running: Desk) -> None:
    async with running.connected(card="arm") as client:
        group = client.get_node(running.group("t-1") + ".KeyLifetime")
        assert await group.read_value() == 3_600_000.0
        assert await bad(group.write_value(1.0)) == "BadNotWritable"
        assert await bad(client.get_node("ns=2;s=goal").write_value(1.0)) == "BadUserAccessDenied"
        assert name(await call(client, "i=85", "ns=2;s=act")) == "BadUserAccessDenied"
        executable = client.get_node(GET_KEYS).read_attribute(ua.AttributeIds.UserExecutable)
        assert (await executable).Value.Value is True


async def test_a_certificate_that_is_trusted_and_no_bridges(running: Desk) -> None:
    client = await running.client(card="visitor")
    assert await bad(client.connect()) == "BadIdentityTokenRejected"
    last = [line for line in running.audit() if line["event"] == "refusal"][-1]
    assert last["what"] == "ActivateSession"
    remedy = "bind it with: ua-fleet cert trust --bridge NAME "
    assert remedy in last["reason"]
    # What it says to do can be done.
    info = trust_bridge(running.state_dir, "visiting", last["reason"].partition(remedy)[2])
    assert info.bridge == "visiting"
    paths = (running.state_dir / "certificates").rglob(f"{info.thumbprint}.der")
    assert list(paths) == []
    revoke_bridge(running.state_dir, "visiting")
    trust(running.state_dir, info.thumbprint)


async def test_a_certificate_that_nobody_knows(running: Desk) -> None:
    client = await running.client(card="stranger")
    assert await bad(client.connect()) == "BadSecurityChecksFailed"


async def test_a_bridge_that_the_configuration_does_not_name(tmp_path: Path, cards: Cards) -> None:
    async with desk(tmp_path, cards) as made:
        trust_bridge(made.state_dir, "gone", cards.get("gone").certificate)
        client = await made.client(card="gone")
        assert await bad(client.connect()) == "BadIdentityTokenRejected"


async def test_a_stolen_certificate_opens_no_channel(running: Desk, cards: Cards, tmp_path: Path) -> None:
    """The thief has the certificate, which is public, and not the key."""
    thief = cards.get("visitor")
    stolen = CertificateFiles(cards.get("arm").certificate, thief.private_key)
    client = await running.client(card="arm", policy=None)
    server = running.state_dir / "certificates" / "own" / "server.der"
    await client.set_security(BASIC256SHA256, stolen.certificate, stolen.private_key, server_certificate=str(server))
    assert await bad(client.connect()) in ("BadSecurityChecksFailed", "closed")


async def activate(running: Desk, client: Client, **changes: Any) -> tuple[str, Any]:
    """Activate a session with a token that is changed in some way; the status, and the token's signature."""
    await client.connect_sessionless()
    await client.create_session()
    params = ua.ActivateSessionParameters()
    policy = client.security_policy
    challenge = (policy.peer_certificate or b"") + client._server_nonce
    if policy.AsymmetricSignatureURI:
        params.ClientSignature.Algorithm = policy.AsymmetricSignatureURI
        params.ClientSignature.Signature = policy.asymmetric_cryptography.signature(challenge)
    files = changes.get("files") or running.cards.get("arm")
    key = await uacrypto.load_private_key(changes.get("key") or files.private_key)
    token = ua.X509IdentityToken()
    token.PolicyId = changes.get("policy_id", "certificate")
    token.CertificateData = changes.get("certificate", files.certificate.read_bytes())
    uri = changes.get("algorithm_of", BASIC256SHA256).URI
    signature, algorithm = sign_asymmetric(key, changes.get("challenge", challenge), uri)
    params.UserIdentityToken = token
    params.UserTokenSignature.Algorithm = changes.get("algorithm", algorithm)
    params.UserTokenSignature.Signature = changes.get("signature", signature)
    result = await bad(client.uaclient.activate_session(params))
    await client._cancel_task(client._renew_channel_task)
    await client.uaclient.close_session(True)
    client.disconnect_socket()
    return result, params.UserTokenSignature.Signature


async def test_a_stolen_certificate_is_no_token_on_another_channel(running: Desk, cards: Cards) -> None:
    visitor = cards.get("visitor")
    stolen = cards.get("arm").certificate.read_bytes()
    for changes in ({"certificate": stolen, "files": visitor}, {"files": cards.get("arm")}):
        client = await running.client(card="visitor")
        result, _ = await activate(running, client, **changes)
        assert result == "BadIdentityTokenRejected"


async def test_a_token_is_good_once(running: Desk) -> None:
    result, seen = await activate(running, await running.client(card="arm"))
    assert result == "Good"
    result, _ = await activate(running, await running.client(card="arm"), signature=seen)
    assert result == "BadUserSignatureInvalid"


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({"challenge": b"another session's"}, "BadUserSignatureInvalid"),
        ({"algorithm": ""}, "BadUserSignatureInvalid"),
        ({"algorithm": "http://www.w3.org/2000/09/xmldsig#rsa-sha1"}, "BadUserSignatureInvalid"),
        ({"algorithm_of": AES256}, "BadUserSignatureInvalid"),
        ({"signature": b""}, "BadUserSignatureInvalid"),
        ({"signature": None}, "BadUserSignatureInvalid"),
        ({"signature": b"\x00" * 10_000}, "BadUserSignatureInvalid"),
        ({"policy_id": "username"}, "BadIdentityTokenInvalid"),
        ({"policy_id": None}, "BadIdentityTokenInvalid"),
        ({"certificate": b""}, "BadIdentityTokenRejected"),
        ({"certificate": None}, "BadIdentityTokenRejected"),
        ({"certificate": b"\x30" * 60_000}, "BadIdentityTokenRejected"),
    ],
)
async def test_tokens_that_prove_nothing(running: Desk, changes: dict[str, Any], status: str) -> None:
    running.server.context.throttle = LoginThrottle()
    logins = running.server.statistics.logins
    result, _ = await activate(running, await running.client(card="arm"), **changes)
    assert result == status
    assert running.server.statistics.logins == logins
    async with running.connected(card="arm") as client:
        assert name(await get_keys(client, "t-0")) == "Good"


async def test_wrong_signatures_are_slowed_down(tmp_path: Path, cards: Cards) -> None:
    async with desk(tmp_path, cards) as made:
        for _ in range(FREE_FAILURES):
            result, _ = await activate(made, await made.client(card="arm"), challenge=b"wrong")
            assert result == "BadUserSignatureInvalid"
        result, _ = await activate(made, await made.client(card="arm"))
        assert result == "BadUserAccessDenied"
        async with made.connected(card="rover") as client:
            assert name(await get_keys(client, "t-0")) == "Good"


async def test_keys_leave_the_server_encrypted_only(tmp_path: Path, cards: Cards) -> None:
    """On a channel that is only signed, or not even that, GetSecurityKeys says so whoever asks."""
    async with desk(
        tmp_path,
        cards,
        policies=[ua.SecurityPolicyType.Basic256Sha256_Sign, ua.SecurityPolicyType.NoSecurity],
        allow_none_security=True,
    ) as made:
        async with made.connected(card="arm", mode=ua.MessageSecurityMode.Sign) as client:
            assert name(await get_keys(client, "t-0")) == "BadSecurityModeInsufficient"
            result = await call(client, PUBLISH_SUBSCRIBE, GET_GROUP, string("t-0"))
            assert name(result) == "BadSecurityModeInsufficient"
        async with made.connected(card="visitor", user="eva", policy=None) as client:
            assert name(await get_keys(client, "t-0")) == "BadSecurityModeInsufficient"
            assert name(await call(client, made.group("t-0"), INVALIDATE)) == "BadSecurityModeInsufficient"
        client = await made.client(card="arm", policy=None)
        result, _ = await activate(made, client)
        assert result == "BadIdentityTokenRejected"
    assert made.service.keys_for_space(0, "t-0", 0, 1).first_token_id == 1


async def test_a_revoked_bridge_is_out_at_once(tmp_path: Path, cards: Cards) -> None:
    async with desk(tmp_path, cards) as made:
        async with made.connected(card="rover") as other:
            client = await made.client(card="arm")
            await client.connect()
            assert name(await get_keys(client, "t-0")) == "Good"
            revoke_bridge(made.state_dir, "arm")
            async with asyncio.timeout(60):
                while await bad(get_keys(client, "t-0")) == "Good":
                    await asyncio.sleep(0.02)
            assert await bad(get_keys(client, "t-0")) == "BadSessionIdInvalid"
            client.disconnect_socket()
            await client._cancel_task(client._renew_channel_task)
            again = await made.client(card="arm")
            assert await bad(again.connect()) == "BadSecurityChecksFailed"
            assert name(await get_keys(other, "t-0")) == "Good"
        assert any(line.get("reason") == "bridge revoked" for line in made.audit())
        trust_bridge(made.state_dir, "arm", cards.get("arm").certificate)
        async with made.connected(card="arm") as client:
            assert name(await get_keys(client, "t-0")) == "Good"


async def test_a_bridge_with_a_new_certificate_is_not_known_by_the_old_one(tmp_path: Path, cards: Cards) -> None:
    async with desk(tmp_path, cards) as made:
        trust_bridge(made.state_dir, "arm", cards.get("new-arm").certificate)
        client = await made.client(card="arm")
        assert await bad(client.connect()) == "BadSecurityChecksFailed"
        async with made.connected(card="new-arm") as client:
            assert name(await get_keys(client, "c-1")) == "Good"


async def test_who_asks_without_end_is_slowed_down_and_fills_no_log(
    tmp_path: Path, cards: Cards, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ua_fleet.endpoint.audit.allowance.SUM_EACH_S", 0.2)
    async with desk(tmp_path, cards) as made:
        async with made.connected(card="arm") as client:
            results = [name(await get_keys(client, "t-0", 0, 1)) for _ in range(4 * LEAST_BURST)]
        assert results[:LEAST_BURST] == ["Good"] * LEAST_BURST
        assert results.count("BadServerTooBusy") > LEAST_BURST
        lines = [line for line in made.audit() if line.get("method") == GET_KEYS]
        assert len(lines) < 3 * LEAST_BURST
        await until(lambda: any(line["event"] == "omitted" for line in made.audit()), "the sum of what was left out")
        sums = [line["of"] for line in made.audit() if line["event"] == "omitted"]
        busy = sum(count for of in sums for kind, count in of.items() if "BadServerTooBusy" in kind)
        told = [line["event"] for line in lines if line["status"] == "BadServerTooBusy"]
        assert set(told) <= {"refusal"}
        assert 0 < len(told) + busy <= results.count("BadServerTooBusy"), sums
        async with made.connected(card="rover") as client:
            assert name(await get_keys(client, "t-0")) == "Good"


async def test_without_bridges_there_is_no_login_by_certificate(tmp_path: Path, cards: Cards) -> None:
    from ua_fleet.config.schema import FleetConfig

    config = FleetConfig.model_validate({"version": 1, "pubsub": {"security": "sign"}})
    async with desk(tmp_path, cards, config=config) as made:
        client = await made.client(card="arm", certificate_login=False)
        offers = await client.connect_and_get_server_endpoints()
        kinds = {policy.TokenType for offer in offers for policy in offer.UserIdentityTokens}
        assert kinds == {ua.UserTokenType.UserName}
        result, _ = await activate(made, await made.client(card="arm"))
        assert result == "BadIdentityTokenRejected"
