"""Commands that begin at once on a machine where none was before, and what those of a version before have left."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from ua_fleet.client.identity import ClientIdentity
from ua_fleet.errors import AccessRefused
from ua_fleet.storage.files import write_whole


def fits(identity: ClientIdentity) -> bool:
    """Whether the certificate belongs to the key."""
    certificate = x509.load_der_x509_certificate(identity.certificate.read_bytes())
    key: Any = load_pem_private_key(identity.key.read_bytes(), None)
    return bool(certificate.public_key() == key.public_key())


async def test_those_that_begin_at_once_have_one_certificate_and_its_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[Path] = []

    def write(path: Path, data: bytes) -> None:
        write_whole(path, data)
        written.append(path)
        time.sleep(0.05)  # another one writes its own meanwhile, if it may

    monkeypatch.setattr("ua_fleet.client.identity.write_whole", write)
    identities = [ClientIdentity(tmp_path) for _ in range(4)]
    await asyncio.gather(*[identity.ensure() for identity in identities])
    assert fits(identities[0])
    assert written == [identities[0].key, identities[0].certificate]


async def test_a_certificate_of_another_key_is_made_anew_or_said(tmp_path: Path) -> None:
    identity, other = ClientIdentity(tmp_path / "a"), ClientIdentity(tmp_path / "b")
    await identity.ensure()
    await other.ensure()
    key = identity.key.read_bytes()
    identity.certificate.write_bytes(other.certificate.read_bytes())
    await identity.ensure()
    assert fits(identity)
    assert identity.key.read_bytes() == key

    bridge = ClientIdentity.of_bridge(tmp_path / "c", "Fleet", "cell")
    await bridge.ensure()
    bridge.certificate.write_bytes(other.certificate.read_bytes())
    with pytest.raises(AccessRefused, match=r"bridge.der: belongs to a key that is not .*cert create --bridge cell"):
        await bridge.ensure()
    await bridge.renew()
    assert fits(bridge)
