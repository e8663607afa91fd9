"""Revocation lists are read once, and again when there is another one in their place."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding

from tests.integration.server_security.harness import load, make_certificate
from ua_fleet.endpoint.certificates import CertificateFiles, CertificateState, certificates_folder, load_certificate
from ua_fleet.endpoint.own_time import own_time
from ua_fleet.endpoint.trust import CertificateRefused, TrustList

MANY = 20_000


def revoke(folder: Path, ca: CertificateFiles, serials: list[int], signer: CertificateFiles | None = None) -> Path:
    """Write the list of a CA, signed by it or by another."""
    certificate, key = load(signer or ca)
    now = datetime.now(UTC)
    revoked = [
        x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(now).build() for serial in serials
    ]
    builder = x509.CertificateRevocationListBuilder(load(ca)[0].subject, now, now + timedelta(days=1), [], revoked)
    path = certificates_folder(folder) / "crl" / "plant.crl"
    path.write_bytes(builder.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM))
    assert certificate
    return path


@pytest.fixture
def issued(tmp_path: Path) -> tuple[Path, CertificateFiles, x509.Certificate]:
    """A state folder that trusts a CA, the CA, and a certificate of it."""
    state = tmp_path / "state"
    TrustList(state)
    ca = make_certificate(tmp_path, "ca", ca=True)
    (certificates_folder(state) / CertificateState.TRUSTED / "ca.der").write_bytes(ca.certificate.read_bytes())
    return state, ca, load_certificate(make_certificate(tmp_path, "plc", issuer=load(ca)).certificate)


def test_a_list_counts_as_soon_as_it_is_there(issued: tuple[Path, CertificateFiles, x509.Certificate]) -> None:
    state, ca, plc = issued
    trust_list = TrustList(state)
    trust_list.check([plc])
    path = revoke(state, ca, [1, 2, plc.serial_number])
    for _ in range(2):
        with pytest.raises(CertificateRefused, match="is revoked"):
            trust_list.check([plc])
    revoke(state, ca, [1, 2])
    trust_list.check([plc])
    path.write_bytes(b"no list")
    for _ in range(2):
        with pytest.raises(CertificateRefused, match="no readable revocation list"):
            trust_list.check([plc])
    path.unlink()
    trust_list.check([plc])


def test_a_list_of_the_same_size_and_time_counts_too(issued: tuple[Path, CertificateFiles, x509.Certificate]) -> None:
    """Written into the same file, with the time of the one before put back."""
    state, ca, plc = issued
    trust_list = TrustList(state)
    path = revoke(state, ca, [plc.serial_number ^ 1])
    trust_list.check([plc])
    before = path.stat()
    revoke(state, ca, [plc.serial_number])
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    with pytest.raises(CertificateRefused, match="is revoked"):
        trust_list.check([plc])


def test_a_list_that_another_has_signed_says_nothing(
    issued: tuple[Path, CertificateFiles, x509.Certificate], tmp_path: Path
) -> None:
    state, ca, plc = issued
    revoke(state, ca, [plc.serial_number], signer=make_certificate(tmp_path, "forger", ca=True))
    trust_list = TrustList(state)
    for _ in range(2):
        trust_list.check([plc])


def test_a_long_list_is_read_once(issued: tuple[Path, CertificateFiles, x509.Certificate]) -> None:
    """Each check of a certificate, of which a login has three, read 20,000 entries anew: 12 ms."""
    state, ca, plc = issued
    revoke(state, ca, list(range(1, MANY + 1)))
    trust_list = TrustList(state)
    first = own_time()
    trust_list.check([plc])
    began = own_time()
    for _ in range(20):
        trust_list.check([plc])
    assert own_time() - began < 10 * (began - first)
