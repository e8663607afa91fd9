"""Keys and policies of a channel are those that asyncua makes; no two channels share what they change."""

from __future__ import annotations

import importlib
import random
from pathlib import Path
from typing import Any

import pytest
from cryptography.exceptions import InvalidSignature

from ua_fleet.endpoint.certificates import ensure_application_certificate
from ua_fleet.endpoint.channel_keys import derive_keys, make_keys, policy_of

ua: Any = importlib.import_module("asyncua.ua")
policies: Any = importlib.import_module("asyncua.crypto.security_policies")
uacrypto: Any = importlib.import_module("asyncua.crypto.uacrypto")

SECURED = ("SecurityPolicyBasic256Sha256", "SecurityPolicyAes128Sha256RsaOaep", "SecurityPolicyAes256Sha256RsaPss")
MODES = (ua.MessageSecurityMode.Sign, ua.MessageSecurityMode.SignAndEncrypt)


@pytest.fixture(scope="module")
def applications(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Any, Any]]:
    """Certificate and private key of a server and of two clients."""
    made: list[tuple[Any, Any]] = []
    for name in ("server", "client", "other"):
        files = ensure_application_certificate(tmp_path_factory.mktemp(name), f"urn:{name}", ["127.0.0.1"])
        certificate = uacrypto.x509_from_der(Path(files.certificate).read_bytes())
        key = uacrypto.serialization.load_pem_private_key(Path(files.private_key).read_bytes(), None)
        made.append((certificate, key))
    return made


def factory(name: str, mode: Any, applications: list[tuple[Any, Any]]) -> Any:
    certificate, key = applications[0]
    return policies.SecurityPolicyFactory(getattr(policies, name), mode, certificate, key)


@pytest.mark.parametrize("sizes", [(32, 32, 16), (32, 16, 16), (16,), (100, 1, 31)])
def test_keys_are_derived_as_by_asyncua(sizes: tuple[int, ...]) -> None:
    rng = random.Random(str(sizes))
    for length in (1, 32, 64, 65, 100):
        secret, seed = rng.randbytes(length), rng.randbytes(32)
        assert tuple(derive_keys(secret, seed, sizes)) == uacrypto.p_sha256(secret, seed, sizes)


@pytest.mark.parametrize("name", SECURED)
@pytest.mark.parametrize("mode", MODES)
def test_a_channels_keys_are_asyncuas(name: str, mode: Any, applications: list[tuple[Any, Any]]) -> None:
    offered, local, remote = factory(name, mode, applications), bytes(range(32)), bytes(range(32, 64))
    ours, theirs = policy_of(offered, applications[1][0]), offered.create(applications[1][0])
    make_keys(ours, local, remote, 60_000)
    theirs.make_local_symmetric_key(remote, local)
    theirs.make_remote_symmetric_key(local, remote, 60_000)
    mine, other = ours.symmetric_cryptography, theirs.symmetric_cryptography
    data = bytes(range(160))
    assert mine.is_encrypted == other.is_encrypted == (mode == ua.MessageSecurityMode.SignAndEncrypt)
    assert mine.signature(data) == other.signature(data)
    assert mine.encrypt(data) == other.encrypt(data)
    assert mine.decrypt(data) == other.decrypt(data)
    mine.verify(data, uacrypto.hmac_sha256(other.Verifier.key, data))
    assert abs(mine.key_expiration - other.key_expiration) < 5
    with pytest.raises(uacrypto.InvalidSignature):
        mine.verify(data, bytes(32))


@pytest.mark.parametrize("name", SECURED)
def test_channels_of_one_client_share_nothing_that_changes(name: str, applications: list[tuple[Any, Any]]) -> None:
    mode = ua.MessageSecurityMode.SignAndEncrypt
    offered = factory(name, mode, applications)
    first, second = (policy_of(offered, applications[1][0]) for _ in range(2))
    make_keys(first, bytes(32), bytes(range(32)), 60_000)
    first.asymmetric_cryptography.use_prev_key = True
    assert second.symmetric_cryptography.Signer is None
    assert second.symmetric_cryptography.Verifier is None
    assert not second.asymmetric_cryptography.use_prev_key
    assert type(second) is getattr(policies, name)
    assert (second.Mode, second.peer_certificate) == (mode, uacrypto.der_from_x509(applications[1][0]))


def test_another_client_has_another_key(applications: list[tuple[Any, Any]]) -> None:
    offered = factory(SECURED[0], MODES[1], applications)
    client, other = (policy_of(offered, certificate) for certificate, _ in applications[1:])
    signed = uacrypto.sign_sha256(applications[1][1], b"data")
    client.asymmetric_cryptography.verify(b"data", signed)
    with pytest.raises(InvalidSignature):
        other.asymmetric_cryptography.verify(b"data", signed)
    unlike = factory(SECURED[0], MODES[0], applications)
    assert policy_of(unlike, applications[1][0]).Mode == MODES[0]
