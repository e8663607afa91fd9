"""Bombs of a client that nobody has let in: the server answers, or closes that connection, and nothing else happens."""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import system
from tests.attacks.bombs import BombMaker, length
from tests.attacks.fuzzing import EARLY
from tests.attacks.harness import AttackedServer, Attacker, attacked, binary, ua

_NULL_ID = b"\0\0"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedServer]:
    with attacked(tmp_path_factory.mktemp("attacked")) as running:
        yield running


def _type_id(name: str) -> bytes:
    return b"\1\0" + struct.pack("<H", getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary"))


def _header(additional: bytes) -> bytes:
    """A RequestHeader that ends in an AdditionalHeader."""
    return _NULL_ID + bytes(8) + struct.pack("<II", 1, 0) + length(-1) + length(0) + additional


def _extension_object(structure: str, body: bytes) -> bytes:
    identifier = int(ua.ObjectIds.__dict__[f"{structure}_Encoding_DefaultBinary"])
    return b"\1\0" + struct.pack("<H", identifier) + b"\1" + length(len(body)) + body


NULLS = b"\x80" + length(10**8)
BOMBS = {
    "nulls": NULLS,
    "more nulls than memory": b"\x80" + length(2**31 - 1),
    "dimensions": b"\xc6" + length(1) + bytes(4) + length(2) + length(1000) * 2,
    "data values": b"\x97" + length(60_000) + bytes(60_000),
    "variants": b"\x98" + length(60_000) + bytes(60_000),
    "nested": (b"\x98" + length(1)) * 10_000 + b"\0",
    "backwards": b"\x8c" + length(10_000) + length(-4),
}


def _carriers(variant: bytes) -> Iterator[bytes]:
    """Requests that carry a Variant to a decoder, each its own way."""
    # KeyValuePair: a QualifiedName and a Variant.
    pair = _extension_object("KeyValuePair", b"\0\0" + length(-1) + variant)
    yield _type_id("GetEndpoints") + _header(pair) + length(-1) * 3
    yield _type_id("CreateSession") + _header(pair)
    signature = length(-1) * 2
    yield _type_id("ActivateSession") + _header(b"\0\0\0") + signature + length(-1) * 2 + pair + signature
    # A literal of an event filter, as deep as a Variant may stand.
    literal = _extension_object("LiteralOperand", variant)
    yield _type_id("ActivateSession") + _header(b"\0\0\0") + signature + length(-1) * 2 + literal + signature


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_a_bomb_in_any_header_harms_nobody(server: AttackedServer, bomb: bytes) -> None:
    with server.harm() as harm:
        for request in _carriers(bomb):
            with server.connected() as attacker:
                attacker.send(request)
                attacker.answer()
    harm.check()


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_a_bomb_in_open_secure_channel_harms_nobody(server: AttackedServer, bomb: bytes) -> None:
    pair = _extension_object("KeyValuePair", b"\0\0" + length(-1) + bomb)
    body = _type_id("OpenSecureChannel") + _header(pair)
    body += struct.pack("<III", 0, 0, 1) + length(-1) + struct.pack("<I", 60_000)
    with server.harm() as harm, Attacker(server.port) as attacker:
        attacker.hello()
        chunk = attacker.chunk(b"OPN", body)
        assert len(chunk) < 65_536
        attacker.write(chunk)
        # The header is passed by its length, so the channel opens as if it were not there.
        assert attacker.frame()[:3] == b"OPN"
    harm.check()


def test_arrays_that_lie_about_their_length_are_refused(server: AttackedServer) -> None:
    lies = {
        "GetEndpoints": length(-1) + length(10**8),
        "FindServers": length(-1) + length(2**31 - 1),
        "ActivateSession": length(-1) * 2 + length(10**8),
    }
    with server.harm() as harm:
        for name, body in lies.items():
            with server.connected() as attacker:
                attacker.send(_type_id(name) + _header(b"\0\0\0") + body)
                fault = binary.struct_from_binary(ua.ServiceFault, ua.utils.Buffer(attacker.answer()))
                assert fault.ResponseHeader.ServiceResult.name == "BadDecodingError", name
    harm.check()


def test_nulls_where_a_value_belongs_get_an_answer(server: AttackedServer) -> None:
    """A null in each place of each request that needs no session; a mistake of ours would be logged as a traceback."""
    null_signature = length(-1) * 2
    requests = {
        "FindServers": [length(-1) + length(-1) + length(2) + length(-1) * 2, length(-1) * 3],
        "GetEndpoints": [length(-1) + length(1) + length(-1) + length(1) + length(-1), length(-1) * 3],
        "CreateSession": [length(-1) * 2 + b"\0" + bytes(4) + length(-1) * 9 + bytes(12)],
        "ActivateSession": [
            null_signature + length(1) + length(-1) * 2 + length(1) + length(-1) + b"\0\0\0" + null_signature,
            null_signature
            + length(-1) * 2
            + _extension_object("UserNameIdentityToken", length(-1) * 4)
            + null_signature,
            null_signature + length(-1) * 2 + _extension_object("X509IdentityToken", length(-1) * 2) + null_signature,
            null_signature + length(-1) * 2 + _extension_object("AnonymousIdentityToken", length(-1)) + null_signature,
        ],
        "CloseSession": [b"", b"\0"],
        "RegisterServer": [length(-1) * 9],
        "Read": [length(-1)],
    }
    with server.harm() as harm:
        for name, bodies in requests.items():
            for body in bodies:
                with server.connected() as attacker:
                    if name == "ActivateSession":
                        attacker.create_session()
                    header = binary.struct_to_binary(attacker.header())
                    attacker.send(_type_id(name) + header + body)
                    assert attacker.answer(), name
    harm.check()


def test_messages_given_up_fill_no_log(server: AttackedServer) -> None:
    before = len(server.log)
    with server.harm() as harm:
        for _ in range(5):
            with server.connected() as attacker:
                for _ in range(200):
                    reason = length(60_000) + b"A" * 60_000
                    attacker.write(attacker.chunk(b"MSG", struct.pack("<I", 0x8000_0000) + reason, b"A"))
                assert not attacker.answer()
    harm.check()
    assert len(server.log) - before < 10_000


def test_a_message_given_up_is_followed_by_others(server: AttackedServer) -> None:
    with server.connected() as client:
        client.write(client.chunk(b"MSG", b"the beginning of a message", b"C"))
        client.write(client.chunk(b"MSG", struct.pack("<I", 0x8000_0000) + length(3) + b"why", b"A"))
        assert not isinstance(client.call(ua.GetEndpointsRequest(), ua.GetEndpointsResponse), str)


def test_fuzzed_requests_before_login_harm_nobody(server: AttackedServer) -> None:
    """Two thousand bombs at a real server; `test_a_hundred_thousand_bombs` is the same without a wire."""
    maker = BombMaker(7, 20_000)
    with server.harm() as harm:
        for number in range(100):
            with server.connected() as attacker:
                for _ in range(20):
                    name = maker.random.choice(EARLY)
                    header = maker.value(ua.RequestHeader) if number % 2 else _header(b"\0\0\0")
                    body = _type_id(name) + header + maker.parameters(getattr(ua, f"{name}Parameters"))
                    attacker.send(body[:60_000])
                    if not attacker.answer():
                        break
    harm.check()
    assert harm.victim.reads > 2


@pytest.mark.timeout(300)
def test_a_hundred_thousand_bombs_take_neither_memory_nor_time() -> None:
    program = Path(__file__).with_name("fuzzing.py")
    ended = system.run(sys.executable, program, "100000", "11", timeout_s=280, folder=system.ROOT)
    assert ended.returncode == 0, ended.stderr[-2_000:]
    told = json.loads(ended.stdout)
    assert told["outcomes"].pop("too late", 0) == 0
    assert set(told["outcomes"]) == {
        "decoded",
        "BadDecodingError",
        "BadEncodingLimitsExceeded",
        "BadTooManyOperations",
    }, told
    assert told["slowest_s"] < 0.5
    assert told["grown_mb"] < 100
