"""What secures a channel, made of asyncua's policies: what follows from two certificates once, the rest each time.

Whether a client's certificate is good now is asked elsewhere, at each opening: nothing here says so.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import functools
import time
from typing import Any, Final

from asyncua.crypto import security_policies
from asyncua.crypto.security_policies import SecurityPolicyFactory
from cryptography import x509
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.hmac import HMAC

__all__ = ["derive_keys", "make_keys", "policy_of"]

_crypto: Final[Any] = security_policies
"""Its classes have no types."""
_BLOCK: Final = 16
"""Of AES, whatever its key: the bytes of an initialization vector."""


def policy_of(factory: SecurityPolicyFactory, certificate: x509.Certificate | None) -> Any:
    """A policy for one channel of a client with this certificate, without symmetric keys yet.

    That of a channel without security, whose client has none, has nothing that a channel would change.
    """
    known = _policy_of(factory, certificate)
    if certificate is None:
        return known
    made = object.__new__(type(known))
    made.__dict__.update(known.__dict__)
    # Both are told which key to use, so each channel has its own.
    made.asymmetric_cryptography = asymmetric = object.__new__(_crypto.Cryptography)
    asymmetric.__dict__.update(known.asymmetric_cryptography.__dict__)
    made.symmetric_cryptography = _crypto.Cryptography(known.Mode)
    return made


@functools.lru_cache(256)
def _policy_of(factory: SecurityPolicyFactory, certificate: x509.Certificate | None) -> Any:
    """The keys of both, in the form that they are used in."""
    create: Any = factory.create
    return create(certificate)


def derive_keys(secret: bytes, seed: bytes, sizes: tuple[int, ...]) -> list[bytes]:
    """Keys of so many bytes each, by P_SHA256 (OPC 10000-6 6.7.5)."""
    keyed = HMAC(secret, SHA256())

    def digest(data: bytes) -> bytes:
        one = keyed.copy()
        one.update(data)
        return one.finalize()

    made, step = b"", seed
    while len(made) < sum(sizes):
        step = digest(step)
        made += digest(step + seed)
    keys: list[bytes] = []
    for size in sizes:
        keys.append(made[:size])
        made = made[size:]
    return keys


def make_keys(policy: Any, local_nonce: bytes, remote_nonce: bytes, lifetime_ms: int) -> None:
    """Give a policy the symmetric keys of its channel's first token, as asyncua does.

    All policies of this server but None have HMAC-SHA256, AES in CBC mode, and P_SHA256 to derive their keys by.
    """
    sizes = policy.signature_key_size, policy.symmetric_key_size, _BLOCK
    symmetric = policy.symmetric_cryptography
    signing, encrypting, vector = derive_keys(remote_nonce, local_nonce, sizes)
    symmetric.Signer = _crypto.SignerHMac256(signing)
    symmetric.Encryptor = _crypto.EncryptorAesCbc(encrypting, vector)
    signing, encrypting, vector = derive_keys(local_nonce, remote_nonce, sizes)
    symmetric.Verifier = _crypto.VerifierHMac256(signing)
    symmetric.Decryptor = _crypto.DecryptorAesCbc(encrypting, vector)
    symmetric.key_expiration = time.monotonic() + lifetime_ms / 1000
