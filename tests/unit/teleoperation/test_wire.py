"""Setpoints under the keys of commands: who can read them, and that they are never taken for data."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.security.securing import ENCRYPT, NONE, SIGN, action, data, envelope, group_keys, one, refusal
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.events import SetpointReceived
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.teleoperation import Setpoint, SetpointAddress
from ua_fleet.teleoperation.messages import datagram_heads, encode_setpoint, read_setpoint
from ua_fleet.wire import Codec, SecurityMode
from ua_fleet.wire.chunks import split

GROUPS = {1001: 2, 1002: 3}
"""The bridges of the spaces 2 and 3."""
FOR_2 = encode_setpoint(Codec(), SetpointAddress(1001, 7), Setpoint(1, 1, 1, (0.5,)))
FOR_3 = encode_setpoint(Codec(), SetpointAddress(1002, 7), Setpoint(1, 1, 1, (0.5,)))


def server(mode: SecurityMode = ENCRYPT) -> Envelope:
    return envelope(0, "t-0", "c-2", "c-3", mode=mode, setpoint_groups=GROUPS)


def bridge(mode: SecurityMode = ENCRYPT, space: int = 2) -> Envelope:
    return envelope(space, "t-0", f"t-{space}", f"c-{space}", mode=mode, setpoint_groups=GROUPS)


def subscriber(opener: Envelope | None, space: int = 2) -> tuple[Subscriber, Counters]:
    counters = Counters()
    return (
        Subscriber(space, PubSubTiming(), counters, Codec(), envelope=opener, setpoint_groups=GROUPS),
        counters,
    )


@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
def test_a_setpoint_is_secured_with_the_keys_of_its_bridges_commands(mode: SecurityMode) -> None:
    sealed = one(server(mode).seal(FOR_2, 0.0))
    assert bridge(mode).open(sealed, 0.0) == FOR_2
    other = envelope(2, "t-0", "t-2", mode=mode, setpoint_groups=GROUPS)
    other.want("c-2")
    other.install("c-2", group_keys(seed="stolen"), 0.0)
    assert refusal(other, sealed) is Drop.BAD_SIGNATURE


@pytest.mark.parametrize("mode", [NONE, SIGN, ENCRYPT])
def test_a_bridge_knows_its_setpoints_by_how_they_begin(mode: SecurityMode) -> None:
    heads = datagram_heads(1001)
    assert one(server(mode).seal(FOR_2, 0.0)).startswith(heads)
    for other in (FOR_3, data(publisher_id=0), action(publisher_id=2)):
        assert not one(server(mode).seal(other, 0.0)).startswith(heads)


def test_a_bystander_leaves_the_setpoints_for_others_alone() -> None:
    sealed = one(server().seal(FOR_2, 0.0))
    three, counters = subscriber(bridge(space=3), 3)
    assert three.receive(sealed, 0.0) == []
    assert not counters.drops


def test_who_has_the_keys_of_data_alone_makes_no_setpoint() -> None:
    forger = envelope(0, "t-0", setpoint_groups={})
    assert refusal(bridge(), one(forger.seal(FOR_2, 0.0))) is Drop.BAD_SIGNATURE
    assert refusal(bridge(), FOR_2) is Drop.NOT_SECURED


def test_who_has_the_keys_of_commands_makes_no_data_of_the_server() -> None:
    forger = envelope(0, "c-2", setpoint_groups={2: 2})
    forged = one(forger.seal(data(publisher_id=0), 0.0))
    assert refusal(bridge(), forged) is Drop.BAD_SIGNATURE


def test_a_setpoint_is_taken_once_and_counts_with_the_actions_of_its_sender() -> None:
    sender, opener = server(), bridge()
    first, asked, second = (one(sender.seal(each, 0.0)) for each in (FOR_2, action(publisher_id=2), FOR_2))
    for datagram in (first, asked, second):
        assert opener.open(datagram, 0.0) is not None
    for datagram in (first, asked, second):
        assert refusal(opener, datagram) is Drop.REPLAYED


def test_an_expired_key_opens_no_setpoint() -> None:
    sender, opener = server(), bridge()
    sender.install("c-2", group_keys(9, seed="0c-2"), 0.0)
    assert refusal(opener, one(sender.seal(FOR_2, 0.0))) is Drop.UNKNOWN_TOKEN


def test_a_setpoint_in_chunks_is_refused() -> None:
    sender, opener = server(), bridge()
    long = encode_setpoint(Codec(), SetpointAddress(1001, 7), Setpoint(1, 1, 1, (0.5,) * 100))
    for chunk in split(long, 400, 1):
        assert refusal(opener, one(sender.seal(chunk, 0.0))) is Drop.UNSUPPORTED


def test_without_the_group_nothing_is_sent_and_it_is_said_which() -> None:
    counters = Counters()
    sender = envelope(0, "t-0", counters=counters, setpoint_groups=GROUPS)
    assert sender.seal(FOR_2, 0.0) == []
    assert sender.problem == "this process is not in the SecurityGroup c-2"
    assert counters.drops == {Drop.NO_KEY: 1}


@pytest.mark.parametrize("mode", [NONE, ENCRYPT])
def test_setpoints_reach_their_bridge_alone_and_no_data_set_reader(mode: SecurityMode) -> None:
    sender = server(mode)
    two, counters = subscriber(bridge(mode))
    three, _ = subscriber(bridge(mode, 3), 3)
    for plain, taker, other in ((FOR_2, two, three), (FOR_3, three, two)):
        datagram = one(sender.seal(plain, 0.0))
        (event,) = taker.receive(datagram, 0.0)
        assert isinstance(event, SetpointReceived)
        assert read_setpoint(event.message) == Setpoint(1, 1, 1, (0.5,))
        assert other.receive(datagram, 0.0) == []
    assert not two.writers
    assert two.next_deadline() is None
    assert not counters.drops
