"""How often the thread of skills looks for what is due."""

from __future__ import annotations

import threading
import time

from ua_bridges.ros1.skills.thread import QUIET_TURN_S, SkillThread


def test_it_looks_rarely_until_a_skill_is_under_way() -> None:
    turns, is_busy, often = list[float](), False, threading.Event()

    def turn(now: float) -> None:
        turns.append(now)
        if is_busy and len(turns) >= 6 and turns[-1] - turns[-2] < QUIET_TURN_S / 2:
            often.set()

    thread = SkillThread()
    thread.start(turn, lambda: is_busy)
    time.sleep(2 * QUIET_TURN_S)
    assert len(turns) <= 3
    is_busy = True
    thread.call(lambda: None)
    assert often.wait(10.0)
    thread.stop()
