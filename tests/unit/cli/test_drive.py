"""Keys of a terminal that drive a robot."""

from __future__ import annotations

import pytest

from ua_fleet.cli.drive import duration_s
from ua_fleet.cli.drive_keys import KEY_S, Controls, KeyRequest, TerminalKeys
from ua_fleet.cli.endings import UsageError

REST = ("", 0)


@pytest.mark.parametrize(
    ("typed", "held"),
    [
        *[(key, ("ahead", 1)) for key in ("w", "W", "\x1b[A", "\x1bOA")],
        *[(key, ("turn", -1)) for key in ("d", "\x1b[C")],
        ("www", ("ahead", 1)),
        ("wa", ("turn", 1)),
        ("\x1b[A\x1b[B", ("ahead", -1)),
        ("e", ("third", -1)),
        ("w ", REST),
        ("wz", REST),
        ("\x1b[I", REST),
        ("\x1b[1;5A", REST),
    ],
)
def test_the_newest_key_counts(typed: str, held: tuple[str, int]) -> None:
    keys = TerminalKeys(0.5)
    assert keys.type(typed, 0.0) is KeyRequest.NOTHING
    assert keys.held(0.1) == held


def test_a_key_counts_for_a_short_time_after_each_repetition() -> None:
    keys = TerminalKeys(0.5)
    for at in (0.0, 0.15, 0.3):
        keys.type("w", at)
    assert keys.held(0.3 + KEY_S - 0.001) == ("ahead", 1)
    assert keys.held(0.3 + KEY_S) == REST


@pytest.mark.parametrize(
    ("typed", "asked"),
    [
        ("x", KeyRequest.END),
        ("\x1b", KeyRequest.END),
        ("w\x04", KeyRequest.END),
        ("w\x1b[O", KeyRequest.AWAY),
        ("w", KeyRequest.NOTHING),
    ],
)
def test_what_else_is_asked_for(typed: str, asked: KeyRequest) -> None:
    keys = TerminalKeys(0.5)
    assert keys.type(typed, 0.0) is asked
    assert (keys.held(0.1) == REST) == (asked is not KeyRequest.NOTHING)


def test_the_speed_stays_within_its_bounds() -> None:
    keys = TerminalKeys(0.5)
    keys.type("+++", 0.0)
    assert keys.share == 0.8
    keys.type("+" * 20, 0.0)
    assert keys.share == 1.0
    keys.type("-" * 20, 0.0)
    assert keys.share == 0.1


def test_controls_drive_axes_by_their_names_or_order() -> None:
    speeds = [2.0, 1.0, 0.5]
    named = Controls(["yaw", "y", "x"])
    assert named.values("ahead", 1, speeds, 0.5) == [0.0, 0.0, 0.25]
    assert named.values("turn", -1, speeds, 0.5) == [-1.0, 0.0, 0.0]
    assert named.values("third", 1, speeds, 1.0) == [0.0, 1.0, 0.0]
    assert named.values("", 0, speeds, 1.0) == [0.0, 0.0, 0.0]
    one = Controls(["joint"])
    assert one.values("ahead", 1, [3.0], 1.0) == [3.0]
    assert one.values("turn", 1, [3.0], 1.0) == [0.0]


def test_times() -> None:
    assert [duration_s(text) for text in ("2s", "500ms", "1.5")] == [2.0, 0.5, 1.5]
    for text in ("", "s", "-1s", "nan", "2h", "4000s"):
        with pytest.raises(UsageError, match="write it as 2s or 500ms"):
            duration_s(text)
