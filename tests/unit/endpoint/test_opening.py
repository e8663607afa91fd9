"""An OpenSecureChannel message is opened and made as asyncua does it; one that was changed on its way is not taken."""

from __future__ import annotations

import hashlib
import importlib
import random
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from ua_fleet.endpoint.certificates import ensure_application_certificate
from ua_fleet.endpoint.chunks import SEQUENCE
from ua_fleet.endpoint.opening import NONE_URI, OPENING, check_open_header, open_opening, seal_opening
from ua_fleet.endpoint.stack import DECODE_ERRORS

ua: Any = importlib.import_module("asyncua.ua")
connections: Any = importlib.import_module("asyncua.common.connection")
policies: Any = importlib.import_module("asyncua.crypto.security_policies")
uacrypto: Any = importlib.import_module("asyncua.crypto.uacrypto")
exceptions: Any = importlib.import_module("cryptography.exceptions")

BODY = bytes(range(150))
SECURED = ("SecurityPolicyBasic256Sha256", "SecurityPolicyAes128Sha256RsaOaep", "SecurityPolicyAes256Sha256RsaPss")


class Ends(NamedTuple):
    """Both ends of a channel, as asyncua's policies."""

    server: Any
    client: Any


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Any, Any]]:
    """Certificate and private key of a server and of a client."""
    made: list[tuple[Any, Any]] = []
    for name in ("server", "client"):
        folder: Path = tmp_path_factory.mktemp(name)
        files = ensure_application_certificate(folder, f"urn:{name}", ["127.0.0.1"])
        certificate = uacrypto.x509_from_der(Path(files.certificate).read_bytes())
        key = uacrypto.serialization.load_pem_private_key(Path(files.private_key).read_bytes(), None)
        made.append((certificate, key))
    return made


def _ends(name: str, keys: list[tuple[Any, Any]]) -> Ends:
    if name == "None":
        return Ends(policies.SecurityPolicyNone(), policies.SecurityPolicyNone())
    (certificate, key), (peer, peer_key) = keys
    kind, mode = getattr(policies, name), ua.MessageSecurityMode.SignAndEncrypt
    return Ends(kind(peer, certificate, key, mode), kind(certificate, peer, peer_key, mode))


def _sealed(policy: Any) -> bytes:
    """The message as asyncua makes it."""
    connection = connections.SecureConnection(policy, connections.TransportLimits())
    connection.security_token.ChannelId = 7
    return bytes(connection.message_to_binary(BODY, message_type=ua.MessageType.SecureOpen, request_id=9))


@pytest.mark.parametrize("name", ["None", *SECURED])
def test_the_message_of_a_client_is_opened_and_ours_has_asyncuas_form(name: str, keys: list[tuple[Any, Any]]) -> None:
    ends = _ends(name, keys)
    frame = _sealed(ends.client)
    header = check_open_header(frame)
    certificate = b"" if name == "None" else ends.client.host_certificate
    assert (header.policy_uri, header.certificate or b"") == (ends.server.URI, certificate)
    named = ends.client.peer_certificate
    assert header.thumbprint == (hashlib.sha1(named, usedforsecurity=False).digest() if named else None)
    sequence, message = open_opening(frame, header.start, ends.server)
    assert (sequence, message) == (1, (9, BODY))
    ours, theirs = seal_opening(BODY, 7, SEQUENCE.pack(1, 9), ends.server), _sealed(ends.server)
    clear = check_open_header(theirs).start
    assert (ours[:clear], len(ours)) == (theirs[:clear], len(theirs))
    assert open_opening(ours, clear, ends.client) == (1, (9, BODY))


@pytest.mark.parametrize("name", SECURED)
def test_a_message_that_was_changed_is_not_taken(name: str, keys: list[tuple[Any, Any]]) -> None:
    ends, rng = _ends(name, keys), random.Random(name)
    frame = _sealed(ends.client)
    start = check_open_header(frame).start
    places = [0, 3, 4, 8, 11, 12, 40, start - 1, start, len(frame) - 1, *(rng.randrange(len(frame)) for _ in range(10))]
    for at in places:
        changed = bytearray(frame)
        changed[at] ^= 1 << rng.randrange(8)
        with pytest.raises((exceptions.InvalidSignature, *DECODE_ERRORS)):
            open_opening(bytes(changed), start, ends.server)
    for end in (start, start + 1, len(frame) - 256, len(frame) - 1):
        with pytest.raises((exceptions.InvalidSignature, *DECODE_ERRORS)):
            open_opening(frame[:end], start, ends.server)


def test_the_first_bytes_say_what_it_is() -> None:
    frame = _sealed(policies.SecurityPolicyNone())
    assert frame.startswith(OPENING)
    assert check_open_header(frame).policy_uri == NONE_URI
