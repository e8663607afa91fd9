"""The one thread in which the ports of a ROS 1 bridge work."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Final

import structlog

__all__ = ["SkillThread"]

TURN_S: Final = 0.1
"""So often it is looked for what is due ..."""
QUIET_TURN_S: Final = 0.5
"""... and so often while no skill is under way."""

_log = structlog.get_logger("ua_bridges.ros1")

Step = Callable[[], None]


class SkillThread:
    """Does steps in their order, and a turn in time."""

    def __init__(self) -> None:
        self._steps: queue.SimpleQueue[Step | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="ros1-skills", daemon=True)
        self._turn: Callable[[float], None]
        self._is_busy: Callable[[], bool]

    def start(self, turn: Callable[[float], None], is_busy: Callable[[], bool]) -> None:
        """Begin to work; what was called before is done now.

        Args:
            turn: does what is due at a time.
            is_busy: whether more may be due soon.
        """
        self._turn, self._is_busy = turn, is_busy
        self._thread.start()

    def call(self, step: Step) -> None:
        """Have a step done; callable from any thread, never blocks."""
        self._steps.put(step)

    def stop(self) -> None:
        """End after the steps that were called before. Blocks until then; after it nothing is done."""
        self._steps.put(None)
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        turn_at = time.monotonic()
        while True:
            now = time.monotonic()
            if now >= turn_at:
                self._do(partial(self._turn, now))
                turn_at = now + (TURN_S if self._is_busy() else QUIET_TURN_S)
            try:
                step = self._steps.get(timeout=max(turn_at - time.monotonic(), 0.0))
            except queue.Empty:
                continue
            if step is None:
                return
            self._do(step)
            turn_at = min(turn_at, time.monotonic() + TURN_S)

    @staticmethod
    def _do(step: Step) -> None:
        try:
            step()
        except Exception:  # noqa: BLE001 - one robot's message must not end the work for all
            _log.exception("a step of a skill has failed")
