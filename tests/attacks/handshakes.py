"""Frames of OpenSecureChannel that cost their maker nothing, and the server the use of its private key."""

from __future__ import annotations

import os
import struct
from datetime import UTC, datetime, timedelta
from functools import cache

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import padding, rsa
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

__all__ = ["client_certificate", "encrypted_blocks", "open_frame"]

_POLICY = b"http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256"
_BLOCK = 214
"""Bytes that RSA-OAEP encrypts with 2048 bits."""


@cache
def client_certificate() -> bytes:
    """A sound certificate (DER) that nobody trusts."""
    key = rsa.generate_private_key(public_exponent=65_537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "stranger")])
    usage = x509.KeyUsage(
        digital_signature=True,
        content_commitment=True,
        key_encipherment=True,
        data_encipherment=True,
        key_agreement=False,
        key_cert_sign=False,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
    now = datetime.now(UTC)
    built = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    built = built.serial_number(x509.random_serial_number()).add_extension(usage, critical=True)
    built = built.not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=30))
    return built.sign(key, hashes.SHA256()).public_bytes(Encoding.DER)


def encrypted_blocks(server: bytes, count: int) -> bytes:
    """Blocks that the server's key (of this certificate) decrypts, all of them the same."""
    key = x509.load_der_x509_certificate(server).public_key()
    assert isinstance(key, rsa.RSAPublicKey)
    oaep = padding.OAEP(padding.MGF1(hashes.SHA1()), hashes.SHA1(), None)
    return key.encrypt(os.urandom(_BLOCK), oaep) * count


def open_frame(server: bytes, body: bytes, certificate: bytes) -> bytes:
    """An OpenSecureChannel message with these bytes as what is encrypted."""
    thumbprint = x509.load_der_x509_certificate(server).fingerprint(hashes.SHA1())
    parts = (_POLICY, certificate, thumbprint)
    security = b"".join(struct.pack("<i", len(part)) + part for part in parts)
    return b"OPNF" + struct.pack("<II", 12 + len(security) + len(body), 0) + security + body
