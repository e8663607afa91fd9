"""By what certificates are known."""

from __future__ import annotations

import functools

from cryptography import x509
from cryptography.hazmat.primitives import hashes

__all__ = ["fingerprint_of"]


@functools.lru_cache(256)
def fingerprint_of(certificate: x509.Certificate) -> bytes:
    """SHA-256 of a certificate, by which it is known in the folders; that of equal certificates is computed once."""
    return certificate.fingerprint(hashes.SHA256())
