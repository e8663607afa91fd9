"""The responses to CreateSession and ActivateSession as bytes, the same as asyncua makes of its objects."""

from __future__ import annotations

import struct
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.answers import EncodedResponse
from ua_fleet.endpoint.binary.builtin import encode_node_id, encode_string
from ua_fleet.endpoint.binary.encoders import EncodedArray
from ua_fleet.endpoint.sessions import Session

__all__ = ["activated_response", "created_response"]

_TIMEOUT: Final = struct.Struct("<d")
_SIZE: Final = struct.Struct("<I")
_NONE: Final = bytes(4)
"""An array without elements."""


def created_response(
    session: Session, endpoints: EncodedArray, policy: Any, signature: bytes, most_bytes: int
) -> EncodedResponse:
    """The response to a CreateSession (OPC 10000-4 5.7.2).

    Args:
        session: that was made.
        endpoints: of the server.
        policy: of the channel.
        signature: of the client's certificate and nonce.
        most_bytes: of a request.
    """
    parts = (
        encode_node_id(session.session_id),
        encode_node_id(session.auth_token),
        _TIMEOUT.pack(session.timeout_s * 1000),
        encode_string(session.nonce),
        encode_string(policy.host_certificate),
        endpoints,
        _NONE,  # ServerSoftwareCertificates
        encode_string(policy.AsymmetricSignatureURI),
        encode_string(signature),
        _SIZE.pack(most_bytes),
    )
    return EncodedResponse(ua.CreateSessionResponse, b"".join(parts))


def activated_response(nonce: bytes) -> EncodedResponse:
    """The response to an ActivateSession (OPC 10000-4 5.7.3): Results and DiagnosticInfos have nothing to tell of."""
    return EncodedResponse(ua.ActivateSessionResponse, encode_string(nonce) + _NONE + _NONE)
