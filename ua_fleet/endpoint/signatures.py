"""Signatures by which a client proves, in ActivateSession, that it has the key of its certificate."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

from typing import Any, Final

from asyncua import ua
from cryptography.exceptions import InvalidSignature

from ua_fleet.endpoint.stack import DECODE_ERRORS, Refusal

__all__ = ["check_signature"]

_ALSO_NAMED: Final = {
    "http://opcfoundation.org/UA/security/rsa-pss-sha2-256": "http://www.w3.org/2001/04/xmldsig-more#rsa-pss-sha256"
}
"""What node-opcua 2.139 calls RSA-PSS, where OPC 10000-7 has a name of its own. Only the name differs."""


def check_signature(
    policy: Any, given: ua.SignatureData | None, nonce: bytes, code: int, *, may_be_unnamed: bool = False
) -> None:
    """Raise Refusal unless the channel's client has signed our certificate and this nonce (OPC 10000-4 6.1.8).

    Args:
        policy: of the channel; its algorithm counts, whatever name the client gives.
        given: the signature.
        nonce: the last one that the client has got.
        code: StatusCode of the refusal.
        may_be_unnamed: whether the name of the algorithm may be left out.
    """
    own = str(policy.AsymmetricSignatureURI)
    name = (given.Algorithm if given is not None else None) or ""
    if given is None or (name not in (own, _ALSO_NAMED.get(own, own)) and not (may_be_unnamed and not name)):
        raise Refusal(code, "another algorithm than the policy's, or no signature")
    try:
        policy.asymmetric_cryptography.verify(policy.host_certificate + nonce, given.Signature or b"")
    except (InvalidSignature, *DECODE_ERRORS) as error:
        raise Refusal(code, "the signature is wrong") from error
