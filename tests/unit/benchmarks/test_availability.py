"""The benchmark `availability`: it fails where robot and requestors disagree, and no slot is lost in silence."""

from __future__ import annotations

import asyncio
import selectors
from collections import Counter
from contextlib import closing
from dataclasses import replace

import pytest

from benchmarks import _availability as processes
from benchmarks._availability import Asked, open_loop
from benchmarks.availability import CHARACTERS, REQUESTS, Run, accounted, rows
from benchmarks.harness import Failed


class Clock(selectors.SelectSelector):
    """What an event loop waits with; the time goes on at once by whatever is waited."""

    now = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self.now += timeout or 0.0
        return super().select(0)


class TimedLoop(asyncio.SelectorEventLoop):
    """An event loop on such a clock."""

    def __init__(self) -> None:
        self.clock = Clock()
        super().__init__(self.clock)

    def time(self) -> float:
        return self.clock.now


KNOWN = Asked(
    5, missed=1, outcomes=Counter(accepted=2, refused=1, timed_out=1), accepted=["a", "b"], ids=["a", "b", "c", "d"]
)
OTHER = Asked(1, outcomes=Counter(accepted=1), accepted=["x"], ids=["x"])


def test_every_request_is_executed_or_refused() -> None:
    accounted(["a", "x", "b"], [KNOWN, OTHER])
    assert Asked.read(KNOWN.line()) == KNOWN


@pytest.mark.parametrize(
    ("told", "asked", "complaint"),
    [
        (["a", "b", "b"], KNOWN, "twice"),
        (["a"], KNOWN, "takes 1 for executed"),
        (["a", "b", "c"], KNOWN, "does not know that 1"),
        (["a", "b", "z"], KNOWN, "nobody asked"),
        (["a", "b"], replace(KNOWN, slots=6), "of 6"),
        (["a", "b"], replace(KNOWN, outcomes=Counter(accepted=2, refused=1, unknown=1)), "of 5"),
    ],
)
def test_what_does_not_add_up_fails(told: list[str], asked: Asked, complaint: str) -> None:
    with pytest.raises(Failed, match=complaint):
        accounted(told, [asked])


def test_a_late_slot_is_asked_for_and_a_too_late_one_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a clock that goes on by what is waited for and computed alone: a busy machine misses no slot of it."""
    monkeypatch.setattr(processes, "MOST_LATE_S", 0.05)
    loop, asked = TimedLoop(), list[float]()

    async def ask(due: float) -> None:
        if not asked:
            loop.clock.now = due + 0.105  # nothing else gets a turn meanwhile
        asked.append(due)

    with closing(loop):
        missed = loop.run_until_complete(open_loop(0.01, 20, ask))
    slots = [round(due / 0.01) for due in asked]
    assert slots == [1, *range(7, 21)], "those of 0.02 to 0.06 were more than 0.05 s ago when there was time for them"
    assert missed == 5


def test_only_long_periods_are_held_to_the_goal() -> None:
    shares = {period: [0.5, 1.0, 1.0, 0.25] for period in REQUESTS}
    run = Run(shares, dict.fromkeys(REQUESTS, 1.0), [(1.0, 2.0, 3.0, 4.0)] * len(CHARACTERS), [])
    found = {figure.name: figure for figure in rows("alone", run) if figure.name.startswith("availability")}
    assert len(found) == 2 * len(REQUESTS)
    assert found["availability every 10 ms, alone, 20,000 characters"].holds
    held = found["availability every 20 ms, alone, up to 10,000 characters"]
    assert (held.value, held.goal, held.holds) == (0.5, 1.0, False)
