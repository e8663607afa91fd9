"""No nonce twice, whatever the disk does."""

from __future__ import annotations

import struct

import pytest

from ua_fleet.pubsub.security.nonces import (
    BLOCK,
    LAST_NUMBER,
    MARGIN,
    MemoryNonces,
    NonceSequence,
    NoncesUnavailable,
    nonce_prefix,
)

PREFIX = nonce_prefix(0x0203, 0xBEEF)


class Disk:
    """Reservations that fail while `broken`, and remember what was given."""

    def __init__(self, first: int = 1) -> None:
        self.first = first
        self.broken = False
        self.calls = 0

    def reserve(self, group_id: str, token_id: int, count: int) -> int:
        assert (group_id, token_id) == ("t-2", 7)
        self.calls += 1
        if self.broken:
            raise NoncesUnavailable("the disk is full")
        first, self.first = self.first, self.first + count
        return first


def sequence(disk: Disk) -> NonceSequence:
    return NonceSequence(disk, "t-2", 7, PREFIX)


def number_of(nonce: bytes) -> int:
    assert nonce[:4] == PREFIX
    return int(struct.unpack("<I", nonce[4:])[0])


def test_layout() -> None:
    assert sequence(Disk()).next(0.0).hex() == "0302" + "efbe" + "01000000"


def test_numbers_go_on_from_block_to_block() -> None:
    disk = Disk()
    nonces = sequence(disk)
    assert [number_of(nonces.next(0.0)) for _ in range(3 * BLOCK)] == list(range(1, 3 * BLOCK + 1))
    assert disk.calls == 4, "the next block is reserved before the old one is used up"


def test_a_restart_goes_on_above() -> None:
    disk = Disk()
    before = [number_of(sequence(disk).next(0.0)) for _ in range(3)]
    assert before == [1, 1 + BLOCK, 1 + 2 * BLOCK]


def test_a_disk_may_fail_for_a_while() -> None:
    disk = Disk()
    nonces = sequence(disk)
    for _ in range(BLOCK - MARGIN):
        nonces.next(0.0)
    disk.broken = True
    for _ in range(MARGIN // 2):
        nonces.next(0.0)
    assert disk.calls == 2, "it is not tried for every message"
    nonces.next(1.0)
    assert disk.calls == 3
    disk.broken = False
    assert number_of(nonces.next(2.0)) == BLOCK - MARGIN // 2 + 2


def test_when_numbers_are_used_up_and_the_disk_fails_there_is_no_nonce() -> None:
    disk = Disk()
    nonces = sequence(disk)
    used = {number_of(nonces.next(0.0)) for _ in range(BLOCK - MARGIN)}
    disk.broken = True
    used |= {number_of(nonces.next(0.0)) for _ in range(MARGIN)}
    assert used == set(range(1, BLOCK + 1))
    for now in (0.0, 0.5, 1.0, 1.5):
        with pytest.raises(NoncesUnavailable, match="the disk is full"):
            nonces.next(now)
    disk.broken = False
    assert number_of(nonces.next(3.0)) == BLOCK + 1


def test_a_key_is_given_up_before_its_numbers_roll_over() -> None:
    nonces = sequence(Disk(LAST_NUMBER - 2))
    assert [number_of(nonces.next(0.0)) for _ in range(3)] == [LAST_NUMBER - 2, LAST_NUMBER - 1, LAST_NUMBER]
    with pytest.raises(NoncesUnavailable, match="ua-fleet keys rotate t-2"):
        nonces.next(5.0)


def test_memory_forgets_nothing_while_it_lives() -> None:
    memory = MemoryNonces()
    assert [memory.reserve("t-2", 7, 10), memory.reserve("t-2", 7, 10), memory.reserve("t-2", 8, 10)] == [1, 11, 1]
