"""The last messages: kept while somebody asks, for each person apart, within bounds, and without keys."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.security.securing import action, announcement, data, envelope, key_data, one
from ua_fleet.dissect.annotate import annotate
from ua_fleet.pubsub.recent import (
    BYTES_IN_ANSWER,
    HOLD_S,
    MESSAGES_IN_ANSWER,
    MOST_MESSAGE_BYTES,
    MOST_MESSAGES,
    MOST_RINGS,
    MOST_RINGS_OF_ONE,
    RecentMessage,
    RecentMessages,
    TooManyLook,
)
from ua_fleet.pubsub.security import telemetry_group
from ua_fleet.wire.security import SecurityMode


def asked(recent: RecentMessages, who: str = "erna", source: str = "", after: int = 0, now: float = 0.0) -> list[int]:
    return [message.number for message in recent.ask(who, source, after, now).messages]


def looked_at(source: str = "") -> RecentMessages:
    recent = RecentMessages()
    assert recent.ask("erna", source, 0, 0.0).begins
    return recent


def plain(recent: RecentMessages, datagram: bytes, dropped: str = "") -> None:
    recent.received(datagram, datagram, 7, "10.0.0.1:4840", dropped)


def the_one(recent: RecentMessages, source: str = "") -> RecentMessage:
    (message,) = recent.ask("erna", source, 0, 0.0).messages
    return message


def test_it_is_kept_while_somebody_asks() -> None:
    assert not RecentMessages().is_wanted
    recent = looked_at()
    plain(recent, data("a"))
    assert asked(recent, now=HOLD_S - 1) == [1]
    plain(recent, data("b"))
    assert asked(recent, after=1, now=2 * HOLD_S - 2) == [2]
    recent.poll(3 * HOLD_S - 3)
    assert recent.is_wanted
    recent.poll(3 * HOLD_S - 2)
    assert [recent.is_wanted] == [False]
    assert recent.ask("erna", "", 2, 3 * HOLD_S).begins


@pytest.mark.parametrize(
    ("source", "numbers"), [("", [1, 2, 3, 4, 5]), ("1", [1, 2, 5]), ("ua_1_2_1001", [1]), ("ua_1_x", []), ("9", [])]
)
def test_a_source_is_a_publisher_or_a_topic(source: str, numbers: list[int]) -> None:
    recent = looked_at(source)
    recent.ask("oscar", "", 0, 0.0)
    for datagram in (data(), data(writer_id=1002), data(publisher_id=3), b"\x00", announcement()):
        recent.received(datagram, datagram, 0, "", "malformed" if datagram == b"\x00" else "")
    assert asked(recent, source=source) == numbers
    assert asked(recent, "oscar") == [1, 2, 3, 4, 5]


def test_a_ring_has_bounds_and_says_what_it_lost() -> None:
    recent = looked_at()
    for _ in range(MOST_MESSAGES + 5):
        plain(recent, data())
    answer = recent.ask("erna", "", 0, 0.0)
    assert (answer.messages[0].number, len(answer.messages), answer.lost) == (6, MESSAGES_IN_ANSWER, 5)
    assert answer.has_more
    answer = recent.ask("erna", "", MOST_MESSAGES, 0.0)
    assert (len(answer.messages), answer.lost, answer.has_more) == (5, 0, False)
    for _ in range(2 * MOST_MESSAGES):
        plain(recent, data("x" * 100_000))
    answer = recent.ask("erna", "", MOST_MESSAGES + 5, 0.0)
    size = sum(len(message.data) for message in answer.messages)
    assert BYTES_IN_ANSWER - MOST_MESSAGE_BYTES < size <= BYTES_IN_ANSWER
    assert {len(message.data) for message in answer.messages} == {MOST_MESSAGE_BYTES}
    assert answer.messages[0].size > 100_000
    assert answer.lost > 0


def test_the_greedy_lose_their_own_places() -> None:
    recent = RecentMessages()
    for number in range(MOST_RINGS_OF_ONE):
        recent.ask("erna", f"{number}", 0, float(number))
    recent.ask("oscar", "", 0, 0.0)
    assert recent.ask("erna", "new", 0, 5.0).begins
    assert not recent.ask("erna", "1", 0, 5.0).begins
    assert not recent.ask("oscar", "", 0, 5.0).begins
    assert recent.ask("erna", "0", 0, 6.0).begins
    for number in range(MOST_RINGS - MOST_RINGS_OF_ONE - 1):
        recent.ask(f"user {number}", "", 0, 7.0)
    with pytest.raises(TooManyLook, match="try again"):
        recent.ask("late", "", 0, 7.0)


@pytest.mark.parametrize("mode", [SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT])
def test_what_was_encrypted_stands_in_plain_and_the_key_does_not(mode: SecurityMode) -> None:
    group = telemetry_group(1)
    sender, receiver = envelope(1, group, mode=mode), envelope(0, group, mode=mode)
    message = data("Hello, I am the text")
    sealed = one(sender.seal(message, 0.0))
    recent = looked_at()
    recent.received(sealed, receiver.open(sealed, 0.0), 0, "", "")
    recent.sent(message, [sealed], 0, "")
    came, went = recent.ask("erna", "", 0, 0.0).messages
    assert came.data == went.data
    assert (came.is_sent, went.is_sent) == (False, True)
    assert (came.mode, came.token_id, came.size) == (mode, 1, len(sealed))
    assert came.data[: -len(sealed)] == sealed[: -len(sealed)]
    texts = [span.meaning for span in annotate(came.data, is_open=True)]
    assert '"Hello, I am the text"' in texts
    assert b"".join(span.data for span in annotate(came.data, is_open=True)) == came.data
    key = key_data(1, f"0{group}")
    assert not any(key[at : at + 8] in came.data for at in range(len(key) - 8))


def test_what_was_not_let_in_stays_closed() -> None:
    sealed = one(envelope(1, telemetry_group(1)).seal(data("secret"), 0.0))
    recent = looked_at()
    recent.received(sealed, None, 0, "", "unknown_token")
    message = the_one(recent)
    assert (message.is_open, message.dropped, message.data) == (False, "unknown_token", sealed)


def test_chunks_are_shown_put_together() -> None:
    group = telemetry_group(1)
    sender, receiver = envelope(1, group, max_datagram_bytes=400), envelope(0, group)
    message = data("x" * 1000)
    recent = looked_at()
    chunks = sender.seal(message, 0.0)
    assert len(chunks) > 2
    for chunk in chunks:
        recent.received(chunk, receiver.open(chunk, 0.0), 0, "", "")
    came = the_one(recent)
    assert (came.data, came.in_chunks, came.mode) == (message, True, SecurityMode.SIGN_AND_ENCRYPT)


def test_what_others_ask_each_other_is_not_kept() -> None:
    recent = looked_at()
    recent.received(action(), None, 0, "", "")
    assert asked(recent) == []


def test_a_number_of_another_process_is_no_reason_to_tell_nothing() -> None:
    recent = looked_at()
    plain(recent, data())
    assert asked(recent, after=900) == [1]
