"""Message security: what is on the wire is that of the tables, and only the unchanged message of this key is opened."""

from __future__ import annotations

import hmac
import pickle
import random
import struct

import pytest
from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.ciphers.modes import ECB
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.wire.corpus import mutate, valid_messages
from tests.unit.wire.everything import chunked_messages, is_plain, secured_messages
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.wire import (
    Cause,
    Codec,
    MessageKey,
    SecurityMode,
    SecurityPolicy,
    payload_offset,
    read_security,
    security,
)
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage, PublisherIdType

AES128, AES256 = SecurityPolicy.AES128_CTR, SecurityPolicy.AES256_CTR
SIGN, ENCRYPT = SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT
NONCE = bytes.fromhex("a1b2c3d4 01000000")
PLAIN = bytes.fromhex("f101 0200 01 0300 01 0900") + bytes.fromhex("01 0100 0b 000000000000f83f")
HEAD = bytes.fromhex("f111 0200 01 0300 01 0900")
"""Of PLAIN, when it is secured."""
DISCOVERY = bytes.fromhex("919108 0700 00 00000000 00 01 0000") + bytes(8)
BYTE_ID = bytes.fromhex("11 07 01 0100 0b 000000000000f83f")
"""With a Byte PublisherId there is no ExtendedFlags1."""
PLAIN_MESSAGES = [message for message in [*valid_messages(), *chunked_messages()] if is_plain(message)]


def key_data(policy: SecurityPolicy, seed: int = 0) -> bytes:
    return random.Random(seed).randbytes(policy.key_data_bytes)


def make_key(policy: SecurityPolicy = AES256, seed: int = 0) -> MessageKey:
    return MessageKey(policy, key_data(policy, seed))


def protect(key: MessageKey, plain: bytes, mode: SecurityMode = ENCRYPT, token_id: int = 1) -> bytes:
    return key.protect(plain, payload_offset(plain), token_id, NONCE, mode)


def unprotect(key: MessageKey, datagram: bytes) -> bytes:
    return key.unprotect(read_security(datagram))


def cause_of(key: MessageKey, datagram: bytes) -> str:
    with pytest.raises(RemoteWireError) as caught:
        unprotect(key, datagram)
    return caught.value.cause


def sign(data: bytes, signed: bytes) -> bytes:
    return signed + hmac.digest(data[:32], signed, "sha256")


def encrypt(data: bytes, nonce: bytes, plain: bytes) -> bytes:
    """AES-CTR as tables 155 to 157 lay it out, made of single blocks."""
    block = Cipher(AES(data[32:-4]), ECB()).encryptor()
    counters = [data[-4:] + nonce + struct.pack(">I", 1 + number) for number in range((len(plain) + 15) // 16)]
    return bytes(a ^ b for a, b in zip(plain, b"".join(map(block.update, counters)), strict=False))


def test_policies() -> None:
    assert AES128 == "http://opcfoundation.org/UA/SecurityPolicy#PubSub-Aes128-CTR"
    assert SecurityPolicy("http://opcfoundation.org/UA/SecurityPolicy#PubSub-Aes256-CTR") is AES256
    assert [policy.key_data_bytes for policy in SecurityPolicy] == [52, 68]
    assert [SecurityPolicy.named(policy.short_name) for policy in SecurityPolicy] == list(SecurityPolicy)
    with pytest.raises(KeyError):
        SecurityPolicy.named("PubSub-Aes512-CTR")


# RFC 3686 section 6: its counter block is that of table 157 (nonce, initialization vector, block number from 1).
RFC_3686 = [
    ("AE6852F8121067CC4BF7A5765577F39E", "00000030", "0000000000000000", b"Single block msg"),
    ("7E24067817FAE0D743D6CE1F32539163", "006CB6DB", "C0543B59DA48D90B", bytes(range(32))),
    ("7691BE035E5020A8AC6E618529F9A0DC", "00E0017B", "27777F3F4A1786F0", bytes(range(36))),
    (
        "776BEFF2851DB06F4C8A0542C8696F6C6A81AF1EEC96B4D37FC1D689E6C1C104",
        "00000060",
        "DB5672C97AA8F0B2",
        b"Single block msg",
    ),
    (
        "F6D66D6BD52D59BB0796365879EFF886C66DD51A5B6A99744B50590C87A23884",
        "00FAAC24",
        "C1585EF15A43D875",
        bytes(range(32)),
    ),
    (
        "FF7A617CE69148E4F1726E2F43581DE2AA62D9F805532EDFF1EED687FB54153D",
        "001CC5B7",
        "51A51D70A1C11148",
        bytes(range(36)),
    ),
]
RFC_3686_CIPHERTEXTS = [
    "E4095D4FB7A7B3792D6175A3261311B8",
    "5104A106168A72D9790D41EE8EDAD388EB2E1EFC46DA57C8FCE630DF9141BE28",
    "C1CF48A89F2FFDD9CF4652E9EFDB72D74540A42BDE6D7836D59A5CEAAEF3105325B2072F",
    "145AD01DBF824EC7560863DC71E3E0C0",
    "F05E231B3894612C49EE000B804EB2A9B8306B508F839D6A5530831D9344AF1C",
    "EB6C52821D0BBBF7CE7594462ACA4FAAB407DF866569FD07F48CC0B583D6071F1EC0E6B8",
]


@pytest.mark.parametrize(
    ("encrypting_key", "key_nonce", "nonce", "plain", "ciphertext"),
    [(*vector, ciphertext) for vector, ciphertext in zip(RFC_3686, RFC_3686_CIPHERTEXTS, strict=True)],
)
def test_counter_block(encrypting_key: str, key_nonce: str, nonce: str, plain: bytes, ciphertext: str) -> None:
    data = bytes(range(32)) + bytes.fromhex(encrypting_key + key_nonce)
    policy = AES128 if len(data) == AES128.key_data_bytes else AES256
    head = PLAIN[:10]
    datagram = MessageKey(policy, data).protect(head + plain, len(head), 9, bytes.fromhex(nonce), ENCRYPT)
    header = bytes.fromhex("03 09000000 08" + nonce)
    assert datagram == sign(data, HEAD + header + bytes.fromhex(ciphertext))
    assert unprotect(MessageKey(policy, data), datagram) == head + plain


@pytest.mark.parametrize("policy", SecurityPolicy)
def test_bytes_on_the_wire(policy: SecurityPolicy) -> None:
    data, key = key_data(policy), make_key(policy)
    payload = PLAIN[10:]
    header = bytes.fromhex("04030201 08") + NONCE
    assert protect(key, PLAIN, SIGN, 0x01020304) == sign(data, HEAD + b"\1" + header + payload)
    encrypted = encrypt(data, NONCE, payload)
    assert protect(key, PLAIN, ENCRYPT, 0x01020304) == sign(data, HEAD + b"\3" + header + encrypted)


def test_no_extended_flags_1_before_and_after() -> None:
    key, data = make_key(), key_data(AES256)
    secured = protect(key, BYTE_ID, SIGN)
    assert secured == sign(data, bytes.fromhex("91 10 07") + b"\1\1\0\0\0\x08" + NONCE + BYTE_ID[2:])
    assert unprotect(key, secured) == BYTE_ID


def test_the_empty_security_header_of_discovery_is_replaced_and_comes_back() -> None:
    key, data = make_key(), key_data(AES256)
    secured = protect(key, DISCOVERY)
    body = encrypt(data, NONCE, DISCOVERY[11:])
    assert secured == sign(data, DISCOVERY[:5] + b"\3\1\0\0\0\x08" + NONCE + body)
    heard = read_security(secured)
    assert (heard.is_discovery, heard.header_offset, heard.payload_offset) == (True, 5, 19)
    assert unprotect(key, secured) == DISCOVERY


@pytest.mark.parametrize("policy", SecurityPolicy)
@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
def test_every_message_comes_back_and_decodes_as_before(policy: SecurityPolicy, mode: SecurityMode) -> None:
    assert len(PLAIN_MESSAGES) > 50
    key, codec = make_key(policy), Codec()
    for plain in [*PLAIN_MESSAGES, *PLAIN_MESSAGES]:  # also with heads and plans that are known
        secured = protect(key, plain, mode)
        assert len(secured) <= len(plain) + security.MOST_ADDED_BYTES
        opened = unprotect(key, secured)
        assert opened == plain
        try:
            codec.decode(opened)
        except RemoteWireError as error:
            assert error.cause == Cause.CHUNK  # noqa: PT017 - a message in most cases
        with pytest.raises(RemoteWireError) as caught:
            codec.decode(secured)
        assert caught.value.cause == Cause.SECURED


@given(
    policy=st.sampled_from(SecurityPolicy),
    mode=st.sampled_from([SIGN, ENCRYPT]),
    token_id=st.integers(0, 0xFFFF_FFFF),
    nonce=st.binary(min_size=8, max_size=8),
    force_key_reset=st.booleans(),
    head=st.sampled_from(PLAIN_MESSAGES).map(lambda plain: plain[: payload_offset(plain)]),
    payload=st.binary(max_size=100),
)
def test_round_trip(
    policy: SecurityPolicy,
    mode: SecurityMode,
    token_id: int,
    nonce: bytes,
    force_key_reset: bool,
    head: bytes,
    payload: bytes,
) -> None:
    key = make_key(policy)
    plain = head + payload
    secured = key.protect(plain, len(head), token_id, nonce, mode, force_key_reset=force_key_reset)
    before, after = read_security(plain), read_security(secured)
    assert after[1:7] == before[1:7]
    assert (after.mode, after.token_id, after.nonce, after.footer_size) == (mode, token_id, nonce, 0)
    assert after.force_key_reset == force_key_reset
    assert (before.mode, before.payload_offset, before.nonce) == (SecurityMode.NONE, len(head), b"")
    assert make_key(policy).unprotect(after) == plain


def test_one_key_in_several_forms() -> None:
    """What a key remembers of one token id, mode or flag is not taken for another."""
    key = make_key()
    for token_id in (1, 2, 1):
        for mode in (SIGN, ENCRYPT, SIGN):
            for force_key_reset in (False, True, False):
                for plain in (PLAIN, BYTE_ID, DISCOVERY):
                    offset = payload_offset(plain)
                    secured = key.protect(plain, offset, token_id, NONCE, mode, force_key_reset=force_key_reset)
                    fresh = make_key().protect(plain, offset, token_id, NONCE, mode, force_key_reset=force_key_reset)
                    assert secured == fresh
                    heard = read_security(secured)
                    assert (heard.token_id, heard.mode, heard.force_key_reset) == (token_id, mode, force_key_reset)
                    assert key.unprotect(heard) == plain


def test_signed_without_token_and_nonce() -> None:
    """Table 154 taken literally: a message that is only signed has token id 0 and no nonce."""
    datagram = sign(key_data(AES256), HEAD + bytes.fromhex("01 00000000 00") + PLAIN[10:])
    heard = read_security(datagram)
    assert (heard.mode, heard.token_id, heard.nonce) == (SIGN, 0, b"")
    assert make_key().unprotect(heard) == PLAIN


@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
@pytest.mark.parametrize("size", [0, 1, 500])
def test_security_footer(mode: SecurityMode, size: int) -> None:
    """It ends the payload, encrypted or not: of a stream cipher both are read the same way, and it is not looked at."""
    data = key_data(AES256)
    payload = encrypt(data, NONCE, PLAIN[10:]) if mode is ENCRYPT else PLAIN[10:]
    flags = 7 if mode is ENCRYPT else 5
    header = struct.pack("<BIB8sH", flags, 1, 8, NONCE, size)
    heard = read_security(sign(data, HEAD + header + payload + b"\xaa" * size))
    assert (heard.mode, heard.footer_size) == (mode, size)
    assert make_key().unprotect(heard) == PLAIN


def test_several_data_set_messages_are_encrypted_with_their_sizes() -> None:
    parts = tuple(DataSetMessage(number, types=(11,), values=(1.5,)) for number in (1, 2, 3))
    plain = Codec().encode(NetworkMessage(2, PublisherIdType.UINT16, writer_group_id=2, messages=parts))
    secured = protect(make_key(), plain)
    heard = read_security(secured)
    assert heard.writer_ids == (1, 2, 3)
    assert secured[heard.payload_offset :][:6] != plain[payload_offset(plain) :][:6]
    assert secured[: heard.header_offset][2:] == plain[: payload_offset(plain)][2:]


def test_force_key_reset_only_of_a_signed_message() -> None:
    secured = make_key().protect(PLAIN, 10, 1, NONCE, SIGN, force_key_reset=True)
    assert read_security(secured).force_key_reset
    assert cause_of(make_key(), secured.replace(HEAD + b"\x09", HEAD + b"\x08")) == Cause.SECURITY_FLAGS


@pytest.mark.parametrize("plain", [PLAIN, BYTE_ID, DISCOVERY, chunked_messages()[0]])
@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
def test_every_flipped_bit_is_refused(plain: bytes, mode: SecurityMode) -> None:
    key = make_key()
    secured = protect(key, plain, mode)
    assert unprotect(key, secured) == plain
    for bit in range(8 * len(secured)):
        changed = bytearray(secured)
        changed[bit // 8] ^= 1 << bit % 8
        assert cause_of(key, bytes(changed)) in set(Cause)


@pytest.mark.parametrize("plain", [PLAIN, BYTE_ID, DISCOVERY])
@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
def test_every_other_length_is_refused(plain: bytes, mode: SecurityMode) -> None:
    key = make_key()
    secured = protect(key, plain, mode)
    for size in range(len(secured)):
        assert cause_of(key, secured[:size]) in (Cause.TRUNCATED, Cause.SIGNATURE)
    for more in (b"\0", b"\xff", bytes(32), secured[-32:]):
        assert cause_of(key, secured + more) == Cause.SIGNATURE


@pytest.mark.parametrize("policy", SecurityPolicy)
@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
def test_another_key_refuses(policy: SecurityPolicy, mode: SecurityMode) -> None:
    secured = protect(make_key(policy), PLAIN, mode)
    for other in SecurityPolicy:
        assert cause_of(make_key(other, seed=1), secured) == Cause.SIGNATURE


def test_swapped_keys() -> None:
    """A key put together of two: with the other's signing half it refuses, with its encrypting half it reads noise.

    Nothing can tell that noise from data, so key data is never taken apart: files and services hold it whole.
    """
    ours, theirs = key_data(AES256, 0), key_data(AES256, 1)
    secured = protect(MessageKey(AES256, ours), PLAIN)
    assert cause_of(MessageKey(AES256, theirs[:32] + ours[32:]), secured) == Cause.SIGNATURE
    for other in (ours[:32] + theirs[32:], ours[:64] + theirs[64:]):
        opened = unprotect(MessageKey(AES256, other), secured)
        assert opened[:10] == PLAIN[:10]
        assert opened[10:] != PLAIN[10:]


def test_nothing_is_decrypted_before_it_is_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    key = make_key()
    secured = bytearray(protect(key, PLAIN))
    secured[-1] ^= 1

    def decrypt(_: bytes) -> bytes:
        raise AssertionError

    monkeypatch.setattr(key, "_update", decrypt)
    assert cause_of(key, bytes(secured)) == Cause.SIGNATURE
    secured[-1] ^= 1
    with pytest.raises(AssertionError):
        unprotect(key, bytes(secured))


def test_a_refused_message_changes_nothing() -> None:
    key = make_key()
    secured = protect(key, PLAIN)
    forged = secured[:2] + b"\7" + secured[3:]
    for _ in range(3):
        assert cause_of(key, forged) == Cause.SIGNATURE
        assert unprotect(key, secured) == PLAIN
    assert protect(key, PLAIN) == secured


def test_a_plain_message_is_not_opened() -> None:
    for plain in (PLAIN, DISCOVERY):
        assert cause_of(make_key(), plain + bytes(32)) == Cause.SIGNATURE
        assert cause_of(make_key(), sign(key_data(AES256), plain)) == Cause.SIGNATURE


def test_keys_are_not_shown() -> None:
    data = bytes(range(100, 168))
    key = MessageKey(AES256, data)
    assert repr(key) == str(key) == f"{key}" == "MessageKey(PubSub-Aes256-CTR)"
    assert not hasattr(key, "__dict__")
    with pytest.raises(TypeError):
        pickle.dumps(key)
    with pytest.raises(LocalWireError) as caught:
        MessageKey(AES128, data)
    assert str(caught.value) == "the key data of PubSub-Aes128-CTR has 52 bytes, not 68"


def test_what_cannot_be_protected() -> None:
    key = make_key()
    secured = protect(key, PLAIN)
    for size in (0, 7, 9):
        with pytest.raises(LocalWireError, match="8 bytes"):
            key.protect(PLAIN, 10, 1, bytes(size), SIGN)
    for token_id in (-1, 1 << 32):
        with pytest.raises(LocalWireError, match="UInt32"):
            key.protect(PLAIN, 10, token_id, NONCE, SIGN)
    with pytest.raises(LocalWireError, match="mode None"):
        key.protect(PLAIN, 10, 1, NONCE, SecurityMode.NONE)
    with pytest.raises(LocalWireError, match="secured already"):
        key.protect(secured, 10, 1, NONCE, SIGN)
    with pytest.raises(LocalWireError, match="secured already"):
        payload_offset(secured)
    with pytest.raises(LocalWireError, match="secured already"):
        payload_offset(protect(key, DISCOVERY))
    with pytest.raises(LocalWireError, match="cannot be secured"):
        key.protect(b"\2\2\2", 1, 1, NONCE, SIGN)
    for offset in (9, 11, len(PLAIN)):
        with pytest.raises(LocalWireError):
            key.protect(PLAIN, offset, 1, NONCE, SIGN)
    with_a_nonce = DISCOVERY[:5] + bytes.fromhex("00 00000000 08") + bytes(8) + DISCOVERY[11:]
    with pytest.raises(LocalWireError, match="secured already"):
        key.protect(with_a_nonce, payload_offset(with_a_nonce), 1, NONCE, SIGN)
    with pytest.raises(RemoteWireError):
        payload_offset(b"\2\2\2")


def test_what_a_key_remembers_is_bounded() -> None:
    key = make_key()
    for number in range(2 * security.MOST_HEADS):
        plain = PLAIN[:8] + struct.pack("<H", number) + PLAIN[10:]
        assert unprotect(key, protect(key, plain)) == plain
    for name in ("_plain_heads", "_secured_heads"):
        assert len(getattr(key, name)) == security.MOST_HEADS
    long = Codec().encode(NetworkMessage("r" * 1000, PublisherIdType.STRING, messages=(DataSetMessage(1),)))
    assert unprotect(key, protect(key, long)) == long
    for name in ("_plain_heads", "_secured_heads"):
        assert max(map(len, getattr(key, name))) <= security.LONGEST_HEAD


@settings(max_examples=50)
@given(seed=st.integers(0, 1 << 32))
def test_the_short_way_reads_what_the_long_way_reads(seed: int) -> None:
    chance = random.Random(seed)
    usual = [protect(make_key(), PLAIN, mode) for mode in (SIGN, ENCRYPT)] + [PLAIN + bytes(20)]
    for _ in range(50):
        datagram = mutate(chance, usual)
        try:
            expected: object = security._read_any(datagram)  # pyright: ignore[reportPrivateUsage]
        except RemoteWireError as error:
            with pytest.raises(RemoteWireError) as caught:
                read_security(datagram)
            assert str(caught.value) == str(error)  # noqa: PT017 - both raise the same
        else:
            assert read_security(datagram) == expected


def test_whatever_has_a_head_is_secured_and_opened_or_refused() -> None:
    """Also what is no message: the payload is nothing but bytes here."""
    chance, key, corpus = random.Random(3), make_key(), [*PLAIN_MESSAGES, *secured_messages()[::9]]
    secured = 0
    for _ in range(5_000):
        plain = mutate(chance, corpus)
        try:
            datagram = protect(key, plain, chance.choice((SIGN, ENCRYPT)))
        except (LocalWireError, RemoteWireError):
            continue
        opened = unprotect(key, datagram)
        assert opened[payload_offset(opened) :] == plain[payload_offset(plain) :]
        secured += 1
    assert secured > 2_000


def test_offsets_of_every_secured_message() -> None:
    for datagram in secured_messages():
        heard = read_security(datagram)
        assert 0 < heard.header_offset < heard.payload_offset <= len(datagram) - security.SIGNATURE_BYTES
        assert datagram[heard.payload_offset - 8 : heard.payload_offset] == heard.nonce
