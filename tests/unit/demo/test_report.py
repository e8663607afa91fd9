"""What a robot's program says of itself can be read, whichever of its threads speak."""

from __future__ import annotations

import io
import sys
import threading
import time
from pathlib import Path

import pytest
from ua_demo.lines import read_line
from ua_demo.report import EVENTS_VARIABLE, report

EACH = 20


class _Pipe(io.StringIO):
    """Lets other threads run after each write, as one to a pipe does."""

    def write(self, text: str) -> int:
        written = super().write(text)
        time.sleep(0.0001)
        return written


def test_two_threads_at_once_lose_no_event(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    events, printed = tmp_path / "events", _Pipe()
    monkeypatch.setenv(EVENTS_VARIABLE, str(events))
    monkeypatch.setattr(sys, "stdout", printed)

    def say(who: str) -> None:
        for count in range(EACH):
            report(who, "counts", count=count)

    threads = [threading.Thread(target=say, args=(who,)) for who in ("main", "callback")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for text in (printed.getvalue(), events.read_text()):
        said = [read_line(line) for line in text.splitlines()]
        for who in ("main", "callback"):
            assert [one.details["count"] for one in said if one and one.who == who] == list(range(EACH))
