from __future__ import annotations

from collections.abc import Iterator

import pytest

from ua_fleet.endpoint.backlog import Backlog


class Told:
    """Events of which each takes some time to make."""

    def __init__(self, count: int, each_s: float = 0.001) -> None:
        self.count, self.each_s, self.now = count, each_s, 0.0
        self.told: list[int] = []
        self.room = count
        self.backlog = Backlog(self._events(), lambda: len(self.told) >= self.room, lambda: self.now)

    def _events(self) -> Iterator[None]:
        for number in range(self.count):
            self.now += self.each_s
            self.told.append(number)
            yield


def test_a_piece_holds_the_loop_for_five_milliseconds() -> None:
    told = Told(1000)
    told.room = 2000
    pieces = 0
    while told.backlog.tell():
        pieces += 1
        assert len(told.told) == 5 * pieces
    assert told.told == list(range(1000))
    assert told.backlog.is_over
    assert pieces == 200
    assert not told.backlog.tell()


def test_it_waits_for_the_queues() -> None:
    told = Told(10, 0.0)
    told.room = 4
    assert not told.backlog.tell()
    assert not told.backlog.tell()
    assert told.told == [0, 1, 2, 3]
    assert not told.backlog.is_over
    told.room = 11
    assert not told.backlog.tell()
    assert told.told == list(range(10))
    assert told.backlog.is_over


def test_one_that_fails_is_over() -> None:
    def events() -> Iterator[None]:
        yield
        raise ValueError("no such fault")

    backlog = Backlog(events(), lambda: False)
    with pytest.raises(ValueError, match="no such fault"):
        backlog.tell()
    assert backlog.is_over
