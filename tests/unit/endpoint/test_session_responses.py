"""Responses of the session services have the bytes that asyncua makes of its objects."""

from __future__ import annotations

import importlib
import random
from typing import Any

import pytest

from ua_fleet.endpoint.answers import EncodedResponse
from ua_fleet.endpoint.binary.encoders import encode_array
from ua_fleet.endpoint.binary.session_responses import activated_response, created_response
from ua_fleet.endpoint.sessions import Session

ua: Any = importlib.import_module("asyncua.ua")
binary: Any = importlib.import_module("asyncua.ua.ua_binary")
policies: Any = importlib.import_module("asyncua.crypto.security_policies")

HANDLE = 4_711
HEAD = 4 + 8 + 4
"""Type, Timestamp and RequestHandle."""


def same(made: EncodedResponse, expected: Any) -> bool:
    """Whether all but the Timestamp is the same."""
    expected.ResponseHeader.RequestHandle = HANDLE
    ours, theirs = made.encode(HANDLE), bytes(binary.struct_to_binary(expected))
    return (ours[:4], ours[12:HEAD], ours[HEAD:]) == (theirs[:4], theirs[12:HEAD], theirs[HEAD:])


class Policy:
    """What is used of a policy."""

    def __init__(self, certificate: bytes, uri: str) -> None:
        self.host_certificate, self.AsymmetricSignatureURI = certificate, uri


@pytest.mark.parametrize("endpoints", [0, 1, 5])
@pytest.mark.parametrize("secured", [True, False])
def test_create_session(endpoints: int, secured: bool) -> None:
    rng = random.Random(endpoints)
    signature, certificate = (rng.randbytes(256), rng.randbytes(900)) if secured else (b"", b"")
    policy = Policy(certificate, policies.SecurityPolicyBasic256Sha256.AsymmetricSignatureURI if secured else "")
    session = Session(None, b"", "urn:client", 12.5)
    offered = [ua.EndpointDescription(EndpointUrl=f"opc.tcp://host:{number}") for number in range(endpoints)]
    response = ua.CreateSessionResponse()
    result = response.Parameters
    result.SessionId, result.AuthenticationToken = session.session_id, session.auth_token
    result.RevisedSessionTimeout, result.MaxRequestMessageSize = 12_500.0, 65_536
    result.ServerNonce, result.ServerCertificate = session.nonce, certificate
    result.ServerEndpoints = offered
    result.ServerSignature.Algorithm, result.ServerSignature.Signature = policy.AsymmetricSignatureURI, signature
    made = created_response(session, encode_array(offered), policy, signature, 65_536)
    assert same(made, response)
    result.ServerNonce = b"another"
    assert not same(made, response)


def test_activate_session() -> None:
    response = ua.ActivateSessionResponse()
    response.Parameters.ServerNonce = bytes(range(32))
    assert same(activated_response(bytes(range(32))), response)


def test_close_session() -> None:
    assert same(EncodedResponse(ua.CloseSessionResponse), ua.CloseSessionResponse())
