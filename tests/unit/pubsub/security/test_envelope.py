"""What is let in, and as what the rest is counted."""

from __future__ import annotations

import contextlib
import hmac
import struct
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.pubsub.publishing import CODEC
from tests.unit.pubsub.security.securing import (
    AES256,
    ENCRYPT,
    NONE,
    SIGN,
    action,
    announcement,
    data,
    envelope,
    group_keys,
    key_data,
    one,
    probe,
    refusal,
)
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.groups import MOST_KEYLESS
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.pubsub.security.nonces import MemoryNonces, NoncesUnavailable
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.wire import MessageKey, SecurityMode, SecurityPolicy, payload_offset, read_security
from ua_fleet.wire.chunks import split
from ua_fleet.wire.messages import NetworkMessage
from ua_fleet.wire.security import MOST_ADDED_BYTES

VECTORS = Path(__file__).parents[3] / "vectors"
PLAIN = data()
PLAINS = {"data": PLAIN, "announcement": announcement(), "timestamped": data(timestamp=5, group_version=3)}


def sender(mode: SecurityMode = ENCRYPT, **more: object) -> Envelope:
    return envelope(1, "t-1", "c-1", mode=mode, **more)  # type: ignore[arg-type]


def reader(mode: SecurityMode = ENCRYPT, **more: object) -> Envelope:
    return envelope(0, "t-1", "c-1", mode=mode, **more)  # type: ignore[arg-type]


def protected(plain: bytes, data_of_key: bytes, *, token_id: int = 1, number: int = 1, **more: bool) -> bytes:
    """A message as a member makes it that is not one of our processes."""
    key = MessageKey(AES256, data_of_key)
    nonce = struct.pack("<II", 0xDEAD, number)
    return key.protect(plain, payload_offset(plain), token_id, nonce, ENCRYPT, **more)


@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
@pytest.mark.parametrize("plain", PLAINS.values(), ids=PLAINS.keys())
def test_what_is_sealed_is_opened(mode: SecurityMode, plain: bytes) -> None:
    sealed = one(sender(mode).seal(plain, 0.0))
    heard = read_security(sealed)
    assert (heard.mode, heard.token_id, struct.unpack("<H2xI", heard.nonce)) == (mode, 1, (1, 1))
    assert len(sealed) <= len(plain) + MOST_ADDED_BYTES
    assert (plain[-5:] in sealed) is (mode is SIGN)
    assert reader(mode).open(sealed, 0.0) == plain


@pytest.mark.parametrize("policy", SecurityPolicy)
def test_both_policies(policy: SecurityPolicy) -> None:
    both = sender(), reader()
    for one_of_them in both:
        one_of_them.install("t-1", group_keys(9, policy=policy), 0.0)
    assert both[1].open(one(both[0].seal(PLAIN, 0.0)), 0.0) == PLAIN


def test_without_security_nothing_changes() -> None:
    one_side = envelope(1, mode=NONE)
    for plain in (*PLAINS.values(), probe(), action()):
        assert one_side.seal(plain, 0.0) == [plain]
        assert one_side.open(plain, 0.0) is not None
    assert one_side.open(PLAIN, 0.0) is PLAIN
    assert one_side.groups_wanted() == []


@pytest.mark.parametrize("junk", [b"", b"\x11", b"\x91", b"\xf1\x91"])
@pytest.mark.parametrize("mode", SecurityMode)
def test_what_is_too_short_to_be_a_message(mode: SecurityMode, junk: bytes) -> None:
    with contextlib.suppress(RemoteWireError):
        assert reader(mode).open(junk, 0.0) == junk


def test_each_message_has_a_nonce_of_its_own() -> None:
    one_side = sender()
    sealed = [one(one_side.seal(PLAIN, 0.0)) for _ in range(100)]
    assert len({read_security(datagram).nonce for datagram in sealed}) == 100
    assert len({datagram[24:] for datagram in sealed}) == 100, "not two are encrypted alike"


@pytest.mark.parametrize(
    ("sent", "wanted", "drop"),
    [
        (NONE, SIGN, Drop.NOT_SECURED),
        (NONE, ENCRYPT, Drop.NOT_SECURED),
        (SIGN, ENCRYPT, Drop.NOT_SECURED),
        (ENCRYPT, SIGN, None),
    ],
)
@pytest.mark.parametrize("plain", [PLAIN, announcement(), action()], ids=["data", "announcement", "action"])
def test_a_message_has_at_least_the_mode(
    sent: SecurityMode, wanted: SecurityMode, drop: Drop | None, plain: bytes
) -> None:
    datagram = one(sender(sent).seal(plain, 0.0))
    if drop is None:
        assert reader(wanted).open(datagram, 0.0) == plain
    else:
        assert refusal(reader(wanted), datagram) is drop


def test_every_changed_byte_is_refused() -> None:
    sealed = one(sender().seal(PLAIN, 0.0))
    opening = reader()
    for at in range(len(sealed)):
        changed = sealed[:at] + bytes([sealed[at] ^ 1]) + sealed[at + 1 :]
        with pytest.raises(RemoteWireError):
            opening.open(changed, 0.0)
    assert opening.open(sealed, 0.0) == PLAIN, "none of them has moved the window"


def test_wrong_keys() -> None:
    assert refusal(reader(seed="other"), one(sender().seal(PLAIN, 0.0))) is Drop.BAD_SIGNATURE


def test_swapped_keys() -> None:
    swapped = envelope(0)
    for group_id, other in (("t-1", "t-2"), ("t-2", "t-1")):
        swapped.install(group_id, group_keys(seed=f"0{other}"), 0.0)
    for space in (1, 2):
        sealed = one(envelope(space, f"t-{space}").seal(data(publisher_id=space), 0.0))
        assert refusal(swapped, sealed) is Drop.BAD_SIGNATURE


@pytest.mark.parametrize(
    ("plain", "group_id"),
    [(data(publisher_id=2), "t-1"), (action(publisher_id=1), "t-1"), (data(publisher_id=1), "c-1")],
    ids=["in another's name", "a command without its key", "data with the key of commands"],
)
def test_a_member_of_one_group_that_signs_for_another(plain: bytes, group_id: str) -> None:
    opening = envelope(0, "t-1", "t-2", "c-1")
    assert refusal(opening, protected(plain, key_data(1, f"0{group_id}"))) is Drop.BAD_SIGNATURE


def test_replayed() -> None:
    one_side, opening = sender(), reader()
    first, second, third = (one(one_side.seal(PLAIN, 0.0)) for _ in range(3))
    assert opening.open(first, 0.0) == opening.open(third, 0.0) == opening.open(second, 0.0) == PLAIN
    for datagram in (first, second, third):
        assert refusal(opening, datagram) is Drop.REPLAYED


def test_replay_may_be_relaxed_for_a_publisher() -> None:
    opening = envelope(0, "t-1", "t-2", relaxed_replay=(1,))
    for space, again in ((1, None), (2, Drop.REPLAYED)):
        plain = data(publisher_id=space)
        sealed = one(envelope(space, f"t-{space}").seal(plain, 0.0))
        assert opening.open(sealed, 0.0) == plain
        if again is None:
            assert opening.open(sealed, 0.0) == plain
        else:
            assert refusal(opening, sealed) is again


def test_replay_of_commands_is_never_relaxed() -> None:
    requestor, responder = envelope(0, "t-0", "c-1"), envelope(1, "t-1", "c-1", relaxed_replay=(1,))
    sealed = one(requestor.seal(action(), 0.0))
    assert responder.open(sealed, 0.0) == action()
    assert refusal(responder, sealed) is Drop.REPLAYED


def test_a_key_reset_does_not_open_the_window_again() -> None:
    sealed = one(sender().seal(PLAIN, 0.0))
    opening = reader()
    assert opening.open(sealed, 0.0) == PLAIN
    opening.install("t-1", group_keys(seed="0t-1", next_s=30.0), 30.0)
    assert refusal(opening, sealed, 30.0) is Drop.REPLAYED


def test_unknown_token() -> None:
    opening = reader()
    datagram = protected(PLAIN, key_data(9, "0t-1"), token_id=9)
    assert opening.keys_wanted(0.0) == ["t-0"]
    assert refusal(opening, datagram) is Drop.UNKNOWN_TOKEN
    assert opening.keys_wanted(0.0) == ["t-0", "t-1"]
    opening.install("t-1", group_keys(9, seed="0t-1"), 0.0)
    assert opening.keys_wanted(0.0) == ["t-0"]
    assert opening.open(datagram, 0.0) == PLAIN


def test_a_publisher_can_ask_all_to_fetch_keys_but_only_with_its_signature() -> None:
    opening = reader()
    flagged = protected(PLAIN, key_data(1, "0t-1"), force_key_reset=True)
    assert refusal(opening, flagged[:-1] + b"x") is Drop.BAD_SIGNATURE
    assert opening.keys_wanted(0.0) == ["t-0"]
    assert opening.open(flagged, 0.0) == PLAIN
    assert opening.keys_wanted(0.0) == ["t-0", "t-1"]


def test_own_data_is_dropped_before_anything_is_verified() -> None:
    one_side = sender()
    sealed = one(one_side.seal(PLAIN, 0.0))
    for datagram in (sealed, sealed[:-1] + b"x", PLAIN, announcement(), one(one_side.seal(announcement(), 0.0))):
        assert refusal(one_side, datagram) is Drop.LOOP


def test_commands_to_ourselves_are_read() -> None:
    requestor, responder = envelope(0, "c-1"), envelope(1, "c-1")
    assert responder.open(one(requestor.seal(action(), 0.0)), 0.0) == action()
    assert requestor.open(one(responder.seal(action(b"response"), 0.0)), 0.0) == action(b"response")


def test_requestors_have_windows_of_their_own() -> None:
    responder = envelope(1, "c-1")
    requestors = [envelope(space, "c-1") for space in (0, 2, 3)]
    for _ in range(3):
        for requestor in requestors:
            sealed = one(requestor.seal(action(), 0.0))
            assert responder.open(sealed, 0.0) == action()
            assert refusal(responder, sealed) is Drop.REPLAYED


def test_commands_of_others_are_not_for_us() -> None:
    bystander = envelope(3, "t-1")
    assert bystander.open(one(sender().seal(action(), 0.0)), 0.0) is None
    assert bystander.open(action(), 0.0) is None
    assert bystander.groups_wanted() == ["t-3", "t-1"]


def test_commands_to_others_cannot_be_sent() -> None:
    counters = Counters()
    outsider = envelope(3, "t-1", counters=counters)
    assert outsider.seal(action(), 0.0) == []
    assert counters.drops == {Drop.NO_KEY: 1}
    assert outsider.problem == "this process is not in the SecurityGroup c-1"


def test_probes_are_not_secured() -> None:
    asking, asked = envelope(0), sender()
    datagram = one(asking.seal(probe(), 0.0))
    assert datagram == probe()
    assert asked.open(datagram, 0.0) == probe()


def test_a_probe_that_somebody_signed_is_verified() -> None:
    asked = sender()
    signed = protected(probe(), key_data(1, "0t-1"))
    assert asked.open(signed, 0.0) == probe()
    assert asked.open(signed, 0.0) == probe(), "asking again is no attack"
    assert refusal(asked, signed[:-1] + b"x") is Drop.BAD_SIGNATURE
    sealed = one(asked.seal(PLAIN, 0.0))
    assert reader().open(sealed, 0.0) == PLAIN


def test_a_message_without_nonce_and_token_is_taken_only_where_replay_is_relaxed() -> None:
    """The form of table 154; nothing in it could tell it from a replay."""
    secured = bytearray(protected(PLAIN, key_data(1, "0t-1")))
    head = bytes(secured[:10]) + struct.pack("<BIB", 0x01, 0, 0) + PLAIN[10:]
    strict, relaxed = reader(SIGN), reader(SIGN, relaxed_replay=(1,))
    for key, drop in ((key_data(1, "0t-1"), None), (key_data(1, "other"), Drop.BAD_SIGNATURE)):
        datagram = head + _hmac(key, head)
        assert refusal(strict, datagram) is Drop.REPLAYED
        if drop is None:
            assert relaxed.open(datagram, 0.0) == PLAIN
        else:
            assert refusal(relaxed, datagram) is drop
    assert refusal(reader(ENCRYPT, relaxed_replay=(1,)), head + bytes(32)) is Drop.NOT_SECURED


def _hmac(key: bytes, message: bytes) -> bytes:
    return hmac.digest(key[:32], message, "sha256")


@pytest.mark.parametrize("kind", [0, 2, 3, 4])
def test_publishers_that_are_no_space_have_no_group(kind: int) -> None:
    foreign = data(publisher_id="one" if kind == 4 else 1, publisher_id_type=kind)  # type: ignore[arg-type]
    opening = envelope(3, "t-2")
    assert refusal(opening, protected(foreign, key_data(1))) is Drop.UNKNOWN_SOURCE
    assert opening.groups_wanted() == ["t-3", "t-2"]


def test_publishers_that_are_heard_are_wanted_but_not_without_bound() -> None:
    opening = envelope(0, "t-1", asks_for_all=True)
    for space in range(2, 3000):
        plain = data(publisher_id=space)
        assert refusal(opening, plain) is Drop.NOT_SECURED
        assert refusal(opening, protected(plain, key_data(1))) is Drop.UNKNOWN_TOKEN
    wanted = opening.groups_wanted()
    assert len(wanted) == 2 + MOST_KEYLESS
    assert wanted[:2] == ["t-0", "t-1"]
    assert wanted[-1] == "t-2999"
    opening.install("t-2999", group_keys(seed="new"), 0.0)
    assert opening.open(protected(data(publisher_id=2999), key_data(1, "new")), 0.0) is not None


def test_publishers_that_nobody_configured_make_nobody_ask_for_keys() -> None:
    """Anybody can write any PublisherId: what the key service is asked for stands in fleet.yaml."""
    opening = envelope(0, "t-1")
    for space in range(2, 3000):
        assert refusal(opening, protected(data(publisher_id=space), key_data(1))) is Drop.UNKNOWN_TOKEN
        assert refusal(opening, announcement(space)) is Drop.NOT_SECURED
    assert opening.groups_wanted() == ["t-0", "t-1"]
    with pytest.raises(DatagramRefused, match="no publisher of fleet"):
        opening.open(protected(data(publisher_id=7), key_data(1)), 0.0)


def test_no_message_of_an_insider_keeps_the_publisher_out() -> None:
    """Whoever reads a publisher has its keys, and can write its nonces."""
    honest, opening = sender(), reader()
    assert opening.open(one(honest.seal(PLAIN, 0.0)), 0.0) == PLAIN
    for number in (1 << 30, 0xFFFF_FFFF, 70_000, 1 << 20, 3 << 30):
        forged = protected(PLAIN, key_data(1, "0t-1"), number=number)
        assert opening.open(forged, 0.0) == PLAIN
        for _ in range(3):
            assert opening.open(one(honest.seal(PLAIN, 0.0)), 0.0) == PLAIN
        assert refusal(opening, forged) is Drop.REPLAYED


def test_probes_in_chunks_do_not_destroy_the_messages_of_others() -> None:
    honest, counters = sender(max_datagram_bytes=1400), Counters()
    opening = reader(counters=counters)
    large = data("x" * 40_000)
    whole = 0
    for _ in range(20):
        chunks = honest.seal(large, 0.0)
        for number, chunk in enumerate(chunks):
            for fake in range(3):
                probe_chunk = split(probe() + bytes(60_000), 1400, (number * 3 + fake) & 0xFFFF)[0]
                assert refusal(opening, probe_chunk) is Drop.NOT_SECURED
            whole += opening.open(chunk, 0.0) == large
    assert whole == 20
    assert counters.drops[Drop.CHUNK_LOST] == 0


@pytest.mark.parametrize("name", ["", "t-", "x-1", "t-01", "t-65536", "t--1", "c-1 ", "t-1\n"])
def test_what_is_no_name_of_a_group(name: str) -> None:
    with pytest.raises(LocalWireError, match="they are called t-<space>, c-<space> and r-<relay>"):
        envelope(0).want(name)


def test_without_a_key_nothing_is_sent() -> None:
    counters = Counters()
    one_side = envelope(1, counters=counters)
    assert one_side.groups_wanted() == ["t-1"]
    assert one_side.seal(PLAIN, 0.0) == []
    assert counters.drops == {Drop.NO_KEY: 1}
    assert one_side.problem.startswith("no key of t-1, or it expired; ")
    one_side.install("t-1", group_keys(next_s=10.0, lifetime_s=10.0, count=1), 0.0)
    assert len(one_side.seal(PLAIN, 29.9)) == 1
    assert one_side.problem == ""
    assert one_side.seal(PLAIN, 30.0) == []


def test_without_a_nonce_nothing_is_sent() -> None:
    class Broken(MemoryNonces):
        def reserve(self, group_id: str, token_id: int, count: int) -> int:
            raise NoncesUnavailable("the disk is full")

    counters = Counters()
    one_side = sender(nonces=Broken(), counters=counters)
    assert one_side.seal(PLAIN, 0.0) == []
    assert (counters.drops, one_side.problem) == ({Drop.NO_KEY: 1}, "the disk is full")


def test_a_new_token_has_new_numbers() -> None:
    one_side, opening = sender(), reader()
    heard = [read_security(one(one_side.seal(PLAIN, now))) for now in (0.0, 59.0, 60.0, 61.0, 120.0)]
    assert [(one_of.token_id, one_of.nonce[4]) for one_of in heard] == [(1, 1), (1, 2), (2, 1), (2, 2), (3, 1)]
    assert all(opening.open(one_of.datagram, 60.0) == PLAIN for one_of in heard)


def test_a_secured_message_is_not_sealed_again() -> None:
    one_side = sender()
    with pytest.raises(LocalWireError, match="secured already"):
        one_side.seal(one(one_side.seal(PLAIN, 0.0)), 0.0)


@pytest.mark.parametrize("mode", SecurityMode)
@pytest.mark.parametrize("most", [576, 1400, 65_507])
def test_large_messages_go_as_chunks_each_with_its_own_nonce(mode: SecurityMode, most: int) -> None:
    plain = data("z" * 100_000)
    one_side, opening = sender(mode, max_datagram_bytes=most), reader(mode)
    sealed = one_side.seal(plain, 0.0)
    assert max(map(len, sealed)) <= most
    assert len(sealed) > 1
    if mode is not NONE:
        assert len({read_security(datagram).nonce for datagram in sealed}) == len(sealed)
    Random(1).shuffle(sealed)
    # The window begins with the first number that is heard, so what is older must not come before it.
    sealed.sort(key=lambda datagram: read_security(datagram).nonce[4:] != b"\1\0\0\0")
    *early, last = sealed
    assert [opening.open(datagram, 0.0) for datagram in early] == [None] * len(early)
    assert opening.next_deadline() == 2.0
    assert opening.open(last, 0.0) == plain
    assert opening.next_deadline() is None


def test_chunks_whose_message_does_not_come_are_given_up() -> None:
    counters = Counters()
    opening = reader(counters=counters)
    opening.open(sender().seal(data("z" * 100_000), 0.0)[0], 0.0)
    opening.poll(2.0)
    assert counters.drops == {Drop.CHUNK_LOST: 1}


def test_large_announcements_go_as_chunks() -> None:
    one_side, opening = sender(max_datagram_bytes=576), reader()
    plain = announcement() + bytes(2_000)
    wholes = [whole for sealed in one_side.seal(plain, 0.0) if (whole := opening.open(sealed, 0.0)) is not None]
    assert wholes == [plain]


def test_own_chunks_that_come_back_are_dropped_without_keeping_them() -> None:
    for mode in SecurityMode:
        one_side = sender(mode)
        for datagram in one_side.seal(data("z" * 100_000), 0.0):
            assert refusal(one_side, datagram) is Drop.LOOP
        assert one_side.next_deadline() is None


def test_chunks_that_are_not_signed_never_reach_the_message() -> None:
    plain = data("z" * 100_000)
    opening = reader()
    assert refusal(opening, sender(NONE).seal(plain, 0.0)[0]) is Drop.NOT_SECURED
    assert opening.next_deadline() is None


def test_nothing_shows_a_key() -> None:
    opening = reader()
    shown = [repr(opening), str(opening)]
    for datagram in (PLAIN, protected(PLAIN, key_data(1, "other")), protected(PLAIN, key_data(9), token_id=9)):
        with pytest.raises(RemoteWireError) as caught:
            opening.open(datagram, 0.0)
        shown += [repr(caught.value), str(caught.value), repr(vars(caught.value))]
    text = "".join(shown)
    for token_id in (1, 2, 3):
        for group_id in ("t-1", "c-1"):
            secret = key_data(token_id, f"0{group_id}")
            assert secret.hex() not in text
            assert repr(secret)[2:-1] not in text


@pytest.mark.parametrize(
    ("file", "mode", "policy"),
    [
        ("peer_sign256.hex", SIGN, SecurityPolicy.AES256_CTR),
        ("peer_enc128.hex", ENCRYPT, SecurityPolicy.AES128_CTR),
    ],
)
def test_open62541_never_changes_its_numbers(file: str, mode: SecurityMode, policy: SecurityPolicy) -> None:
    """A strict window takes one of its messages; a relaxed one takes all."""
    datagrams = [bytes.fromhex(line) for line in (VECTORS / file).read_text().split()]
    keys = GroupKeys(policy, 1, (bytes(range(policy.key_data_bytes)),), 60.0, 60.0)
    strict, relaxed = envelope(0, mode=mode), envelope(0, mode=mode, relaxed_replay=(2234,))
    for opening in (strict, relaxed):
        opening.install("t-2234", keys, 0.0)
    for datagram in datagrams:
        plain = relaxed.open(datagram, 0.0)
        assert plain is not None
        message = CODEC.decode(plain)
        assert isinstance(message, NetworkMessage)
        assert message.messages[0].values[-1] == "robot-7"
    assert strict.open(datagrams[0], 0.0) is not None
    assert len(datagrams) > 1
    assert {refusal(strict, datagram) for datagram in datagrams} == {Drop.REPLAYED}


@settings(max_examples=300)
@given(st.data())
def test_whatever_comes_only_remote_errors_go_out(draw: st.DataObject) -> None:
    mode = draw.draw(st.sampled_from(SecurityMode))
    opening, sealing = reader(mode), sender(draw.draw(st.sampled_from(SecurityMode)), max_datagram_bytes=576)
    known = [part for plain in (*PLAINS.values(), action(), data("z" * 2_000)) for part in sealing.seal(plain, 0.0)]
    datagram = bytearray(draw.draw(st.one_of(st.sampled_from(known), st.binary(max_size=100))))
    for at in draw.draw(st.lists(st.integers(0, max(len(datagram) - 1, 0)), max_size=4)):
        if datagram:
            datagram[at] = draw.draw(st.integers(0, 255))
    with contextlib.suppress(RemoteWireError):
        assert isinstance(opening.open(bytes(datagram[: draw.draw(st.integers(0, 100_000))]), 0.0), bytes | None)
