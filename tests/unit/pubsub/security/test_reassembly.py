"""Chunks in any order, and none that fills the memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterable
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.pubsub.security.securing import data
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.security.reassembly import (
    CHUNK_TIMEOUT_S,
    FULL_SENDERS,
    LEAST_CHUNK_BYTES,
    MOST_MESSAGES,
    Reassembly,
)
from ua_fleet.wire import Cause, Chunk, read_chunk, split

MAX = 65_536
LARGE = data("x" * 5_000)


def chunks(plain: bytes = LARGE, most_bytes: int = 600, number: int = 7) -> list[Chunk]:
    read = [read_chunk(part) for part in split(plain, most_bytes, number)]
    return [chunk for chunk in read if chunk is not None]


class Joining:
    def __init__(self, max_bytes: int = MAX) -> None:
        self.counters = Counters()
        self.reassembly = Reassembly(self.counters, max_bytes)

    def add(self, parts: Iterable[Chunk], now: float = 0.0) -> list[bytes]:
        return [whole for part in parts if (whole := self.reassembly.add(part, now)) is not None]

    @property
    def lost(self) -> int:
        return self.counters.drops[Drop.CHUNK_LOST]


@settings(max_examples=100)
@given(
    size=st.integers(600, 20_000),
    most_bytes=st.integers(100, 2_000),
    random=st.randoms(use_true_random=False),
    copies=st.integers(1, 3),
)
def test_shuffled_and_duplicated_chunks_give_the_message_once(
    size: int, most_bytes: int, random: Random, copies: int
) -> None:
    plain = data("y" * size)
    if len(plain) <= most_bytes:
        return
    parts = chunks(plain, most_bytes) * copies
    random.shuffle(parts)
    # The smallest chunks count as larger than they are.
    joining = Joining(max(MAX, len(parts) * LEAST_CHUNK_BYTES))
    assert joining.add(parts) == [plain]
    assert joining.reassembly.held_bytes == 0
    assert joining.reassembly.next_deadline() is None
    assert joining.counters.drops == {}


def test_messages_of_different_writers_and_numbers_do_not_mix() -> None:
    plains = [data("a" * 2_000), data("b" * 2_000, writer_id=1002), data("c" * 2_000, 3), data("d" * 2_000)]
    sets = [chunks(plain, number=number) for plain, number in zip(plains, (7, 7, 7, 8), strict=True)]
    parts = [part for column in zip(*sets, strict=True) for part in column]
    assert Joining().add(parts) == plains


def test_a_message_that_takes_too_long_is_given_up() -> None:
    joining = Joining()
    first, *rest = chunks()
    joining.add([first], 10.0)
    assert joining.reassembly.next_deadline() == 10.0 + CHUNK_TIMEOUT_S
    joining.reassembly.poll(11.9)
    assert (joining.lost, joining.reassembly.held_bytes) == (0, len(first.data))
    joining.reassembly.poll(12.0)
    assert (joining.lost, joining.reassembly.held_bytes) == (1, 0)
    assert joining.add(rest, 12.5) == []
    assert joining.lost == 1, "its late chunks are not a message"
    assert joining.add(chunks(), 20.0) == [LARGE], "the number comes again, for another message"


def test_time_is_looked_at_without_poll_too() -> None:
    joining = Joining()
    first, *rest = chunks()
    joining.add([first], 0.0)
    assert joining.add(rest, 5.0) == []
    assert joining.lost == 1


def changed(chunk: Chunk, **changes: object) -> Chunk:
    return chunk._replace(**changes)  # type: ignore[arg-type]


CONTRADICTIONS: dict[str, tuple[Cause, Callable[[list[Chunk]], Chunk]]] = {
    "reaches into the next": (Cause.CHUNK_OVERLAPS, lambda c: changed(c[1], data=bytes(c[1].data) + b"z")),
    "begins in the one before": (Cause.CHUNK_OVERLAPS, lambda c: changed(c[1], offset=c[1].offset - 1)),
    "covers others": (Cause.CHUNK_OVERLAPS, lambda c: changed(c[0], data=b"z" * 3000)),
    "other data": (Cause.CHUNK_OVERLAPS, lambda c: changed(c[0], data=b"z" * len(c[0].data))),
    "shorter": (Cause.CHUNK_OVERLAPS, lambda c: changed(c[0], data=c[0].data[:-1])),
    "another size": (Cause.CHUNK_CONTRADICTS, lambda c: changed(c[1], total_size=c[1].total_size + 1)),
}


@pytest.mark.parametrize(("cause", "make"), CONTRADICTIONS.values(), ids=CONTRADICTIONS.keys())
def test_a_message_with_contradicting_chunks_is_given_up(cause: Cause, make: Callable[[list[Chunk]], Chunk]) -> None:
    joining = Joining()
    parts = chunks()
    assert joining.add([parts[0], parts[2]]) == []
    with pytest.raises(RemoteWireError) as caught:
        joining.add([make(parts)])
    assert caught.value.cause == cause
    assert (joining.lost, joining.reassembly.held_bytes) == (1, 0)
    assert joining.add(parts) == []
    assert joining.lost == 1


def test_each_chunk_has_numbers_and_a_timestamp_of_its_own() -> None:
    """OPC 10000-14 6.3.1.4.2: the NetworkMessageNumber counts chunks too."""
    joining = Joining()
    *parts, last = chunks()
    assert joining.add([changed(part, head=bytes([number]) + last.head) for number, part in enumerate(parts)]) == []
    assert [whole.startswith(last.head) for whole in joining.add([last])] == [True]


def test_actions_of_two_requestors_are_kept_apart() -> None:
    """Both have the PublisherId of the responder and count their messages for themselves."""
    joining = Joining()
    ours, theirs = (
        [changed(part, is_action=True, action_header=header) for part in chunks()] for header in (b"a", b"b")
    )
    assert joining.add([ours[0], *theirs[1:]]) == []
    assert len(joining.add([theirs[0], *ours[1:]])) == 2


def test_a_message_beyond_the_bound_is_refused_at_its_first_chunk() -> None:
    joining = Joining()
    with pytest.raises(RemoteWireError) as caught:
        joining.add([changed(chunks()[0], total_size=MAX + 1)])
    assert caught.value.cause == Cause.CHUNK_TOO_LARGE
    assert "pubsub.max_message_bytes is 65536" in str(caught.value)
    assert joining.reassembly.held_bytes == 0


def test_a_message_of_the_largest_size_is_put_together() -> None:
    overhead = len(data("")) - 10
    plain = data("x" * (MAX - overhead))
    assert read_chunk(split(plain, 600, 1)[0]).total_size == MAX  # type: ignore[union-attr]
    joining = Joining()
    assert joining.add(chunks(plain, 600)) == [plain]


def test_who_holds_most_goes_first() -> None:
    joining = Joining()
    small = chunks(data("s" * 2_000), number=1)
    joining.add(small[:-1])
    for number in range(2, 300):
        joining.add(chunks(data("h" * 40_000), 30_000, number)[:1])
        assert joining.reassembly.held_bytes <= MAX + LEAST_CHUNK_BYTES
    assert joining.add(small[-1:]) == [data("s" * 2_000)]
    assert joining.lost > 290


def test_many_unfinished_messages_are_bounded() -> None:
    joining = Joining(64 * MAX)
    for number in range(10 * MOST_MESSAGES):
        joining.add(chunks(number=number)[:1])
    assert joining.lost == 9 * MOST_MESSAGES


def test_chunks_of_one_byte_count_as_more_than_that() -> None:
    joining = Joining()
    head = chunks()[0]
    for offset in range(0, 2_000, 2):
        joining.add([changed(head, offset=offset, data=b"x", total_size=MAX)])
    assert joining.lost == 1, "the rest of it is not begun anew"
    assert joining.reassembly.held_bytes == 0


def test_memory_under_chunks_that_never_end() -> None:
    """Measured, whatever the sizes, numbers and order."""
    bound = 1024 * 1024
    joining = Joining(bound)
    random = Random(3)
    head = chunks()[0]
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for i in range(20_000):
            size = random.choice((1, 1, 100, 1_000, 30_000))
            chunk = changed(
                head,
                message_sequence_number=random.randrange(0x10000) if i % 2 else random.randrange(5),
                publisher_id=random.randrange(30),
                offset=random.randrange(bound - size),
                total_size=bound,
                data=random.randbytes(size),
            )
            try:
                joining.add([chunk], i / 1000)
            except RemoteWireError as error:
                assert error.cause == Cause.CHUNK_OVERLAPS  # noqa: PT017 - most are none
        peak = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    assert peak < (FULL_SENDERS + 1) * bound
    assert joining.lost > 100


@pytest.mark.parametrize("forged", [1, 7])
def test_who_never_ends_his_messages_takes_nobody_else_s_place(forged: int) -> None:
    """An honest sender's large message comes between 10 MB of others' chunks, each of another message."""
    joining = Joining()
    plain = data("h" * 60_000)
    whole: list[bytes] = []
    for number, part in enumerate(chunks(plain, 2_000)):
        for other in range(20):
            flood = changed(
                chunks(data("f" * 40_000), 30_000, 20 * number + other)[0], publisher_id=100 + (number + other) % forged
            )
            joining.add([flood])
        whole += joining.add([part])
        assert joining.reassembly.held_bytes <= FULL_SENDERS * (MAX + LEAST_CHUNK_BYTES)
    assert whole == [plain]
