"""How much of the program runs: for what is to grow with what there is, and not with its square."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

__all__ = ["counted_lines"]


def counted_lines(do: Callable[[], object]) -> int:
    """Lines of `ua_fleet` that run while something is done."""
    count = 0

    def in_frame(_frame: FrameType, event: str, _given: Any) -> Any:
        nonlocal count
        count += event == "line"
        return in_frame

    def called(frame: FrameType, _event: str, _given: Any) -> Any:
        return in_frame if "/ua_fleet/" in frame.f_code.co_filename else None

    before = sys.gettrace()
    sys.settrace(called)
    try:
        do()
    finally:
        sys.settrace(before)
    return count
