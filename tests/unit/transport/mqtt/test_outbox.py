"""What goes to a broker, and what waits, is kept or is dropped."""

from __future__ import annotations

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.counters import Drop
from ua_fleet.transport.mqtt.outbox import KEPT_FOR_S, STUCK_S, Outbox, Parcel
from ua_fleet.transport.mqtt.patience import Patience
from ua_fleet.transport.mqtt.subject import Lane, Subject
from ua_fleet.transport.mqtt.topics import Kind


def value(writer: int, number: int, now: float = 0.0) -> Parcel:
    payload = f"{writer}:{number}".encode()
    return Parcel(Subject(f"ua_1_2_{writer}", Lane.VALUE, Kind.DATA, (2, writer)), payload, payload, now)


def command(now: float = 0.0, lifetime_s: float = 1.0, text: bytes = b"command") -> Parcel:
    return Parcel(Subject("request", Lane.COMMAND, Kind.ACTION_REQUEST, lifetime_s=lifetime_s), text, text, now)


def kept(topic: str, text: bytes, now: float = 0.0) -> Parcel:
    return Parcel(Subject(topic, Lane.KEPT, Kind.METADATA), text, text, now)


def connected(**arguments: int) -> Outbox:
    outbox = Outbox(**arguments)
    outbox.connected(0.0)
    return outbox


def taken(outbox: Outbox, now: float = 0.0) -> list[bytes]:
    """What is sent now, acknowledged at once."""
    sent = list(outbox.take(now))
    for parcel in sent:
        outbox.acknowledged(parcel)
    return [parcel.plain for parcel in sent]


def test_of_what_was_announced_and_cleared_in_flight_the_clearing_goes_again() -> None:
    outbox = connected()
    outbox.put(kept("meta", b"metadata"), 0.0)
    assert [parcel.plain for parcel in outbox.take(0.0)] == [b"metadata"]
    outbox.clear("meta", Kind.METADATA, 0.1)
    assert [parcel.plain for parcel in outbox.take(0.1)] == [b""]
    outbox.disconnected()
    outbox.connected(10.0)
    assert taken(outbox, 10.0) == [b""]


def test_what_can_be_sent_goes_at_once_in_its_order() -> None:
    outbox = connected()
    for number in range(3):
        outbox.put(value(1, number), 0.0)
    assert taken(outbox) == [b"1:0", b"1:1", b"1:2"]
    assert outbox.drops == {}


def test_commands_go_before_what_is_kept_and_that_before_values() -> None:
    outbox = connected()
    outbox.put(value(1, 0), 0.0)
    outbox.put(kept("meta", b"meta"), 0.0)
    outbox.put(command(), 0.0)
    assert taken(outbox) == [b"command", b"meta", b"1:0"]


def test_values_wait_for_a_short_absence_and_none_is_lost() -> None:
    outbox = Outbox()
    for number in range(100):
        outbox.put(value(number % 3, number, now=0.01 * number), 0.01 * number)
    outbox.connected(1.5)
    assert taken(outbox, 1.5) == [f"{number % 3}:{number}".encode() for number in range(100)]
    assert outbox.drops == {}


def test_of_a_long_absence_the_newest_of_each_writer_is_left() -> None:
    outbox = Outbox()
    for number in range(100):
        outbox.put(value(number % 3, number, now=float(number)), float(number))
    outbox.connected(200.0)
    outbox.poll(200.0)
    assert sorted(taken(outbox, 200.0)) == [b"0:99", b"1:97", b"2:98"]
    assert outbox.drops == {Drop.BROKER_AWAY: 97}


def test_an_old_value_goes_when_a_newer_one_of_its_writer_comes() -> None:
    outbox = Outbox()
    outbox.put(value(1, 0, 0.0), 0.0)
    outbox.put(value(2, 0, 0.0), 0.0)
    outbox.poll(10.0)
    outbox.put(value(1, 1, 10.0), 10.0)
    outbox.connected(10.0)
    assert taken(outbox, 10.0) == [b"2:0", b"1:1"]
    assert outbox.drops == {Drop.BROKER_AWAY: 1}


def test_all_parts_of_a_large_message_stay_together() -> None:
    outbox = Outbox()
    plain = b"large"
    subject = Subject("ua_1_2_1", Lane.VALUE, Kind.DATA, (2, 1))
    for part in (b"a", b"b", b"c"):
        outbox.put(Parcel(subject, part, plain, 0.0), 0.0)
        outbox.put(value(2, len(part), 0.0), 0.0)
    outbox.poll(10.0)  # too old to wait in the row
    outbox.connected(10.0)
    parts = [parcel.payload for parcel in outbox.take(10.0) if parcel.plain is plain]
    assert parts == [b"a", b"b", b"c"]


def test_memory_is_bounded_and_the_oldest_go() -> None:
    outbox = Outbox(most_bytes=10_000)
    for writer in range(1, 1000):
        outbox.put(value(writer, 0), 0.0)
    assert outbox.waiting_bytes <= 10_000
    assert outbox.drops[Drop.BROKER_AWAY] + outbox.waiting == 999
    outbox.connected(0.0)
    assert taken(outbox)[-1] == b"999:0"


def test_a_command_is_never_kept_for_a_broker_that_is_away() -> None:
    outbox = Outbox()
    outbox.put(command(), 0.0)
    outbox.connected(0.1)
    assert taken(outbox, 0.1) == []
    assert outbox.drops == {Drop.BROKER_AWAY: 1}


def test_a_command_that_waits_for_a_slow_broker_is_not_sent_late() -> None:
    outbox = connected(window_messages=1)
    outbox.put(value(1, 0), 0.0)
    (first,) = outbox.take(0.0)
    outbox.put(command(lifetime_s=1.0), 0.0)
    outbox.put(command(lifetime_s=3.0, text=b"later"), 0.0)
    assert list(outbox.take(0.5)) == [], "the window is full"
    outbox.acknowledged(first)
    assert taken(outbox, 2.0) == [b"later"]
    assert outbox.drops == {Drop.EXPIRED: 1}


def test_commands_that_wait_or_fly_are_gone_with_their_connection() -> None:
    outbox = connected(window_messages=1)
    outbox.put(command(), 0.0)
    assert len(list(outbox.take(0.0))) == 1
    outbox.put(command(), 0.0)
    outbox.disconnected()
    outbox.connected(0.1)
    assert taken(outbox, 0.1) == []
    assert outbox.drops == {Drop.BROKER_AWAY: 2}


def keep_alive(writer: int, number: int, now: float = 0.0) -> Parcel:
    parcel = value(writer, number, now)
    parcel.subject = parcel.subject._replace(is_keep_alive=True)
    return parcel


def test_a_keep_alive_takes_no_value_s_place_while_the_broker_is_away() -> None:
    outbox = connected(window_messages=1)
    outbox.put(value(1, 0), 0.0)
    assert [parcel.plain for parcel in outbox.take(0.0)] == [b"1:0"]
    outbox.disconnected()
    for number in range(1, 60):
        outbox.put(keep_alive(1, number, float(number)), float(number))
        outbox.poll(float(number))
    outbox.connected(60.0)
    assert taken(outbox, 60.0) == [b"1:0"]
    assert outbox.drops == {}


def test_values_that_were_not_acknowledged_go_again_in_their_place() -> None:
    outbox = connected()
    for number in range(4):
        outbox.put(value(1, number), 0.0)
    first, *_ = list(outbox.take(0.0))
    outbox.acknowledged(first)
    outbox.disconnected()
    outbox.put(value(1, 4), 0.1)
    outbox.connected(0.2)
    assert taken(outbox, 0.2) == [b"1:1", b"1:2", b"1:3", b"1:4"]


def test_what_is_kept_goes_again_with_each_connection_before_values_and_is_secured_anew() -> None:
    outbox = connected()
    outbox.put(kept("a", b"a"), 0.0)
    outbox.put(kept("b", b"b"), 0.0)
    assert taken(outbox) == [b"a", b"b"]
    outbox.put(kept("a", b"a2"), 0.0)
    assert taken(outbox) == [b"a2"]
    outbox.disconnected()
    outbox.put(value(1, 0), 0.1)
    outbox.connected(0.2)
    again = list(outbox.take(0.2))
    assert [parcel.plain for parcel in again] == [b"a2", b"b", b"1:0"]
    assert [parcel.payload for parcel in again] == [None, None, b"1:0"], "a nonce is used once"


def test_what_is_kept_goes_again_under_a_new_key_and_before_the_broker_forgets_it() -> None:
    outbox = connected()
    outbox.put(kept("a", b"a"), 0.0)
    assert taken(outbox) == [b"a"]
    outbox.renewed(1.0)
    assert taken(outbox, 1.0) == [b"a"]
    outbox.poll(1.0 + KEPT_FOR_S / 3 - 1.0)
    assert taken(outbox, 60.0) == []
    outbox.poll(1.0 + KEPT_FOR_S / 3)
    assert taken(outbox, 61.0) == [b"a"]


def test_what_is_cleared_is_sent_as_nothing_also_after_a_break() -> None:
    outbox = connected()
    outbox.put(kept("a", b"a"), 0.0)
    assert taken(outbox) == [b"a"]
    outbox.clear("a", Kind.METADATA, 0.0)
    assert [parcel.payload for parcel in outbox.take(0.0)] == [b""]
    outbox.disconnected()
    outbox.connected(0.1)
    (again,) = outbox.take(0.1)
    assert (again.subject.topic, again.payload) == ("a", b"")
    outbox.acknowledged(again)
    outbox.disconnected()
    outbox.connected(0.2)
    assert taken(outbox, 0.2) == []


def test_no_more_is_in_flight_than_the_broker_takes() -> None:
    outbox = Outbox()
    outbox.connected(0.0, receive_maximum=2)
    for number in range(5):
        outbox.put(value(1, number), 0.0)
    first, second = outbox.take(0.0)
    outbox.put(command(), 0.0)
    outbox.acknowledged(first)
    assert [parcel.plain for parcel in outbox.take(0.0)] == [b"command"], "it goes before the values that wait"
    outbox.acknowledged(second)
    assert [parcel.plain for parcel in outbox.take(0.0)] == [b"1:2"]


def test_a_broker_that_acknowledges_nothing_is_noticed() -> None:
    outbox = connected()
    outbox.put(value(1, 0), 0.0)
    (parcel,) = outbox.take(0.0)
    assert not outbox.is_stuck(STUCK_S)
    assert outbox.is_stuck(STUCK_S + 0.1)
    outbox.acknowledged(parcel)
    assert not outbox.is_stuck(100.0)


def test_a_cluster_has_longer_to_answer_and_its_values_keep_their_order_for_longer() -> None:
    assert Patience.of(None, None, is_cluster=False) == (STUCK_S, 2.0)
    assert Patience.of(1.0, 0.0, is_cluster=True) == (1.0, 0.0)
    answer_s, ordered_s = Patience.of(None, None, is_cluster=True)
    outbox = Outbox(stuck_s=answer_s, most_age_s=ordered_s)
    outbox.connected(0.0)
    outbox.put(value(1, 0), 0.0)
    assert list(outbox.take(0.0))
    assert not outbox.is_stuck(9.0), "nats-server chooses who leads within that"
    outbox.disconnected()
    outbox.put(value(1, 1, 9.0), 9.0)
    outbox.connected(12.0)
    outbox.poll(12.0)
    assert taken(outbox, 12.0) == [b"1:0", b"1:1"]
    assert outbox.drops == {}


@given(st.integers(0, 10_000))
def test_each_value_is_sent_or_counted_and_none_of_a_writer_comes_after_a_newer_one(seed: int) -> None:
    random = Random(seed)
    outbox = Outbox(most_bytes=5_000, window_messages=5)
    now, put, sent, flying = 0.0, 0, dict[int, list[int]](), list[Parcel]()
    arrived = set[bytes]()
    for _ in range(200):
        now += random.choice((0.0, 0.1, 3.0))
        what = random.random()
        if what < 0.6:
            outbox.put(value(random.randint(1, 4), put, now), now)
            put += 1
        elif what < 0.7:
            outbox.disconnected()
            flying.clear()
        elif what < 0.8:
            outbox.connected(now)
        elif what < 0.9 and flying:
            parcel = flying.pop(0)
            arrived.add(parcel.plain)
            outbox.acknowledged(parcel)
        else:
            outbox.poll(now)
        for parcel in outbox.take(now):
            flying.append(parcel)
            writer, number = map(int, parcel.plain.split(b":"))
            sent.setdefault(writer, []).append(number)
        assert outbox.waiting_bytes <= 5_000 + 5 * 300
    dropped = outbox.drops.get(Drop.BROKER_AWAY, 0)
    assert len(arrived) + outbox.waiting + outbox.in_flight + dropped == put
    for numbers in sent.values():
        firsts = list(dict.fromkeys(numbers))
        assert firsts == sorted(firsts)
