"""Actions as bytes: a table read in both directions, random messages, and what a peer may do wrong."""

from __future__ import annotations

from collections import Counter
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.dissect.annotate import annotate
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import ActionMessage, ActionState, Cause, Codec, encode_action
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.security import MessageKey, SecurityMode, SecurityPolicy, payload_offset, read_security

ID = bytes(range(16))
HEAD = "f1 81 20  0700  01 0300  01 6400"
"""Flags, PublisherId 7, WriterGroup 3, DataSetWriter 100."""
ID_HEX = "10000000 000102030405060708090a0b0c0d0e0f"
NAME_HEX = "0c 08000000 302e736572766572"
TWO_FIELDS = "0200 0b 000000000000f83f 0c 01000000 61"
REQUEST = ActionMessage(
    7,
    3,
    100,
    9,
    1,
    ActionState.EXECUTING,
    is_request=True,
    requestor_id="0.server",
    correlation_data=ID,
    timeout_hint_ms=2.0,
    types=(BuiltinType.DOUBLE, BuiltinType.STRING),
    values=(1.5, "a"),
    timestamp=1,
)
RESPONSE = ActionMessage(
    7,
    3,
    100,
    9,
    1,
    ActionState.DONE,
    is_request=False,
    requestor_id="0.server",
    correlation_data=ID,
    types=(BuiltinType.BYTE,),
    values=(0,),
    status=StatusCode.BAD_TOO_MANY_OPERATIONS,
)
IDLE = ActionMessage(7, None, 100, 9, 1, ActionState.IDLE, is_request=True)

TABLE = [
    (
        "a request",
        REQUEST,
        f"{HEAD} 1d {ID_HEX} {NAME_HEX} 0000000000000040 81 15 0100000000000000 0900 0100 01 {TWO_FIELDS}",
    ),
    ("a response", RESPONSE, f"{HEAD} 0c {ID_HEX} {NAME_HEX} 91 06 1080 0900 0100 02 0100 03 00"),
    (
        "the version of the announcement",
        IDLE._replace(major_version=0x01020304),
        "d1 81 20 0700 01 6400 01 a1 05 04030201 0900 0100 00 0000",
    ),
    ("nothing that may be absent", IDLE, "d1 81 20 0700 01 6400 01 81 05 0900 0100 00 0000"),
    (
        "a ResponseAddress",
        IDLE._replace(response_address="opc.udp://h:1"),
        "d1 81 20 0700 01 6400 03 0d000000 6f70632e7564703a2f2f683a31 81 05 0900 0100 00 0000",
    ),
    (
        "two requests in one NetworkMessage",
        IDLE._replace(others=(IDLE._replace(data_set_writer_id=101, action_target_id=2, request_id=2),)),
        "d1 81 20 0700 02 6400 6500 01 0900 0900 81 05 0900 0100 00 0000 81 05 0200 0200 00 0000",
    ),
    (
        "a String PublisherId",
        IDLE._replace(publisher_id="r", publisher_id_type=PublisherIdType.STRING),
        "d1 84 20 01000000 72 01 6400 01 81 05 0900 0100 00 0000",
    ),
]


@pytest.mark.parametrize(("message", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in TABLE])
def test_the_bytes_in_both_directions(message: ActionMessage, encoded: str) -> None:
    assert encode_action(message).hex() == bytes.fromhex(encoded).hex()
    assert Codec().decode(bytes.fromhex(encoded)) == message


READ_ONLY = [
    ("padding up to ConfiguredSize", IDLE, "d1 81 20 0700 01 6400 01 81 05 0900 0100 00 0000 000000"),
    (
        "all of the DataSetMessage header",
        IDLE._replace(status=StatusCode.GOOD, timestamp=5, major_version=1),
        "d1 81 20 0700 01 6400 01 f9 35 0900 0500000000000000 0100 0000 01000000 02000000 0900 0100 00 0000",
    ),
    ("a NetworkMessage Timestamp", IDLE, "d1 a1 20 0700 01 6400 0500000000000000 01 81 05 0900 0100 00 0000"),
    (
        "null for what is there",
        IDLE,
        "d1 81 20 0700 01 6400 0f ffffffff ffffffff 0c ffffffff 81 05 0900 0100 00 0000",
    ),
    (
        "one of two that is not valid",
        IDLE,
        "d1 81 20 0700 02 6500 6400 01 0100 0900 00 81 05 0900 0100 00 0000",
    ),
    ("no payload header", IDLE._replace(data_set_writer_id=0), "91 81 20 0700 01 81 05 0900 0100 00 0000"),
]


@pytest.mark.parametrize(("message", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in READ_ONLY])
def test_what_others_may_send(message: ActionMessage, encoded: str) -> None:
    assert Codec().decode(bytes.fromhex(encoded)) == message


@pytest.mark.parametrize(
    "message",
    [
        REQUEST._replace(action_state=3),
        REQUEST._replace(action_target_id=65_536),
        REQUEST._replace(timeout_hint_ms=float("nan")),
        REQUEST._replace(timeout_hint_ms=-1.0),
        REQUEST._replace(correlation_data=bytes(257)),
        REQUEST._replace(requestor_id="a" * 256),
        REQUEST._replace(values=(1.5,)),
        REQUEST._replace(values=("a", "a")),
        REQUEST._replace(publisher_id=65_536),
        REQUEST._replace(others=(RESPONSE,)),
        REQUEST._replace(others=(REQUEST._replace(others=(REQUEST,)),)),
    ],
)
def test_what_cannot_be_encoded(message: ActionMessage) -> None:
    with pytest.raises(LocalWireError):
        encode_action(message)


UINT16S = st.integers(0, 0xFFFF)
TEXTS = st.none() | st.text(max_size=20)
FIELDS = st.lists(
    st.tuples(st.just(BuiltinType.INT32.value), st.integers(-(2**31), 2**31 - 1))
    | st.tuples(st.just(BuiltinType.STRING.value), TEXTS)
    | st.tuples(st.just(BuiltinType.BOOLEAN.value), st.booleans()),
    max_size=4,
)


@st.composite
def actions(draw: st.DrawFn) -> ActionMessage:
    fields = draw(FIELDS)
    is_request = draw(st.booleans())
    return ActionMessage(
        draw(UINT16S),
        draw(st.none() | UINT16S),
        draw(UINT16S),
        draw(UINT16S),
        draw(UINT16S),
        draw(st.integers(0, 2)),
        is_request,
        draw(TEXTS),
        draw(st.none() | st.binary(max_size=40)),
        draw(TEXTS),
        draw(st.none() | st.floats(0, 1e9)),
        tuple([code for code, _ in fields]),
        tuple([value for _, value in fields]),
        draw(st.none() | st.integers(0, 0xFFFF).map(lambda upper: upper << 16)),
        draw(st.none() | st.integers(-(2**63), 2**63 - 1)),
    )


@given(actions(), actions())
def test_what_is_encoded_is_decoded(message: ActionMessage, other: ActionMessage) -> None:
    codec = Codec()
    assert codec.decode(encode_action(message)) == message
    of_the_same_header = message._replace(
        data_set_writer_id=other.data_set_writer_id, types=other.types, values=other.values, status=other.status
    )
    both = message._replace(others=(of_the_same_header,))
    assert codec.decode(encode_action(both)) == both


@pytest.mark.parametrize("mode", [SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT])
def test_everything_behind_the_security_header_is_encrypted(mode: SecurityMode) -> None:
    key = MessageKey(SecurityPolicy.AES256_CTR, bytes(range(68)))
    plain = encode_action(REQUEST)
    offset = payload_offset(plain)
    assert plain[offset] == 0x1D, "the ActionFlags are the first byte"
    secured = key.protect(plain, offset, 5, bytes(8), mode)
    heard = read_security(secured)
    assert heard.is_action
    assert (heard.publisher_id, heard.writer_group_id, heard.writer_ids) == (7, 3, (100,))
    assert (b"0.server" in secured) is (mode is SecurityMode.SIGN)
    assert key.unprotect(heard) == plain


def test_only_the_typed_remote_error_escapes() -> None:
    chance = Random(15)
    corpus = [encode_action(row[1]) for row in TABLE] + [bytes.fromhex(row[2]) for row in READ_ONLY]
    codec = Codec()
    causes: Counter[str] = Counter()
    for _ in range(30_000):
        data = bytearray(chance.choice(corpus))
        for _ in range(chance.randint(1, 4)):
            place = chance.randrange(len(data))
            if chance.random() < 0.2:
                del data[place:]
                data = data or bytearray(1)
            else:
                data[place] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.getrandbits(8)))
        try:
            decoded = codec.decode(bytes(data))
        except RemoteWireError as error:
            causes[error.cause] += 1
        else:
            causes[type(decoded).__name__] += 1
            if isinstance(decoded, ActionMessage):
                assert encode_action(decoded)
        assert annotate(bytes(data))
    assert causes["ActionMessage"] > 1000
    action_causes = {Cause.ACTION_FLAGS, Cause.ACTION_KIND, Cause.ACTION_STATE, Cause.ACTION_ENCODING}
    assert action_causes | {Cause.REQUESTOR_ID} <= set(causes)
