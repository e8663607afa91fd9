from __future__ import annotations

import datetime as dt
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import NameOID

from ua_fleet.endpoint.certificates import certificate_paths, thumbprint
from ua_fleet.endpoint.rejected import MAX_REJECTED, RejectedCertificates, rejection_of

NOW = dt.datetime(2030, 1, 1, tzinfo=dt.UTC)


@pytest.fixture(scope="module")
def key() -> rsa.RSAPrivateKey:
    return rsa.generate_private_key(65537, 2048)


def made(key: rsa.RSAPrivateKey, name: str) -> x509.Certificate:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number())
    builder = builder.not_valid_before(NOW).not_valid_after(NOW + dt.timedelta(days=1))
    return builder.sign(key, hashes.SHA256())


class Clock:
    def __init__(self) -> None:
        self.now_s = 1_000.0

    def __call__(self) -> float:
        self.now_s += 2.0
        return self.now_s


def kept(folder: Path) -> set[str]:
    return {path.stem for path in certificate_paths(folder)}


def test_a_flood_from_one_address_takes_nobodys_place(tmp_path: Path, key: rsa.RSAPrivateKey) -> None:
    store = RejectedCertificates(tmp_path, Clock())
    honest = [made(key, f"plc {number}") for number in range(3)]
    for number, certificate in enumerate(honest[:2]):
        store.keep(certificate, f"10.0.0.{number}")
    flood = [made(key, f"flood {number}") for number in range(MAX_REJECTED + 10)]
    for certificate in flood:
        store.keep(certificate, "10.9.9.9")
    assert len(kept(tmp_path)) == MAX_REJECTED
    store.keep(honest[2], "10.0.0.2")
    for certificate in flood[-3:]:
        store.keep(certificate, "10.9.9.9")
    left = kept(tmp_path)
    assert len(left) == MAX_REJECTED
    assert {thumbprint(certificate) for certificate in honest} <= left
    assert len(list(tmp_path.iterdir())) == 2 * MAX_REJECTED, "what is written beside a certificate goes with it"


def test_who_waits_longest_keeps_its_place(tmp_path: Path, key: rsa.RSAPrivateKey) -> None:
    store = RejectedCertificates(tmp_path, Clock())
    first = [made(key, f"plc {number}") for number in range(MAX_REJECTED)]
    for number, certificate in enumerate(first):
        store.keep(certificate, f"10.0.0.{number}")
    latest = made(key, "latest")
    store.keep(latest, "10.0.1.1")
    assert kept(tmp_path) == {thumbprint(certificate) for certificate in [*first[:-1], latest]}


def test_a_flood_costs_one_write_a_second(tmp_path: Path, key: rsa.RSAPrivateKey) -> None:
    store = RejectedCertificates(tmp_path, lambda: 1_000.0)
    certificates = [made(key, f"plc {number}") for number in range(MAX_REJECTED + 3)]
    for certificate in certificates:
        store.keep(certificate, "10.0.0.1")
    assert kept(tmp_path) == {thumbprint(certificate) for certificate in certificates[:MAX_REJECTED]}


def test_when_and_from_where(tmp_path: Path, key: rsa.RSAPrivateKey) -> None:
    clock = Clock()
    store, certificate = RejectedCertificates(tmp_path, clock), made(key, "plc")
    store.keep(certificate, "10.0.0.1")
    store.keep(certificate, "10.0.0.2")
    [path] = certificate_paths(tmp_path)
    rejection = rejection_of(path)
    assert (rejection.address, rejection.first_s, rejection.last_s) == ("10.0.0.2", 1_002.0, 1_004.0)
    path.with_suffix(".json").write_text('{"address": 1')
    assert rejection_of(path).address == ""
