"""No number of a lease is given twice, whatever becomes of the process and its file."""

from __future__ import annotations

from pathlib import Path

import pytest

from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.lease_numbers import BLOCK, LeaseNumbers


def test_numbers_rise_within_a_run_and_over_restarts(tmp_path: Path) -> None:
    given: list[int] = []
    for _ in range(3):
        numbers = LeaseNumbers(tmp_path / "state")
        given += [numbers.next() for _ in range(5)]
    assert given == sorted(set(given))
    assert given[0] == 1


def test_numbers_rise_over_the_end_of_a_block(tmp_path: Path) -> None:
    numbers = LeaseNumbers(tmp_path)
    assert [numbers.next() for _ in range(2 * BLOCK + 1)] == list(range(1, 2 * BLOCK + 2))
    assert LeaseNumbers(tmp_path).next() == 3 * BLOCK + 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"{", "is no file of lease numbers"),
        (b"[]", "is no file of lease numbers"),
        (b'{"version": 1}', "is no file of lease numbers"),
        (b'{"version": 1, "reserved": -1}', "is no file of lease numbers"),
        (b'{"version": 1, "reserved": "7"}', "is no file of lease numbers"),
        (b'{"version": 2, "reserved": 7}', "has version 2"),
        (b'{"version": 1, "reserved": 4294967295}', "are used up"),
    ],
)
def test_a_file_that_cannot_be_understood_is_no_empty_one(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "lease_numbers.json"
    file.write_bytes(content)
    with pytest.raises(StorageUnavailable, match=said):
        LeaseNumbers(tmp_path).next()
    assert file.read_bytes() == content


def test_no_number_is_given_that_could_not_be_reserved(tmp_path: Path) -> None:
    (tmp_path / "lease_numbers.json").mkdir()
    with pytest.raises(StorageUnavailable, match="cannot be kept: is a directory"):
        LeaseNumbers(tmp_path).next()
