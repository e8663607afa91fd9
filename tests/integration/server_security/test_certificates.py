"""Which clients may open a channel at all."""

from __future__ import annotations

import gc
import hashlib
import time
from pathlib import Path
from typing import Any

import pytest
from asyncua.crypto import security_policies

from tests.integration.server_security.harness import CLIENT_URI, Door, Identities, Raw, bad, door, load, ua
from ua_fleet.endpoint.certificates import CertificateState, list_certificates, own_files, thumbprint, trust
from ua_fleet.endpoint.channel import Channel

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def connects(hardened: Door, name: str, uri: str = CLIENT_URI, **options: Any) -> str:
    """StatusCode with which a client with that certificate connects."""
    client = await hardened.client(files=hardened.identities.get(name, **options), uri=uri)
    result = await bad(client.connect())
    if result == "Good":
        await client.disconnect()
    return result


@pytest.fixture
def slow_collection(monkeypatch: pytest.MonkeyPatch) -> None:
    """Garbage is collected while a message is read, and takes 0.3 s of computing, as in a process with many objects."""
    receive, computed, collected = Channel.receive, time.thread_time, [0.0]
    monkeypatch.setattr(time, "thread_time", lambda: computed() + sum(collected))

    def collecting(phase: str, _info: dict[str, Any]) -> None:
        collected.append(0.3 if phase == "start" else 0.0)

    def receive_and_collect(channel: Channel, frame: bytes) -> Any:
        gc.callbacks.append(collecting)
        gc.collect(0)
        gc.callbacks.remove(collecting)
        return receive(channel, frame)

    monkeypatch.setattr(Channel, "receive", receive_and_collect)


def rejected(hardened: Door) -> list[str]:
    return [
        info.thumbprint for info in list_certificates(hardened.state_dir) if info.state is CertificateState.REJECTED
    ]


async def test_unknown_certificates_wait_to_be_trusted(hardened: Door) -> None:
    """Stock asyncua accepts any; with a validator it looks in CreateSession only. Here the channel is not opened."""
    assert await connects(hardened, "stranger") == "BadSecurityChecksFailed"
    mark = thumbprint(load(hardened.identities.get("stranger"))[0])
    assert rejected(hardened) == [mark]
    line = next(line for line in hardened.audit() if line.get("what") == "certificate")
    assert line["status"] == "BadCertificateUntrusted"
    assert f"ua-fleet cert trust {mark[:12]}" in line["reason"]
    assert hardened.server.statistics.sessions == 0
    trust(hardened.state_dir, mark[:8])
    assert rejected(hardened) == []
    assert await connects(hardened, "stranger") == "Good"


@pytest.mark.parametrize(
    ("name", "options", "status"),
    [
        ("expired", {"days": (-30, -1)}, "BadCertificateTimeInvalid"),
        ("early", {"days": (1, 30)}, "BadCertificateTimeInvalid"),
        ("short", {"bits": 1024}, "BadCertificatePolicyCheckFailed"),
        ("serveronly", {"client": False}, "BadCertificateUseNotAllowed"),
    ],
)
async def test_unsound_certificates_are_refused_though_trusted(
    hardened: Door, name: str, options: dict[str, Any], status: str
) -> None:
    """Stock asyncua's default checks know neither key length, nor use, and are not made before CreateSession."""
    files = hardened.identities.get(name, **options)
    trust(hardened.state_dir, files.certificate)
    assert await connects(hardened, name) == "BadSecurityChecksFailed"
    assert [line for line in hardened.audit() if line.get("what") == "certificate"][-1]["status"] == status


@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        (bytes.fromhex("2a864886f70d010101"), bytes.fromhex("2a864886f70d01017f")),  # the algorithm of its key
        (bytes.fromhex("a003020102"), bytes.fromhex("a003020105")),  # its version
    ],
)
async def test_a_certificate_that_cannot_be_read_is_the_strangers_mistake(
    hardened: Door, was: bytes, becomes: bytes
) -> None:
    certificate = hardened.identities.client.certificate.read_bytes()
    assert certificate.count(was) == 1
    own = hashlib.sha1(own_files(hardened.state_dir).certificate.read_bytes(), usedforsecurity=False).digest()
    parts = security_policies.SecurityPolicyBasic256Sha256.URI.encode(), certificate.replace(was, becomes), own
    body = bytes(4) + b"".join(len(part).to_bytes(4, "little") + part for part in parts) + bytes(256)
    async with Raw.open(hardened.server.port) as raw:
        raw.hello()
        await raw.answer()
        raw.write(b"OPNF" + (8 + len(body)).to_bytes(4, "little") + body)
        answer = await raw.answer()
    assert (answer[:4], answer[8:12].hex()) == (b"ERRF", "00001380")
    assert [line for line in hardened.audit() if line.get("what") == "certificate"][-1]["status"] == (
        "BadCertificateInvalid"
    )
    assert not hardened.server.context.mistakes.text()


@pytest.mark.usefixtures("slow_collection")
async def test_no_client_is_charged_for_the_collection_of_garbage(tmp_path: Path, identities: Identities) -> None:
    """It takes seconds in a large process; an address that owed for it was served no more for 20 s."""
    async with door(tmp_path, identities) as lab:
        for _ in range(3):
            assert await connects(lab, "stranger") == "BadSecurityChecksFailed"
        assert await connects(lab, "client") == "Good"


async def test_certificate_of_another_application(hardened: Door) -> None:
    """The ApplicationUri of the session is that of the certificate."""
    assert await connects(hardened, "client", uri="urn:test:somebody-else") == "BadCertificateUriInvalid"


async def test_certificates_of_a_trusted_authority(hardened: Door) -> None:
    """A CA in trusted/ covers what it has signed; a CA of the same name does not."""
    authority = hardened.identities.get("authority", ca=True)
    trust(hardened.state_dir, authority.certificate)
    assert await connects(hardened, "employee", issuer=load(authority)) == "Good"
    impostor = hardened.identities.get("impostor", ca=True)
    name = load(authority)[0]
    forged = hardened.identities.get("forged", issuer=(name, load(impostor)[1]))
    client = await hardened.client(files=forged)
    assert await bad(client.connect()) == "BadSecurityChecksFailed"


async def test_trust_taken_away_holds_at_the_next_renewal(hardened: Door) -> None:
    """Stock asyncua never looks at the certificate again."""
    files = hardened.identities.get("leaver")
    info = trust(hardened.state_dir, files.certificate)
    client = await hardened.client(files=files)
    await client.connect()
    info.path.unlink()
    assert await bad(client.activate_session("oscar", "operate-1")) == "BadSecurityChecksFailed"
    assert await bad(client.open_secure_channel(renew=True)) in {"BadSecurityChecksFailed", "closed"}
    for task in (client._stale_watchdog_task, client._supervisor_task, client._renew_channel_task):
        await client._cancel_task(task)
    client.disconnect_socket()


async def test_any_client_when_asked_for(
    tmp_path: Path, identities: Identities, capsys: pytest.CaptureFixture[str]
) -> None:
    async with door(tmp_path, identities, trust_all_clients=True) as lab:
        said = capsys.readouterr()
        assert "trust_all_clients" in said.out + said.err
        assert await connects(lab, "nobody") == "Good"
        assert await connects(lab, "expired", days=(-30, -1)) == "BadSecurityChecksFailed"


async def test_renewed_channels_go_on(hardened: Door) -> None:
    async with hardened.connected() as client:
        for _ in range(3):
            await client.open_secure_channel(renew=True)
            assert await client.get_node(hardened.nodes.plain).read_value() == 7.0


@pytest.mark.parametrize("name", ["Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"])
async def test_each_policy_is_served_encrypted_alone(hardened: Door, name: str) -> None:
    policy = getattr(security_policies, f"SecurityPolicy{name}")
    async with hardened.connected(policy=policy) as client:
        assert await client.get_node(hardened.nodes.plain).read_value() == 7.0
    signed = await hardened.client(policy=policy)
    signed.security_policy.Mode = ua.MessageSecurityMode.Sign
    assert await bad(signed.connect()) in {"BadSecurityPolicyRejected", "closed"}


@pytest.mark.parametrize("name", ["Basic128Rsa15", "Basic256"])
async def test_broken_policies_are_not_served(hardened: Door, name: str) -> None:
    """asyncua has them; they are not to be had here."""
    client = await hardened.client(policy=getattr(security_policies, f"SecurityPolicy{name}"))
    assert await bad(client.connect()) in {"BadSecurityPolicyRejected", "closed"}
