"""Keys of a terminal that drive a robot. Pure; time is an argument.

A terminal tells no release of a key. What it has is that a held key repeats itself, some 30 times a second once it has
been held for a while. So a key counts for KEY_S after each of its characters: a tap is a nudge, and a held key drives
from its first repetition on and stops KEY_S after its last. The newest key counts, since a terminal repeats that alone.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from enum import Enum
from typing import Final

__all__ = ["KEY_LINE", "KEY_S", "Controls", "KeyRequest", "TerminalKeys"]

KEY_S: Final = 0.2
KEY_LINE: Final = "hold W A S D or the arrows (Q E: third axis); space stops; + and - change the speed; X ends"
_STEP: Final = 0.1
_FOCUS_LOST: Final = "\x1b[O"
_KEYS: Final = {
    **dict.fromkeys(("w", "\x1b[A", "\x1bOA"), ("ahead", 1)),
    **dict.fromkeys(("s", "\x1b[B", "\x1bOB"), ("ahead", -1)),
    **dict.fromkeys(("a", "\x1b[D", "\x1bOD"), ("turn", 1)),
    **dict.fromkeys(("d", "\x1b[C", "\x1bOC"), ("turn", -1)),
    "q": ("third", 1),
    "e": ("third", -1),
}
_TOKEN: Final = re.compile(r"\x1b(?:[\[O][0-?]*[ -/]*[@-~])|.", re.DOTALL)
_AHEAD: Final = re.compile(r"(linear|linear_x|x|forward|ahead|vx|speed|translation)$", re.IGNORECASE)
_TURN: Final = re.compile(r"(angular|angular_z|yaw|turn|rotation|steering|wz|rz)$", re.IGNORECASE)


class KeyRequest(Enum):
    """What a person asks for beside driving."""

    NOTHING = 0
    END = 1
    AWAY = 2
    """The terminal has lost the focus."""


class Controls:
    """Which axis each control drives: by its name where that says it, else in the order of the axes."""

    def __init__(self, axes: Sequence[str]) -> None:
        free = list(range(len(axes)))

        def take(wanted: re.Pattern[str] | None) -> int | None:
            for place in free:
                if wanted is None or wanted.match(axes[place]):
                    free.remove(place)
                    return place
            return None

        ahead, turn = take(_AHEAD), take(_TURN)
        self._places = {
            "ahead": take(None) if ahead is None else ahead,
            "turn": take(None) if turn is None else turn,
        }
        self._places["third"] = take(None)
        self._axes = len(axes)

    def values(self, control: str, sign: int, speeds: Sequence[float], share: float) -> list[float]:
        """The speed of each axis while one control is held."""
        values = [0.0] * self._axes
        place = self._places.get(control)
        if place is not None:
            values[place] = sign * share * speeds[place]
        return values


class TerminalKeys:
    """What is held at a terminal."""

    def __init__(self, share: float) -> None:
        """Begin with nothing."""
        self.share = share
        """The part of each axis' speed that a key stands for."""
        self._held: tuple[str, int] = "", 0
        self._until = 0.0

    def type(self, text: str, now: float) -> KeyRequest:
        """Take what was typed."""
        for token in _TOKEN.findall(text):
            key = token.lower() if len(token) == 1 else token
            if key in ("x", "\x1b", "\x04"):
                self._held = "", 0
                return KeyRequest.END
            if token == _FOCUS_LOST:
                self._held = "", 0
                return KeyRequest.AWAY
            if key in "+=" or key == "-":
                step = -_STEP if key == "-" else _STEP
                self.share = min(1.0, max(_STEP, round(self.share + step, 1)))
            elif key in _KEYS:
                self._held, self._until = _KEYS[key], now + KEY_S
            elif not key.startswith("\x1b["):
                self._held = "", 0  # the space bar, and whatever was hit in a hurry
        return KeyRequest.NOTHING

    def held(self, now: float) -> tuple[str, int]:
        """The control that is held, and to which side; empty: none."""
        return self._held if now < self._until else ("", 0)
