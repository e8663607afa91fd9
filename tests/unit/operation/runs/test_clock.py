from __future__ import annotations

from ua_fleet.operation.runs.clock import steady


def test_a_wall_clock_that_is_set_moves_nothing() -> None:
    monotonic, wall = [5.0], [1_000.0]
    clock = steady(lambda: monotonic[0], lambda: wall[0])
    assert clock() == 1_000.0
    monotonic[0] += 2.5
    wall[0] += 3_600.0
    assert clock() == 1_002.5
